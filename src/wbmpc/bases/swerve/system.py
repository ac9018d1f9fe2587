"""A simulated swerve robot with its controller and MPC: what views and first runs start from."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.base import System
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import StateCost, SwerveCost, swerve_mpc
from wbmpc.bases.swerve.goal_guess import GoalGuess
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Reference
from wbmpc.settings import MpcSettings
from wbmpc.simulation.lockstep import Timing

#: Rate of the controller [Hz], drive lag that it assumes [s].
CONTROL_RATE, DRIVE_LAG = 400.0, 0.020
#: Legs pull harder than in tracking: their configuration is asked for, not left over.
LEG_WEIGHT = 20.0


def make_system(robot: RobotModel, plant: SwervePlant) -> System:
    """Controller and MPC of a plant that stands at home, with home as their goal."""
    settings = MpcSettings(horizon=4.0, intervals=40)
    mpc = swerve_mpc(robot, settings, SwerveCost(state=StateCost(leg=LEG_WEIGHT)), GoalGuess(robot))
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [position], orientation)
    mpc.reference["state"] = Reference.constant(robot.home)
    mpc.reference["input"] = Reference.constant(np.zeros(robot.input.size))
    timing = Timing.of(plant.timestep, CONTROL_RATE, settings.rate, settings.computation_delay)
    controller = SwerveController(robot, plant.truth().pose, timing.period, tracking=TrackingSettings(lag=DRIVE_LAG))
    mpc.reset(robot.home)
    return System(plant, controller, mpc, timing)
