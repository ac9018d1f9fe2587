"""Steered wheels: where they stand on a base, how fast a motion moves them, and how they roll with it.

Source: Pankert et al., RA-L 2022 (arXiv 2206.15298), equations 1 to 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array


@dataclass(frozen=True)
class ModuleGeometry:
    """Numbers of n steered wheels (modules), in the body frame.

    ``hinge`` (n, 2) [m], or where a leg that slides begins; ``leg_length`` (n,) from there to the steer axis [m]; ``leg_heading`` (n,)
    of the leg and ``wheel_heading`` (n,) of the wheel, all at zero joint positions [rad]; ``slides`` (n,): 1 for a leg whose joint makes
    it longer [m], 0 for one that turns about its hinge [rad]. Where no ``legs_move``, joint positions and rates of legs have no effect.
    """

    hinge: Array
    leg_length: Array
    leg_heading: Array
    wheel_heading: Array
    wheel_radius: float
    legs_move: bool
    slides: Array

    @property
    def modules(self) -> int:
        """Number of modules n."""
        return len(self.hinge)

    def leg_text(self, leg: ArrayLike) -> str:
        """Positions (n) of the legs' joints for a message, each with its unit where they differ."""
        units = ["m" if slides else "rad" for slides in self.slides]
        if len(set(units)) == 1:
            return f"{np.round(np.array(leg, float), 2)} {units[0]}"
        return ", ".join(f"{p:.2f} {unit}" for p, unit in zip(np.array(leg, float).tolist(), units, strict=True))

    def leg_positions(self, leg: ArrayLike) -> Array:
        """Positions (..., n) [rad, or m of those that slide] or rates of the legs' joints as far as they can move: zero for fixed legs."""
        positions = np.asarray(leg, float) * self.legs_move
        return positions if positions.shape[-1:] == (self.modules,) else np.broadcast_to(positions, self.modules)

    def leg_angles(self, leg: ArrayLike) -> Array:
        """By how much (..., n) [rad] joint positions ``leg`` (..., n) turn the legs, or rates of them."""
        return self.leg_positions(leg) * (1.0 - self.slides)

    def steer_axes(self, leg: ArrayLike) -> Array:
        """Positions (..., n, 2) [m] of the steer axes for positions of the legs' joints (..., n)."""
        a = self.leg_heading + self.leg_angles(leg)
        axes = np.empty((*a.shape, 2))
        axes[..., 0], axes[..., 1] = np.cos(a), np.sin(a)
        axes *= (self.leg_length + self.leg_positions(leg) * self.slides)[..., None]
        axes += self.hinge
        return axes

    def leg_motions(self, leg: ArrayLike, axes: Array) -> Array:
        """Velocities (..., n, 2) [m/s] of the steer ``axes`` (..., n, 2) [m] in the body frame for a rate of 1 of each leg's joint."""
        a = self.leg_heading + self.leg_angles(leg)
        swing, turns = axes - self.hinge, 1.0 - self.slides
        motions = np.empty(axes.shape)
        motions[..., 0] = self.slides * np.cos(a) - turns * swing[..., 1]
        motions[..., 1] = self.slides * np.sin(a) + turns * swing[..., 0]
        return motions


def wheel_velocities(geometry: ModuleGeometry, leg: ArrayLike, twist: ArrayLike, leg_rate: ArrayLike = 0.0) -> Array:
    """Velocities (n, 2) [m/s] of the steer axes in the body frame for a twist (vx, vy, ω) and leg rates (n,)."""
    s, (vx, vy, w) = geometry.steer_axes(leg), np.asarray(twist, float).tolist()
    own = geometry.leg_motions(leg, s) * geometry.leg_positions(leg_rate)[:, None]
    velocities = np.empty(s.shape)
    velocities[:, 0], velocities[:, 1] = vx - w * s[:, 1] + own[:, 0], vy + w * s[:, 0] + own[:, 1]
    return velocities


def rolling_inverse_kinematics(
    geometry: ModuleGeometry, leg: ArrayLike, steer: ArrayLike, twist: ArrayLike, leg_rate: ArrayLike = 0.0
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


def aligned_steering(geometry: ModuleGeometry, leg: ArrayLike, steer: ArrayLike) -> Array:
    """Steering angles (n,) [rad] near ``steer`` that have a common center: those of the twist that slips least there.

    The twist is the last right singular vector of the side-slip rows; the turn is weighed with the modules' distance.
    """
    s, steer = geometry.steer_axes(leg), np.asarray(steer, float)
    heading = geometry.wheel_heading + geometry.leg_angles(leg) + steer
    lever = float(np.sqrt(np.mean(np.sum((s - s.mean(axis=0)) ** 2, axis=1))))
    c, d = np.cos(heading), np.sin(heading)
    rows = np.stack([-d, c, (c * s[:, 0] + d * s[:, 1]) / lever], axis=1)
    twist = np.linalg.svd(rows)[2][-1] / [1.0, 1.0, lever]
    return rolling_inverse_kinematics(geometry, leg, steer, twist)[0]
