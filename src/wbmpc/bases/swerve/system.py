"""A simulated swerve robot with its controller and MPC: what views and first runs start from."""

from __future__ import annotations

from typing import Any

from wbmpc.bases.base import Calibration, System
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import StateCost, SwerveCost, swerve_mpc
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.goal_guess import GoalGuess
from wbmpc.bases.swerve.path_guess import PathGuess
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.default_problem import stay_at_home
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.world import Obstacles
from wbmpc.settings import ACTUATOR_TIME_CONSTANT, COMPUTATION_DELAY, CONTROL_RATE, MpcSettings, StabilitySettings
from wbmpc.types import Timing

#: Legs pull harder than in tracking: their configuration is asked for, not left over.
LEG_WEIGHT = 20.0


def make_mpc(
    robot: RobotModel, obstacles: Obstacles | None = None, stability: StabilitySettings | None = None, *,
    progress: str | None = None, **changes: Any,
) -> MPC:  # fmt: skip
    """The MPC whose goal is home; ``changes`` of its settings."""
    settings = MpcSettings(**{"horizon": 4.0, "intervals": 40, **changes})
    cost, guess = SwerveCost(state=StateCost(leg=LEG_WEIGHT)), PathGuess(robot) if progress else GoalGuess(robot)
    mpc = swerve_mpc(
        robot, settings, cost, guess, obstacles=obstacles, stability=stability, progress=progress, self_clearance=True
    )
    stay_at_home(robot, mpc)
    return mpc


def make_system(robot: RobotModel, plant: SwervePlant, mpc: MPC, calibration: Calibration | None = None) -> System:
    """Controller of a plant that stands at home; ``calibration`` of its wheels (:class:`WheelCalibration`)."""
    timing = Timing.of(plant.timestep, CONTROL_RATE, mpc.rate, COMPUTATION_DELAY)
    wheels = None if calibration is None else WheelCalibration(**calibration)
    controller = SwerveController(
        robot,
        plant.truth().pose,
        timing.period,
        tracking=TrackingSettings(lag=ACTUATOR_TIME_CONSTANT),
        estimation=EstimatorSettings(calibration=wheels),
    )
    return System(plant, controller, mpc, timing)
