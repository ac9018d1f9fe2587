"""A simulated ball robot with its controller and MPC: what views and first runs start from."""

from __future__ import annotations

from typing import Any

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import rezero_mpc, set_home_references
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.ball.settings import PUSHED_SPEED, STEPS_AND_PUSHES, mpc_settings
from wbmpc.default_problem import hold
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.world import Obstacles
from wbmpc.settings import ACTUATOR_TIME_CONSTANT, MpcSettings


def make_mpc(robot: RobotModel, obstacles: Obstacles | None = None, **changes: Any) -> MPC:
    """The MPC whose goal is the equilibrium at home; ``changes`` of its settings."""
    settings = MpcSettings(**{**mpc_settings(barrier_mu=3e-2).model_dump(), **changes})
    home, torque = ball_base(robot).numeric.equilibrium(robot.home[robot.state["arm"]])
    mpc = rezero_mpc(robot, settings, STEPS_AND_PUSHES, obstacles)
    set_home_references(mpc, robot, torque)
    hold(mpc, *robot.pose(home))
    mpc.reset(home, torque)
    return mpc


def make_controller(robot: RobotModel, mpc: MPC, period: float) -> BallController:
    """Of a plant that rests in its equilibrium; its goals are set while it runs."""
    arm = robot.home[robot.state["arm"]]
    _, torque = ball_base(robot).numeric.equilibrium(arm)
    controller = BallController(robot, mpc, torque, period, DriveSettings(ACTUATOR_TIME_CONSTANT))
    controller.learned.lean_control = LeanControl(robot, arm, STEPS_AND_PUSHES.lean, PUSHED_SPEED)
    return controller
