"""Which of the named configurations a robot's legs are in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.stability import configurations, leg_angles
from wbmpc.stability.configurations import leg_group

#: Legs are in a configuration where each is within this [rad] of its angle.
NEAR = 0.05


class LegConfiguration:
    """Of one robot (None: of none), from the positions of ``joints`` (names, in their order)."""

    def __init__(self, robot: RobotModel | None, joints: Sequence[str]) -> None:
        self._places: list[int] = []
        if robot is None:
            return
        try:
            angles = [leg_angles(robot, name) for name in configurations(robot)]
        except InputError:  # legs that do not reach one of them
            return
        if not angles:
            return
        names = robot.state.groups[leg_group(robot)]
        if set(names) <= set(joints):
            self._places, self._angles = [list(joints).index(name) for name in names], np.array(angles)

    def number(self, positions: Array) -> float:
        """The place among the robot's configurations of that which positions (n) [rad] are in, -1 between them, nan without such legs."""
        if not self._places:
            return float("nan")
        off = np.abs(self._angles - positions[self._places]).max(axis=1)
        return float(np.argmin(off)) if off.min() < NEAR else -1.0


def configuration_text(number: float, names: Sequence[str]) -> str:
    """What a page says of it, by the ``names`` of the robot's configurations; empty without such legs."""
    if not np.isfinite(number):
        return ""
    return f"legs: {names[int(number)]}" if number >= 0 else "legs: between configurations"
