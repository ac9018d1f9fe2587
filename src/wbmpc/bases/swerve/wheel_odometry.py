"""Wheel odometry of bases on steered wheels from positions that were measured together.

Source: Pankert et al., RA-L 2022 (arXiv 2206.15298), section III-B: least squares for the twist over all wheels, leg
motion subtracted. Here with increments of positions instead of speeds (nothing is lost between two samples), angles at
the middle of the interval, and exact integration on SE(2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.arrays import Array
from wbmpc.bases.swerve.wheel_fit import WheelFit
from wbmpc.checks import each, numbers, positive
from wbmpc.model.wheels import ModuleGeometry

Mask = NDArray[np.bool_]


#: Row vectors times this: turned by a quarter to the left.
_QUARTER_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
#: Minimum share of a leg's swing that no twist explains; below it the swing is not observable.
WEAK = 0.1
#: Positions (n) [rad] of legs, steering and wheels that were read together.
Sample = tuple[Array, Array, Array]


@dataclass(frozen=True)
class Increment:
    """The motion of the base between two samples, estimated from its wheels.

    ``twist`` (dx, dy, dyaw) [m, rad]: integral of the body twist that fits best; ``residual`` (n, 2) [m]: difference of
    each wheel's displacement from it; ``rolled`` (n) [m] and ``heading`` (n) [rad]: length of each wheel's path, with
    sign, and its direction in the body; ``fit`` (3, n, 2): derivative of the twist by the wheels' displacements.
    """

    twist: Array
    residual: Array
    rolled: Array
    heading: Array
    fit: Array

    @classmethod
    def of(cls, fitted: WheelFit) -> Increment:
        """A copy of the present result of a fit."""
        m, n = fitted.memory, fitted.n
        residual, slope = m["residual"].reshape(n, 2), m["slope"].reshape(3, n, 2)
        return cls(m["twist"].copy(), residual.copy(), m["rolled"].copy(), m["heading"].copy(), slope.copy())

    def leg_residual_basis(self, motions: Array, is_open: Mask) -> Array:
        """Orthonormal basis (k, 2n) of the residuals that cannot be slip while some legs are open; ``motions`` (n, 2): of the steer
        axes at a rate of 1 of the legs' joints, ``is_open`` (n) bool.

        The wheels push each other with forces that balance and do no work on a leg that is open: slip is in their span.
        What is left is the span of P T (P: without what twists give, T: what leg rates give). Directions in which a leg must swing
        far for a small contradiction, as all four do in X when they turn the base, are left out.
        """
        n = len(motions)
        swings = np.zeros((n, n, 2))
        swings[np.arange(n), np.arange(n)] = motions
        swings = swings[is_open]
        # fit (3, n, 2) is the left inverse of the twists' displacements; its rows span the same space as those
        twists = np.linalg.qr(self.fit.reshape(3, -1).T)[0]
        off = swings.reshape(len(swings), -1)
        off = off - (off @ twists) @ twists.T
        _, values, rows = np.linalg.svd(off, full_matrices=False)
        return np.asarray(rows[values > WEAK * np.hypot(*motions.T).max()])


def outlier_wheel(residual: Array, axes: Array) -> tuple[int, float]:
    """The wheel without which the least-squares fit improves most, and the share of the sum of squares that vanishes without it.

    ``residual`` (n, 2), or (k, n, 2) of k intervals: of a twist fitted with equal weights; ``axes`` (n, 2) [m]: positions of the wheels.

    Leaving out wheel i lowers the sum of squares by r_i' (1 - H_ii)^-1 r_i, H being the projection on what twists give.
    """
    away = axes - axes.mean(axis=0)
    across = away @ _QUARTER_TURN
    left = (1.0 - 1.0 / len(axes)) * np.eye(2) - across[:, :, None] * across[:, None, :] / np.sum(away**2)
    each = residual.reshape(-1, len(axes), 2)
    less = np.einsum("kni,nij,knj->n", each, np.linalg.inv(left), each)
    i = int(np.argmax(less))
    return i, float(less[i] / max(float(np.sum(residual**2)), 1e-300))


class WheelOdometry:
    """Planar pose of a base on steered wheels by dead reckoning.

    ``pose`` (x, y, yaw) starts at ``pose0``, yaw not wrapped; ``increment`` (dx, dy, dyaw): integral of the body twist
    over the last update; ``residual`` (n, 2) [m]: by what each wheel's displacement differs from it. Calibration:
    ``wheel_radius`` [m], one or one per wheel (the geometry's when left out); ``leg_offset``, ``steer_offset`` (n, or one for all)
    [rad]: true angle = measured − zero. Raises :class:`InputError` for what is not finite, of another length, or no radius.
    """

    def __init__(
        self, geometry: ModuleGeometry, pose0: ArrayLike = (0.0, 0.0, 0.0), *, wheel_radius: ArrayLike | None = None,
        leg_offset: ArrayLike = 0.0, steer_offset: ArrayLike = 0.0,
    ) -> None:  # fmt: skip
        n = self._n = geometry.modules
        self.geometry, self._pose = geometry, numbers("odometry", "pose0", pose0, 3).copy()
        radius = geometry.wheel_radius if wheel_radius is None else wheel_radius
        self.radius = each("odometry", "wheel_radius", radius, n)
        positive("odometry", wheel_radius=float(self.radius.min()))
        self._leg_offset = each("odometry", "leg_offset", leg_offset, n)
        self._steer_offset = each("odometry", "steer_offset", steer_offset, n)
        self._fit, self._started = WheelFit(geometry, self.radius), False
        self._run = self._fit.with_pose(self._pose)

    @property
    def pose(self) -> Array:
        """(x, y, yaw)."""
        return self._pose.copy()

    @property
    def increment(self) -> Array:
        """(dx, dy, dyaw) [m, rad]."""
        return self._fit.memory["twist"].copy()

    @property
    def residual(self) -> Array:
        """(n, 2) [m]."""
        return self._fit.memory["residual"].reshape(self._n, 2).copy()

    def update(self, leg: ArrayLike, steer: ArrayLike, wheel: ArrayLike) -> Array:
        """The pose after positions (n) [rad] of legs (empty or ignored for fixed legs), steering and wheels.

        The first call only stores them.
        """
        return self.advance(self.checked(leg, steer, wheel))

    def advance(self, sample: Sample) -> Array:
        """As :meth:`update`, after true positions that are :meth:`checked`."""
        memory = self._fit.memory
        np.concatenate(sample, out=memory["now"])
        if self._started:
            self._run()
        memory["before"][:] = memory["now"]
        self._started = True
        return self.pose

    def restart(self) -> None:
        """Forget the last sample: the encoders start again, and the next message moves nothing."""
        self._started = False
        for name in ("twist", "residual"):
            self._fit.memory[name][:] = 0.0

    @property
    def arrays(self) -> dict[str, Array]:
        """``twist`` (3) and ``residual`` (2n) of the last update; the arrays change with every update."""
        return {name: self._fit.memory[name] for name in ("twist", "residual")}

    @property
    def slip(self) -> float:
        """Root mean square [m] of the last increment's residual: how far the wheels disagree. It detects slip."""
        return float(np.sqrt(np.mean(self.residual**2)))

    def checked(self, leg: ArrayLike, steer: ArrayLike, wheel: ArrayLike) -> Sample:
        """True angles (leg, steer) and wheel angles (n each) of a message, or :class:`InputError`."""
        n = self._n
        steered = numbers("odometry", "steer", steer, n) - self._steer_offset
        rolled = numbers("odometry", "wheel", wheel, n).copy()
        # fixed legs have no angle; their heading is part of the geometry
        angle = numbers("odometry", "leg", leg, n) - self._leg_offset if self.geometry.legs_move else np.zeros(n)
        return angle, steered, rolled
