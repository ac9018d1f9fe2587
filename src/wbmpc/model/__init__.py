"""Robot models: layouts, bases, kinematics, dynamics."""

from wbmpc.model.augment import DriveLag, FrequencyShaping, InputFilter, InputRate
from wbmpc.model.door import DoorGeometry, WithDoor
from wbmpc.model.equations import Equations
from wbmpc.model.held_arm import ServoedArm
from wbmpc.model.layout import Layout
from wbmpc.model.robot import Dynamics, Limits, RobotModel, load_robot
from wbmpc.model.swerve import (
    SwerveGeometry,
    aligned_steering,
    beyond_range,
    rolling_inverse_kinematics,
    wheel_velocities,
)
from wbmpc.model.symbolic import FramePose

__all__ = [
    "DoorGeometry",
    "DriveLag",
    "Dynamics",
    "Equations",
    "FramePose",
    "FrequencyShaping",
    "InputFilter",
    "InputRate",
    "Layout",
    "Limits",
    "RobotModel",
    "ServoedArm",
    "SwerveGeometry",
    "WithDoor",
    "aligned_steering",
    "beyond_range",
    "load_robot",
    "rolling_inverse_kinematics",
    "wheel_velocities",
]
