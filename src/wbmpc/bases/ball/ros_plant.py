"""The simulated ball robot's side of a ROS 2 bus: torques in, encoders and inertial unit out."""

from __future__ import annotations

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.plants import RosPlant
from wbmpc.types import Truth


class BallRosPlant(RosPlant):
    """Of torques. It is held until the first ones come."""

    def __init__(self, robot: RobotModel, plant: BallPlant) -> None:
        super().__init__(robot, plant)
        self.imu_at = plant.sensors.mount

    def command(self, groups: dict[str, Array]) -> BallCommand:
        return BallCommand(np.concatenate([groups["wheel"], groups["arm"]]))

    def base(self, truth: Truth) -> tuple[Array, Array]:
        """Position and quaternion of the base, which leans; its frame is the ball's center."""
        rotation = truth.tool_rotation @ truth.tool_rotation_in_base.T
        return np.array([*truth.pose[:2], self.lift]), lie.rotation_to_quaternion(rotation)
