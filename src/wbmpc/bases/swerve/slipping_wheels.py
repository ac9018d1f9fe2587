"""Wheels whose way the others contradict: in the air, turning about, climbing a cable."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.estimation.wheel_odometry import WheelOdometry, odd_one_out
from wbmpc.model.wheels import ModuleGeometry

Array = NDArray[np.float64]
#: Contradiction of the wheels [m/s] that is looked into, averaged over [s]; for how long [s] a wheel is not believed after it.
CONTRADICTS, OVER, HOLD = 0.01, 0.04, 0.1
#: Wheels whose velocities of the base are nearer [m/s] agree.
NEAR = 0.02
#: Without a gyro: share of the contradiction that one wheel has to make, fewest wheels from which it can be found.
SHARE, FEWEST = 0.8, 4


class SlippingWheels:
    """Finds the wheels that go elsewhere than most do. ``odd`` (n): for how long [s] each is not believed yet.

    With a gyro every wheel gives a velocity of the base, its own less what the turn does at its place; the largest group of
    wheels that agree is right, of groups of one size the one that agrees best. So two of four wheels may be wrong. Without a gyro one
    wheel may be, the one without which the others agree.
    """

    def __init__(self, geometry: ModuleGeometry) -> None:
        n = geometry.modules
        self._geometry, self.odd = geometry, np.zeros(n)
        self._contradiction, self._velocity = np.zeros((n, 2)), np.zeros((n, 2))

    def update(
        self, h: float, wheels: WheelOdometry, leg: Array, turn: float | None, known: NDArray[np.bool_] | None = None
    ) -> None:
        """After the last update of ``wheels``, over h [s]; ``leg`` (n) [rad]; ``turn`` [rad]: the gyro's over it; ``known`` (n): wheels
        that slip, as the controller says, and have no say about the others."""
        self.odd = np.maximum(self.odd - h, 0.0)
        if h <= 0.0:
            return
        new, residual = 1.0 - np.exp(-h / OVER), wheels.residual
        self._contradiction += new * (residual / h - self._contradiction)
        axes = self._geometry.steer_axes(leg)
        if turn is not None:
            dx, dy, dyaw = wheels.increment
            across = np.stack([-axes[:, 1], axes[:, 0]], axis=1)
            velocity = (residual + [dx, dy] + (dyaw - turn) * across) / h
            self._velocity += new * (velocity - self._velocity)
        if np.sum(self._contradiction**2) > CONTRADICTS**2:
            self.odd[self._find(axes, turn is not None, np.zeros(len(axes), bool) if known is None else known)] = HOLD

    def _find(self, axes: Array, gyro: bool, known: NDArray[np.bool_]) -> Array:
        """Which wheels (n) bool contradict the others; none where no two agree."""
        n = len(axes)
        if not gyro:
            i, share = odd_one_out(self._contradiction, axes)
            return (np.arange(n) == i) & (share > SHARE) & (n >= FEWEST)
        apart = np.linalg.norm(self._velocity[:, None] - self._velocity[None], axis=2)
        near = (apart < NEAR) & ~known & ~known[:, None]
        count = near.sum(axis=1)
        spread = np.where(near, apart, 0.0).sum(axis=1) / np.maximum(count, 1)
        best = np.lexsort((spread, -count))[0]
        return ~near[best] & (count[best] > 1)
