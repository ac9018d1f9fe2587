"""Which of the configurations that a base type names a robot is in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbmpc.arrays import Array
from wbmpc.model.robot import RobotModel
from wbmpc.stability import configurations

#: A robot is in a configuration where each of its joints is within this [rad] of its angle.
NEAR = 0.05


class NamedConfiguration:
    """Of one robot (None: of none), from the positions of ``joints`` (names, in their order)."""

    def __init__(self, robot: RobotModel | None, joints: Sequence[str]) -> None:
        named = {} if robot is None else configurations(robot)
        held = [name for group in robot.base.brakes.values() for name in robot.state.groups[group]] if named else []  # type: ignore[union-attr]
        self._angles = np.array([*named.values()])
        self._places = [list(joints).index(name) for name in held] if set(held) <= set(joints) else []

    def number(self, positions: Array) -> float:
        """The place among the robot's configurations of that which positions (n) [rad] are in, -1 between them, nan where it has none."""
        if not self._places:
            return float("nan")
        off = np.abs(self._angles - positions[self._places]).max(axis=1)
        return float(np.argmin(off)) if off.min() < NEAR else -1.0


def configuration_text(number: float, names: Sequence[str]) -> str:
    """What a page says of it, by the ``names`` of the robot's configurations; empty where it has none."""
    if not np.isfinite(number):
        return ""
    return f"configuration: {names[int(number)]}" if number >= 0 else "between configurations"
