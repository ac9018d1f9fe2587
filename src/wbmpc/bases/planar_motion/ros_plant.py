"""The simulated robot on wheels of a base, on a ROS 2 bus: speeds in, encoders and inertial unit out."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.messages import PlanarCommand
from wbmpc.ros2.plants import Reading, RosPlant


class PlanarRosPlant(RosPlant):
    """Of speeds."""

    def command(self, groups: dict[str, Array]) -> PlanarCommand:
        return PlanarCommand(groups["wheel"], groups["arm"], groups.get("steer", np.zeros(0)))

    def read(self) -> Reading:
        m = self.plant.measure()
        counted = self.robot.description.base.takes_twist  # by the base's own driver
        wheel, way = (np.zeros(0), m.wheel) if counted else (m.wheel, None)
        joints = {"leg": np.zeros(0), "steer": m.steer, "wheel": wheel, "arm": m.arm}
        self.last = Reading(joints, m.gyro, m.accel, way=way)
        return self.last
