"""Points of a scan that the robot sees of itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.mapping.body_step import mark_own
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.obstacles.solids import KINDS


class BodyFilter:
    """Finds points of a robot's own shapes. ``padding`` [m]: what is so near to one belongs to it."""

    def __init__(self, robot: RobotModel, padding: float) -> None:
        self._geometry, self._padding = robot_geometry(robot), padding
        solids = [s.solid for s in self._geometry.shapes]
        self._kind = np.array([KINDS.index(s.kind) for s in solids], np.int64)
        self._size = np.array([s.size for s in solids], float).ravel()
        self._around = np.array([s.radius for s in solids])

    def mark(self, points: Array, kind: NDArray[np.int64], state: Array) -> None:
        """Mark points (n, 3) [m] of the robot in a state (nx) in ``kind`` (n)."""
        geometry = self._geometry
        centers, axes = geometry.at(*geometry.kinematics(state[None]))
        flat = [np.ascontiguousarray(a).reshape(-1) for a in (points, centers[0], axes[0])]
        mark_own(
            len(points), flat[0], len(self._kind), self._kind, self._size, self._around, flat[1], flat[2],
            self._padding, kind,
        )  # fmt: skip
