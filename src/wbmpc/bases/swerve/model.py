"""Swerve bases: steered and driven wheels, on fixed legs, or on passive hinges or slides with brakes.

Source: Pankert et al., RA-L 2022 (arXiv 2206.15298), equations 1 to 5 and 9 to 12. Wheel i: hinge at h_i, leg angle φ_i,
steer axis s_i = h_i + L d(φ_i); its velocity in the body frame is v + ω ẑ × s_i + λ_i φ̇_i ẑ × (s_i − h_i). A leg that slides has
s_i = h_i + (L + q_i) d, and λ_i q̇_i d in place of the last term.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.swerve.description import ModuleDescription, SwerveBaseDescription
from wbmpc.errors import InputError
from wbmpc.model.joints import Limits, joint_home, joint_limits
from wbmpc.model.kinematics import Chain, FramePose, constant, rotation_about
from wbmpc.model.layout import Layout
from wbmpc.model.tree import Tree
from wbmpc.model.wheels import ModuleGeometry, rolling_inverse_kinematics
from wbmpc.robots import RobotDescription
from wbmpc.units import rate_unit

if TYPE_CHECKING:
    from wbmpc.bases.footprint import Footprint, SteeredFeet
    from wbmpc.model.robot import RobotModel
    from wbmpc.ocp import Constraint

_LOG = logging.getLogger("wbmpc")
#: By how much [rad] a steering range may be short of half a turn (files say 1.57): a wheel points 0.01 rad off at worst.
NEARLY = 0.02

# A wheel whose contact lies farther [m] from the steer axis is a caster, which these equations do not describe; a hinged leg that
# is shorter [m] is moved by no wheel. Wheels that differ by more [m] in height leave the robot standing on some of them.
LARGEST_OFFSET, _SHORTEST_LEG, _LEVEL = 0.005, 0.005, 0.001


def read_geometry(description: RobotDescription, tree: Tree) -> tuple[ModuleGeometry, float]:
    """Geometry from the tree at zero joint angles, and the height [m] of the body's frame above the ground.

    Raises :class:`InputError` for modules that this model does not describe.
    """
    base = description.base
    assert isinstance(base, SwerveBaseDescription)
    poses = tree.zero_poses()
    moved = [m.leg is not None for m in base.modules]
    if any(moved) != all(moved):
        raise InputError(
            f"{description.source}: key 'base.modules': either all modules or none have a 'hinge' or 'slide'"
        )
    hinge, length, leg, wheel, height = [], [], [], [], []
    for module in base.modules:
        steer, rolling = tree.joint(module.steer), tree.joint(module.wheel)
        # The parent of a steer joint is the leg, on its hinge or fixed; without a leg the steer axis is on the body.
        mount = tree.joint(module.leg) if module.leg else tree.links[steer].parent
        start = poses[steer][0] if tree.links[mount].parent < 0 else poses[mount][0]
        along = (poses[steer][0] - start)[:2]
        axle = poses[rolling][1] @ tree.links[rolling].axis
        _check_module(description, tree, module, poses)
        _check_wheel_turns(description, tree, module.wheel)
        hinge.append(start[:2])
        length.append(float(np.hypot(*along)))
        if module.hinge and length[-1] < _SHORTEST_LEG:
            raise InputError(
                f"{description.source}: the steering axis '{module.steer}' must be away from the hinge '{module.hinge}': no wheel "
                f"swings a leg of {1e3 * length[-1]:.3g} mm; a module without a leg has no 'hinge'"
            )
        if module.slide:
            along = (poses[mount][1] @ tree.links[mount].axis)[:2]
            length[-1] = float(along @ (poses[steer][0] - start)[:2])
            start = poses[steer][0] - np.array([*(length[-1] * along), 0.0])
            hinge[-1] = start[:2]
        leg.append(float(np.arctan2(along[1], along[0])))
        wheel.append(float(np.arctan2(-axle[0], axle[1])))  # rolling direction = axle × up
        height.append(base.wheel_radius - float(poses[rolling][0][2]))
    _check_level(description.source, [m.wheel for m in base.modules], np.array(height))
    geometry = ModuleGeometry(
        hinge=np.array(hinge), leg_length=np.array(length), leg_heading=np.array(leg), wheel_heading=np.array(wheel),
        wheel_radius=base.wheel_radius, legs_move=all(moved),
        slides=np.array([float(m.slide is not None) for m in base.modules]),
    )  # fmt: skip
    return geometry, float(np.mean(height))


def _check_module(
    description: RobotDescription, tree: Tree, module: ModuleDescription, poses: list[tuple[Array, Array]]
) -> None:
    steer, wheel = tree.joint(module.steer), tree.joint(module.wheel)
    for upper, joint in ((module.leg, module.steer), (module.steer, module.wheel)):
        if upper:
            tree.check_moves(upper, joint, f"{description.source}: key 'base.modules'")
    for name in (module.hinge, module.steer, module.wheel):
        if name and tree.links[tree.joint(name)].kind != "revolute":
            raise InputError(
                f"{description.model}: joint '{name}' slides; it is in base.modules of {description.source}, where all joints but "
                "those of the key 'slide' turn"
            )
    if module.slide:
        link = tree.links[tree.joint(module.slide)]
        if link.kind != "prismatic":
            raise InputError(
                f"{description.model}: joint '{module.slide}' turns; {description.source} names it as a 'slide' of base.modules"
            )
        if abs((poses[tree.joint(module.slide)][1] @ link.axis)[2]) > 1e-6:
            raise InputError(f"{description.source}: joint '{module.slide}' must slide horizontally")
    for name in (module.hinge, module.steer):
        if name and (poses[tree.joint(name)][1] @ tree.links[tree.joint(name)].axis)[2] < 1.0 - 1e-6:
            raise InputError(f"{description.source}: joint '{name}' must turn about the body's +z axis")
    if abs((poses[wheel][1] @ tree.links[wheel].axis)[2]) > 1e-6:
        raise InputError(f"{description.source}: joint '{module.wheel}' must have a horizontal axis")
    if np.hypot(*(poses[wheel][0] - poses[steer][0])[:2]) > LARGEST_OFFSET:
        raise InputError(f"{description.source}: wheel '{module.wheel}' must stand under the axis of '{module.steer}'")


def _check_level(source: object, wheels: Sequence[str], height: Array) -> None:
    """All wheels touch even ground. ``height`` (n,) [m]: of the body's frame over the lowest point of each."""
    if np.ptp(height) <= _LEVEL:
        return
    above = np.median(height) - height
    odd = int(np.argmax(np.abs(above)))
    raise InputError(
        f"{source}: key 'base.modules': the wheels do not stand on one level: '{wheels[odd]}' is "
        f"{1e3 * abs(above[odd]):.3g} mm too {'high' if above[odd] > 0.0 else 'low'}, wheels may differ by {1e3 * _LEVEL:g} mm"
    )


