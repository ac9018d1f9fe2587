"""Settings of a ball robot's controller on a ROS 2 bus."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from wbmpc.bases.ball.defaults import RezeroCost
from wbmpc.bases.ball.settings import LEARNED, STEPS_AND_PUSHES, BallControllerSettings
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.settings import RosSettings, WrenchLimits
from wbmpc.settings import MpcSettings

_DEFAULT = BallControllerSettings()
#: Of wheels on a ball [rad/s]: 3 m/s of the ball, for its description limits torques only.
WHEEL_SPEED = 50.0


class BallRosSettings(RosSettings):
    """Torques, their own problem; rate and weights of :class:`BallControllerSettings`. ``estimate_disturbance``: of constant disturbances;
    ``expected_push_time`` [s]: how much longer a detected push is expected to last, for which the lean leaves room (0: pushes are ignored);
    ``max_pushed_speed`` [m/s]: a ball that goes faster under a strong force that lasts ends the run."""

    mpc: MpcSettings = _DEFAULT.mpc
    cost: RezeroCost = STEPS_AND_PUSHES
    wrench: WrenchLimits | None = WrenchLimits()
    estimate_disturbance: bool = True
    expected_push_time: float = Field(_DEFAULT.expected_push_time, ge=0, le=1.0)
    max_pushed_speed: Annotated[float, LEARNED] = Field(_DEFAULT.max_pushed_speed, ge=0.01, le=100)

    def joint_speeds(self, robot: RobotModel, group: str) -> np.ndarray:
        """The arm's limits are limits of the state; the wheels' are guessed."""
        if group == "wheel":
            return np.full(len(robot.input.groups["wheel"]), WHEEL_SPEED)
        return robot.limits.state_upper[robot.state[f"{group}_velocity"]]
