"""The simulated robot on wheels of a base, on a ROS 2 bus: speeds in, encoders and inertial unit out."""

from __future__ import annotations

from wbmpc.bases.planar_motion.messages import PlanarCommand
from wbmpc.ros2.plants import RosPlant


class PlanarRosPlant(RosPlant):
    """Of speeds."""

    Command = PlanarCommand