def _check_wheel_turns(description: RobotDescription, tree: Tree, wheel: str) -> None:
    """A wheel that stops at the end of a range would be dragged from there on."""
    key = "limits.position"
    in_key, (low, high) = description.limits.position.get(wheel), tree.links[tree.joint(wheel)].range
    if in_key is not None:
        raise InputError(
            f"{description.source}: key '{key}.{wheel}': a wheel is a continuous joint and can have no range"
        )
    if np.isfinite([low, high]).any():
        raise InputError(
            f"{description.model}: joint '{wheel}' has a range, {low:g} to {high:g} rad; it is a wheel (base.modules of "
            f"{description.source}), which is a continuous joint: take the range away (in a URDF: type continuous)"
        )


class ModuleFootprint:
    """A swerve base stands under its steer axes."""

    def __init__(self, base: SwerveBase) -> None:
        self._base, self.size = base, base.geometry.modules
        self.modules: ModuleGeometry | None = base.geometry
        self.steered: SteeredFeet | None = self
        self.leg_group, self._state = "leg" if base.geometry.legs_move else "", Layout(base.state)
        self.names, self.even = list(base.state["wheel"]), True

    def positions(self, x: Array) -> Array:
        """Feet (n, 2) [m] in the axes of the body at a state (nx)."""
        return self._base.geometry.steer_axes(self.legs(x))

    def legs(self, x: Array) -> Array:
        """Positions (n) [rad, or m of those that slide] of the legs' joints; zero where they are fixed."""
        return x[self._state[self.leg_group]] if self.leg_group else np.zeros(self.size)

    def headings(self, x: Array) -> Array:
        """Directions (n) [rad] of the wheels in the axes of the body."""
        g = self._base.geometry
        return np.asarray(g.wheel_heading + g.leg_angles(self.legs(x)) + x[self._state["steer"]], float)

    def with_legs(self, x: Array, legs: Array) -> Array:
        """The state with the legs' joints at ``legs`` (n), the wheels along the same directions of the body."""
        moved = x.copy()
        moved[self._state["steer"]] += self._base.geometry.leg_angles(self.legs(x) - legs)
        moved[self._state[self.leg_group]] = legs
        return moved

    def rolling(self, x: Array, twist: Array) -> Array:
        """The state with the wheels along a twist (vx, vy, wz) of the body, within a quarter turn of where they stand at zero."""
        turned, straight = x.copy(), np.zeros(self.size)
        turned[self._state["steer"]] = rolling_inverse_kinematics(self._base.geometry, self.legs(x), straight, twist)[0]
        return turned

    def expressions(self, x: ca.SX) -> list[ca.SX]:
        """The same (2 each) as symbols of the state."""
        g, parts = self._base.geometry, self._base.slices(x, True)
        feet = []
        for i in range(g.modules):
            feet.append(steer_axis(g, i, parts["leg"][i] if g.legs_move else ca.SX(0.0))[0])
        return feet


