"""Omnidirectional bases: the twist is free, the wheels' rollers decide which rates it gives."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.omnidirectional.description import OmnidirectionalBaseDescription
from wbmpc.bases.planar_motion.model import PlanarBase
from wbmpc.bases.planar_motion.wheels import FixedWheels
from wbmpc.errors import InputError
from wbmpc.model.tree import Tree
from wbmpc.robots import RobotDescription

#: Levers of yaw that differ by less than this share do not show how mecanum rollers stand.
_CLEAR = 0.05


def roller_angles(description: RobotDescription, wheels: FixedWheels) -> Array:
    """(n) [rad]: of the rollers' axles from the rolling direction. Raises :class:`InputError` where "mecanum" is ambiguous."""
    base = description.base
    assert isinstance(base, OmnidirectionalBaseDescription)
    if base.rollers == "omni":
        return np.zeros(len(wheels.heading))
    if base.rollers != "mecanum":
        return np.deg2rad(base.rollers)
    at = wheels.position - wheels.position.mean(axis=0)
    left, right = (np.abs(_cross(at, wheels.forward + sign * wheels.side)) for sign in (1.0, -1.0))
    unclear = np.abs(left - right) <= _CLEAR * (left + right)
    if unclear.any():
        raise InputError(
            f"{description.source}: key 'base.rollers': 'mecanum' does not say how the rollers of '{base.wheels[int(np.argmax(unclear))]}' "
            "stand, it is ahead of or beside the middle of the wheels; valid: an angle [deg] for each wheel"
        )
    return np.where(left > right, np.pi / 4, -np.pi / 4)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def omnidirectional_base(description: RobotDescription, tree: Tree, wheels: FixedWheels) -> PlanarBase:
    """The model. Raises :class:`InputError` for wheels that leave a motion free."""
    matrix = wheels.rates(roller_angles(description, wheels))
    return PlanarBase(description, tree, wheels, matrix, ("vx", "vy", "wz"), np.eye(3))
