"""The simulated swerve robot's side of a ROS 2 bus: speeds and brakes in, encoders and inertial unit out."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.ros2.plants import Reading, RosPlant


class SwerveRosPlant(RosPlant):
    """Of speeds and brakes."""

    def rest(self) -> dict[str, Array]:
        return {"brake": np.zeros(0)} | super().rest()

    def command(self, groups: dict[str, Array]) -> SwerveCommand:
        """Commands of the drives; four brakes for fixed legs, as the plant expects them."""
        return SwerveCommand(**groups)

    def read(self) -> Reading:
        m = self.plant.measure()
        self.last = Reading({"leg": m.leg, "steer": m.steer, "wheel": m.wheel, "arm": m.arm}, m.gyro, m.accel)
        return self.last
