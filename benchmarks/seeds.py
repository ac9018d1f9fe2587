"""Both main experiments over a range of seeds: how the runs ended; median, 5 %, 95 % and worst of every metric of those that completed.

Usage: python benchmarks/seeds.py [--seeds 300-319] [--json FILE]
The seeds 0 to 19 were used for tuning; 300 to 319 are for reporting.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.registry import REGISTRY
from wbmpc.result import RunResult


def statistics(values: list[float]) -> dict[str, float]:
    """Median, 5 %, 95 % and largest value."""
    low, middle, high = np.percentile(values, [5, 50, 95])
    return {"median": float(middle), "p5": float(low), "p95": float(high), "worst": float(np.max(values))}


def summary(runs: Sequence[RunResult]) -> dict[str, Any]:
    """``outcomes``: how many runs ended how; ``metrics``: statistics of those that completed. What a run measured before it failed says
    nothing about the whole."""
    done = [run for run in runs if run.completed]
    names = dict.fromkeys(name for run in done for name in run.metrics)
    metrics = {name: statistics([r.metrics[name].value for r in done if name in r.metrics]) for name in names}
    solves = [run.mpc.solve_ms["median"] for run in done if run.mpc is not None]
    if solves:
        metrics["solve_ms"] = statistics(solves)
    return {"outcomes": dict(Counter(run.outcome for run in runs)), "metrics": metrics}


def show(title: str, entry: dict[str, Any]) -> None:
    """Print a :func:`summary`."""
    print(f"\n{title}: {', '.join(f'{count} {name}' for name, count in entry['outcomes'].items())}")
    print(f"{'metric':34s}{'median':>12s}{'5 %':>12s}{'95 %':>12s}{'worst':>12s}")
    for metric, s in entry["metrics"].items():
        print(f"{metric:34s}{s['median']:12.4g}{s['p5']:12.4g}{s['p95']:12.4g}{s['worst']:12.4g}")
    print(flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="300-319", help="first-last")
    parser.add_argument("--json", type=Path, help="also write the table to this file")
    parser.add_argument("--only", nargs="*", default=["swerve-track", "rezero-steps"])
    given = parser.parse_args()
    first, last = (int(s) for s in given.seeds.split("-"))
    table: dict[str, dict[str, Any]] = {}
    for name in given.only:
        experiment, runs = REGISTRY[name], []
        for seed in range(first, last + 1):
            runs.append(experiment.run(experiment.config_type(), seed, None))
            print(f"{name} seed {seed}: {runs[-1].outcome} {runs[-1].reason}", flush=True)
        table[name] = summary(runs)
        show(f"{name}, seeds {given.seeds}", table[name])
    if given.json is not None:
        given.json.write_text(json.dumps(table, indent=2) + "\n")


if __name__ == "__main__":
    main()
