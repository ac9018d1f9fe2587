"""Swerve bases: steered and driven wheels, on fixed legs or on passive hinges with brakes.

Source: Pankert et al., RA-L 2022 (arXiv 2206.15298), equations 1 to 5 and 9 to 12. Wheel i: hinge at h_i, leg angle φ_i,
steer axis s_i = h_i + L d(φ_i); its velocity in the body frame is v + ω ẑ × s_i + λ_i φ̇_i ẑ × (s_i − h_i).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.model.symbolic import Chain, FramePose, constant, rotation_about
from wbmpc.model.tree import Tree
from wbmpc.robots import RobotDescription, SwerveBaseDescription

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SwerveGeometry:
    """Numbers of a swerve base, in the body frame. n modules.

    ``hinge`` (n, 2) [m]; ``leg_length`` (n,) from hinge to steer axis [m] (0 for fixed legs, whose hinge is the steer
    axis); ``leg_heading`` (n,) of the leg and ``wheel_heading`` (n,) of the wheel at zero joint angles [rad].
    """

    hinge: Array
    leg_length: Array
    leg_heading: Array
    wheel_heading: Array
    wheel_radius: float
    has_hinge: bool

    @property
    def modules(self) -> int:
        return len(self.hinge)

    def steer_axes(self, leg: ArrayLike) -> Array:
        """Positions (n, 2) [m] of the steer axes for leg angles (n,)."""
        a = self.leg_heading + np.asarray(leg, float)
        return self.hinge + self.leg_length[:, None] * np.stack([np.cos(a), np.sin(a)], axis=1)


def read_geometry(tree: Tree, base: SwerveBaseDescription) -> SwerveGeometry:
    """Geometry from the tree at zero joint angles."""
    poses: list[tuple[Array, Array]] = []
    for link in tree.links:
        position, rotation = (np.zeros(3), np.eye(3)) if link.parent < 0 else poses[link.parent]
        poses.append((position + rotation @ link.position, rotation @ link.rotation))
    rows = []
    for module in base.modules:
        steer_position, steer_rotation = poses[tree.joint(module.steer)]
        hinge = steer_position if module.hinge is None else poses[tree.joint(module.hinge)][0]
        arm = (steer_position - hinge)[:2]
        length = float(np.hypot(*arm))
        rows.append((hinge[:2], length, np.arctan2(arm[1], arm[0]), np.arctan2(steer_rotation[1, 0], steer_rotation[0, 0])))
    hinge, length, leg, wheel = (np.array(v, float) for v in zip(*rows, strict=True))
    return SwerveGeometry(hinge, length, leg, wheel, base.wheel_radius, base.modules[0].hinge is not None)


def wheel_velocities(geometry: SwerveGeometry, leg: ArrayLike, twist: ArrayLike, leg_rate: ArrayLike = 0.0) -> Array:
    """Velocities (n, 2) [m/s] of the steer axes in the body frame for a twist (vx, vy, ω) and leg rates (n,)."""
    s, (vx, vy, w) = geometry.steer_axes(leg), np.asarray(twist, float)
    swing = (s - geometry.hinge) * np.broadcast_to(np.asarray(leg_rate, float), geometry.modules)[:, None]
    return np.stack([vx - w * s[:, 1] - swing[:, 1], vy + w * s[:, 0] + swing[:, 0]], axis=1)


def rolling_inverse_kinematics(
    geometry: SwerveGeometry, leg: ArrayLike, steer: ArrayLike, twist: ArrayLike, leg_rate: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Steering angles (n,) [rad] (the branch nearest to ``steer``) and wheel speeds (n,) [rad/s] that roll a motion."""
    v = wheel_velocities(geometry, leg, twist, leg_rate)
    steer = np.asarray(steer, float)
    heading = geometry.wheel_heading + np.asarray(leg, float) * geometry.has_hinge + steer
    change = np.arctan2(v[:, 1], v[:, 0]) - heading
    change = (change + np.pi / 2) % np.pi - np.pi / 2
    still = np.hypot(v[:, 0], v[:, 1]) < 1e-9
    target = np.where(still, steer, steer + change)
    heading = heading + (target - steer)
    speed = (v[:, 0] * np.cos(heading) + v[:, 1] * np.sin(heading)) / geometry.wheel_radius
    return target, speed


