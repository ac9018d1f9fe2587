"""Whether a ball robot's arm rests against the robot itself: a joint that stands there says nothing about its encoder."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.clearance.rows import SelfRows
from wbmpc.model.robot import RobotModel
from wbmpc.ocp.clearance_residuals import SelfClearance

#: Parts that are as near as this [m] may touch: soft contacts, zeros of encoders (2 mrad at an arm's length), shapes that are not exact.
TOUCHES = 0.01


class SelfContact:
    """The pairs that the robot file lists (``collision.self.pairs``), at measured states."""

    def __init__(self, robot: RobotModel) -> None:
        self._rows = SelfRows(SelfClearance(robot))
        self._arm = robot.state["arm"].start

    def closes(self, state: Array, joint: int, turn: float) -> bool:
        """Whether a pair that touches, or nearly so, at a ``state`` (nx) would come nearer if arm ``joint`` turned by ``turn`` [rad]."""
        turned = state.copy()
        turned[self._arm + joint] += turn
        now, then = self._rows.measure(np.array([state, turned]))
        return bool(((then < now) & (now < TOUCHES)).any())
