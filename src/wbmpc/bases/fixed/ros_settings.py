"""Settings of the controller of an arm on a base that does not move, on a ROS 2 bus."""

from __future__ import annotations

from wbmpc.default_problem import DefaultCost, default_settings
from wbmpc.ros2.settings import RosSettings
from wbmpc.settings import MpcSettings


class FixedRosSettings(RosSettings):
    """``cost``: weights that scale with the robot."""

    mpc: MpcSettings = default_settings()
    cost: DefaultCost = DefaultCost()
