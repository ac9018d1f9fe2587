"""Brakes that fail in the swerve robots' experiments. Truth: faults put into their monitors, which the results must tell."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from toys import robot
from wbmpc.errors import InputError
from wbmpc.estimation import BrakeFault
from wbmpc.experiments import REGISTRY, swerve_drive, swerve_fixed, swerve_plaster, swerve_track, swerve_unified
from wbmpc.loop import Ending
from wbmpc.plant import Perturbation, RezeroPlant
from wbmpc.robots import load_description

SWERVE = robot("swerve-ur10")
FAULT = BrakeFault(1.0, 0, "leg_LF", "does not hold", 0.01)
EARLY = Ending("stopped before its first tick")


def no_mpc(*_: Any, **__: Any) -> Any:
    """What an experiment needs of an MPC that is never asked: compiling one takes a second."""
    figures = SimpleNamespace(solve_times=[], solves=0, failures=0, no_step=0)
    idle = lambda *_: None
    return SimpleNamespace(
        rate=50.0, statistics=figures, reference={}, ocp=SimpleNamespace(dynamics=SWERVE), reset=idle, set_schedule=idle
    )


@pytest.mark.parametrize("module", [swerve_track, swerve_plaster, swerve_unified])
def test_what_the_agent_found_is_in_the_result(module: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def found(plant: Any, agent: Any, *_: Any) -> Ending:
        assert agent.faulty is not None  # the plan is to count with it
        agent.monitor.real.append(FAULT)
        return EARLY

    monkeypatch.setattr(module, "run_lockstep", found)
    for name in ("swerve_mpc", "MPC"):
        if hasattr(module, name):
            monkeypatch.setattr(module, name, no_mpc)
    experiment = REGISTRY[module.NAME]
    more: dict[Any, dict[str, Any]] = {swerve_unified: {}, swerve_plaster: {"calibration": "none", "passes": 1}}
    sure = more.get(module, {"calibration": "none"})
    result = experiment.run(experiment.config_type(rest=0.0, **sure), 0, None)
    assert result.faults == [str(FAULT)]


def test_what_parts_found_is_in_the_result_with_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        swerve_drive._Run, "planned", lambda self, name, *_, **__: (EARLY, no_mpc(), [f"{name}: {FAULT}"], None)
    )
    assert swerve_drive.run(swerve_drive.SwerveDriveSettings(), 0).faults == [f"tour: {FAULT}"]
    monkeypatch.setattr(swerve_fixed, "swerve_mpc", no_mpc)
    monkeypatch.setattr(swerve_fixed, "drive", lambda name, *_: (EARLY, [str(FAULT)] if name == "ik" else []))
    settings = swerve_fixed.SwerveFixedSettings(motions=("forward",), random=0.0)
    assert swerve_fixed.run(settings, 0).faults == [f"ik: {FAULT}"]


def test_a_ball_robot_has_no_brakes() -> None:
    with pytest.raises(InputError, match=r"plant\.brake_fault: is for swerve robots only"):
        RezeroPlant(load_description("rezero"), perturbation=Perturbation(brake_fault="open"))
