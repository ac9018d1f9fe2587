"""The symbolic side of a mix of wheels.

Wheel i stands at R(δ) o from its steering axis at a (o = 0 and no δ for one that does not steer), and rolls along d at an angle
ψ = ψ₀ + σ δ in the body. Its center moves at v + ω ẑ × a + (ω + σ δ̇) ẑ × R(ψ) o; of that the part along d is f, the part to the left g.
A tire has g = 0 and turns at f / r; a wheel with rollers at an angle γ turns at (f + g tan γ) / r.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.model import PlanarBase, standing_on
from wbmpc.bases.planar_motion.wheels import FixedWheels
from wbmpc.bases.wheels.description import WheelsBaseDescription
from wbmpc.errors import InputError
from wbmpc.model.kinematics import constant
from wbmpc.model.tree import Tree
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.bases.footprint import SteeredFeet
    from wbmpc.model.robot import RobotModel
    from wbmpc.model.wheels import ModuleGeometry
    from wbmpc.ocp import Constraint

#: Of the rows that keep steered tires from slipping sideways: measured steering angles never agree exactly.
SOFTNESS = 1e-6
#: Of the wheels' rates, per share of the largest and second: more than any goal pulls with. Rates depend on steering angles, so their rows
#: have a slack, and what a plan has of it no wheel does.
RATE_SLACK = 1e6
#: How far tires that do not steer may disagree: angle [rad], distance [m] of their axles' lines.
_PARALLEL, _BESIDE = 1e-3, 0.002


@dataclass(frozen=True)
class Contact:
    """A wheel. ``axis`` (2) [m] of its steering, ``heading`` [rad] at zero, ``offset`` (2) [m] along and to the left of the heading;
    ``sign`` of the steering axis (0: none) and its ``place`` among the steering joints; ``roller`` [rad], None of a tire."""

    axis: Array
    heading: float
    offset: Array
    sign: float
    place: int
    roller: float | None
    driven: bool

    def place_of(self, steer: Any) -> Any:
        """Where the wheel stands (2) [m] in the axes of the body."""
        symbolic = isinstance(steer, ca.SX)
        cos, sin = (ca.cos, ca.sin) if symbolic else (np.cos, np.sin)
        angle = self.heading + (self.sign * steer[self.place] if self.sign else 0.0)
        c, s, (x, y), (ox, oy) = cos(angle), sin(angle), self.axis, self.offset
        place = [x + c * ox - s * oy, y + s * ox + c * oy]
        return ca.vertcat(*place) if symbolic else np.array(place, float)

    def rows(self, steer: Any, steering: int) -> tuple[Any, Any]:
        """Velocity of the center along its heading and to the left, as rows (3 + ``steering``) of twist and steering rates. ``steer``:
        angles by joint, numbers or symbols."""
        symbolic = isinstance(steer, ca.SX)
        cos, sin = (ca.cos, ca.sin) if symbolic else (np.cos, np.sin)
        angle = self.heading + (self.sign * steer[self.place] if self.sign else 0.0)
        c, s, (x, y), (ox, oy) = cos(angle), sin(angle), self.axis, self.offset
        rates = [[0.0] * steering, [0.0] * steering]
        if self.sign:
            rates[0][self.place], rates[1][self.place] = -self.sign * oy, self.sign * ox
        along = [c, s, s * x - c * y - oy, *rates[0]]
        aside = [-s, c, c * x + s * y + ox, *rates[1]]
        return (ca.horzcat(*along), ca.horzcat(*aside)) if symbolic else (np.array(along), np.array(aside))


def read_contacts(description: RobotDescription, tree: Tree) -> list[Contact]:
    """The wheels at zero joint angles. Raises :class:`InputError` for steering axes that are not vertical."""
    base, poses, found = description.base, tree.zero_poses(), []
    assert isinstance(base, WheelsBaseDescription)
    steering = base.joint_groups().get("steer", [])
    for wheel in base.wheels:
        center, turned = poses[tree.joint(wheel.joint)]
        axle = turned @ tree.links[tree.joint(wheel.joint)].axis
        heading = float(np.arctan2(-axle[0], axle[1]))  # rolling direction = axle × up
        axis, sign, place = center[:2], 0.0, 0
        if wheel.steer:
            tree.check_moves(wheel.steer, wheel.joint, f"{description.source}: key 'base.wheels'")
            link = tree.joint(wheel.steer)
            up = (poses[link][1] @ tree.links[link].axis)[2]
            if abs(up) < 1.0 - 1e-6:
                raise InputError(
                    f"{description.source}: key 'base.wheels': joint '{wheel.steer}' must turn about a vertical axis"
                )
            axis, sign, place = poses[link][0][:2], float(np.sign(up)), steering.index(wheel.steer)
        beside, c, s = center[:2] - axis, np.cos(heading), np.sin(heading)
        offset = np.array([c * beside[0] + s * beside[1], c * beside[1] - s * beside[0]])
        roller = None if wheel.rollers is None else float(np.deg2rad(wheel.rollers))
        found.append(Contact(axis, heading, offset, sign, place, roller, wheel.driven))
    return found


def allowed_twist(description: RobotDescription, contacts: list[Contact]) -> tuple[Array, tuple[str, ...]]:
    """(3, m) and names: the body's twist by the base's input. Tires that do not steer leave a speed along them and the turn about their
    axle. Raises :class:`InputError` where their axles are not one."""
    fixed = [c for c in contacts if c.roller is None and not c.sign]
    if not fixed:
        return np.eye(3), ("vx", "vy", "wz")
    x, y = np.mean([c.axis for c in fixed], axis=0)
    heading = fixed[0].heading
    twist = np.column_stack([[np.cos(heading), np.sin(heading), 0.0], [y, -x, 1.0]])
    for c, (along, turning) in zip(fixed, [c.rows(np.zeros(0), 0)[1] @ twist for c in fixed], strict=True):
        if abs(along) > _PARALLEL or abs(turning) > _BESIDE:
            base = description.base
            assert isinstance(base, WheelsBaseDescription)
            raise InputError(
                f"{description.source}: key 'base.wheels': tires that do not steer share one axle, '{base.wheels[contacts.index(c)].joint}' is "
                f"{1e3 * abs(turning):.3g} mm away from it; wheels that are dragged have base type planar"
            )
    return twist, ("v", "wz")


class WheelsFootprint:
    """Where a mix of wheels stands: contacts beside their steering axes move with those; casters do not."""

    modules: ModuleGeometry | None = None
    steered: SteeredFeet | None = None

    def __init__(self, base: WheelsBase, description: WheelsBaseDescription) -> None:
        self._contacts, self._casters = base.wheel_contacts, np.array(description.casters).reshape(-1, 2)
        self._part = slice(3, 3 + base.steering)
        self.names = [w.joint for w in description.wheels] + [f"caster {i}" for i in range(len(self._casters))]
        # a caster's spring is not a tire's
        self.size, self.even = len(self.names), not len(self._casters)

    def positions(self, x: Array) -> Array:
        """Feet (n, 2) [m] in the axes of the body at a state (nx)."""
        return np.vstack([*(c.place_of(x[self._part]) for c in self._contacts), *self._casters])

    def expressions(self, x: ca.SX) -> list[ca.SX]:
        """The same (2 each) as symbols of the state."""
        return [*(c.place_of(x[self._part]) for c in self._contacts), *(constant(at) for at in self._casters)]


class WheelsBase(PlanarBase):
    """State: (x, y, yaw) of the body's frame, steering, arm; input: the base's speeds, steering and arm rates."""

    def __init__(self, description: RobotDescription, tree: Tree, wheels: FixedWheels) -> None:
        self.wheel_contacts = read_contacts(description, tree)
        twist, names = allowed_twist(description, self.wheel_contacts)
        self.steering = len(description.base.joint_groups().get("steer", []))
        self.radius = wheels.radius
        home = np.array([description.home.get(n, 0.0) for n in description.base.joint_groups().get("steer", [])])
        roll, side = self.matrices(home)
        super().__init__(description, tree, wheels, np.vstack([roll, side])[:, :3], names, twist)
        assert isinstance(description.base, WheelsBaseDescription)
        self.footprint = standing_on(WheelsFootprint(self, description.base), np.concatenate([np.zeros(3), home]))
        contacts = list(enumerate(self.wheel_contacts))
        self.feet_of_rows = [i for i, c in contacts if c.driven] + [i for i, c in contacts if c.roller is None]

    def matrices(self, steer: Any) -> tuple[Any, Any]:
        """Rows (k, 3 + s) of the body's twist and s steering rates: rates [rad/s] of driven wheels, and how fast tires slip sideways over
        their radius [rad/s]."""
        roll, side = [], []
        for contact in self.wheel_contacts:
            along, aside = contact.rows(steer, self.steering)
            if contact.driven:
                roll.append((along if contact.roller is None else along + np.tan(contact.roller) * aside) / self.radius)
            if contact.roller is None:
                side.append(aside / self.radius)
        if isinstance(steer, ca.SX):
            return ca.vertcat(*roll), ca.vertcat(*side)
        return np.array(roll).reshape(-1, 3 + self.steering), np.array(side).reshape(-1, 3 + self.steering)

    def fastest_rates(self) -> Array:
        """(n, m): the largest rates of driven wheels by each of the base's speeds, steered ones in their fastest direction."""
        found = []
        for contact in (c for c in self.wheel_contacts if c.driven):
            along, aside = (row[:3] @ self.twist for row in contact.rows(np.zeros(self.steering), self.steering))
            if contact.roller is not None:
                along = along + np.tan(contact.roller) * aside
            found.append((np.hypot(along, aside) if contact.sign else np.abs(along)) / self.radius)
        return np.array(found)

    def by_input(self, rows: Any) -> Any:
        """The same rows by the base's input and the steering rates."""
        if not isinstance(rows, np.ndarray):
            return ca.horzcat(rows[:, :3] @ constant(self.twist), rows[:, 3:])
        return np.hstack([rows[:, :3] @ self.twist, rows[:, 3:]])

    def constraints(self, robot: RobotModel, *, hard: bool = True) -> list[Constraint]:
        """Steered tires do not slip sideways; driven wheels keep their largest rates."""
        from wbmpc.ocp import Constraint, residuals, sets

        part = slice(3, 3 + self.steering)
        size, found = self.twist.shape[1] + self.steering, []
        tires = [c for c in self.wheel_contacts if c.roller is None]
        steered = [i for i, c in enumerate(tires) if c.sign]
        if steered:
            slip = lambda s: self.radius * (self.by_input(self.matrices(s.x[part])[1])[steered, :] @ s.u[:size])
            found.append(Constraint("rolling", residuals.Expression(len(steered), slip), softness=SOFTNESS))
        limited = np.flatnonzero(np.isfinite(self.wheel_upper)).tolist()
        if limited:
            upper = constant(1.0 / self.wheel_upper[limited])
            rates = lambda s: upper * (self.by_input(self.matrices(s.x[part])[0])[limited, :] @ s.u[:size])
            found.append(
                Constraint(
                    "wheels",
                    residuals.Expression(len(limited), rates),
                    sets.Box(-1.0, 1.0),
                    hard=hard,
                    slack=RATE_SLACK,
                )
            )
        return found


def wheels_base(robot: RobotModel) -> WheelsBase:
    """The base of a robot on any wheels. Raises :class:`InputError` for one of another type."""
    if not isinstance(robot.base, WheelsBase):
        kind = robot.description.base.type
        raise InputError(f"{robot.description.name}: a base of type wheels is needed, it has one of type '{kind}'")
    return robot.base
