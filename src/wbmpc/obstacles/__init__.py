"""Obstacles and self-collision: shapes of robots and of what stands around them, nearest points, rows for a problem."""

from wbmpc.obstacles import shapes
from wbmpc.obstacles.world import Obstacles

__all__ = ["Obstacles", "shapes"]
