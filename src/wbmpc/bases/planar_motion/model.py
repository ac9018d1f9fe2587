"""The symbolic side: the body's twist is a constant matrix times the base's input, and wheel rates another one times that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.wheels import FixedWheels, section
from wbmpc.errors import InputError
from wbmpc.model.joints import Limits, joint_home, joint_limits
from wbmpc.model.kinematics import Chain, FramePose, constant, rotation_about
from wbmpc.model.tree import Tree
from wbmpc.robots import RobotDescription
from wbmpc.units import rate_unit

if TYPE_CHECKING:
    from wbmpc.bases.footprint import Footprint, SteeredFeet
    from wbmpc.model.robot import RobotModel
    from wbmpc.model.wheels import ModuleGeometry
    from wbmpc.ocp import Constraint

_UP = np.array([0.0, 0.0, 1.0])
#: Smallest ratio of singular values of the wheel matrix, turns counted at the wheels' distance, at which wheels hold the base.
_SINGULAR = 1e-3
#: Of the wheels' accelerations, what plans use: the rest is for the way from a plan to the next; slack of these limits, more than any
#: goal pulls with: from a speed that plans may not have, they give way.
ACCELERATION_SHARE, ACCELERATION_SLACK = 0.9, 1e6
#: Feet whose spread across a line is a smaller share of that along it stand on the line.
FLAT = 1e-3


class PointFootprint:
    """Points (n, 2) [m] that do not move in the axes of the body: wheels, casters. ``even``: see
    :class:`wbmpc.bases.footprint.Footprint`."""

    modules: ModuleGeometry | None = None
    steered: SteeredFeet | None = None

    def __init__(self, points: Array, names: Sequence[str], even: bool) -> None:
        self._points, self.size, self.names, self.even = points, len(points), list(names), even

    def positions(self, x: Array) -> Array:
        """Feet (n, 2) [m]."""
        return self._points.copy()

    def expressions(self, x: ca.SX) -> list[ca.SX]:
        """The same (2 each) as symbols."""
        return [constant(point) for point in self._points]


def standing_on(footprint: Footprint, home: Array | None = None) -> Footprint | None:
    """The footprint of a base that stands on three points or more, which are not on one line at its state ``home``; or None."""
    points = footprint.positions(np.zeros(0) if home is None else home)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) > 2 else np.zeros(2)
    return footprint if spread[1] > FLAT * spread[0] else None


class PlanarBase:
    """State: (x, y, yaw) of the body's frame and the arm; input: the base's speeds ``names``, of which the last is "wz", and the
    arm's rates.

    ``twist`` (3, m): the body's twist (vx, vy, wz) in its own axes by the base's input; ``rates`` (n, m): wheel rates [rad/s] by
    the same, of full column rank; ``wheel_upper`` (n) [rad/s] and ``wheel_acceleration`` (n) [rad/s²]: limits, infinite where the
    description has none. Raises :class:`InputError` for wheels that do not determine the motion.
    """

    def __init__(
        self, description: RobotDescription, tree: Tree, wheels: FixedWheels, matrix: Array, names: Sequence[str],
        twist: Array,
    ) -> None:  # fmt: skip
        """``matrix`` (n, 3): wheel rates by the twist."""
        self.tree, self.geometry, self.twist, self.rates = tree, wheels, twist, matrix @ twist
        joints = {**description.base.joint_groups(), "arm": list(description.arm.joints)}
        self._joints = [tree.joint(n) for group in joints.values() for n in group]
        self._groups = tuple(joints)
        self.state: dict[str, list[str]] = {"base": ["x", "y", "yaw"], **joints}
        self.input: dict[str, list[str]] = {"base": list(names), **joints}
        units = {group: tree.units(own) for group, own in joints.items()}
        self.state_units = {"base": ("m", "m", "rad"), **units}
        self.input_units = {
            "base": (*["m/s"] * (len(names) - 1), "rad/s"), **{g: [rate_unit(u) for u in own] for g, own in units.items()}
        }  # fmt: skip
        self.parameters: dict[str, list[str]] = {}
        self.mode: dict[str, list[str]] = {}
        self.mode_bounds: dict[str, tuple[float, float]] = {}
        self.brakes: dict[str, str] = {}
        self.rolling_groups: tuple[str, ...] = ()
        self.steering_groups: tuple[str, ...] = ("steer",) if "steer" in joints else ()
        self.unit_quaternions: tuple[int, ...] = ()
        self.footprint: Footprint | None = standing_on(
            PointFootprint(wheels.position, section(description).wheel_joints(), True)
        )
        self.wheels, self.balances = 0, False  # no constraint makes the wheels roll: their rates follow from the input
        self.ground, self.body_height = 0.0, wheels.height
        #: feet whose wheel is in each row of the odometry
        self.feet_of_rows: list[int] = list(range(len(self.rates)))
        limits, driven = description.limits, section(description).wheel_joints()
        self.wheel_upper = np.array([limits.velocity.get(n, np.inf) for n in driven])
        self.wheel_acceleration = np.array([limits.acceleration.get(n, np.inf) for n in driven])
        self._check_rank(description)

    def _singular_values(self) -> Array:
        """Of the matrix of wheel rates, turns counted at the wheels' distance."""
        size = max(float(np.linalg.norm(np.ptp(self.geometry.position, axis=0))), self.geometry.radius)
        scaled = self.rates.copy()
        scaled[:, -1] /= size
        return np.asarray(np.linalg.svd(scaled, compute_uv=False), float)

    def condition(self) -> float:
        """Ratio of the largest singular value of the wheel matrix to the smallest."""
        values = self._singular_values()
        return float(values[0] / values[-1])

    def _check_rank(self, description: RobotDescription) -> None:
        values = self._singular_values()
        if len(self.rates) < self.rates.shape[1] or values[-1] < _SINGULAR * values[0]:
            raise InputError(
                f"{description.source}: key 'base.wheels': these {len(self.rates)} wheels do not determine the motion of the base "
                f"({', '.join(self.input['base'])}): the matrix of wheel rates has rank {int(np.sum(values > _SINGULAR * values[0]))}, "
                f"{self.rates.shape[1]} is needed; check positions, axes and rollers of the wheels"
            )

    def root_pose(self, x: ca.SX) -> FramePose:
        position = ca.vertcat(x[0], x[1], self.body_height)
        return FramePose(position, ca.sparsify(lie.quaternion_about(_UP, x[2])), rotation_about(_UP, x[2]))

    def chain(self, x: ca.SX) -> Chain:
        """The tree at a state, with the wheels as the file draws them."""
        return Chain(self.tree.links, {link: x[3 + k] for k, link in enumerate(self._joints)}, self.root_pose(x))

    def _twist(self, u: ca.SX) -> ca.SX:
        return constant(self.twist) @ u[: self.twist.shape[1]]

    def velocities(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        """Joint rates by link, linear and angular velocity of the body in its own axes."""
        t, m = self._twist(u), self.twist.shape[1]
        rates = {link: u[m + k] for k, link in enumerate(self._joints)}
        return rates, ca.vertcat(t[0], t[1], ca.SX(1, 1)), ca.vertcat(ca.SX(2, 1), t[2])

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ: the twist in world axes, and the arm's rates."""
        t, c, s = self._twist(u), ca.cos(x[2]), ca.sin(x[2])
        return ca.vertcat(c * t[0] - s * t[1], s * t[0] + c * t[1], t[2], u[self.twist.shape[1] :])

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        """No rows: wheel rates follow from the input, and the input has no motion in which a wheel would slip."""
        return ca.SX(0, 1)

    def constraints(self, robot: RobotModel, *, hard: bool = True) -> list[Constraint]:
        """Limits of the wheels' rates as shares of the largest, and of their accelerations; none where the description has no limit."""
        from wbmpc.bases.planar_motion.accelerations import WheelAccelerationLimit
        from wbmpc.ocp import Constraint, residuals, sets

        limited, found = np.isfinite(self.wheel_upper), []
        if limited.any():
            shares, m = constant(self.rates[limited] / self.wheel_upper[limited, None]), self.rates.shape[1]
            rows = residuals.Expression(int(limited.sum()), lambda s: shares @ s.u[:m])
            found.append(Constraint("wheels", rows, sets.Box(-1.0, 1.0), hard=hard))
        # a drive of one of the speeds alone has the limit of that speed
        if np.isfinite(self.wheel_acceleration).any() and np.count_nonzero(self.rates, axis=1).max() > 1:
            change = WheelAccelerationLimit(robot, ["base"], ACCELERATION_SHARE, base=self)
            found.append(
                Constraint("wheel_accelerations", change, sets.NonNegative(), hard=True, slack=ACCELERATION_SLACK)
            )
        return found

    def fastest_rates(self) -> Array:
        """(n, m): the largest rates of driven wheels by each of the base's speeds."""
        return np.abs(self.rates)

    def limits(self, description: RobotDescription) -> Limits:
        """Ranges of the arm's joints (state); speeds and accelerations of base and arm (input): those of the base are what its wheels'
        allow each of its speeds alone."""
        limits = description.limits
        speeds = [limits.base_angular if n == "wz" else limits.base_linear for n in self.input["base"]]
        found = joint_limits(self, description, self._groups, limits.velocity, limits.acceleration, {"base": speeds})
        rates = self.fastest_rates()
        changes = np.full((len(rates) + 1, rates.shape[1]), np.inf)
        np.divide(self.wheel_acceleration[:, None], rates, out=changes[:-1], where=rates != 0.0)
        rate = found.input_rate.copy()
        rate[: self.rates.shape[1]] = changes.min(axis=0)
        return replace(found, input_rate=rate)

    def home(self, robot: RobotModel) -> Array:
        """The arm at the description's home, the body at the origin."""
        return joint_home(self, robot.description, self._groups)


def planar_base(robot: RobotModel) -> PlanarBase:
    """The base of a robot that moves in the plane by wheels. Raises :class:`InputError` for one of another kind."""
    if not isinstance(robot.base, PlanarBase):
        kind = robot.description.base.type
        raise InputError(
            f"{robot.description.name}: a base that moves in the plane is needed, it has one of type '{kind}'"
        )
    return robot.base
