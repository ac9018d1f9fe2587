"""An arm that no plan moves stays where it is, whatever it carries. Truth: the joints of the simulation."""

import numpy as np
import pytest

from wbmpc import load_robot
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.log import Log
from wbmpc.studies.pankert2022 import reference_drive
from wbmpc.studies.pankert2022.reference_drive import SwerveCalibrateSettings, drive
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.types import Timing

LOADED = SwervePerturbation(payload=10.0)
#: How far a joint may give way [rad]: drives that hold a speed of 0 lose twice as much in these 2 s under this load.
GIVES = 0.02


def moved(plant: SwervePlant, start: np.ndarray) -> float:
    """How far [rad] a joint of the arm is from where it was at most."""
    return float(np.abs(arm_of(plant) - start).max())


def arm_of(plant: SwervePlant) -> np.ndarray:
    return np.array(plant.data.qpos[plant._q["arm"]])


def test_a_loaded_arm_stays_while_the_robot_stands() -> None:
    robot = load_robot("swerve-ur10")
    plant = SwervePlant(robot.description, robot.state.split(robot.home), LOADED, 0)
    controller = SwerveController(robot, plant.truth().pose, 2.5e-3)
    start = arm_of(plant)
    stand_still(plant, controller, Timing.of(plant.timestep, 400.0, 50.0, 0.0), 2.0)
    assert moved(plant, start) < GIVES


def test_a_loaded_arm_stays_while_wheels_are_calibrated(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the first phase of the drive, in which the base stands."""
    phases = reference_drive._phases
    monkeypatch.setattr(reference_drive, "_phases", lambda robot, settings: phases(robot, settings)[:1])
    robot = load_robot("swerve-ur10")
    settings = SwerveCalibrateSettings(plant=LOADED, settle_time=2.0)
    _, plant, reason = drive(robot, settings, 0, Log(), odometry=False)
    assert reason == "" and moved(plant, robot.state.split(robot.home)["arm"]) < GIVES
