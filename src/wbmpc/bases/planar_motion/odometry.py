"""Dead reckoning of bases on fixed wheels: least squares over the wheels' increments, the turn from a gyro."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import lie
from wbmpc.checks import finite, numbers

Array = NDArray[np.float64]
#: The base stands while no wheel has turned by more than this [rad] (a few counts of its encoder) for this time [s].
STANDS, STANDS_FOR = 1e-3, 0.25
#: The gyro's bias counts as known below this doubt [rad/s]; its doubt at the start, its walk [rad/s/√s], the gyro's noise [rad/s/√Hz].
KNOWN, BIAS, WALK, NOISE = 1e-3, 0.05, 3e-5, 3e-4
#: What wheels show of turns: doubt of a radius (relative), slip that comes and goes (share of what a wheel rolls in an interval), error of
#: an encoder [rad] and of its time [s]; interval [s] of comparisons with the gyro; so many
#: standard deviations beside it are a slip.
RADIUS, SLIP, COUNT, JITTER, INTERVAL, SLIPS = 0.002, 0.003, 4e-4, 1e-3, 0.2, 4.0


class GyroBias:
    """Kalman filter for the ``bias`` [rad/s] of a gyro, by comparing its turn with that of n wheels.

    Wheels whose radii are wrong turn with the distance, a bias turns with the time: both are states, so that a base which stands, or
    whose speed changes, shows the bias, and one that rolls steadily leaves it as it is. Wheels that slip further than that beside the
    gyro say nothing. ``std`` [rad/s]: its doubt.
    """

    def __init__(self, wheels: int, radius_std: float = RADIUS) -> None:
        self._mean = np.zeros(1 + wheels)  # bias, relative errors of the radii
        self._covariance = np.diag([BIAS**2, *[radius_std**2] * wheels])
        self._time = self._turn = 0.0
        self._shares = np.zeros(wheels)

    @property
    def bias(self) -> float:
        """[rad/s]."""
        return float(self._mean[0])

    @property
    def std(self) -> float:
        """[rad/s]."""
        return float(np.sqrt(self._covariance[0, 0]))

    def update(self, h: float, yaw_rate: float, shares: Array, weights: Array) -> None:
        """Over h [s] the gyro had a mean ``yaw_rate`` [rad/s] and each wheel turned the base by its share (n) [rad], ``weights`` (n) times
        what it rolled [rad]."""
        self._time += h
        self._turn += yaw_rate * h
        self._shares = self._shares + shares
        if self._time >= INTERVAL:
            self._compare(weights)
            self._time = self._turn = 0.0
            self._shares = np.zeros(len(self._shares))

    def _compare(self, weights: Array) -> None:
        """One update of the filter with what came together."""
        t, wheels = self._time, self._shares
        row = np.concatenate([[t], wheels])
        noise = NOISE**2 * t + (COUNT**2 + (JITTER * self._turn / t) ** 2) * float(weights @ weights)
        noise += SLIP**2 * float(wheels @ wheels)
        self._covariance[0, 0] += WALK**2 * t
        gain = self._covariance @ row
        variance = float(row @ gain) + noise
        off = self._turn - float(wheels.sum()) - float(row @ self._mean)
        rolls = float(np.abs(wheels).max(initial=0.0)) > COUNT
        if rolls and off**2 > SLIPS**2 * variance:
            return
        self._mean = self._mean + gain * (off / variance)
        self._covariance -= np.outer(gain, gain / variance)


class PlanarOdometry:
    """Pose (x, y, yaw) of the body's frame, yaw not wrapped.

    ``twist`` (3, m) and ``rates`` (n, m): as in :class:`wbmpc.bases.planar_motion.model.PlanarBase`, the last column is the turn;
    ``pose0`` (3). ``gyro``: its bias; until it is known, and while the base stands, the
    turn is the wheels'. ``residual`` (n) [rad]: what the wheels of the last update contradict each other.
    Raises :class:`InputError` for numbers that are not finite or of another length.
    """

    def __init__(self, twist: Array, rates: Array, pose0: ArrayLike) -> None:
        self._twist, self._rates = twist, rates
        self._fit, self._fit_linear = np.linalg.pinv(rates), np.linalg.pinv(rates[:, :-1])
        self.pose = numbers("odometry", "pose0", pose0, 3).copy()
        self.gyro = GyroBias(len(rates))
        self.residual: Array = np.zeros(len(rates))
        self._last: tuple[float, Array] | None = None
        self._anchor: tuple[float, Array] = (0.0, np.zeros(len(rates)))  # since when the wheels are where they are

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
        if yaw_rate is not None:
            self.gyro.update(h, yaw_rate, self._fit[-1] * rolled, self._fit[-1])
            if time - self._anchor[0] < STANDS_FOR and self.gyro.std < KNOWN:
                turn = (yaw_rate - self.gyro.bias) * h
                moved = np.append(self._fit_linear @ (rolled - self._rates[:, -1] * turn), turn)
        self.residual = rolled - self._rates @ moved
        self.pose = lie.se2_step(self.pose, self._twist @ moved)
        return self.pose

    def restart(self) -> None:
        """The encoders start again: the next update moves nothing."""
        self._last = None
