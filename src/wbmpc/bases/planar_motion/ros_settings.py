"""Settings of the controller of a robot on wheels of a base on a ROS 2 bus."""

from __future__ import annotations

from wbmpc.default_problem import DefaultCost, default_settings
from wbmpc.ros2.settings import RosSettings
from wbmpc.settings import MpcSettings


class PlanarRosSettings(RosSettings):
    """``cost``: weights that scale with the robot; ``use_gyro``: whether the odometry takes the yaw rate from the inertial unit."""

    mpc: MpcSettings = default_settings()
    cost: DefaultCost = DefaultCost()
    use_gyro: bool = True