class SwerveBase:
    """Kinematic model: the input is the body twist and all joint rates; rolling is a constraint."""

    def __init__(self, description: RobotDescription, tree: Tree, height: float) -> None:
        assert isinstance(description.base, SwerveBaseDescription)
        self.base = description.base
        self.tree, self.height = tree, height
        self.geometry = read_geometry(tree, self.base)
        modules, arm = self.base.modules, description.arm.joints
        legs = {"leg": [m.hinge for m in modules]} if self.geometry.has_hinge else {}
        joints = {**legs, "steer": [m.steer for m in modules], "wheel": [m.wheel for m in modules], "arm": list(arm)}
        self.quaternion = self.base.orientation == "quaternion"
        pose = ["x", "y", "z", "qw", "qx", "qy", "qz"] if self.quaternion else ["x", "y", "yaw"]
        self.state = {"base": pose, **joints}
        self.input = {"base": ["vx", "vy", "wz"], **joints}
        self.mode = {"brake": [f"brake_{m.hinge}" for m in modules]} if legs else {}
        self.parameters: dict[str, list[str]] = {}
        self.unit_quaternions = (3,) if self.quaternion else ()
        self._start = len(pose)
        self._joints = [tree.joint(n) for group in joints.values() for n in group]

    def slices(self, vector: ca.SX, state: bool) -> dict[str, ca.SX]:
        """Parts of a state or an input by group."""
        out, start = {}, 0
        for group, names in (self.state if state else self.input).items():
            out[group] = vector[start : start + len(names)]
            start += len(names)
        return out

    def root(self, x: ca.SX) -> FramePose:
        """Pose of the body's frame."""
        if self.quaternion:
            from wbmpc.lie import quaternion_to_rotation

            return FramePose(x[0:3], x[3:7], quaternion_to_rotation(x[3:7]))
        half = x[2] / 2
        quaternion = ca.vertcat(ca.cos(half), ca.SX(2, 1), ca.sin(half))
        position = ca.vertcat(x[0], x[1], self.height)
        return FramePose(position, quaternion, rotation_about(np.array([0.0, 0.0, 1.0]), x[2]))

    def chain(self, x: ca.SX) -> Chain:
        """The tree at a state."""
        values = {link: x[self._start + k] for k, link in enumerate(self._joints)}
        return Chain(self.tree.links, values, self.root(x))

    def motion(self, x: ca.SX, u: ca.SX) -> tuple[dict[int, ca.SX], ca.SX, ca.SX]:
        """Joint rates by link, linear and angular velocity of the body in its own axes."""
        rates = {link: u[3 + k] for k, link in enumerate(self._joints)}
        return rates, ca.vertcat(u[0], u[1], ca.SX(1, 1)), ca.vertcat(ca.SX(2, 1), u[2])

    def derivative(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ = f(x, u): ṗ = R (vx, vy), joint rates = inputs, leg rates times the brake state."""
        rates = u[3:]
        if self.geometry.has_hinge:
            n = self.geometry.modules
            rates = ca.vertcat(m[0:n] * u[3 : 3 + n], u[3 + n :])
        if self.quaternion:
            velocity = self.root(x).rotation @ ca.vertcat(u[0], u[1], ca.SX(1, 1))
            half = u[2] / 2
            turn = ca.vertcat(-half * x[6], half * x[5], -half * x[4], half * x[3])
            return ca.vertcat(velocity, turn, rates)
        c, s = ca.cos(x[2]), ca.sin(x[2])
        return ca.vertcat(c * u[0] - s * u[1], s * u[0] + c * u[1], u[2], rates)

    def rolling(self, x: ca.SX, u: ca.SX, m: ca.SX) -> ca.SX:
        """Rolling (n) and side-slip (n) velocities of the contacts [m/s] (Pankert et al. 2022, equations 4 and 5)."""
        g, state, given = self.geometry, self.slices(x, True), self.slices(u, False)
        rolling, side = [], []
        for i in range(g.modules):
            leg = state["leg"][i] if g.has_hinge else 0.0
            rate = m[i] * given["leg"][i] if g.has_hinge else 0.0
            if g.leg_length[i] > 0.0:
                angle = float(g.leg_heading[i]) + leg
                arm = float(g.leg_length[i]) * ca.vertcat(ca.cos(angle), ca.sin(angle))
            else:
                arm = ca.SX(2, 1)
            s = constant(g.hinge[i]) + arm
            vx = u[0] - u[2] * s[1] - rate * arm[1]
            vy = u[1] + u[2] * s[0] + rate * arm[0]
            heading = float(g.wheel_heading[i]) + leg + state["steer"][i]
            c, d = ca.cos(heading), ca.sin(heading)
            rolling.append(c * vx + d * vy - g.wheel_radius * given["wheel"][i])
            side.append(-d * vx + c * vy)
        return ca.vertcat(*rolling, *side)
