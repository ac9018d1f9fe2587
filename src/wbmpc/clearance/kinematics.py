"""Where frames of a robot are at many states, compiled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbmpc.arrays import Array
from wbmpc.kernel.function import CompiledFunction
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import Frame
from wbmpc.obstacles.geometry import frame_function, split_poses


class CompiledKinematics:
    """As :class:`wbmpc.obstacles.geometry.Kinematics`: positions (n, F, 3) [m] and rotations (n, F, 3, 3), contiguous ones."""

    def __init__(self, robot: RobotModel, frames: Sequence[Frame]) -> None:
        self._size = robot.state.size
        self._function = CompiledFunction(frame_function(robot, frames))

    def __call__(self, states: Array) -> tuple[Array, Array]:
        """Of states (n, nx or more: what a problem adds comes after the robot's own)."""
        return split_poses(self._function(np.atleast_2d(states)[:, : self._size]))
