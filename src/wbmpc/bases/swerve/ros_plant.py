"""The simulated swerve robot's side of a ROS 2 bus: speeds and brakes in, encoders and inertial unit out."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.convert import upright
from wbmpc.ros2.plants import Reading, RosPlant
from wbmpc.ros2.settings import drive_groups
from wbmpc.types import Truth


class SwerveRosPlant(RosPlant):
    """Of speeds and brakes."""

    def __init__(self, robot: RobotModel, plant: SwervePlant) -> None:
        super().__init__(robot, plant)
        self._sizes = {"brake": 0} | {g: len(names) for g, names in drive_groups(robot).items()}

    def rest(self) -> dict[str, Array]:
        """Everything at rest, brakes closed."""
        return {g: np.zeros(n) for g, n in self._sizes.items()}

    def command(self, groups: dict[str, Array]) -> SwerveCommand:
        """Commands of the drives; four brakes for fixed legs, as the plant expects them."""
        return SwerveCommand(**groups)

    def read(self) -> Reading:
        """What the sensors say."""
        m = self.plant.measure()
        self.last = Reading({"leg": m.leg, "steer": m.steer, "wheel": m.wheel, "arm": m.arm}, m.gyro, m.accel)
        return self.last

    def base(self, truth: Truth) -> tuple[Array, Array]:
        """Position and quaternion of the base."""
        return upright(truth.pose, self.robot.base.body_height)
