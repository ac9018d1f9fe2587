"""One run of a study, where a worker does it: what comes in and goes out is small and plain."""

from __future__ import annotations

import shlex
import shutil
import socket
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from wbmpc import __version__
from wbmpc.errors import InputError, NotWritten, RunAborted, described
from wbmpc.interrupts import in_main_thread
from wbmpc.recording.recorder import Recorder
from wbmpc.report import RECORDING, about_run, commit, outcome, write_run
from wbmpc.result import RunResult
from wbmpc.simulation.lockstep import Watch
from wbmpc.study.plan import assignments, open_experiment, settings_of

#: Outcomes without a result, which a study that goes on tries again: an error of the program, a worker that died.
ERROR, LOST = "error", "lost"
#: What a row says of each metric beside its value.
ABOUT_METRIC = ("unit", "paper", "goal", "least", "larger_is_better")
#: Bytes of a run's recording, at most.
RECORD_LIMIT = 500_000_000
#: Packages that change no figure of an experiment.
_NOT_FIGURES = ("cli", "study", "view", "ros2", "benchmark", "embedded")


@cache
def code_hash() -> str:
    """A hash of the source that figures are of."""
    root, total = Path(__file__).parents[1], sha256()
    for path in sorted(p for p in root.rglob("*.py") if p.relative_to(root).parts[0] not in _NOT_FIGURES):
        total.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return total.hexdigest()[:12]


def execute(task: Mapping[str, Any]) -> dict[str, Any]:
    """Do a run and return its row: outcome, metrics with units and targets, times, version, commit, host.

    ``task``: ``source`` of the experiment, ``changes`` of its settings, ``seed``; ``files``: directory of report and recording
    (None: there are none), which with ``keep`` "failed" is removed again after a run that completed. Where the disk is full the row has
    ``unwritten``: it says nothing of the robot, and the run is to be repeated.
    """
    began, spent, started = time.perf_counter(), time.process_time(), datetime.now(UTC)
    directory = None if task["files"] is None else Path(task["files"])
    try:
        found = _result(task, directory)
    except InputError as error:
        found = {"outcome": "rejected", "reason": str(error)}
    except NotWritten as error:
        found = {"outcome": ERROR, "reason": str(error), "unwritten": True}
    except RunAborted as error:
        found = {"outcome": "gave_up", "reason": str(error)}
    except BaseException as error:  # Ctrl-C comes to the main thread alone: in a worker's a program has raised it
        if in_main_thread() and not isinstance(error, Exception):
            raise
        found = {"outcome": ERROR, "reason": described(error)}
    unwanted = "unwritten" in found or (found["outcome"] == "completed" and task["keep"] == "failed")
    if directory is not None and unwanted:
        shutil.rmtree(directory, ignore_errors=True)
        directory = None
    about = {"version": __version__, "commit": commit(), "code": code_hash(), "host": socket.gethostname()}
    times = {
        "started": started.isoformat(timespec="milliseconds"),
        "wall_time": time.perf_counter() - began,
        "cpu_time": time.process_time() - spent,
    }
    return {**found, **times, **about, "files": "" if directory is None else str(directory)}


def _result(task: Mapping[str, Any], directory: Path | None) -> dict[str, Any]:
    experiment = open_experiment(task["source"])
    settings = settings_of(experiment, task["changes"], experiment.name)
    if directory is None:
        return _row(experiment.run(settings, task["seed"], None))
    shutil.rmtree(directory, ignore_errors=True)  # of a run that was killed
    try:
        directory.mkdir(parents=True)
    except OSError as error:
        raise NotWritten(f"{directory}: cannot be written ({error.strerror})") from error
    name, seed, plain = experiment.name, task["seed"], settings.model_dump(mode="json")
    recorder = Recorder(directory / RECORDING, about_run(name, seed, plain), RECORD_LIMIT)
    began, gave_up = time.perf_counter(), None
    try:
        try:
            result = experiment.run(settings, seed, Watch(None, (recorder,)))
        except RunAborted as error:
            result, gave_up = RunResult.aborted(name, seed, str(error), plain), error
        result.command, result.wall_time = command(task), time.perf_counter() - began
        recorder.close(outcome(result))
        if recorder.failure:
            raise NotWritten(recorder.failure)
        result.motion = recorder.motion
        write_run(result, directory)
    finally:
        recorder.close({"completed": "false", "reason": "an error of the program"})
    if gave_up is not None:
        raise gave_up
    return _row(result)


def command(task: Mapping[str, Any]) -> str:
    """The line that repeats a run alone."""
    changes = [word for setting in assignments(task["changes"]) for word in ("--set", setting)]
    return shlex.join(["wbmpc", "run", task["source"], "--seed", str(task["seed"]), *changes])


def _row(result: RunResult) -> dict[str, Any]:
    if result.interrupted:  # a run that the user ended is no result
        raise KeyboardInterrupt
    metrics = result.metrics.items()
    row: dict[str, Any] = {
        "outcome": result.outcome,
        "reason": result.reason,
        "metrics": {name: float(m.value) for name, m in metrics},
        "about": {name: {key: getattr(m, key) for key in ABOUT_METRIC} for name, m in metrics},
    }
    if result.mpc is not None:
        solve = {f"solve_ms_{k}": float(v) for k, v in result.mpc.solve_ms.items()}
        counts = {"solves": result.mpc.solves, "deadline_misses": result.mpc.deadline_misses}
        row["timing"] = {**solve, **counts, "failed_share": result.mpc.failed_share}
    return row


def lost(reason: str) -> dict[str, Any]:
    """The row of a run whose worker died."""
    return {"outcome": LOST, "reason": reason}
