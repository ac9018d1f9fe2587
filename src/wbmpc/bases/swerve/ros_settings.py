"""Settings of a swerve robot's controller on a ROS 2 bus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from wbmpc.bases.swerve.defaults import SwerveCost
from wbmpc.ros2.settings import NUMBERS, RosSettings, Topics


class SwerveTopics(Topics):
    """``legs``, ``brakes`` and ``leg_configuration`` are what the service ``set_legs`` does, as topics."""

    requests: ClassVar[Mapping[str, str]] = {
        **Topics.requests, "legs": "sensor_msgs/msg/JointState", "brakes": NUMBERS, "leg_configuration": "std_msgs/msg/String",
    }  # fmt: skip
    services: ClassVar[tuple[str, ...]] = ("set_legs",)

    legs: str = "/legs"
    brakes: str = "/brakes"
    leg_configuration: str = "/leg_configuration"
    set_legs: str = "/set_legs"


class SwerveRosSettings(RosSettings):
    """``use_gyro``: whether the odometry takes the yaw rate from the inertial unit; ``leg_guard``: whether open legs that do not move
    as planned are held by their brakes."""

    topics: SwerveTopics = SwerveTopics()
    cost: SwerveCost = SwerveCost()
    use_gyro: bool = True
    leg_guard: bool = True
