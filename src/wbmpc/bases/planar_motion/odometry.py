"""Dead reckoning of bases on fixed wheels: least squares over the wheels' increments, the turn from a gyro."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.wheel_errors import WheelErrors
from wbmpc.checks import finite, numbers
from wbmpc.estimation.repetition import Repetition

#: The base stands while no wheel has turned by more than this [rad] (a few counts of its encoder) for this time [s].
STANDS, STANDS_FOR = 1e-3, 0.25
#: The gyro's bias counts as known below this doubt [rad/s]; its doubt at the start, its walk [rad/s/√s], the gyro's noise [rad/s/√Hz].
KNOWN, BIAS, WALK, NOISE = 1e-3, 0.05, 3e-5, 3e-4
#: What wheels show of turns: slip that comes and goes (share of what a wheel rolls in an interval), error of
#: an encoder [rad] and of its time [s]; interval [s] of comparisons with the gyro; so many
#: standard deviations beside it are a slip.
SLIP, COUNT, JITTER, INTERVAL, SLIPS = 0.002, 4e-4, 1e-3, 0.2, 4.0


#: Where the base is (x, y), its yaw and the gyro's bias in the filter's state; errors of wheels follow.
YAW, GYRO, WHEELS = 2, 3, 4


class GyroFilter:
    """Kalman filter for the ``bias`` [rad/s] of a gyro, by comparing its turn with that of n wheels, and for what the bias that was believed
    before has done to the pose.

    Wheels whose radii are wrong turn with the distance, a bias turns with the time: both are states, so that a base which stands, or
    whose speed changes, shows the bias, and one that rolls steadily leaves it as it is. Errors of the pose are states too: a bias that is
    found late turns the way back that was driven with another one. Wheels that slip further than that beside the
    gyro say nothing, and ``contradicted`` it. ``doubt`` (n, n): covariance of the wheels' relative errors; ``std`` [rad/s]: doubt of the bias.
    """

    def __init__(self, doubt: Array) -> None:
        n = WHEELS + len(doubt)
        self._mean, self._covariance = np.zeros(n), np.zeros((n, n))
        self.contradicted, self._apart = False, 0.0
        self._covariance[GYRO, GYRO], self._covariance[WHEELS:, WHEELS:] = BIAS**2, doubt
        self._clear()

    def _clear(self) -> None:
        self._time = self._turn = self._led = 0.0  # led: time in which the turn was the gyro's
        self._shares, self._believed = np.zeros((2, self._mean.size - WHEELS))  # believed: where it was the wheels'
        self._way = np.zeros(2)

    @property
    def bias(self) -> float:
        """[rad/s]."""
        return float(self._mean[GYRO])

    @property
    def std(self) -> float:
        """[rad/s]."""
        return float(np.sqrt(self._covariance[GYRO, GYRO]))

    @property
    def apart(self) -> float:
        """By how much [rad] the gyro has turned further than the wheels where they contradicted each other; either may be wrong by all of it."""
        return self._apart + (self._off if self.contradicted else 0.0)

    @property
    def _off(self) -> float:
        """The same in what has come together since the last comparison."""
        believed = self.bias * self._time + float(self._shares @ (1.0 + self._mean[WHEELS:]))
        return self._turn - believed

    def place(self) -> None:
        """The pose comes from elsewhere: nothing that is found of the bias changes what was before."""
        self._covariance[:GYRO, :] = self._covariance[:, :GYRO] = 0.0
        self._way = np.zeros(2)

    def update(self, h: float, yaw_rate: float, shares: Array, weights: Array, led: bool, way: Array) -> Array | None:
        """Over h [s] the gyro had a mean ``yaw_rate`` [rad/s] and each wheel turned the base by its share (n) [rad], ``weights`` (n) times
        what it rolled [rad]; the pose went on by ``way`` (2) [m], and turned as the gyro said (``led``) or the wheels. Gives the
        correction (3) of the pose where there is one."""
        self._time += h
        self._turn += yaw_rate * h
        self._shares = self._shares + shares
        self._way = self._way + way
        if led:
            self._led += h
        else:
            self._believed = self._believed + shares
        if self._time < INTERVAL:
            return None
        found = self._compare(weights)
        self._clear()
        return found

    def _compare(self, weights: Array) -> Array | None:
        """One update of the filter with what came together."""
        t, led, wheels, n = self._time, self._led, self._shares, self._mean.size
        step = np.eye(n)
        step[0, YAW], step[1, YAW] = -self._way[1], self._way[0]
        step[YAW, GYRO], step[YAW, WHEELS:] = -led, self._believed
        p = step @ self._covariance @ step.T
        p[GYRO, GYRO] += WALK**2 * t
        row = np.concatenate([np.zeros(GYRO), [t], wheels])
        rolling = SLIP**2 * float(wheels @ wheels)
        slip = SLIP**2 * float(self._believed @ self._believed)
        p[YAW, YAW] += NOISE**2 * led + slip
        noise = NOISE**2 * t + (COUNT**2 + (JITTER * self._turn / t) ** 2) * float(weights @ weights) + rolling
        gain = p @ row
        variance = float(row @ gain) + noise
        gain[YAW] -= NOISE**2 * led + slip  # the same noise is in the yaw
        off = self._off
        rolls = float(np.abs(wheels).max(initial=0.0)) > COUNT
        self._covariance = p
        self.contradicted = rolls and off**2 > SLIPS**2 * variance
        if self.contradicted:
            self._apart += off
            return None
        self._mean = self._mean + gain * (off / variance)
        self._covariance = p - np.outer(gain, gain / variance)
        correction = self._mean[:GYRO].copy()
        self._mean[:GYRO] = 0.0
        return correction


class PlanarOdometry:
    """Pose (x, y, yaw) of the body's frame, yaw not wrapped.

    ``twist`` (3, m) and ``rates`` (n, m): as in :class:`wbmpc.bases.planar_motion.model.PlanarBase`, the last column is the turn;
    ``pose0`` (3); ``wheels``: what is known of the wheels' errors (left out: nothing). ``gyro``: its bias; until it is known, but where
    wheels contradict it whatever its bias, and while the base stands, the turn is the wheels'. ``ahead`` [m]: how far a lean has
    brought the body's frame ahead of its axle, of a base without a speed to the side, whose tires creep there. ``residual`` (n) [rad]: what
    the wheels of the last update contradict each other.
    Raises :class:`InputError` for numbers that are not finite or of another length.
    """

    def __init__(self, twist: Array, rates: Array, pose0: ArrayLike, wheels: WheelErrors | None = None) -> None:
        self.wheels = wheels or WheelErrors.unknown(*rates.shape)
        #: of a base without a speed to the side: the direction to its left
        self._left = None if twist.shape[1] > 2 else np.array([-twist[1, 0], twist[0, 0], 0.0])
        self.ahead = 0.0
        self._twist, self._weights = twist, np.ones(len(rates))
        self._fit_to(self.wheels.corrected(rates))
        self.pose = numbers("odometry", "pose0", pose0, 3).copy()
        self.gyro = GyroFilter(self.wheels.of_turn(len(rates)))
        self.residual: Array = np.zeros(len(rates))
        self._last: tuple[float, Array] | None = None
        self._repetition = Repetition()
        self._anchor: tuple[float, Array] = (0.0, np.zeros(len(rates)))  # since when the wheels are where they are

    def weigh(self, weights: Array) -> None:
        """How much each wheel (n) counts from now on where they contradict each other."""
        self._weights = weights
        self._fit_to(self._rates)

    def _fit_to(self, rates: Array) -> None:
        root = np.sqrt(self._weights)
        weighted = root[:, None] * rates
        self._rates = rates
        self._fit, self._fit_linear = np.linalg.pinv(weighted) * root, np.linalg.pinv(weighted[:, :-1]) * root

    @property
    def lever(self) -> float:
        """How far [m] a turn moves the base for each radian that it is the gyro's and not the wheels', by their weights."""
        ahead = self._fit_linear @ self._rates[:, -1]
        return float(np.linalg.norm(self._twist[:2, :-1] @ ahead - self._twist[:2, -1]))

    def update(self, time: float, wheel: ArrayLike, yaw_rate: float | None) -> Array:
        """The pose after wheel angles (n) [rad] at ``time`` [s]; ``yaw_rate`` [rad/s]: mean of the gyro since the last call, None
        without one. The first call only stores the angles; of a time that went back the gyro says nothing, and the wheels' way counts."""
        now = numbers("odometry", "wheel", wheel, len(self._rates))
        if yaw_rate is not None:
            finite("odometry", yaw_rate=yaw_rate)
        back = self._last is not None and time < max(self._last[0], self._repetition.time)
        if back:
            self._repetition.forget()
        counts, yaw_rate = self._repetition.count(time, self._time, now, yaw_rate, self.gyro.bias)
        if not counts:
            return self.pose
        last, self._last = self._last, (time, now)
        if last is None or back or np.max(np.abs(now - self._anchor[1])) > STANDS:
            self._anchor = (time, now)
        if last is None or time == last[0]:
            return self.pose
        yaw_rate = None if back else yaw_rate
        h, rolled = time - last[0], now - last[1]
        moved, before = self._fit @ rolled, self.pose
        led = time - self._anchor[0] < STANDS_FOR and (self.gyro.std < KNOWN or self.gyro.contradicted)
        if yaw_rate is not None and led:
            turn = (yaw_rate - self.gyro.bias) * h
            moved = np.append(self._fit_linear @ (rolled - self._rates[:, -1] * turn), turn)
        self.residual = rolled - self._rates @ moved
        moves = self._twist @ moved
        if self._left is not None:
            moves += self._left * (moved[1] * (self.ahead - float(self.wheels.creep) * moved[0] / h))
        self.pose = lie.se2_step(before, moves)
        if yaw_rate is not None:
            way = (self.pose - before)[:2]
            correction = self.gyro.update(h, yaw_rate, self._fit[-1] * rolled, self._fit[-1], led, way)
            self.pose = self.pose if correction is None else self.pose + correction
        return self.pose

    def place(self, pose: Array) -> None:
        """The base is at ``pose`` (3), as another localization knows."""
        self.pose = pose
        self.gyro.place()

    def turn(self, time: float, wheel: ArrayLike, steer: ArrayLike, yaw_rate: float | None) -> Array:
        """:meth:`update` with angles of steering joints, of which there are none."""
        return self.update(time, wheel, yaw_rate)

    def restart(self) -> None:
        """The encoders start again: the next update moves nothing."""
        self._last = None
        self._repetition.forget()

    @property
    def _time(self) -> float:
        """Of the last call that counted [s]; minus infinity before the first."""
        return -np.inf if self._last is None else self._last[0]
