"""Settings of a ball robot's controller on a ROS 2 bus."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.ball.defaults import RezeroCost
from wbmpc.bases.ball.settings import STEPS_AND_PUSHES, ExpectedPush, PushedDisturbance, mpc_settings
from wbmpc.configuration import OneOf
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.settings import RosSettings, WrenchLimits
from wbmpc.settings import MpcSettings, Nothing

#: Of wheels on a ball [rad/s]: 3 m/s of the ball, for its description limits torques only.
WHEEL_SPEED = 50.0


class BallRosSettings(ExpectedPush, RosSettings):
    """Torques, their own problem, for steps and pushes. ``disturbance``: whether constant ones are estimated (:class:`PushedDisturbance`), or
    none."""

    mpc: MpcSettings = mpc_settings(barrier_mu=3e-2)
    cost: RezeroCost = STEPS_AND_PUSHES
    wrench: WrenchLimits | None = WrenchLimits()
    disturbance: OneOf[Nothing | PushedDisturbance] = PushedDisturbance()

    def joint_speeds(self, robot: RobotModel, group: str) -> np.ndarray:
        """The arm's limits are limits of the state; the wheels' are guessed."""
        if group == "wheel":
            return np.full(len(robot.input.groups["wheel"]), WHEEL_SPEED)
        return robot.limits.state_upper[robot.state[f"{group}_velocity"]]
