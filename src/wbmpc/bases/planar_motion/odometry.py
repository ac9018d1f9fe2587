"""Dead reckoning of bases on fixed wheels: least squares over the wheels' increments, the turn from a gyro."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import lie
from wbmpc.checks import finite, numbers

Array = NDArray[np.float64]
#: The base stands while no wheel has turned by more than this [rad] (a few counts of its encoder) for this time [s].
STANDS, STANDS_FOR = 1e-3, 0.25
#: Time [s] of standing over which the gyro's bias is averaged; after this much of it the bias counts as known.
AVERAGED, KNOWN = 1.0, 0.25


class PlanarOdometry:
    """Pose (x, y, yaw) of the body's frame, yaw not wrapped.

    ``twist`` (3, m) and ``rates`` (n, m): as in :class:`wbmpc.bases.planar_motion.model.PlanarBase`, the last column is the turn;
    ``pose0`` (3). ``bias`` [rad/s] of the gyro, learned while the base stands; until it is known, and while the base stands, the
    turn is the wheels'. ``residual`` (n) [rad]: what the wheels of the last update contradict each other.
    Raises :class:`InputError` for numbers that are not finite or of another length.
    """

    def __init__(self, twist: Array, rates: Array, pose0: ArrayLike) -> None:
        self._twist, self._rates = twist, rates
        self._fit, self._fit_linear = np.linalg.pinv(rates), np.linalg.pinv(rates[:, :-1])
        self.pose = numbers("odometry", "pose0", pose0, 3).copy()
        self.bias = 0.0
        self.residual: Array = np.zeros(len(rates))
        self._last: tuple[float, Array] | None = None
        self._anchor: tuple[float, Array] = (0.0, np.zeros(len(rates)))  # since when the wheels are where they are
        self._rested = 0.0

    def update(self, time: float, wheel: ArrayLike, yaw_rate: float | None) -> Array:
        """The pose after wheel angles (n) [rad] at ``time`` [s]; ``yaw_rate`` [rad/s]: mean of the gyro since the last call, None
        without one. The first call only stores the angles."""
        now = numbers("odometry", "wheel", wheel, len(self._rates))
        if yaw_rate is not None:
            finite("odometry", yaw_rate=yaw_rate)
        last, self._last = self._last, (time, now)
        if last is None or np.max(np.abs(now - self._anchor[1])) > STANDS:
            self._anchor = (time, now)
        if last is None or time <= last[0]:
            return self.pose
        h, rolled = time - last[0], now - last[1]
        moved = self._fit @ rolled
        if yaw_rate is not None and time - self._anchor[0] >= STANDS_FOR:
            self._learn_bias(h, yaw_rate)
        elif yaw_rate is not None and self._rested >= KNOWN:
            turn = (yaw_rate - self.bias) * h
            moved = np.append(self._fit_linear @ (rolled - self._rates[:, -1] * turn), turn)
        self.residual = rolled - self._rates @ moved
        self.pose = lie.se2_step(self.pose, self._twist @ moved)
        return self.pose

    def restart(self) -> None:
        """The encoders begin anew: the next update moves nobody."""
        self._last = None

    def _learn_bias(self, h: float, yaw_rate: float) -> None:
        """From what the gyro shows while the base stands."""
        self._rested = min(self._rested + h, AVERAGED)
        self.bias += h / self._rested * (yaw_rate - self.bias)
