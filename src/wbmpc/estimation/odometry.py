"""Wheel odometry of swerve bases from positions that were measured together.

Source: Pankert et al., RA-L 2022 (arXiv 2206.15298), section III-B: least squares for the twist over all wheels, leg
motion subtracted. Here with increments of positions instead of speeds (nothing is lost between two samples), angles at
the middle of the interval, and exact integration on SE(2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.model.swerve import SwerveGeometry

Array = NDArray[np.float64]


class WheelOdometry:
    """Planar pose of a swerve base by dead reckoning.

    ``pose`` (x, y, yaw) starts at ``pose0``, yaw not wrapped; ``increment`` (dx, dy, dyaw): integral of the body twist
    over the last update; ``residual`` (n, 2) [m]: by what each wheel's displacement differs from it. Calibration:
    ``wheel_radius`` [m], one or one per wheel (the geometry's when left out); ``leg_zero``, ``steer_zero`` (n) [rad]:
    true angle = measured − zero.
    """

    def __init__(
        self,
        geometry: SwerveGeometry,
        pose0: ArrayLike = (0.0, 0.0, 0.0),
        *,
        wheel_radius: ArrayLike | None = None,
        leg_zero: ArrayLike = 0.0,
        steer_zero: ArrayLike = 0.0,
    ) -> None:
        n = self._n = geometry.modules
        self.geometry, self.pose = geometry, np.array(pose0, float)
        radius = geometry.wheel_radius if wheel_radius is None else wheel_radius
        self._radius = np.broadcast_to(np.asarray(radius, float), n)
        self._leg_zero = np.broadcast_to(np.asarray(leg_zero, float), n)
        self._steer_zero = np.broadcast_to(np.asarray(steer_zero, float), n)
        self._last: tuple[Array, Array, Array] | None = None
        self.increment: Array = np.zeros(3)
        self.residual: Array = np.zeros((n, 2))

    def update(self, leg: ArrayLike, steer: ArrayLike, wheel: ArrayLike, yaw_increment: float | None = None) -> Array:
        """The pose after positions (n) [rad] of legs (empty or ignored for fixed legs), steering and wheels.

        The first call only stores them. ``yaw_increment`` [rad], e.g. of a gyro, replaces the wheels' own.
        """
        now = self.checked(leg, steer, wheel)
        if self._last is not None:
            self.increment = self.solve(self._last, now, yaw_increment)
            self.pose = lie.se2_step(self.pose, self.increment)
        self._last = now
        return self.pose

    @property
    def slip(self) -> float:
        """Root mean square [m] of what the wheels of the last increment contradict each other: a detector of slip."""
        return float(np.sqrt(np.mean(self.residual**2)))

    def checked(self, leg: ArrayLike, steer: ArrayLike, wheel: ArrayLike) -> tuple[Array, Array, Array]:
        """True angles (leg, steer) and wheel angles (n each) of a message, or :class:`InputError`."""
        n = self._n
        parts = {"steer": np.asarray(steer, float), "wheel": np.asarray(wheel, float)}
        # fixed legs have no angle; their heading is part of the geometry
        parts["leg"] = np.asarray(leg, float) - self._leg_zero if self.geometry.has_hinge else np.zeros(n)
        for name, values in parts.items():
            if values.shape != (n,) or not np.isfinite(values).all():
                raise InputError(f"odometry: '{name}' needs {n} finite numbers, got {values}")
        return parts["leg"], parts["steer"] - self._steer_zero, parts["wheel"].copy()

    def solve(
        self, before: tuple[Array, Array, Array], now: tuple[Array, Array, Array], yaw: float | None = None
    ) -> Array:
        """Integral (dx, dy, dyaw) of the body twist that fits two samples (leg, steer, wheel) best; sets ``residual``.

        Wheel i moves in the body's frame by t + ψ ẑ × s_i + Δs_i. With rates that are constant over the interval its
        heading turns by Δ: the path's chord is sin(Δ/2) / (Δ/2) of the rolled length, along the middle heading. The
        least squares solution follows from centroids: ψ = Σ (s − s̄) × (b − b̄) / Σ |s − s̄|², t = b̄ − ψ ẑ × s̄.
        """
        g = self.geometry
        (leg0, steer0, wheel0), (leg1, steer1, wheel1) = before, now
        turn = (leg1 - leg0) + (steer1 - steer0)
        heading = g.wheel_heading + 0.5 * (leg0 + leg1 + steer0 + steer1)
        rolled = self._radius * (wheel1 - wheel0) * np.sinc(turn / (2.0 * np.pi))
        s0, s1 = g.steer_axes(leg0), g.steer_axes(leg1)
        b = rolled[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1) - (s1 - s0)
        s = 0.5 * (s0 + s1)
        s_mean, b_mean = s.mean(axis=0), b.mean(axis=0)
        if yaw is None:
            ds, db = s - s_mean, b - b_mean
            yaw = float(np.sum(ds[:, 0] * db[:, 1] - ds[:, 1] * db[:, 0]) / np.sum(ds * ds))
        shift = b_mean - yaw * np.array([-s_mean[1], s_mean[0]])
        self.residual = b - shift - yaw * np.stack([-s[:, 1], s[:, 0]], axis=1)
        return np.array([shift[0], shift[1], yaw])


class ReleaseOdometry:
    """The odometry of leggedrobotics/swerve_steering, as a baseline: angles of steering and legs are refreshed every
    ``refresh`` [s] only, speeds instead of increments, Euler integration. ``period`` [s] between two updates."""

    def __init__(self, geometry: SwerveGeometry, pose0: ArrayLike, period: float, refresh: float = 0.05) -> None:
        self._fit, self.pose = WheelOdometry(geometry), np.array(pose0, float)
        self._every, self._count = max(1, round(refresh / period)), 0
        self._held: tuple[Array, Array] | None = None
        self._last: tuple[Array, Array] | None = None

    def update(self, leg: ArrayLike, steer: ArrayLike, wheel: ArrayLike) -> Array:
        """The pose after positions (n) [rad]; the first call only stores them."""
        now_leg, now_steer, now_wheel = self._fit.checked(leg, steer, wheel)
        if self._held is None or self._count % self._every == 0:
            self._held = (now_leg, now_steer)
        self._count += 1
        if self._last is not None:
            held_leg, held_steer = self._held
            leg0, wheel0 = self._last
            swing = now_leg - leg0
            before = (held_leg - 0.5 * swing, held_steer + 0.5 * swing, wheel0)
            now = (held_leg + 0.5 * swing, held_steer - 0.5 * swing, now_wheel)
            dx, dy, turn = self._fit.solve(before, now)
            c, s = np.cos(self.pose[2]), np.sin(self.pose[2])
            self.pose = self.pose + np.array([c * dx - s * dy, s * dx + c * dy, turn])
        self._last = (now_leg, now_wheel)
        return self.pose
