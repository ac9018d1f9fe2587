"""Both main experiments over a range of seeds: median, 5 %, 95 % and worst of every metric, as a table and as JSON.

Usage: python benchmarks/seeds.py [--seeds 200-219] [--json FILE]
The seeds 0 to 19 were used for tuning; 200 to 219 are for reporting.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from wbmpc.registry import REGISTRY


def statistics(values: list[float]) -> dict[str, float]:
    """Median, 5 %, 95 % and largest value."""
    low, middle, high = np.percentile(values, [5, 50, 95])
    return {"median": float(middle), "p5": float(low), "p95": float(high), "worst": float(np.max(values))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="200-219", help="first-last")
    parser.add_argument("--json", type=Path, help="also write the table to this file")
    parser.add_argument("--only", nargs="*", default=["swerve-track", "rezero-steps"])
    given = parser.parse_args()
    first, last = (int(s) for s in given.seeds.split("-"))
    table: dict[str, dict[str, dict[str, float]]] = {}
    for name in given.only:
        experiment = REGISTRY[name]
        runs = []
        for seed in range(first, last + 1):
            result = experiment.run(experiment.config_type(), seed, None)
            runs.append(result)
            print(f"{name} seed {seed}: {'completed' if result.completed else result.reason}", flush=True)
        table[name] = {k: statistics([r.metrics[k].value for r in runs]) for k in runs[0].metrics}
        solves = [r.mpc.solve_ms["median"] for r in runs if r.mpc is not None]
        if solves:
            table[name]["solve_ms"] = statistics(solves)
        print(f"\n{name}, seeds {given.seeds}\n{'metric':34s}{'median':>12s}{'5 %':>12s}{'95 %':>12s}{'worst':>12s}")
        for metric, s in table[name].items():
            print(f"{metric:34s}{s['median']:12.4g}{s['p5']:12.4g}{s['p95']:12.4g}{s['worst']:12.4g}")
        print(flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(table, indent=2) + "\n")


if __name__ == "__main__":
    main()
