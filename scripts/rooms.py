"""The table of docs/results/rooms.md, from runs of the study `rooms`.

Usage: python scripts/rooms.py [--study runs/rooms] [--page docs/results/rooms.md]
`wbmpc study rooms --out runs/rooms` makes them. Rooms count in which every method has a run: all do the same ones.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
from figures import publish, row

ROOT = Path(__file__).parents[1]
METHODS = {"alone": "MPC alone", "alternatives": "MPC with alternatives", "planner": "planner and MPC"}
HEAD = ("things", "method", "rooms", "passed", "stuck", "touched", "arrival [s]", "least clearance [mm]", "solve [ms]",
        "alternatives [s]", "planning [s]")  # fmt: skip
Row = dict[str, Any]


def shared(rows: list[Row]) -> list[Row]:
    """Rows of rooms in which every method has one."""
    room = lambda r: (r["set.things"], r["seed"])
    done = [{room(r) for r in rows if r["condition"] == method} for method in METHODS]
    return [r for r in rows if room(r) in set.intersection(*done)]


def cells(things: str, method: str, rows: list[Row]) -> list[str]:
    """One line: counts, and medians (arrival: of the runs that passed; clearance: the least of all)."""
    median = lambda name, factor=1.0, digits=1: f"{factor * np.median([r.get(name) or 0.0 for r in rows]):.{digits}f}"
    passed = [r for r in rows if r["metric.passed"] == 1.0]
    arrival = f"{np.median([r['metric.arrival_time'] for r in passed]):.1f}" if passed else "–"
    return [
        things, METHODS[method], str(len(rows)), str(len(passed)), str(sum(r["outcome"] in ("stuck", "declined") for r in rows)),
        str(sum(r["metric.obstacle_contacts"] > 0 for r in rows)), arrival,
        f"{1e3 * min(r['metric.obstacle_clearance_min'] for r in rows):.0f}", median("metric.solve_time_mean", 1e3),
        median("metric.alternatives_computation", digits=2), median("metric.planning_time", digits=2),
    ]  # fmt: skip


def table(rows: list[Row]) -> str:
    """A line for each method, of each number of things and of all."""
    rows = shared(rows)
    if not rows:
        raise SystemExit("rooms: there is no room in which every method has a run")
    seeds = sorted({int(r["seed"]) for r in rows})
    commits = ", ".join(sorted({str(r["commit"]) for r in rows}))
    text = (
        f"### Success, clearance and time\nSeeds {seeds[0]} to {seeds[-1]}, commit {commits}.\n\n"
        + row(HEAD)
        + "|"
        + " --- |" * len(HEAD)
        + "\n"
    )
    for things in [*sorted({int(r["set.things"]) for r in rows}), "all"]:
        for method in METHODS:
            mine = [r for r in rows if r["condition"] == method and things in ("all", r["set.things"])]
            text += row(cells(str(things), method, mine))
    return text


def main() -> None:
    """Put the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", type=Path, default=ROOT / "runs" / "rooms")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "results" / "rooms.md")
    given = parser.parse_args()
    file = given.study / "runs.parquet"
    if not file.is_file():
        raise SystemExit(f"rooms: there is no {file}; wbmpc study rooms --out {given.study}")
    publish(given.page, "rooms", table(pyarrow.parquet.read_table(file).to_pylist()))


if __name__ == "__main__":
    main()
