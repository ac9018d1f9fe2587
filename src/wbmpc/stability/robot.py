"""The support of a described robot: contacts, masses, loads and margins, as symbols and as numbers.

Only bases with a footprint (:class:`wbmpc.bases.footprint.Footprint`) of at least three points stand by themselves. Everything is in
axes of the world (z along the ground's normal), with the origin on the ground under the base's frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.bases.base import Base
from wbmpc.bases.footprint import Footprint
from wbmpc.checks import numbers
from wbmpc.errors import InputError
from wbmpc.model.kinematics import Chain, FramePose, PointLoad, RootMotion, constant
from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel
from wbmpc.stability.friction import friction_needed
from wbmpc.stability.geometry import Array, Triangle, hull, support_polygon, triangle_margins
from wbmpc.stability.geometry import margin as margin_to
from wbmpc.stability.zmp import GRAVITY, Load

Feet = Sequence[int]
#: Largest number that is taken, of any unit: nothing real is larger, and squares of far larger ones overflow.
LARGEST = 1e9


def standing(robot: RobotModel) -> Footprint:
    """Where the robot stands, on three feet or more, or :class:`InputError`."""
    footprint: Footprint | None = robot.base.footprint
    feet = 0 if footprint is None else footprint.size
    if footprint is None or feet < 3:
        raise InputError(
            f"{robot.description.name}: stability needs a base that stands on 3 feet or more; this one, of type "
            f"'{robot.description.base.type}', stands on {feet}"
        )
    return footprint


class Support:
    """Symbolic expressions of one robot at a state x (nx): CasADi SX, for residuals and compiled functions."""

    def __init__(self, robot: RobotModel, x: ca.SX) -> None:
        self.robot, self.x = robot, x
        self.base: Base = robot.base
        footprint = standing(robot)
        root = self.base.root_pose(x)
        self._ground = root.position
        above = ca.vertcat(0.0, 0.0, root.position[2])
        chain = self.base.chain(x)
        self.chain = Chain(chain.links, chain.values, FramePose(above, root.quaternion, root.rotation))
        self.mass = float(sum(link.mass for link in self.chain.links))
        self.feet = ca.horzcat(*[root.rotation[0:2, 0:2] @ foot for foot in footprint.expressions(x)]).T
        self.com = self._com()

    def _com(self) -> ca.SX:
        total = ca.SX(3, 1)
        for i, link in enumerate(self.chain.links):
            if link.mass > 0.0:
                position, turn = self.chain.link_place(i)
                total += link.mass * (position + turn @ constant(link.com))
        return total / self.mass

    def tool(self) -> ca.SX:
        """The end effector's frame (3) [m]."""
        return self.chain.frame_place(self.robot.tree.frames[self.robot.tool])[0]

    def load(
        self,
        wrench: ca.SX | None = None,
        gravity: ArrayLike = GRAVITY,
        motion: tuple[ca.SX, ca.SX, ca.SX] | None = None,
        payload: ca.SX | None = None,
    ) -> tuple[ca.SX, ca.SX]:
        """Force (3) [N] and moment (3) [N m] about the origin: gravity, the world's ``wrench`` (6) on the end effector (force and
        moment in world axes) and the inertia of a ``motion``: rates u (nu), ẋ (nx), and u̇ (nu). ``payload`` (4): mass [kg] of a point that
        the end effector carries, and its center [m] in the end effector's axes."""
        if motion is None:
            force = self.mass * constant(gravity)
            moment = ca.cross(self.com, force)
            if payload is not None:
                weight = payload[0] * constant(gravity)
                frame = self.chain.frame_pose(self.robot.tree.frames[self.robot.tool])
                force, moment = (
                    force + weight,
                    moment + ca.cross(frame.position + frame.rotation @ payload[1:4], weight),
                )
        else:
            force, moment = self._dynamic_load(gravity, motion, payload)
        if wrench is not None:
            force = force + wrench[0:3]
            moment = moment + wrench[3:6] + ca.cross(self.tool(), wrench[0:3])
        return force, moment

    def _dynamic_load(
        self, gravity: ArrayLike, motion: tuple[ca.SX, ca.SX, ca.SX], payload: ca.SX | None
    ) -> tuple[ca.SX, ca.SX]:
        """Gravity and inertia by a Newton-Euler recursion: a quarter of the operations of differentiating the momentum."""
        u, x_rate, u_rate = motion
        rates, linear, angular = self.base.velocities(self.x, u)
        links = list(rates)
        every, change = ca.vertcat(self.x, u), ca.vertcat(x_rate, u_rate)
        now = ca.vertcat(linear, angular, *rates.values())
        rate = ca.jtimes(now, every, change)
        root = self.chain.root
        assert root is not None
        lifted = rate[0:3] + ca.cross(angular, linear) - root.rotation.T @ constant(gravity)
        load = None
        if payload is not None:
            frame = self.robot.tree.frames[self.robot.tool]
            place = constant(frame.position) + constant(frame.rotation) @ payload[1:4]
            load = PointLoad(frame.link, place, payload[0])
        moved = RootMotion(angular, rate[3:6], lifted)
        accelerations = {link: rate[6 + k] for k, link in enumerate(links)}
        force, moment = self.chain.root_wrench(rates, accelerations, moved, load)
        force, moment = -(root.rotation @ force), -(root.rotation @ moment)
        return force, moment + ca.cross(root.position, force)

    @staticmethod
    def zmp(load: tuple[ca.SX, ca.SX]) -> ca.SX:
        """Zero-moment point (2) [m] of a force and a moment."""
        force, moment = load
        return ca.vertcat(-moment[1], moment[0]) / force[2]

    def foot_loads(self, load: tuple[ca.SX, ca.SX]) -> ca.SX:
        """Loads (n) [N] of the feet under a force and a moment, which they share as equal springs under a stiff body do: the load is
        linear in a foot's place."""
        (force, moment), n = load, self.feet.shape[0]
        x, y = self.feet[:, 0] - ca.sum1(self.feet[:, 0]) / n, self.feet[:, 1] - ca.sum1(self.feet[:, 1]) / n
        middle = ca.sum1(self.feet) / n
        xx, xy, yy = ca.dot(x, x), ca.dot(x, y), ca.dot(y, y)
        # moments about the middle of the feet: Σ N y and −Σ N x answer them
        about_x, about_y = moment[0] - middle[1] * force[2], moment[1] + middle[0] * force[2]
        along, aside, det = about_y, -about_x, xx * yy - xy**2
        a, b = (yy * along - xy * aside) / det, (xx * aside - xy * along) / det
        return -force[2] / n + a * x + b * y

    def foot_forces(self, load: tuple[ca.SX, ca.SX], loads: ca.SX) -> ca.SX:
        """Forces (n, 2) [N] along the ground with which feet that carry ``loads`` (n) [N] answer a force and a moment: those with the
        least sum of squares over N. Together they push through the zero-moment point; each takes a share of that in proportion to its load, and of
        the turn about the point in proportion to its load and distance."""
        (force, moment), total = load, ca.sum1(loads)
        at = self.feet.T @ loads / total
        x, y = self.feet[:, 0] - at[0], self.feet[:, 1] - at[1]
        turn = moment[2] - at[0] * force[1] + at[1] * force[0]
        rate = -turn / ca.dot(loads, x**2 + y**2)
        return ca.horzcat(loads * (-force[0] / total - rate * y), loads * (-force[1] / total + rate * x))

    def distances(self, feet: Feet, point: ca.SX) -> ca.SX:
        """Distances [m] of a point (2) to the edges of a polygon of feet, in their order (counter-clockwise: inside > 0)."""
        return edge_distances(self.feet, feet, point)


