"""Settings of a swerve robot's controller on a ROS 2 bus."""

from __future__ import annotations

from wbmpc.bases.swerve.defaults import SwerveCost
from wbmpc.ros2.settings import RosSettings


class SwerveRosSettings(RosSettings):
    """``use_gyro``: whether the odometry takes the yaw rate from the inertial unit; ``leg_guard``: whether open legs that do not move
    as planned are held by their brakes."""

    cost: SwerveCost = SwerveCost()
    use_gyro: bool = True
    leg_guard: bool = True
