"""A simulated ball robot with its controller and MPC: what views and first runs start from."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import rezero_mpc
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.ball.settings import PUSHED_SPEED, STEPS_AND_PUSHES, mpc_settings
from wbmpc.bases.base import System
from wbmpc.default_problem import hold
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.world import Obstacles
from wbmpc.ocp import Reference
from wbmpc.settings import ACTUATOR_TIME_CONSTANT, COMPUTATION_DELAY, CONTROL_RATE, MpcSettings
from wbmpc.types import Timing


def make_mpc(robot: RobotModel, obstacles: Obstacles | None = None, **changes: Any) -> MPC:
    """The MPC whose goal is the equilibrium at home; ``changes`` of its settings."""
    settings = MpcSettings(**{**mpc_settings(barrier_mu=3e-2).model_dump(), **changes})
    home, torque = ball_base(robot).numeric.equilibrium(robot.home[robot.state["arm"]])
    mpc = rezero_mpc(robot, settings, STEPS_AND_PUSHES, obstacles)
    mpc.reference["body"] = Reference.constant(robot.home)
    mpc.reference["twist"] = Reference.constant(np.zeros(6))
    mpc.reference["torque"] = Reference.constant(torque)
    hold(mpc, *robot.pose(home))
    mpc.reset(home, torque)
    return mpc


def make_system(robot: RobotModel, plant: BallPlant, mpc: MPC) -> System:
    """Controller of a plant that rests in its equilibrium."""
    arm = robot.home[robot.state["arm"]]
    _, torque = ball_base(robot).numeric.equilibrium(arm)
    timing = Timing.of(plant.timestep, CONTROL_RATE, mpc.rate, COMPUTATION_DELAY)
    controller = BallController(robot, mpc, torque, timing.period, DriveSettings(ACTUATOR_TIME_CONSTANT))
    controller.lean_control = LeanControl(robot, arm, STEPS_AND_PUSHES.lean, PUSHED_SPEED)
    return System(plant, controller, mpc, timing)
