"""The simulated swerve robot's side of a ROS 2 bus: speeds and brakes in, encoders and inertial unit out."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.ros2.plants import RosPlant


class SwerveRosPlant(RosPlant):
    """Of speeds and brakes."""

    Command = SwerveCommand

    def rest(self) -> dict[str, Array]:
        return {"brake": np.zeros(0)} | super().rest()
