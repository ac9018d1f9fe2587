"""The base type ``fixed``: a table, a wall or a ceiling that carries an arm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco

from wbmpc.bases.base import BaseType, Proposal
from wbmpc.bases.fixed.description import FixedBaseDescription
from wbmpc.bases.fixed.model import FixedBase
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel


class FixedBaseType(BaseType):
    """Planning only: there is no simulated robot of this base type."""

    Description = FixedBaseDescription

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Any body can stand still."""

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal:
        """Everything can stand still; a robot on wheels should not."""
        reason = "its wheels stand still" if wheels else "no wheels"
        return Proposal({}, 0.1 if wheels else 0.9, reason)

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> FixedBase:
        """The arm's tree on the body's pose in the file."""
        body = spec.compile().body(description.base.body)
        return FixedBase(description, read_tree(spec, description.base.body), body.pos.copy(), body.quat.copy())
