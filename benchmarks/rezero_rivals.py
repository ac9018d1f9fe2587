"""The ball robot's MPC against its rivals: gains by the same search on tuning seeds, one table on reporting seeds.

Usage: python benchmarks/rezero_rivals.py [--search lqr|scheduled-lqr] [--seeds 200-203] [--json FILE].
Without --search: the table; runs that are in FILE are not repeated.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from wbmpc.configuration import configure
from wbmpc.experiments import REGISTRY

CONTROLLERS = ("mpc", "lqr", "scheduled-lqr")
GRID: dict[str, tuple[float, ...]] = {
    "hand": (1.0, 0.3, 0.1, 0.03),
    "torque": (1.0, 3.0, 10.0),
    "damping": (1.0, 3.0, 10.0),
    "most": (0.1, 0.3, 0.03),
}
RUNS: dict[str, tuple[str, list[str]]] = {
    "pushes, hand held": ("rezero-push-hand", []),
    "pushes, ball held": ("rezero-push-ball", []),
    "steps": ("rezero-steps", []),
}
SHOWN = ("not_recovered", "rise_time_max", "steady_position_error_max", "hand_error_max", "tilt_max", "fell")


def run(name: str, seed: int, controller: str, assignments: list[str]) -> dict[str, Any]:
    """Metrics of one run, and why it ended."""
    experiment = REGISTRY[name]
    settings = configure(experiment.config_type, [f"controller={controller}", *assignments], name)
    result = experiment.run(settings, seed, None)
    return {"reason": result.reason, **{k: m.value for k, m in result.metrics.items()}}


def loss(controller: str, gains: dict[str, float], seeds: range) -> float:
    """Pushes after which the hand was not back, and how far [m] it was pushed away at most, summed over the seeds."""
    given = ["forces=[100, 150, 200]", "settle=2", "pause=5", *(f"rival.{k}={v}" for k, v in gains.items())]
    found = [run("rezero-push-hand", seed, controller, given) for seed in seeds]
    return sum(f["not_recovered"] + f["hand_error_max"] for f in found)


def search(controller: str, seeds: range) -> None:
    """Coordinate search from ones."""
    gains = {key: values[0] for key, values in GRID.items()}
    best = loss(controller, gains, seeds)
    print(f"{controller} {gains}: {best:.2f}", flush=True)
    for key, values in GRID.items():
        for value in values[1:]:
            found = loss(controller, {**gains, key: value}, seeds)
            print(f"{controller} { ({**gains, key: value}) }: {found:.2f}", flush=True)
            if found < best:
                best, gains = found, {**gains, key: value}
    print(f"best: {gains}: {best:.2f}")


def table(seeds: range, file: Path) -> None:
    """Worst of the seeds for each controller and run."""
    done: dict[str, dict[str, Any]] = json.loads(file.read_text()) if file.exists() else {}
    for label, (name, given) in RUNS.items():
        for controller in CONTROLLERS:
            for seed in seeds:
                key = f"{label}, {controller}, {seed}"
                if key not in done:
                    done[key] = run(name, seed, controller, given)
                    file.write_text(json.dumps(done, indent=1) + "\n")
            rows = [done[f"{label}, {controller}, {seed}"] for seed in seeds]
            worst = {k: max(r[k] for r in rows) for k in SHOWN if k in rows[0]}
            fallen = sum(r["fell"] for r in rows)
            print(
                f"{label:20s} {controller:14s} fell {fallen:.0f} of {len(rows)}; worst: "
                + ", ".join(f"{k} {v:.4g}" for k, v in worst.items()),
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--search", choices=CONTROLLERS[1:])
    parser.add_argument("--seeds", help="first-last; left out: 0-0 for the search, 200-203 for the table")
    parser.add_argument("--json", type=Path, default=Path("rezero_rivals.json"))
    given = parser.parse_args()
    first, last = (int(s) for s in (given.seeds or ("0-0" if given.search else "200-203")).split("-"))
    seeds = range(first, last + 1)
    if given.search:
        search(given.search, seeds)
    else:
        table(seeds, given.json)


if __name__ == "__main__":
    main()
