"""One call from an MPC of one's own to a closed loop with its report, recording and live view."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from wbmpc.configuration import describe
from wbmpc.errors import InputError
from wbmpc.experiment import run_scenario
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.recording.recorder import Recorder
from wbmpc.report import RECORDING, RUN_FILES, about_run, outcome, write_run
from wbmpc.result import RunResult
from wbmpc.simulation.lockstep import Watch, Watcher
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.loop import check_loop, closed_loop
from wbmpc.tasks.settings import SimulationSettings
from wbmpc.view.live import View


def simulate(
    robot: RobotModel,
    mpc: MPC,
    duration: float,
    seed: int = 0,
    *,
    name: str = "simulation",
    out: str | Path | None = None,
    view: bool = False,
    since: float = 0.0,
    **settings: Any,
) -> RunResult:
    """Run ``mpc``, with its costs, constraints and references, on a simulated ``robot`` for ``duration`` [s]. ``seed`` of all random
    numbers; ``name`` of the run in files and in the view.

    In MuJoCo by default: plant perturbed against the model, noisy sensors, drives with lag, delay. ``settings`` are those of
    :class:`wbmpc.tasks.settings.SimulationSettings`: ``plant="kinematic"`` for the model itself, ``plant={"mass": 0}``,
    ``computation_delay``. ``out``: a directory for metrics.json, log.npz, report.html and run.mcap (default: no files); ``view``: show it
    in a browser, in real time; ``since`` [s]: metrics of errors start then. Raises :class:`InputError` for bad settings, and for a
    directory that already has a run. A run that ends early is returned with its reason.
    """
    try:
        chosen = SimulationSettings(**settings)
    except ValidationError as error:
        raise InputError(f"simulate: {describe(error, SimulationSettings)}") from error
    check_loop(robot, mpc, duration, seed, since, chosen)
    if not isinstance(name, str) or not name.isprintable():
        raise InputError(f"simulate: name: a text that can be printed is needed, got {name!r}")
    directory = None if out is None else _directory(out)
    watchers: list[Watcher] = []
    with ExitStack() as open_things:
        if view:
            shown = View(name, opened=lambda url: print(f"the view is at {url}"))
            open_things.callback(shown.close)
            watchers.append(shown)
        recorder = None
        if directory is not None:
            recorder = Recorder(directory / RECORDING, about_run(name, seed, chosen.model_dump(mode="json")))
            watchers.append(recorder)
        build = lambda kept, seed: closed_loop(robot, mpc, duration, seed, kept, since=since)
        result = run_scenario(name, build, chosen, seed, Watch(None, tuple(watchers)), DEFINITIONS)
        if directory is not None and recorder is not None:
            recorder.close(outcome(result))
            result.motion = recorder.motion
            write_run(result, directory)
    return result


def _directory(out: str | Path) -> Path:
    """Raises :class:`InputError` where a run's files are already."""
    if not isinstance(out, str | Path):
        raise InputError(f"simulate: out: the path of a directory is needed, got {out!r}")
    path = Path(out)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"simulate: out: '{path}' cannot be made ({error.strerror})") from error
    except ValueError as error:  # a name that no file system takes
        raise InputError(f"simulate: out: {out!r} cannot be made ({error})") from error
    present = [file for file in RUN_FILES if os.path.lexists(path / file)]  # nor links
    if present:
        raise InputError(f"simulate: out: '{path}' has a run already ('{present[0]}'); give another directory")
    return path
