"""Closed loops of both robots: simulated seconds per CPU second, and microseconds of a controller's tick, part by part.

Usage: python benchmarks/closed_loop.py [--only swerve ball] [--against SRC] [--no-recording] [--json FILE] [--profile FILE]. Times are CPU
times of the whole process, so that other programs do not count, but threads of a linear algebra library do: medians of turns of 0.2 s.
A core's own speed changes while others use the machine, so two versions are compared in one run only: ``--against`` runs the package
in SRC (another checkout's ``src``) beside this one, in turns.
"""

from __future__ import annotations

import argparse
import cProfile
import gc
import hashlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import wraps
from pathlib import Path
from typing import Any

import wbmpc
from wbmpc.configuration import configure
from wbmpc.recording.recorder import Recorder
from wbmpc.registry import REGISTRY
from wbmpc.simulation.lockstep import Ending, Running, Watch

#: What is run: an experiment, its settings.
RUNS = {
    "swerve": ("swerve-track", ["periods=1"]),
    "ball": ("rezero-circle", ["rounds=1"]),
}
#: Parts of a loop that are timed, by the object that has them.
PARTS = {
    "controller": ("measure", "predict", "command"), "mpc": ("update",), "plant": ("measure", "step"),
    "watcher": ("tick",),
}  # fmt: skip
SEED = 200
#: Ticks of a turn: two plans at 10 Hz, and a chunk of a recording.
TURN = 80


class Stopwatch:
    """A watcher that times the parts of a loop: after every turn it writes their times per tick [µs] as a line of JSON, and waits for a
    line before the next."""

    def __init__(self, recorder: Recorder | None, profile: cProfile.Profile | None) -> None:
        self.recorder, self.profile = recorder, profile
        self.seconds: dict[str, float] = {}
        self._ticks, self._start = 0, 0.0

    def begin(self, running: Running) -> None:
        owners = {
            "controller": running.controller,
            "mpc": running.mpc,
            "plant": running.plant,
            "watcher": self.recorder,
        }
        for name, owner in owners.items():
            for method in PARTS[name] if owner is not None and self.profile is None else ():
                self.seconds[f"{name}.{method}"] = 0.0
                setattr(owner, method, self._timed(f"{name}.{method}", getattr(owner, method)))
        self._period = running.timing.period
        gc.collect()
        if self.profile is not None:
            self.profile.enable()
        else:
            self._turn()

    def _timed(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        clock, seconds = time.process_time, self.seconds

        @wraps(call)
        def timed(*arguments: Any) -> Any:
            start = clock()
            found = call(*arguments)
            seconds[part] += clock() - start
            return found

        return timed

    def _turn(self) -> None:
        if self._ticks:
            whole = time.process_time() - self._start
            parts = {**self.seconds, "rest": whole - sum(self.seconds.values()), "whole": whole}
            parts["controller"] = sum(v for k, v in parts.items() if k.startswith("controller."))
            per_tick = {part: 1e6 * seconds / TURN for part, seconds in parts.items()}
            print(json.dumps(per_tick | {"speed": TURN * self._period / whole}), flush=True)
        sys.stdin.readline()
        self.seconds.update(dict.fromkeys(self.seconds, 0.0))
        self._start = time.process_time()

    def tick(self, t: float, command: Any, plans: Any) -> None:
        self._ticks += 1
        if self._ticks % TURN == 0 and self.profile is None:
            self._turn()

    def end(self, ending: Ending) -> None:
        if self.profile is not None:
            self.profile.disable()


def run(name: str, recording: bool, profile: cProfile.Profile | None = None) -> str:
    """Run a loop; a hash of its metrics, which are the same of versions that do the same."""
    experiment, settings = RUNS[name]
    kind = REGISTRY[experiment]
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder) / "run.mcap", {}, 2**31) if recording else None
        watch = Stopwatch(recorder, profile)
        watchers = (watch,) if recorder is None else (recorder, watch)
        result = kind.run(configure(kind.config_type, settings, experiment), SEED, Watch(None, watchers))
        if recorder is not None:
            recorder.close({})
    metrics = {k: m.value for k, m in result.metrics.items()}
    return hashlib.sha256(json.dumps(metrics, sort_keys=True).encode()).hexdigest()[:16]


def turns(name: str, sources: list[str], recording: bool, most: float) -> Iterator[list[Any]]:
    """The turns of the packages in ``sources``, one after the other: times per tick of each; in the end, where they are not more than
    ``most``, the hashes of their metrics."""
    command = [sys.executable, __file__, "--only", name, "--child", *([] if recording else ["--no-recording"])]
    runs = [
        subprocess.Popen(
            command, env=os.environ | {"PYTHONPATH": s}, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for s in sources
    ]
    answers: list[Any] = [None]
    try:
        while not isinstance(answers[0], str) and most > 0:
            answers, most = [], most - 1
            for child in runs:
                assert child.stdin is not None and child.stdout is not None
                child.stdin.write("\n")
                child.stdin.flush()
                answers.append(json.loads(child.stdout.readline()))
            yield answers
    finally:
        for child in runs:
            child.kill()
            child.communicate()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=list(RUNS), choices=list(RUNS))
    parser.add_argument("--against", metavar="SRC", help="a package to compare with, turn by turn")
    parser.add_argument("--turns", type=float, default=float("inf"), help="so many at most, instead of a whole run")
    parser.add_argument("--no-recording", action="store_true", help="without run.mcap, as in tests")
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--profile", type=Path, help="write cProfile's statistics of the loops there; no times")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        print(json.dumps(run(given.only[0], not given.no_recording)))
        return
    if given.profile is not None:
        profile = cProfile.Profile(time.process_time)
        for name in given.only:
            run(name, not given.no_recording, profile)
        profile.dump_stats(given.profile)
        return
    found: dict[str, Any] = {}
    here = str(Path(wbmpc.__file__).parents[1])
    sources = [here] if given.against is None else [given.against, here]
    for name in given.only:
        *rows, hashes = turns(name, sources, not given.no_recording, given.turns + 1)
        if not isinstance(hashes[0], str):
            hashes = ["(not the whole run)"]
        parts = {
            key: [statistics.median(row[i][key] for row in rows) for i in range(len(sources))] for key in rows[0][0]
        }
        ratios = {key: statistics.median(row[-1][key] / max(row[0][key], 1e-9) for row in rows) for key in rows[0][0]}
        found[name] = {
            "run": RUNS[name],
            "seed": SEED,
            "sources": sources,
            "medians": parts,
            "ratios": ratios,
            "metrics": hashes,
        }
        print(
            f"{name}: {RUNS[name][0]} {' '.join(RUNS[name][1])}, {len(rows)} turns; medians; metrics {' '.join(hashes)}"
        )
        for key, values in parts.items():
            unit = "simulated s per CPU s" if key == "speed" else "µs per tick"
            ratio = "" if len(values) == 1 else f"   ratio {ratios[key]:.3f}"
            print(f"  {key:20s}" + "".join(f"{v:9.2f}" for v in values) + f" {unit}{ratio}", flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
