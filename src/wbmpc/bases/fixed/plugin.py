"""The base type ``fixed``: a table, a wall or a ceiling that carries an arm."""

from __future__ import annotations

from typing import Any

import mujoco

from wbmpc.bases.base import System
from wbmpc.bases.fixed.description import FixedBaseDescription
from wbmpc.bases.fixed.model import FixedBase
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription


class FixedBaseType:
    """Planning only: there is no simulated robot of this base type."""

    Description = FixedBaseDescription

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Any body can stand still."""

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> FixedBase:
        """The arm's tree on the body's pose in the file."""
        body = spec.compile().body(description.base.body)
        return FixedBase(description, read_tree(spec, description.base.body), body.pos.copy(), body.quat.copy())

    def plant(self, robot: RobotModel, perturbation: Any, seed: int) -> Any:
        """Raises :class:`InputError`."""
        raise _no("simulated robot", robot)

    def system(self, robot: RobotModel, seed: int) -> System:
        """Raises :class:`InputError`."""
        raise _no("simulated robot", robot)

    def ros(self, robot: RobotModel, settings: Any, period: float) -> Any:
        """Raises :class:`InputError`."""
        raise _no("adapter for ROS 2", robot)


def _no(what: str, robot: RobotModel) -> InputError:
    return InputError(f"{robot.description.name}: a base of type fixed has no {what}; valid: planning with an MPC")
