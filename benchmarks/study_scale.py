"""A study of a million runs: what is shipped and kept for each run, and how many workers one scheduler keeps busy.

Usage: python benchmarks/study_scale.py runs/NAME [--runs 1000000] [--workers 1000] [--latency 0.001]
Bytes and times are those of a finished study's folder. What the client (this program: hands over, keeps rows) and Dask's scheduler
spend on a run is measured here, with a run that returns such a row at once. A simulation of events then has both as single servers
between the workers: a worker waits from the end of its run until the next one has come.
"""

from __future__ import annotations

import argparse
import heapq
import json
import pickle
import tempfile
import time
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.study.files import ROWS
from wbmpc.study.store import Store
from wbmpc.study.workers import Cluster, completed

#: Mean lengths of runs [s] that are simulated, and runs that each simulation has at most.
LENGTHS, SIMULATED = (1.0, 3.0, 10.0, 60.0), 200_000
TRIED, AT_ONCE = 2000, 100


def answer(task: dict[str, Any]) -> dict[str, Any]:
    """A run that takes no time."""
    row: dict[str, Any] = task["row"]
    return row


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """Rows of a finished study as its workers returned them."""
    table = Store(folder).table()
    names = [n for n in table.column_names if n.startswith("metric.")]
    units = {n: (table.schema.field(n).metadata or {}).get(b"unit", b"1").decode() for n in names}
    about = {n.removeprefix("metric."): {"unit": units[n], "paper": None, "goal": 0.001, "least": None} for n in names}
    kept = ("key", "experiment", "condition", "robot", "seed", "draw", "outcome", "reason", "started", "wall_time", "cpu_time", "version",
            "commit", "code", "host", "files")  # fmt: skip
    rows = []
    for found in table.to_pylist():
        row = {name: found[name] for name in kept} | {"about": about, "changes": json.loads(found["changes"])}
        row["metrics"] = {n.removeprefix("metric."): found[n] for n in names}
        row["varied"] = {n.removeprefix("set."): v for n, v in found.items() if n.startswith("set.")}
        row["timing"] = {
            n: v for n, v in found.items() if n.startswith("solve") or n in ("deadline_misses", "failed_share")
        }
        rows.append(row)
    return rows


