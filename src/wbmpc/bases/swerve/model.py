"""Swerve bases: steered and driven wheels, on fixed legs or on passive hinges with brakes.

Source: Pankert et al., RA-L 2022 (arXiv 2206.15298), equations 1 to 5 and 9 to 12. Wheel i: hinge at h_i, leg angle φ_i,
steer axis s_i = h_i + L d(φ_i); its velocity in the body frame is v + ω ẑ × s_i + λ_i φ̇_i ẑ × (s_i − h_i).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.model.kinematics import Chain, FramePose, constant, rotation_about
from wbmpc.model.tree import Tree
from wbmpc.robots import ModuleDescription, RobotDescription, SwerveBaseDescription

Array = NDArray[np.float64]


# A wheel whose contact lies farther [m] from the steer axis is a caster, which these equations do not describe; a hinged leg that
# is shorter [m] is moved by no wheel. Wheels that differ by more [m] in height leave the robot standing on some of them.
_LARGEST_OFFSET, _SHORTEST_LEG, _LEVEL = 0.005, 0.005, 0.001


@dataclass(frozen=True)
class SwerveGeometry:
    """Numbers of a swerve base, in the body frame. n modules.

    ``hinge`` (n, 2) [m]; ``leg_length`` (n,) from hinge to steer axis [m]; ``leg_heading`` (n,) of the leg and
    ``wheel_heading`` (n,) of the wheel at zero joint angles [rad]. Fixed legs have their angle in the headings; joint
    angles and rates of legs have no effect on them.
    """

    hinge: Array
    leg_length: Array
    leg_heading: Array
    wheel_heading: Array
    wheel_radius: float
    has_hinge: bool

    @property
    def modules(self) -> int:
        """Number of modules n."""
        return len(self.hinge)

    def leg_angles(self, leg: ArrayLike) -> Array:
        """Leg angles (n,) or rates as far as the legs can turn: zero for fixed legs."""
        return np.broadcast_to(np.asarray(leg, float) * self.has_hinge, self.modules)

    def steer_axes(self, leg: ArrayLike) -> Array:
        """Positions (n, 2) [m] of the steer axes for leg angles (n,)."""
        a = self.leg_heading + self.leg_angles(leg)
        return self.hinge + self.leg_length[:, None] * np.stack([np.cos(a), np.sin(a)], axis=1)


def read_geometry(description: RobotDescription, tree: Tree) -> tuple[SwerveGeometry, float]:
    """Geometry from the tree at zero joint angles, and the height [m] of the body's frame above the ground.

    Raises :class:`InputError` for modules that this model does not describe.
    """
    base = description.base
    assert isinstance(base, SwerveBaseDescription)
    poses = tree.zero_poses()
    hinged = [m.hinge is not None for m in base.modules]
    if any(hinged) != all(hinged):
        raise InputError(f"{description.source}: key 'base.modules': either all modules or none have a 'hinge'")
    hinge, length, leg, wheel, height = [], [], [], [], []
    for module in base.modules:
        steer, rolling = tree.joint(module.steer), tree.joint(module.wheel)
        # The parent of a steer joint is the leg, on its hinge or fixed; without a leg the steer axis is on the body.
        mount = tree.joint(module.hinge) if module.hinge else tree.links[steer].parent
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
        leg.append(float(np.arctan2(along[1], along[0])))
        wheel.append(float(np.arctan2(-axle[0], axle[1])))  # rolling direction = axle × up
        height.append(base.wheel_radius - float(poses[rolling][0][2]))
    _check_level(description.source, [m.wheel for m in base.modules], np.array(height))
    geometry = SwerveGeometry(
        hinge=np.array(hinge),
        leg_length=np.array(length),
        leg_heading=np.array(leg),
        wheel_heading=np.array(wheel),
        wheel_radius=base.wheel_radius,
        has_hinge=all(hinged),
    )
    return geometry, float(np.mean(height))


def _check_module(
    description: RobotDescription, tree: Tree, module: ModuleDescription, poses: list[tuple[Array, Array]]
) -> None:
    steer, wheel = tree.joint(module.steer), tree.joint(module.wheel)
    for name in (module.hinge, module.steer, module.wheel):
        if name and tree.links[tree.joint(name)].kind != "revolute":
            raise InputError(
                f"{description.model}: joint '{name}' slides; it is in base.modules of {description.source}, where all joints turn"
            )
    for name in (module.hinge, module.steer):
        if name and (poses[tree.joint(name)][1] @ tree.links[tree.joint(name)].axis)[2] < 1.0 - 1e-6:
            raise InputError(f"{description.source}: joint '{name}' must turn about the body's +z axis")
    if abs((poses[wheel][1] @ tree.links[wheel].axis)[2]) > 1e-6:
        raise InputError(f"{description.source}: joint '{module.wheel}' must have a horizontal axis")
    if np.hypot(*(poses[wheel][0] - poses[steer][0])[:2]) > _LARGEST_OFFSET:
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
        raise InputError(f"{description.source}: key '{key}.{wheel}': a wheel turns on and on, it can have no range")
    if np.isfinite([low, high]).any():
        raise InputError(
            f"{description.model}: joint '{wheel}' has a range, {low:g} to {high:g} rad; it is a wheel (base.modules of "
            f"{description.source}), which turns on and on: take the range away (in a URDF: type continuous)"
        )


def wheel_velocities(geometry: SwerveGeometry, leg: ArrayLike, twist: ArrayLike, leg_rate: ArrayLike = 0.0) -> Array:
    """Velocities (n, 2) [m/s] of the steer axes in the body frame for a twist (vx, vy, ω) and leg rates (n,)."""
    s, (vx, vy, w) = geometry.steer_axes(leg), np.asarray(twist, float)
    swing = (s - geometry.hinge) * geometry.leg_angles(leg_rate)[:, None]
    return np.stack([vx - w * s[:, 1] - swing[:, 1], vy + w * s[:, 0] + swing[:, 0]], axis=1)


def rolling_inverse_kinematics(
    geometry: SwerveGeometry, leg: ArrayLike, steer: ArrayLike, twist: ArrayLike, leg_rate: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Steering angles (n,) [rad] (the branch nearest to ``steer``) and wheel speeds (n,) [rad/s] that roll a motion."""
    v = wheel_velocities(geometry, leg, twist, leg_rate)
    steer = np.asarray(steer, float)
    heading = geometry.wheel_heading + geometry.leg_angles(leg) + steer
    change = np.arctan2(v[:, 1], v[:, 0]) - heading
    change = (change + np.pi / 2) % np.pi - np.pi / 2
    still = np.hypot(v[:, 0], v[:, 1]) < 1e-9
    target = np.where(still, steer, steer + change)
    heading = heading + (target - steer)
    speed = (v[:, 0] * np.cos(heading) + v[:, 1] * np.sin(heading)) / geometry.wheel_radius
    return target, speed


