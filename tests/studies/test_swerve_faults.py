"""Brakes that fail in the swerve robots' experiments. Truth: faults put into their monitors, which the results must report."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from toys import robot
from wbmpc import experiment
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.brake_monitor import BrakeFault
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.experiment import Outcome
from wbmpc.log import Log
from wbmpc.registry import REGISTRY
from wbmpc.robots import load_description
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.pankert2022 import brake_tests
from wbmpc.studies.pankert2022 import brakes as swerve_brakes
from wbmpc.studies.pankert2022 import drive as swerve_drive
from wbmpc.studies.pankert2022 import fixed as swerve_fixed
from wbmpc.studies.pankert2022 import plaster as swerve_plaster
from wbmpc.studies.pankert2022 import track as swerve_track
from wbmpc.studies.pankert2022 import unified as swerve_unified
from wbmpc.studies.pankert2022.drive_missions import SwerveDriveSettings
from wbmpc.studies.pankert2022.fixed_motions import Motion, SwerveFixedSettings
from wbmpc.studies.pankert2022.mission_run import MissionRun

SWERVE = robot("swerve-ur10")
FAULT = BrakeFault(1.0, 0, "leg_LF", "does not hold", 0.01)
EARLY = Ending("stopped before its first tick")


def no_mpc(*_: Any, **__: Any) -> Any:
    """What an experiment needs of an MPC that is never asked: compiling one takes a second."""
    figures = SimpleNamespace(solve_times=[], solves=0, failures=0, no_step=0)
    idle = lambda *_: None
    ocp = SimpleNamespace(dynamics=SWERVE)
    return SimpleNamespace(
        rate=50.0, statistics=figures, reference={}, ocp=ocp, dynamics=SWERVE, reset=idle, set_schedule=idle
    )


@pytest.mark.parametrize("module", [swerve_track, swerve_plaster, swerve_unified])
def test_what_the_controller_found_is_in_the_result(module: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def found(plant: Any, controller: Any, *_: Any) -> Ending:
        assert controller.supervision.report is not None  # the plan is to count with it
        controller.supervision.monitor.real.append(FAULT)
        return EARLY

    monkeypatch.setattr(experiment, "run_lockstep", found)
    for name in ("swerve_mpc", "MPC"):
        if hasattr(module, name):
            monkeypatch.setattr(module, name, no_mpc)
    found_by = REGISTRY[module.NAME]
    more: dict[Any, dict[str, Any]] = {swerve_plaster: {"calibration": "none", "passes": 1}}
    sure = more.get(module, {"calibration": "none"})
    result = found_by.run(found_by.config_type(settle_time=0.0, **sure), 0, None)
    assert result.faults == [str(FAULT)]


def test_what_parts_found_is_in_the_result_with_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    found = SimpleNamespace(faults=[FAULT], holds=0)
    monkeypatch.setattr(
        MissionRun, "planned", lambda self, name, *_, **__: (Outcome(EARLY, found.faults, found, no_mpc()), None)
    )
    assert swerve_drive.EXPERIMENT.run(SwerveDriveSettings(calibration="none"), 0).faults == [f"tour: {FAULT}"]
    monkeypatch.setattr(swerve_fixed, "swerve_mpc", no_mpc)
    monkeypatch.setattr(swerve_fixed, "drive", lambda name, *_: Outcome(faults=[str(FAULT)] if name == "ik" else []))
    settings = SwerveFixedSettings(motions=("forward",), random_time=0.0, calibration="none")
    assert swerve_fixed.EXPERIMENT.run(settings, 0).faults == [f"ik: {FAULT}"]


def test_what_the_baseline_found_is_in_the_result_but_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """The goal is for the monitor beside the MPC."""
    counted: list[int] = []

    def planned(run: Any, name: str, *_: Any, **__: Any) -> Any:
        run.log.add(f"{name}.base", 0.0, np.zeros(3))
        return Outcome(controller=SimpleNamespace(faults=[], holds=0), mpc=no_mpc()), None

    monkeypatch.setattr(MissionRun, "planned", planned)
    monkeypatch.setattr(swerve_drive, "metrics", lambda log, robot, faults, *_: counted.append(len(faults)) or {})
    monkeypatch.setattr(swerve_drive, "plots", lambda *_: [])
    lockstep = lambda plant, controller, *_: controller.supervision.monitor.real.append(FAULT) or Ending()
    monkeypatch.setattr(experiment, "run_lockstep", lockstep)
    result = swerve_drive.EXPERIMENT.run(SwerveDriveSettings(settle_time=0.0, calibration="none"), 0)
    assert result.faults == [f"baseline: {FAULT}"] and counted == [0]


@pytest.mark.parametrize("name", ["ik", "four_wheel"])
def test_what_the_baselines_of_hinged_legs_found_is_handed_on(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        experiment,
        "run_lockstep",
        lambda plant, controller, *_: controller.supervision.monitor.real.append(FAULT) or EARLY,
    )
    settings = SwerveFixedSettings(motions=("forward",), random_time=0.0, settle_time=0.0, calibration="none")
    motion = Motion.of(settings, 0)
    outcome = swerve_fixed.drive(name, settings, 0, SWERVE, motion, EstimatorSettings(), None, Log())
    assert (outcome.ending, [str(fault) for fault in outcome.faults]) == (EARLY, [str(FAULT)])


def test_swerve_brakes_reports_what_nobody_made_fail_and_was_not_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leg 2 is made to fail; of leg 0 one fault was taken back, of leg 1 none. An alarm that was taken back is still one."""
    fault = lambda leg, t: BrakeFault(t, leg, f"leg {leg}", "does not open", 0.2)
    back, own, wrong, sound = fault(2, 1.0), fault(2, 2.5), fault(0, 1.5), fault(1, 3.0)
    monitor: Any = SimpleNamespace(faults=[back, wrong, own, sound], real=[own, sound])
    found = brake_tests.Found.of(monitor, 2, 0.5)
    assert found == brake_tests.Found(2.0, [wrong, sound], [sound])
    assert brake_tests.Found.of(monitor, None, 0.5).time == np.inf
    for part in ("push", "slip_torque", "slide_force"):
        monkeypatch.setattr(brake_tests, part, lambda bench, *_: bench.log.add("pushed", 0.0, 0.0) or 0.0)
    monkeypatch.setattr(brake_tests, "fault", lambda *_: found)
    monkeypatch.setattr(swerve_brakes, "_plots", lambda *_: [])
    result = swerve_brakes.EXPERIMENT.run(brake_tests.SwerveBrakesSettings(), 0)
    assert result.metrics["false_alarms"].value == 6.0 and result.metrics["fault_detection_time_open"].value == 2.0
    kinds = ("sound", "stuck closed", "stuck open")
    assert result.faults == [f"a brake that is {kind}: {sound}" for kind in kinds]


def test_swerve_brakes_makes_its_faults_itself() -> None:
    """What its monitor rightly found of another brake would count as a false alarm, and the pushes mean brakes that hold."""
    with pytest.raises(InputError, match=r"unknown key 'plant\.brake_fault'"):
        configure(swerve_brakes.SwerveBrakesSettings, ["plant.brake_fault=open"], "swerve-brakes")


def test_a_ball_robot_has_no_brakes() -> None:
    with pytest.raises(InputError, match=r"plant\.brake_fault: .* does not read it"):
        BallPlant(load_description("rezero"), perturbation=AnyPerturbation(brake_fault="open"))


@pytest.mark.parametrize("name", ["leg=2", "time=5"])
def test_a_fault_that_no_brake_has_is_rejected(name: str) -> None:
    """Nothing would come of it."""
    settings = swerve_track.SwerveTrackSettings
    with pytest.raises(InputError, match=rf"plant.brake_fault.{name[:-2]}: nothing uses it without .*brake_fault=open"):
        configure(settings, [f"plant.brake_fault.{name}"], "swerve-track")
    given = [f"plant.brake_fault.{name}", "plant.brake_fault=open"]
    assert configure(settings, given, "swerve-track").plant.brake_fault.kind == "open"