def bytes_of(folder: Path, rows: list[dict[str, Any]]) -> dict[str, float]:
    """Per run: what goes to a worker, what comes back, what is kept while the study runs and in the end."""
    task = {
        "key": rows[0]["key"],
        "source": "hold",
        "changes": rows[0]["changes"],
        "seed": 1,
        "files": None,
        "keep": "none",
    }
    size = lambda thing: len(pickle.dumps(thing, protocol=5))
    with tempfile.TemporaryDirectory() as made:
        many = [_another(row, k) for k in range(20_000 // len(rows)) for row in rows]
        with Store(Path(made)) as store:
            for row in many:
                store.add(row)
            store.finish()
        whole = (Path(made) / ROWS).stat().st_size / len(many)
    line = np.mean([len(json.dumps(row, separators=(",", ":"))) + 1 for row in rows])
    return {
        "task": size(task),
        "row": float(np.mean([size(row) for row in rows])),
        "journal": float(line),
        "parquet": whole,
    }


def _another(row: dict[str, Any], seed: int) -> dict[str, Any]:
    """A row with other figures: equal ones would take no room."""
    vary = np.random.default_rng(seed).uniform(0.5, 1.5, len(row["metrics"]) + len(row["timing"]) + 2)
    figures = dict(zip((*row["metrics"], *row["timing"], "wall_time", "cpu_time"), vary, strict=True))
    scaled = {part: {n: v and v * figures[n] for n, v in row[part].items()} for part in ("metrics", "timing")}
    times = {n: row[n] * figures[n] for n in ("wall_time", "cpu_time")}
    return {**row, **scaled, **times, "key": f"{row['key']}.{seed}", "seed": seed}


def overheads(rows: list[dict[str, Any]]) -> dict[str, float]:
    """CPU seconds per run of client and scheduler, which share this process; the worker has one of its own."""
    from distributed import Client, LocalCluster

    work = lambda first, n: ({"key": f"{k}", "row": rows[k % len(rows)]} for k in range(first, first + n))
    with (
        tempfile.TemporaryDirectory() as made,
        Store(Path(made)) as store,
        LocalCluster(n_workers=1, threads_per_worker=AT_ONCE, dashboard_address=None, silence_logs=50) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        for first, n in ((0, 50), (50, TRIED)):  # the first ones import what is needed
            began, spent = time.perf_counter(), time.process_time()
            for task, row in completed(Cluster(client), answer, work(first, n)):
                store.add({**row, "key": task["key"]})
        both, wall = (time.process_time() - spent) / TRIED, (time.perf_counter() - began) / TRIED
    return {"client and scheduler": both, "keeping the row": _keeping(rows), "round trip": wall}


def _keeping(rows: list[dict[str, Any]]) -> float:
    """CPU seconds per row of the store."""
    with tempfile.TemporaryDirectory() as made:
        began = time.process_time()
        with Store(Path(made)) as store:
            for k in range(10_000):
                store.add({**rows[k % len(rows)], "key": f"{k}"})
            store.finish()
        return (time.process_time() - began) / 10_000


@dataclass(frozen=True)
class Servers:
    """Seconds that a run takes of the client and of the scheduler, and of each way between two machines."""

    client: float
    scheduler: float
    latency: float


def simulate(servers: Servers, workers: int, runs: int, length: float, seed: int = 0) -> dict[str, float]:
    """Runs of random length (half of the mean fixed, half exponential) on ``workers``: share of the time in which they work, runs per
    second, largest number of ended runs that wait."""
    rng, number = np.random.default_rng(seed), count()
    draw = lambda: length * (0.5 + rng.exponential(0.5))
    client = scheduler = 0.0
    # (time, order, kind, length): "ended" comes to the scheduler, "result" to the client, "submit" to the scheduler again
    events: list[tuple[float, int, str]] = [(0.0, next(number), "submit") for _ in range(min(workers, runs))]
    heapq.heapify(events)
    left, working, done, waiting, most, now = runs - len(events), 0.0, 0, 0, 0, 0.0
    while events:
        now, _, kind = heapq.heappop(events)
        if kind == "ended":
            waiting += 1
            most = max(most, waiting)
            scheduler = max(scheduler, now) + 0.5 * servers.scheduler
            heapq.heappush(events, (scheduler + servers.latency, next(number), "result"))
        elif kind == "result":
            client = max(client, now) + servers.client
            waiting, done = waiting - 1, done + 1
            if left:
                left -= 1
                heapq.heappush(events, (client + servers.latency, next(number), "submit"))
        else:
            scheduler = max(scheduler, now) + 0.5 * servers.scheduler
            takes = draw()
            working += takes
            heapq.heappush(events, (scheduler + 2.0 * servers.latency + takes, next(number), "ended"))
    return {
        "length": length,
        "busy": working / (workers * now),
        "rate": done / now,
        "waiting": most,
        "hours": now / 3600.0,
    }


def main() -> None:
    """Measure, simulate, print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of a finished study")
    parser.add_argument("--runs", type=int, default=1_000_000)
    parser.add_argument("--workers", type=int, default=1000)
    parser.add_argument("--latency", type=float, default=1e-3, help="of a message between two machines [s]")
    given = parser.parse_args()
    rows = rows_of(given.folder)
    size, spent = bytes_of(given.folder, rows), overheads(rows)
    print("bytes per run:", ", ".join(f"{name} {value:.0f}" for name, value in size.items()))
    print(f"{given.runs} runs:", ", ".join(f"{name} {value * given.runs / 1e9:.2f} GB" for name, value in size.items()))
    print("seconds per run:", ", ".join(f"{name} {value:.2e}" for name, value in spent.items()))
    half = 0.5 * (spent["client and scheduler"] - spent["keeping the row"])
    servers = Servers(half + spent["keeping the row"], half, given.latency)
    print(
        f"simulated: {given.workers} workers, client {servers.client:.1e} s, scheduler {servers.scheduler:.1e} s a run"
    )
    print(
        "| length of a run [s] | workers busy [%] | runs per second | ended runs that wait, at most | hours for all |\n|"
        + " --- |" * 5
    )
    for length in LENGTHS:
        few = min(given.runs, SIMULATED)
        found = simulate(servers, given.workers, few, length)
        hours = given.runs / found["rate"] / 3600.0
        print(f"| {length:g} | {100 * found['busy']:.0f} | {found['rate']:.0f} | {found['waiting']} | {hours:.1f} |")


if __name__ == "__main__":
    main()
