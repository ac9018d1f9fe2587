"""Residuals that a base answers (:class:`wbmpc.bases.base.Base`): rolling wheels, braked joints, the support margin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.ocp.symbols import Symbols
from wbmpc.stability import GRAVITY, Support, counter_clockwise, standing

#: Forces along the ground below this share of the mean load count as this: their size has no slope at zero.
ROUNDED = 0.01


@dataclass(frozen=True)
class Rolling:
    """Rolling (n) and side-slip (n) velocity of the wheels' contact points [m/s]; zero when they roll.

    ``allow_side_slip``: the reference (n) says which wheels may slip sideways (1), while they reverse under a moving base, and which may
    not (0). ``groups``: "rolling" and "side". Raises :class:`InputError` for a base without wheels that a constraint makes roll.
    """

    robot: RobotModel
    allow_side_slip: bool = False
    groups: Mapping[str, slice] = field(init=False, repr=False)

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return self.robot.base.wheels if self.allow_side_slip else 0

    def __post_init__(self) -> None:
        wheels = self.robot.base.wheels
        if not wheels:
            kind = self.robot.description.base.type
            raise InputError(f"rolling: the wheels of a base of type '{kind}' need no constraint to roll")
        object.__setattr__(self, "groups", {"rolling": slice(0, wheels), "side": slice(wheels, 2 * wheels)})

    @property
    def size(self) -> int:
        """How many rows."""
        return self.groups["side"].stop

    def __call__(self, s: Symbols) -> ca.SX:
        rows = self.robot.base.rolling(s.x, s.u, s.mode)
        if not self.allow_side_slip:
            return rows
        return ca.vertcat(rows[self.groups["rolling"]], (1.0 - s.reference) * rows[self.groups["side"]])


@dataclass(frozen=True)
class LockedJoints:
    """Rates [rad/s] of joints where their brake is closed, zero where it is open, ``groups``: rows by group of joints.

    Raises :class:`InputError` without brakes.
    """

    robot: RobotModel
    groups: Mapping[str, slice] = field(init=False, repr=False)

    reference = 0

    def __post_init__(self) -> None:
        groups, start = {}, 0
        for joints in self.robot.base.brakes.values():
            groups[joints] = slice(start, start := start + len(self.robot.input.groups[joints]))
        if not groups:
            raise InputError(f"locked joints: '{self.robot.description.name}' has no brakes")
        object.__setattr__(self, "groups", groups)

    @property
    def size(self) -> int:
        """How many rows."""
        return sum(part.stop - part.start for part in self.groups.values())

    def __call__(self, s: Symbols) -> ca.SX:
        layouts = self.robot.mode, self.robot.input
        brakes = self.robot.base.brakes.items()
        return ca.vertcat(*[(1.0 - s.mode[layouts[0][b]]) * s.u[layouts[1][joints]] for b, joints in brakes])


@dataclass(frozen=True)
class SupportMargin:
    """Distances [m] of the zero-moment point to the edges of support polygons, positive inside: all to be at least zero.

    ``supports``: groups of feet (indices), each the corners of a convex polygon: a support triangle, or several whose
    overlap the point is to stay in (Pankert et al. 2022, section II-A); left out: the support polygon of all feet.
    Reference: the wrench (6) of the world on the end effector, force [N] and moment [N m] in world axes; with ``payload`` then also what
    it carries (4): a mass [kg] and its center [m] in the end effector's axes. ``gravity`` (3)
    [m/s²]: on a slope not along −z. Loads are static unless ``dynamics`` are given: then also the inertia of what their
    states say about the inputs' rates (:class:`wbmpc.model.augment.InputRate`; inputs that are no states count as constant).
    """

    robot: RobotModel
    supports: Sequence[Sequence[int]] | None = None
    gravity: tuple[float, float, float] = GRAVITY
    dynamics: Any = None
    payload: bool = False
    groups: Mapping[str, slice] = field(init=False, repr=False)
    polygons: tuple[tuple[int, ...], ...] = field(init=False, repr=False)

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return 10 if self.payload else 6

    def __post_init__(self) -> None:
        supports = [None] if self.supports is None else list(self.supports)
        if not supports:
            raise InputError("support margin: supports must name at least one group of modules")
        polygons = tuple(counter_clockwise(self.robot, feet) for feet in supports)
        groups, start = {}, 0
        for feet in polygons:
            groups["-".join(map(str, feet))] = slice(start, start + len(feet))
            start += len(feet)
        object.__setattr__(self, "polygons", polygons)
        object.__setattr__(self, "groups", groups)

    @property
    def size(self) -> int:
        """How many rows."""
        return sum(map(len, self.polygons))

    def __call__(self, s: Symbols) -> ca.SX:
        support = Support(self.robot, s.x)
        zmp = support.zmp(_ground_load(support, s, self))
        return ca.vertcat(*[support.distances(feet, zmp) for feet in self.polygons])


@dataclass(frozen=True)
class WheelLoads:
    """Loads of the feet relative to their mean at rest (the robot's weight without payload, over the number of feet): 1 is the mean, 0 a
    wheel that lifts. Feet share the load like equal springs under a rigid body. Reference, ``gravity`` and ``dynamics``: see
    :class:`SupportMargin`; with ``payload`` the reference ends with it. ``groups``: one row for each foot.

    Raises :class:`InputError` for a base whose feet do not share the load in this way.
    """

    robot: RobotModel
    gravity: tuple[float, float, float] = GRAVITY
    dynamics: Any = None
    payload: bool = False
    groups: Mapping[str, slice] = field(init=False, repr=False)

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return 10 if self.payload else 6

    def __post_init__(self) -> None:
        footprint = standing(self.robot)
        if not footprint.even:
            raise InputError(
                f"wheel loads: nothing says how the wheels of '{self.robot.description.name}' share the load (casters on springs); "
                "valid: the support margin, or a base without casters"
            )
        object.__setattr__(self, "groups", {name: slice(i, i + 1) for i, name in enumerate(footprint.names)})

    @property
    def size(self) -> int:
        """How many rows."""
        return len(self.groups)

    @property
    def row_names(self) -> list[str]:
        """What the rows are called."""
        return list(self.groups)

    def __call__(self, s: Symbols) -> ca.SX:
        support = Support(self.robot, s.x)
        mean = support.mass * float(np.linalg.norm(self.gravity)) / self.size
        return support.foot_loads(_ground_load(support, s, self)) / mean


@dataclass(frozen=True)
class TireFriction(WheelLoads):
    """Friction reserve of each wheel, μ N − ``|t|``, relative to the mean load at rest: ≥ 0 where tires do not slide.

    Loads N are those of :class:`WheelLoads`, forces t those of :meth:`wbmpc.stability.Support.foot_forces`: tires push in any direction
    (rollers do not). Reference: as there, and then the coefficient of friction μ.
    """

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return super().reference + 1

    def __call__(self, s: Symbols) -> ca.SX:
        support = Support(self.robot, s.x)
        load = _ground_load(support, s, self)
        loads = support.foot_loads(load)
        forces, mean = support.foot_forces(load, loads), support.mass * float(np.linalg.norm(self.gravity)) / self.size
        size = ca.sqrt(ca.sum2(forces**2) + (ROUNDED * mean) ** 2)
        return (s.reference[self.reference - 1] * loads - size) / mean


def _ground_load(support: Support, s: Symbols, residual: SupportMargin | WheelLoads) -> tuple[ca.SX, ca.SX]:
    """Force and moment that the ground answers: see :meth:`wbmpc.stability.Support.load`."""
    motion, n = None, s.x.shape[0]
    if residual.dynamics is not None:
        rates = s.rate_of(ca.vertcat(s.x, s.u), residual.dynamics)
        motion = (s.u, rates[:n], rates[n:])
    return support.load(s.reference[:6], residual.gravity, motion, s.reference[6:10] if residual.payload else None)
