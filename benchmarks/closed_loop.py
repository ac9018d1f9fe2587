"""Closed loops of both robots: simulated seconds per CPU second, and microseconds of a controller's tick, part by part.

Usage: python benchmarks/closed_loop.py [--only swerve ball] [--repeat 3] [--no-recording] [--json FILE] [--profile FILE]. Times are CPU
times of the whole process, so that other programs do not count, but threads of a linear algebra library do. Of the repeats the fastest counts.
"Undisturbed" is the tenth percentile of a part's calls. On a machine that others use a core's own speed changes too: a fixed piece of work
is timed now and then, and "corrected" figures are those at the speed at which it was fastest.
"""

from __future__ import annotations

import argparse
import cProfile
import gc
import hashlib
import json
import tempfile
import time
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

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
#: The fixed piece of work: so long a sum, every so many ticks.
WORK, EVERY = 3000, 10


class Stopwatch:
    """A watcher that times the parts of the last loop of a run, which is its task; ``seconds`` by part, ``loop`` its whole."""

    def __init__(self, recorder: Recorder | None, profile: cProfile.Profile | None) -> None:
        self.recorder, self.profile = recorder, profile
        self.seconds: dict[str, list[float]] = {}
        self.simulated = self.loop = 0.0
        self.work: list[float] = []

    def begin(self, running: Running) -> None:
        objects = {
            "controller": running.controller,
            "mpc": running.mpc,
            "plant": running.plant,
            "watcher": self.recorder,
        }
        for name, owner in objects.items():
            for method in PARTS[name] if owner is not None else ():
                setattr(owner, method, self._timed(f"{name}.{method}", getattr(owner, method)))
        self.simulated, self._ticks = running.duration, 0
        gc.collect()
        if self.profile is not None:
            self.profile.enable()
        self._start = time.process_time()

    def _timed(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        clock, note = time.process_time, self.seconds.setdefault(part, []).append
        if self.profile is not None:
            return call

        @wraps(call)
        def timed(*arguments: Any) -> Any:
            start = clock()
            found = call(*arguments)
            note(clock() - start)
            return found

        return timed

    def tick(self, t: float, command: Any, plans: Any) -> None:
        self._ticks += 1
        if self._ticks % EVERY == 0 and self.profile is None:
            start = time.process_time()
            sum(k * k % 7 for k in range(WORK))
            self.work.append(time.process_time() - start)

    def end(self, ending: Ending) -> None:
        self.loop = time.process_time() - self._start - sum(self.work)
        if self.profile is not None:
            self.profile.disable()


def measured(name: str, recording: bool, profile: cProfile.Profile | None = None) -> dict[str, Any]:
    """Figures of one run."""
    experiment, settings = RUNS[name]
    kind = REGISTRY[experiment]
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder) / "run.mcap", {}, 2**31) if recording else None
        watch = Stopwatch(recorder, profile)
        watchers = (watch,) if recorder is None else (recorder, watch)
        begun = time.process_time()
        result = kind.run(configure(kind.config_type, settings, experiment), SEED, Watch(None, watchers))
        whole = time.process_time() - begun
        if recorder is not None:
            recorder.close({})
    slow = sum(watch.work) / len(watch.work) if watch.work else 1.0
    ticks = max(len(watch.seconds.get("controller.measure", ())), 1)
    parts = {part: 1e6 * sum(calls) / ticks for part, calls in watch.seconds.items()}
    # of the tenth of its calls that were fastest, the slowest: what a part takes where nobody disturbs it
    quick = {
        part: 1e6 * sorted(calls)[len(calls) // 10] * len(calls) / ticks
        for part, calls in watch.seconds.items()
        if calls
    }
    metrics = {k: m.value for k, m in result.metrics.items()}
    return {
        "experiment": experiment, "settings": settings, "completed": result.completed, "simulated_s": watch.simulated,
        "simulated_per_cpu_second": watch.simulated / watch.loop, "with_preparation": watch.simulated / whole,
        "controller_us": sum(v for k, v in parts.items() if k.startswith("controller.")),
        "controller_undisturbed_us": sum(v for k, v in quick.items() if k.startswith("controller.")), "undisturbed_us_per_tick": quick,
        "work_s": slow, "fastest_work_s": min(watch.work, default=1.0),
        "parts_us_per_tick": {**parts, "rest": 1e6 * watch.loop / ticks - sum(parts.values())}, "metrics": metrics,
        "digest": hashlib.sha256(json.dumps(metrics, sort_keys=True).encode()).hexdigest()[:16],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=list(RUNS), choices=list(RUNS))
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--no-recording", action="store_true", help="without run.mcap, as in tests")
    parser.add_argument(
        "--work", type=float, help="time [s] of the fixed piece of work on the idle machine, if it is known"
    )
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--profile", type=Path, help="write cProfile's statistics of the loops there; no times")
    given = parser.parse_args()
    if given.profile is not None:
        profile = cProfile.Profile(time.process_time)
        for name in given.only:
            measured(name, not given.no_recording, profile)
        profile.dump_stats(given.profile)
        return
    found: dict[str, Any] = {}
    for name in given.only:
        runs = [measured(name, not given.no_recording) for _ in range(given.repeat)]
        best = found[name] = max(runs, key=lambda run: run["simulated_per_cpu_second"])
        for key in ("controller_us", "controller_undisturbed_us"):
            best[key] = min(run[key] for run in runs)
        fastest = given.work or min(run["fastest_work_s"] for run in runs)
        best["corrected"] = {
            "simulated_per_cpu_second": max(run["simulated_per_cpu_second"] * run["work_s"] for run in runs) / fastest,
            "controller_us": min(run["controller_us"] / run["work_s"] for run in runs) * fastest,
        }
        print(
            f"{name}: {best['experiment']} {' '.join(best['settings'])}: {best['simulated_per_cpu_second']:.2f} simulated s per CPU s "
            f"({best['with_preparation']:.2f} with preparation), controller {best['controller_us']:.0f} µs per tick, "
            f"undisturbed {best['controller_undisturbed_us']:.0f}"
        )
        corrected = best["corrected"]
        print(
            f"  corrected: {corrected['simulated_per_cpu_second']:.2f} simulated s per CPU s, controller {corrected['controller_us']:.0f} µs "
            f"per tick; the machine was {best['work_s'] / fastest:.2f} times slower than at its fastest ({1e6 * fastest:.0f} µs)"
        )
        for part, us in best["parts_us_per_tick"].items():
            quick = best["undisturbed_us_per_tick"].get(part)
            print(f"  {part:20s}{us:8.1f} µs per tick" + ("" if quick is None else f", undisturbed {quick:8.1f}"))
        print(f"  metrics {best['digest']}", flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