def edge_distances(corners: ca.SX, feet: Feet, point: ca.SX) -> ca.SX:
    """Distances [m] of a point (2) to the edges of a polygon whose corners are some ``feet`` of ``corners`` (n, 2) [m], in their order."""
    rows = []
    for k, i in enumerate(feet):
        j = feet[(k + 1) % len(feet)]
        a, b = corners[i, :].T, corners[j, :].T
        d, to = b - a, point - a
        rows.append((d[0] * to[1] - d[1] * to[0]) / ca.norm_2(d))
    return ca.vertcat(*rows)


def counter_clockwise(robot: RobotModel, feet: Feet | None = None) -> tuple[int, ...]:
    """Feet (all on the hull when left out) in the order in which they stand around at the robot's home."""
    points = standing(robot).positions(robot.home)
    if feet is None:
        return tuple(hull(points))
    chosen = list(feet)
    if len(set(chosen)) < 3 or not set(chosen) <= set(range(len(points))):
        raise InputError(f"feet: at least 3 different feet of 0 to {len(points) - 1} are needed, got {tuple(feet)}")
    order = hull(points[chosen])
    if len(order) < len(chosen):
        raise InputError(f"feet: at the robot's home the feet {tuple(feet)} are not the corners of a convex polygon")
    return tuple(chosen[i] for i in order)


