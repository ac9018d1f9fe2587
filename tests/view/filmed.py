"""A short recording to show: the swerve robot of a session, which holds its end effector for a second."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from wbmpc.model.robot import load_robot
from wbmpc.recording.recorder import Recorder
from wbmpc.simulation.lockstep import Watch, run_lockstep
from wbmpc.view.session import system_of


def record(folder: Path, *watchers: Any) -> Any:
    """Writes ``folder/run.mcap``, with other watchers before the recorder; returns the MPC."""
    recorder = Recorder(
        folder / "run.mcap", {"run": {"experiment": "toy", "seed": 1, "settings": '{"robot": "swerve-ur10"}'}}
    )
    plant, controller, mpc, timing = system_of(load_robot("swerve-ur10"), 1).parts
    watch = Watch(None, (*watchers, recorder))
    ending = run_lockstep(plant, controller, mpc, timing, 1.0, lambda *_: None, watch)
    assert ending.reason == ""
    recorder.close({"completed": "true"})
    return mpc


@cache
def _film() -> bytes:
    with TemporaryDirectory() as folder:
        record(Path(folder))
        return (Path(folder) / "run.mcap").read_bytes()


def copy_film(folder: Path) -> None:
    """Writes ``folder/run.mcap``: of a run that is made once for all tests of this process."""
    (folder / "run.mcap").write_bytes(_film())
