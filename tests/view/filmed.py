"""A short recording to show: the swerve robot of a session, which holds its end effector for a second."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from wbmpc.model.robot import load_robot
from wbmpc.recording.recorder import Recorder
from wbmpc.simulation.lockstep import Watch, run_lockstep
from wbmpc.view.session import system_of


def record(folder: Path, *watchers: Any) -> Any:
    """Writes ``folder/run.mcap``, with other watchers before the recorder; returns the MPC."""
    recorder = Recorder(folder / "run.mcap", {"run": {"experiment": "toy", "seed": 1}})
    plant, controller, mpc, timing = system_of(load_robot("swerve-ur10"), 1).parts
    watch = Watch(None, (*watchers, recorder))
    ending = run_lockstep(plant, controller, mpc, timing, 1.0, lambda *_: None, watch)
    assert ending.reason == ""
    recorder.close({"completed": "true"})
    return mpc