def steer_axis(g: ModuleGeometry, i: int, leg: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Of module i with its leg's joint at ``leg`` [rad or m]: the steer axis (2) [m], its velocity (2) at a rate of 1 of that joint, the
    angle by which the leg has turned [rad]."""
    slides = bool(g.slides[i])
    nothing = ca.SX(0.0)
    angle, length = (nothing, leg) if slides else (leg, nothing)
    heading = float(g.leg_heading[i]) + angle
    along = ca.vertcat(ca.cos(heading), ca.sin(heading))
    arm = (float(g.leg_length[i]) + length) * along
    return constant(g.hinge[i]) + arm, along if slides else ca.vertcat(-arm[1], arm[0]), angle


def _warn_of_short_steering(description: RobotDescription, names: Sequence[str], limits: Limits, part: slice) -> None:
    """A wheel with less than half a turn of steering cannot roll in every direction: possible, but not what is expected."""
    low, high = limits.state_lower[part], limits.state_upper[part]
    short = np.flatnonzero(high - low < np.pi - NEARLY)
    if short.size:
        i = int(short[0])
        more = f" (and {short.size - 1} more)" if short.size > 1 else ""
        _LOG.warning(
            "%s: steering joint '%s'%s turns from %g to %g rad, less than half a turn: no wheel rolls along what is left out, "
            "%g to %g rad, and motions that ask for it drag the wheel",
            description.source, names[i], more, low[i], high[i], high[i], low[i] + np.pi,
        )  # fmt: skip


class SwerveBase:
    """Kinematic model: the input is the wheels' body twist and all joint rates; rolling is a constraint."""

    def __init__(self, description: RobotDescription, tree: Tree) -> None:
        assert isinstance(description.base, SwerveBaseDescription)
        self.base = description.base
        self.tree = tree
        self.geometry, self.body_height = read_geometry(description, tree)
        hinges = [m.leg for m in self.base.modules if m.leg]
        joints = {**self.base.joint_groups(), "arm": list(description.arm.joints)}
        self.quaternion = self.base.orientation == "quaternion"
        pose = ["x", "y", "z", "qw", "qx", "qy", "qz"] if self.quaternion else ["x", "y", "yaw"]
        self.state: dict[str, list[str]] = {"base": pose, **joints}
        self.input: dict[str, list[str]] = {"base": ["vx", "vy", "wz"], **joints}
        units = {group: tree.units(names) for group, names in joints.items()}
        self.state_units = {"base": ("m", "m", "m", *"1111") if self.quaternion else ("m", "m", "rad"), **units}
        self.input_units = {
            "base": ("m/s", "m/s", "rad/s"), **{g: [rate_unit(u) for u in own] for g, own in units.items()}
        }  # fmt: skip
        self.mode: dict[str, list[str]] = {"brake": hinges} if hinges else {}
        self.mode_bounds = {group: (0.0, 1.0) for group in self.mode}
        self.brakes = dict.fromkeys(self.mode, "leg")
        self.rolling_groups: tuple[str, ...] = ("wheel",)
        self.steering_groups: tuple[str, ...] = ("steer",)
        self.footprint: Footprint | None = ModuleFootprint(self)
        self.twist = np.eye(3)
        self.wheels = self.geometry.modules
        self.ground, self.balances = 0.0, False
        self.parameters: dict[str, list[str]] = {"drift": ["vx", "vy", "wz"]}
        self.unit_quaternions: tuple[int, ...] = (3,) if self.quaternion else ()
        self._start = len(pose)
        self._groups = tuple(joints)
        self._joints = [tree.joint(n) for group in joints.values() for n in group]

    def slices(self, vector: ca.SX, state: bool) -> dict[str, ca.SX]:
        out: dict[str, ca.SX] = {}
        start = 0
        for group, names in (self.state if state else self.input).items():
            out[group] = vector[start : start + len(names)]
            start += len(names)
        return out

    def root_pose(self, x: ca.SX) -> FramePose:
        if self.quaternion:
            return FramePose(x[0:3], x[3:7], lie.quaternion_to_rotation(x[3:7]))
        up = np.array([0.0, 0.0, 1.0])
        position = ca.vertcat(x[0], x[1], self.body_height)
        return FramePose(position, ca.sparsify(lie.quaternion_about(up, x[2])), rotation_about(up, x[2]))

    def chain(self, x: ca.SX) -> Chain:
        """The tree at a state."""
        values = {link: x[self._start + k] for k, link in enumerate(self._joints)}
        return Chain(self.tree.links, values, self.root_pose(x))

    def velocities(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        """Joint rates by link, linear and angular velocity of the body in its own axes."""
        rates = {link: u[3 + k] for k, link in enumerate(self._joints)}
        return rates, ca.vertcat(u[0], u[1], ca.SX(1, 1)), ca.vertcat(ca.SX(2, 1), u[2])

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ = f(x, u): ṗ = R (vx, vy), joint rates = inputs, leg rates times the brake state.

        The body moves by the twist of its wheels and the parameter ``drift`` (body axes): what slip on a slope adds.
        """
        rates, u = u[3:], ca.vertcat(u[:3] + w[:3], u[3:])
        if self.geometry.legs_move:
            n = self.geometry.modules
            rates = ca.vertcat(m[0:n] * u[3 : 3 + n], u[3 + n :])
        if self.quaternion:
            velocity = self.root_pose(x).rotation @ ca.vertcat(u[0], u[1], ca.SX(1, 1))
            rate = ca.vertcat(ca.SX(3, 1), u[2])
            return ca.vertcat(velocity, 0.5 * lie.quaternion_multiply(x[3:7], rate), rates)
        c, s = ca.cos(x[2]), ca.sin(x[2])
        return ca.vertcat(c * u[0] - s * u[1], s * u[0] + c * u[1], u[2], rates)

    def acceleration(self, limits: Limits) -> Array:
        """(3) [m/s², m/s², rad/s²]: bounds of the twist's rate for which wheels keep their ``limits`` in any steering direction."""
        g = self.geometry
        slowest = float(np.min(limits.input_rate[Layout(self.input)["wheel"]])) * g.wheel_radius
        lever = float(np.max(np.linalg.norm(g.hinge, axis=1) + g.leg_length))
        return slowest * np.array([1.0, 1.0, 1.0 / lever])

    def check_brakes(self, leg: ArrayLike, brake: ArrayLike) -> None:
        """Raise :class:`InputError` if legs at ``leg`` (n) [rad] with brakes (n, 1 = open) hold the base against nothing."""
        from wbmpc.bases.swerve.brake_control import reject_floating

        reject_floating(self.geometry, leg, brake)

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        """Rolling (n) and side-slip (n) velocities of the contacts [m/s] (Pankert et al. 2022, equations 4 and 5)."""
        g, state, inputs = self.geometry, self.slices(x, True), self.slices(u, False)
        rolling, side = [], []
        for i in range(g.modules):
            leg = state["leg"][i] if g.legs_move else ca.SX(0.0)
            rate = m[i] * inputs["leg"][i] if g.legs_move else 0.0
            s, moved, angle = steer_axis(g, i, leg)
            vx = u[0] - u[2] * s[1] + rate * moved[0]
            vy = u[1] + u[2] * s[0] + rate * moved[1]
            heading = float(g.wheel_heading[i]) + angle + state["steer"][i]
            c, d = ca.cos(heading), ca.sin(heading)
            rolling.append(c * vx + d * vy - g.wheel_radius * inputs["wheel"][i])
            side.append(-d * vx + c * vy)
        return ca.vertcat(*rolling, *side)

    def constraints(
        self, robot: RobotModel, side_softness: float = 0.0, *, allow_side_slip: bool = False, hard: bool = True
    ) -> list[Constraint]:
        """Rolling wheels, with the softness of their rows; closed brakes where legs are hinged: equations, ``hard`` limits or not.
        ``allow_side_slip``: the reference of "rolling" says which wheels may slip sideways."""
        from wbmpc.ocp import Constraint, residuals

        rolling = Constraint("rolling", residuals.Rolling(robot, allow_side_slip), softness=side_softness)
        brakes = [Constraint("brakes", residuals.LockedJoints(robot))] if self.brakes else []
        return [rolling, *brakes]

    def limits(self, description: RobotDescription) -> Limits:
        """Ranges of the joints (state); the body's twist, speeds and accelerations of the joints (input)."""
        limits = description.limits
        twist = {"base": [limits.base_linear, limits.base_linear, limits.base_angular]}
        found = joint_limits(self, description, self._groups, limits.velocity, limits.acceleration, twist)
        steering = self.base.joint_groups()["steer"]
        found.actuator_upper[Layout(self.input)["steer"]] = [
            limits.actuator_velocity.get(name, limits.velocity.get(name, np.inf)) for name in steering
        ]
        return found

    def warn(self, description: RobotDescription) -> None:
        """Log what is possible but not what is expected: a wheel that cannot roll in every direction."""
        part = Layout(self.state)["steer"]
        _warn_of_short_steering(description, self.state["steer"], self.limits(description), part)

    def home(self, robot: RobotModel) -> Array:
        """The joints at the description's home, the body at the origin."""
        x = joint_home(self, robot.description, self._groups)
        if self.quaternion:
            x[:7] = [0, 0, self.body_height, 1, 0, 0, 0]
        return x


def swerve_base(robot: RobotModel) -> SwerveBase:
    """The base of a robot with steered wheels. Raises :class:`InputError` for one of another type."""
    if not isinstance(robot.base, SwerveBase):
        kind = robot.description.base.type
        raise InputError(f"{robot.description.name}: a base of type swerve is needed, it has one of type '{kind}'")
    return robot.base
