"""Differential drives: the wheels' axles lie on one line, along which the base cannot move."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.differential.description import DifferentialBaseDescription
from wbmpc.bases.planar_motion.model import PlanarBase, PointFootprint, standing_on
from wbmpc.bases.planar_motion.wheels import FixedWheels
from wbmpc.errors import InputError
from wbmpc.model.tree import Tree
from wbmpc.robots import RobotDescription

#: How far apart the axles' lines may be: angle [rad], distance [m].
_PARALLEL, _BESIDE = 1e-3, 0.002


def allowed_twist(wheels: FixedWheels) -> Array:
    """(3, 2): the body's twist by (v, wz): speed of the middle of the axle along the rolling direction, turn about that middle."""
    along, (x, y) = wheels.forward[0], wheels.position.mean(axis=0)
    return np.column_stack([[*along, 0.0], [y, -x, 1.0]])


def differential_base(description: RobotDescription, tree: Tree, wheels: FixedWheels) -> PlanarBase:
    """The model. Raises :class:`InputError` for wheels that do not share one axle: they would be dragged sideways."""
    side = wheels.along(wheels.side) @ allowed_twist(wheels)
    odd = int(np.argmax(np.abs(side) @ [1.0 / _PARALLEL, 1.0 / _BESIDE]))
    if abs(side[odd, 0]) > _PARALLEL or abs(side[odd, 1]) > _BESIDE:
        raise InputError(
            f"{description.source}: key 'base.wheels': the wheels of a differential base share one axle, '{description.base.joints()[odd]}' "
            f"is {1e3 * abs(side[odd, 1]):.3g} mm ahead of or behind their middle and turned by "
            f"{np.degrees(np.arcsin(min(1.0, abs(side[odd, 0])))):.2g} deg; wheels that are dragged have no base type"
        )
    twist = allowed_twist(wheels)
    base = PlanarBase(description, tree, wheels, wheels.rates(np.zeros(len(side))), ("v", "wz"), twist)
    casters = caster_places(description, wheels)
    names = [*description.base.joints(), *(f"caster {i}" for i in range(len(casters)))]
    # casters on springs: how much of the load they carry the file does not say
    base.footprint = standing_on(PointFootprint(np.vstack([wheels.position, casters]), names, even=False))
    return base


def caster_places(description: RobotDescription, wheels: FixedWheels) -> Array:
    """(n, 2) [m] in the axes of the body: the description's, or one ahead of and one behind the axle."""
    assert isinstance(description.base, DifferentialBaseDescription)
    if description.base.casters is not None:
        return np.array(description.base.casters)
    middle = wheels.position.mean(axis=0)
    ahead = 0.5 * float(np.linalg.norm(np.ptp(wheels.position, axis=0))) * wheels.forward[0]
    return np.array([middle + ahead, middle - ahead])
