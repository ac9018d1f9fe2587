"""Obstacles and self-collision: shapes of robots and of what stands around them, nearest points, rows for a problem."""

import wbmpc.mujoco_start  # noqa: F401  (before others import MuJoCo)
from wbmpc.obstacles import shapes
from wbmpc.obstacles.world import Obstacles

__all__ = ["Obstacles", "shapes"]
