"""Settings of controllers on a ROS 2 bus whose drives take speeds and whose problem is the default one."""

from __future__ import annotations

from wbmpc.default_problem import DefaultCost, default_mpc_settings
from wbmpc.ros2.settings import RosSettings
from wbmpc.settings import MpcSettings


class FixedRosSettings(RosSettings):
    """``cost``: weights that scale with the robot."""

    mpc: MpcSettings = default_mpc_settings()
    cost: DefaultCost = DefaultCost()


class PlanarRosSettings(FixedRosSettings):
    """``cost``: weights that scale with the robot; ``use_gyro``: whether the odometry takes the yaw rate from the inertial unit."""

    use_gyro: bool = True