@dataclass(frozen=True)
class Stance:
    """How a robot stands, in world axes under its base: ``feet`` (n, 2) [m], ``com`` (3) [m], ``mass`` [kg], the total load
    ``force`` (3) [N], ``moment`` (3) [N m], its zero-moment point ``zmp`` (2) [m] (not a number without load)."""

    feet: Array
    com: Array
    mass: float
    force: Array
    moment: Array
    zmp: Array

    @property
    def polygon_margin(self) -> float:
        """Signed distance [m] of the zero-moment point to the border of the support polygon."""
        return float(margin_to(support_polygon(self.feet), self.zmp))

    @property
    def friction_needed(self) -> float:
        """Least coefficient of friction at which the feet hold the load: force, yaw moment and the feet's loads together
        (:func:`friction_needed`); not a number where the robot lifts off or tips over."""
        return friction_needed(self.feet, Load(self.force, self.moment))

    @property
    def triangle_margins(self) -> dict[Triangle, float]:
        """The same to every support triangle."""
        return {t: float(m) for t, m in triangle_margins(self.feet, self.zmp).items()}


#: What was compiled, by robot.
_COMPILED: WeakKeyDictionary[RobotModel, tuple[Numeric, float]] = WeakKeyDictionary()


def _compiled(robot: RobotModel) -> tuple[Numeric, float]:
    """Feet, center of mass, force and moment as a function of (x, u, u̇, wrench, gravity), and the mass [kg]; of one robot once."""
    if robot not in _COMPILED:
        sizes = {"x": robot.state.size, "u": robot.input.size, "a": robot.input.size, "wrench": 6, "gravity": 3}
        x, u, a, wrench, gravity = symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
        support = Support(robot, x)
        x_rate = robot.dynamics()(x, u, ca.SX.zeros(robot.parameters.size), ca.SX.ones(robot.mode.size))
        load = support.load(wrench, GRAVITY, (u, x_rate, a))
        change = support.mass * (gravity - ca.DM(GRAVITY))
        outputs = [support.feet, support.com, load[0] + change, load[1] + ca.cross(support.com, change)]
        function = Numeric(ca.Function("stance", symbols, [ca.densify(o) for o in outputs]))
        _COMPILED[robot] = function, support.mass
    return _COMPILED[robot]


class StanceOf:
    """Callable: a robot's :class:`Stance` at numeric states; its expressions are compiled once for each robot."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self._function, self.mass = _compiled(robot)

    def __call__(
        self,
        x: ArrayLike,
        wrench: ArrayLike = (0.0,) * 6,
        gravity: ArrayLike = GRAVITY,
        u: ArrayLike | None = None,
        u_rate: ArrayLike | None = None,
    ) -> Stance:
        """At state x (nx), with the world's ``wrench`` (6) on the end effector (force [N], moment [N m], world axes), ``gravity`` (3)
        [m/s²], and the inertia of inputs u (nu) that change by ``u_rate`` (nu) per second (brakes open)."""
        none = np.zeros(self.robot.input.size)
        arguments = (x, none if u is None else u, none if u_rate is None else u_rate, wrench, gravity)
        sizes = (self.robot.state.size, none.size, none.size, 6, 3)
        names = ("state", "input", "input's rate", "wrench", "gravity")
        checked = [_numbers(n, v, s) for n, v, s in zip(names, arguments, sizes, strict=True)]
        feet, com, force, moment = self._function(*checked)
        force, moment = force.ravel(), moment.ravel()
        down = force[2] if force[2] < 0.0 else np.nan
        return Stance(feet, com.ravel(), self.mass, force, moment, np.array([-moment[1], moment[0]]) / down)


def _numbers(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    array = numbers("stability", name, values, size)
    if np.abs(array).max(initial=0.0) > LARGEST:
        raise InputError(
            f"{name}: numbers of {LARGEST:g} at most are needed, got {np.array2string(array, threshold=8)}"
        )
    return array
