"""Wheels whose way the others contradict: in the air, turning about, climbing a cable."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.bases.swerve.slip_step import detect_contradiction
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry, outlier_wheel
from wbmpc.kernel.step import bind
from wbmpc.model.wheels import ModuleGeometry

#: Contradiction of the wheels [m/s] that is looked into, averaged over [s]; for how long [s] a wheel is not believed after it.
CONTRADICTS, OVER, HOLD = 0.01, 0.04, 0.1
#: Wheels whose velocities of the base are nearer [m/s] agree.
NEAR = 0.02
#: Without a gyro: share of the contradiction that one wheel has to make, fewest wheels from which it can be found.
SHARE, FEWEST = 0.8, 4


class SlippingWheels:
    """Finds the ``wheels`` that go elsewhere than most do. ``odd`` (n): for how long [s] each is not believed yet; ``seen`` (2n) [m/s]:
    with a gyro the base's velocity by each wheel, averaged.

    With a gyro every wheel gives a velocity of the base, its own less what the turn does at its place; the largest group of
    wheels that agree is right, of groups of one size the one that agrees best. So two of four wheels may be wrong. Without a gyro one
    wheel may be, the one without which the others agree.
    """

    def __init__(self, geometry: ModuleGeometry, wheels: WheelOdometry) -> None:
        n = geometry.modules
        self._geometry, self.odd, self._leg = geometry, np.zeros(n), np.zeros(n)
        self._contradiction, self.seen = np.zeros(2 * n), np.zeros(2 * n)
        arrays = {
            "hinge": np.array(geometry.hinge, float).ravel(), "length": np.array(geometry.leg_length, float),
            "leg_heading": np.array(geometry.leg_heading, float), "slides": np.array(geometry.slides, float), "leg": self._leg, "odd": self.odd,
            "contradiction": self._contradiction, "velocity": self.seen, **wheels.arrays,
        }  # fmt: skip
        self._detect_contradiction = bind(detect_contradiction, arrays, n=n, over=OVER, threshold=CONTRADICTS)

    @property
    def contradictory(self) -> bool:
        """Whether the wheels contradict each other by more than :data:`CONTRADICTS`."""
        return float(self._contradiction @ self._contradiction) > CONTRADICTS**2

    def update(self, h: float, leg: Array, turn: float | None, known: NDArray[np.bool_] | None = None) -> None:
        """After the last update of the ``wheels``, over h [s]; ``leg`` (n) [rad]; ``turn`` [rad]: the gyro's over it; ``known`` (n): wheels
        that slip, as the controller says, and have no say about the others."""
        self._leg[:] = leg
        if self._detect_contradiction(h, 0.0 if turn is None else turn, turn is not None):
            silent = np.zeros(len(leg), bool) if known is None else known
            self.odd[self._find(self._geometry.steer_axes(leg), turn is not None, silent)] = HOLD

    def _find(self, axes: Array, gyro: bool, known: NDArray[np.bool_]) -> Array:
        """Which wheels (n) bool contradict the others; none where no two agree."""
        n, velocity = len(axes), self.seen.reshape(-1, 2)
        if not gyro:
            i, share = outlier_wheel(self._contradiction.reshape(-1, 2), axes)
            return (np.arange(n) == i) & (share > SHARE) & (n >= FEWEST)
        apart = np.linalg.norm(velocity[:, None] - velocity[None], axis=2)
        near = (apart < NEAR) & ~known & ~known[:, None]
        count = near.sum(axis=1)
        spread = np.where(near, apart, 0.0).sum(axis=1) / np.maximum(count, 1)
        best = np.lexsort((spread, -count))[0]
        return ~near[best] & (count[best] > 1)
