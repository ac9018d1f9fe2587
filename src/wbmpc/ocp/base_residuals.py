"""Residuals that a base answers (:class:`wbmpc.bases.base.Base`): rolling wheels, braked joints, the support margin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import not_negative
from wbmpc.errors import InputError
from wbmpc.model.kinematics import constant
from wbmpc.model.robot import RobotModel
from wbmpc.ocp.clearance_residuals import stopping_time
from wbmpc.ocp.symbols import Symbols
from wbmpc.stability import GRAVITY, StanceOf, Support, counter_clockwise, standing
from wbmpc.stability.robot import edge_distances

#: Forces along the ground below this share of the mean load count as this: their size has no slope at zero.
ROUNDED = 0.01
#: Accelerations at which slopes by them are measured.
SMALL = 1e-3
#: By how much more than a pendulum falls a center of mass takes to come to rest at an edge: it needs 1 / 4 of its distance then.
GENTLE = 2.0


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
            raise InputError("support margin: supports must name at least one group of feet")
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


#: The center of mass, and the zero-moment point.
UprightPart = Literal["center", "zmp"]


@dataclass(frozen=True)
class Upright:
    """What keeps a robot from tipping over in plans whose inputs are speeds: distances [m] to the edges of its support polygon, positive
    inside, of its center of mass ("center") and of a zero-moment point ("zmp").

    Where the arm moves the center of mass towards an edge, what counts is where it gets to in ``approach`` [s]: it comes to rest before the
    edge so gently that this does not push the robot over. None: :data:`GENTLE` times √(h / g), the time constant of a pendulum as high as
    the center of mass, or the time in which the arm stops where that is longer. The zero-moment point is that of accelerations, which move
    it as they do at home: of those from the last command to a node's input, which in a receding horizon is the acceleration itself where
    it acts next, and a mean one later.

    Reference: the last command (n) and the time [s] since it was given; without a time (0) speeds are constant. Of a base that stands
    level. ``parts``: which of the two. ``feet``: indices of the polygon's corners; ``groups``: one row for each of n edges, by part;
    ``pushes`` (n, nu) [m s², m s²/rad]: how far a unit of each input's acceleration moves the point away from each edge at home.
    """

    robot: RobotModel
    approach: float | None = None
    parts: tuple[UprightPart, ...] = ("center", "zmp")
    groups: Mapping[str, slice] = field(init=False, repr=False)
    feet: tuple[int, ...] = field(init=False, repr=False)
    pushes: NDArray[np.float64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        stance, home, feet = StanceOf(self.robot), self.robot.home, counter_clockwise(self.robot)
        still = stance(home)
        falls = float(np.sqrt(max(float(still.com[2]), 0.0) / -GRAVITY[2]))
        approach = max(GENTLE * falls, stopping_time(self.robot)) if self.approach is None else self.approach
        not_negative("upright", approach=approach)
        object.__setattr__(self, "approach", float(approach))
        shifts = [stance(home, u_rate=SMALL * row).zmp - still.zmp for row in np.eye(self.robot.input.size)]
        edges = np.roll(still.feet[list(feet)], -1, axis=0) - still.feet[list(feet)]
        inward = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1, keepdims=True)
        object.__setattr__(self, "feet", feet)
        n = len(feet)
        object.__setattr__(self, "groups", {part: slice(n * k, n * (k + 1)) for k, part in enumerate(self.parts)})
        object.__setattr__(self, "pushes", inward @ np.array(shifts).T / SMALL)

    @property
    def last_inputs(self) -> list[int]:
        """All: see :class:`wbmpc.ocp.symbols.FollowsLastInput`."""
        return list(range(self.robot.input.size))

    @property
    def size(self) -> int:
        """How many rows."""
        return len(self.parts) * len(self.feet)

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return self.robot.input.size + 1

    def __call__(self, s: Symbols) -> ca.SX:
        base, n = self.robot.base, self.robot.input.size
        corners = ca.horzcat(*standing(self.robot).expressions(s.x)).T
        inside = edge_distances(corners, self.feet, base.chain(s.x).center_of_mass()[:2])
        ahead = ca.jtimes(inside, s.x, self.robot.dynamics()(s.x, s.u, s.parameters, s.mode))
        since = s.reference[n]
        change = (since > 0.0) * (s.u - s.reference[:n]) / (since + (since <= 0.0))
        rows = {"center": inside + float(self.approach or 0.0) * ahead, "zmp": inside + constant(self.pushes) @ change}
        return ca.vertcat(*[rows[part] for part in self.parts])


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
