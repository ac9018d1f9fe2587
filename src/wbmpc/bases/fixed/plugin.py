"""The base type ``fixed``: a table, a wall or a ceiling that carries an arm."""

from __future__ import annotations

import mujoco

from wbmpc.bases.base import BaseType
from wbmpc.bases.fixed.description import FixedBaseDescription
from wbmpc.bases.fixed.model import FixedBase
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription


class FixedBaseType(BaseType):
    """Planning only: there is no simulated robot of this base type."""

    Description = FixedBaseDescription

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Any body can stand still."""

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> FixedBase:
        """The arm's tree on the body's pose in the file."""
        body = spec.compile().body(description.base.body)
        return FixedBase(description, read_tree(spec, description.base.body), body.pos.copy(), body.quat.copy())