def beyond_range(steer: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> Array:
    """By how much [rad] wheels at angles ``steer`` (..., n) are out of their ranges (n), whichever way round they roll."""
    low, high = np.broadcast_arrays(np.asarray(lower, float), np.asarray(upper, float))
    all_round = high - low >= np.pi
    middle = np.where(all_round, 0.0, 0.5 * (np.where(all_round, 0.0, low) + np.where(all_round, 0.0, high)))
    off = np.abs((np.asarray(steer, float) - middle + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
    return np.where(all_round, 0.0, np.maximum(off - 0.5 * (high - low), 0.0))


def aligned_steering(geometry: SwerveGeometry, leg: ArrayLike, steer: ArrayLike) -> Array:
    """Steering angles (n,) [rad] near ``steer`` that have a common centre: those of the twist that slips least there.

    The twist is the last right singular vector of the side-slip rows; the turn is weighed with the modules' distance.
    """
    s, steer = geometry.steer_axes(leg), np.asarray(steer, float)
    heading = geometry.wheel_heading + geometry.leg_angles(leg) + steer
    lever = float(np.sqrt(np.mean(np.sum((s - s.mean(axis=0)) ** 2, axis=1))))
    c, d = np.cos(heading), np.sin(heading)
    rows = np.stack([-d, c, (c * s[:, 0] + d * s[:, 1]) / lever], axis=1)
    twist = np.linalg.svd(rows)[2][-1] / [1.0, 1.0, lever]
    return rolling_inverse_kinematics(geometry, leg, steer, twist)[0]


class SwerveBase:
    """Kinematic model: the input is the wheels' body twist and all joint rates; rolling is a constraint."""

    def __init__(self, description: RobotDescription, tree: Tree) -> None:
        assert isinstance(description.base, SwerveBaseDescription)
        self.base = description.base
        self.tree = tree
        self.geometry, self.height = read_geometry(description, tree)
        modules, arm = self.base.modules, description.arm.joints
        hinges = [m.hinge for m in modules if m.hinge]
        legs = {"leg": hinges} if hinges else {}
        joints = {**legs, "steer": [m.steer for m in modules], "wheel": [m.wheel for m in modules], "arm": list(arm)}
        self.quaternion = self.base.orientation == "quaternion"
        pose = ["x", "y", "z", "qw", "qx", "qy", "qz"] if self.quaternion else ["x", "y", "yaw"]
        self.state: dict[str, list[str]] = {"base": pose, **joints}
        self.input: dict[str, list[str]] = {"base": ["vx", "vy", "wz"], **joints}
        self.mode: dict[str, list[str]] = {"brake": hinges} if hinges else {}
        self.mode_bounds = {group: (0.0, 1.0) for group in self.mode}
        self.parameters: dict[str, list[str]] = {"drift": ["vx", "vy", "wz"]}
        self.unit_quaternions = (3,) if self.quaternion else ()
        self._start = len(pose)
        self._joints = [tree.joint(n) for group in joints.values() for n in group]

    def slices(self, vector: ca.SX, state: bool) -> dict[str, ca.SX]:
        """Parts of a state or an input by group."""
        out: dict[str, ca.SX] = {}
        start = 0
        for group, names in (self.state if state else self.input).items():
            out[group] = vector[start : start + len(names)]
            start += len(names)
        return out

    def root(self, x: ca.SX) -> FramePose:
        """Pose of the body's frame."""
        if self.quaternion:
            return FramePose(x[0:3], x[3:7], lie.quaternion_to_rotation(x[3:7]))
        up = np.array([0.0, 0.0, 1.0])
        position = ca.vertcat(x[0], x[1], self.height)
        return FramePose(position, ca.sparsify(lie.quaternion_about(up, x[2])), rotation_about(up, x[2]))

    def chain(self, x: ca.SX) -> Chain:
        """The tree at a state."""
        values = {link: x[self._start + k] for k, link in enumerate(self._joints)}
        return Chain(self.tree.links, values, self.root(x))

    def motion(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        """Joint rates by link, linear and angular velocity of the body in its own axes."""
        rates = {link: u[3 + k] for k, link in enumerate(self._joints)}
        return rates, ca.vertcat(u[0], u[1], ca.SX(1, 1)), ca.vertcat(ca.SX(2, 1), u[2])

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ = f(x, u): ṗ = R (vx, vy), joint rates = inputs, leg rates times the brake state.

        The body moves by the twist of its wheels and the parameter ``drift`` (body axes): what slip on a slope adds.
        """
        rates, u = u[3:], ca.vertcat(u[:3] + w[:3], u[3:])
        if self.geometry.has_hinge:
            n = self.geometry.modules
            rates = ca.vertcat(m[0:n] * u[3 : 3 + n], u[3 + n :])
        if self.quaternion:
            velocity = self.root(x).rotation @ ca.vertcat(u[0], u[1], ca.SX(1, 1))
            rate = ca.vertcat(ca.SX(3, 1), u[2])
            return ca.vertcat(velocity, 0.5 * lie.quaternion_multiply(x[3:7], rate), rates)
        c, s = ca.cos(x[2]), ca.sin(x[2])
        return ca.vertcat(c * u[0] - s * u[1], s * u[0] + c * u[1], u[2], rates)

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        """Rolling (n) and side-slip (n) velocities of the contacts [m/s] (Pankert et al. 2022, equations 4 and 5)."""
        g, state, given = self.geometry, self.slices(x, True), self.slices(u, False)
        rolling, side = [], []
        for i in range(g.modules):
            leg = state["leg"][i] if g.has_hinge else 0.0
            rate = m[i] * given["leg"][i] if g.has_hinge else 0.0
            angle = float(g.leg_heading[i]) + leg
            arm = float(g.leg_length[i]) * ca.vertcat(ca.cos(angle), ca.sin(angle))
            s = constant(g.hinge[i]) + arm
            vx = u[0] - u[2] * s[1] - rate * arm[1]
            vy = u[1] + u[2] * s[0] + rate * arm[0]
            heading = float(g.wheel_heading[i]) + leg + state["steer"][i]
            c, d = ca.cos(heading), ca.sin(heading)
            rolling.append(c * vx + d * vy - g.wheel_radius * given["wheel"][i])
            side.append(-d * vx + c * vy)
        return ca.vertcat(*rolling, *side)
