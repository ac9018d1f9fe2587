"""Robot descriptions: YAML beside a URDF or MJCF. Built-in robots are data in ``robots/data``."""

import wbmpc.mujoco_start  # noqa: F401  (before others import MuJoCo)
from wbmpc.robots.description import (
    ArmDescription,
    LimitsDescription,
    RobotDescription,
    available_robots,
    load_description,
    load_spec,
)

__all__ = [
    "ArmDescription", "LimitsDescription", "RobotDescription", "available_robots", "load_description", "load_spec",
]  # fmt: skip
