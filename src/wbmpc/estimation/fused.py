"""Wheels, gyro and, where there is one, a source of global poses in one filter, with an honest covariance.

An extended Kalman filter on (x, y, yaw; gyro bias; lateness; steer zeros; wheel radii). The wheels' least-squares twist
moves it (:mod:`wbmpc.estimation.odometry`), the gyro measures the turn of the same interval, global poses come late and
are taken in at the time they belong to. The calibration is part of the state because its errors make the drift: they are
not noise, they last. The lateness is the turn between the moment at which encoders were read and their message: it ends
with the next message, and a filter that took it for noise of each interval would add it up. Equations and sources:
docs/derivations.md, section "Swerve base".
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.estimation.odometry import Increment, Sample, WheelOdometry, fit_twist
from wbmpc.estimation.wheels import WheelCalibration
from wbmpc.model.swerve import SwerveGeometry

Array = NDArray[np.float64]

#: A global pose whose normalised error squared is above this is refused: 99.99 % of chi-square with 3 degrees of freedom.
GATE = 21.1
#: So many refusals in a row mean that the estimate is wrong and not the source: its next pose is taken as it is.
PATIENCE = 10


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviations of what is random.

    ``along``, ``across`` [m/√m]: each wheel's displacement over the way it rolls; ``slip_window`` [s]: over which the
    wheels' contradiction is averaged, longer than slip lasts; ``reading`` [m]: of where a wheel is (counts); ``age`` [s] of
    a message's encoders, ``mean_age`` [s] before it; ``gyro`` [rad/s/√Hz], ``gyro_walk`` [rad/s/√s], ``gyro_bias`` [rad/s]
    at the start. Defaults: 2^14 counts on a radius of 0.1 m, messages up to 2 ms old, a gyro of the order of an ADIS16448.
    """

    along: float = 3e-4
    across: float = 3e-4
    slip_window: float = 0.2
    reading: float = 1.1e-5
    age: float = 6e-4
    mean_age: float = 1e-3
    gyro: float = 2e-4
    gyro_walk: float = 2e-5
    gyro_bias: float = 0.01


@dataclass(frozen=True)
class _Step:
    """From one message to the next: length [s], twist and its derivative by (zeros, radii), both at the correction
    ``fitted``, covariance of the twist, variance of the wheels' turn by counts, turn that the gyro saw (NaN without)."""

    h: float
    twist: Array
    by_wheels: Array
    fitted: Array
    covariance: Array
    counts: float
    turn: float


@dataclass(frozen=True)
class _State:
    """``mean``: x, y, yaw, gyro bias, lateness [rad], corrections of steer zeros and of radii; ``p``: covariance of its
    error."""

    t: float
    mean: Array
    p: Array


#: Time constant [s] of the derivatives of the twist by the wheels' corrections.
SMOOTHING = 0.05
#: Places of gyro bias and lateness in the state; from WHEELS on the corrections of the wheels.
BIAS, LATE, WHEELS = 3, 4, 5


class _SlipIntensity:
    """Intensity [m²/s] of the wheels' slip, each component, from what they contradict each other.

    The residual's speed is averaged over the window w (encoder counts cancel, slip that is much shorter than w is left
    with intensity / (2 w)); its square over ten windows of motion, for one has few degrees of freedom and would make lucky
    intervals look exact. A contradiction that is far above that counts at once.
    """

    #: windows over which squares are averaged; ratio of squares that is sudden; speed [m/s] of a base that moves
    MEMORY, SUDDEN, MOVING = 10.0, 6.0, 1e-3

    def __init__(self, freedoms: int, window: float) -> None:
        self.freedoms, self.window = freedoms, window
        self.now = 0.0
        self._mean: Array | float = 0.0
        self._unseen, self._squares, self._weight, self._speed = 1.0, 0.0, 0.0, 0.0

    def update(self, residual: Array, speed: float, h: float) -> float:
        """The intensity after h [s] with residual speeds (n, 2) and mean wheel speed [m/s]."""
        decay = np.exp(-h / self.window)
        self._mean = decay * self._mean + (1.0 - decay) * residual
        self._speed = decay * self._speed + (1.0 - decay) * speed
        self._unseen *= decay**2  # the mean starts from 0: it is short of this share of its variance
        square = float(np.sum(np.square(self._mean))) / self.freedoms
        self.now = square / (1.0 - self._unseen)
        if self._speed > self.MOVING:
            fade = decay ** (1.0 / self.MEMORY)
            self._squares = fade * self._squares + (1.0 - fade) * square
            self._weight = fade * self._weight + (1.0 - fade) * (1.0 - self._unseen)
            usual = self._squares / self._weight
            self.now = self.now if self.now > self.SUDDEN * usual else usual
        return 2.0 * self.window * self.now


class FusedOdometry:
    """Planar pose of a swerve base with its covariance.

    ``calibration``: what is known of the wheels (:meth:`WheelCalibration.unknown` when left out); ``pose_std`` (x, y, yaw)
    of the start; ``history`` [s]: how old a global pose may be. ``twist`` (3): body twist of the last interval;
    ``slip`` [m/s]: root mean square by which the wheels contradict each other over the slip window; ``taken``, ``refused``: how
    many global poses did and did not fit.
    """

    def __init__(
        self,
        geometry: SwerveGeometry,
        pose0: ArrayLike = (0.0, 0.0, 0.0),
        *,
        calibration: WheelCalibration | None = None,
        noise: OdometryNoise | None = None,
        pose_std: ArrayLike = (0.0, 0.0, 0.0),
        history: float = 0.5,
    ) -> None:
        n = self._n = geometry.modules
        self.geometry, self.noise = geometry, noise or OdometryNoise()
        self._prior = calibration or WheelCalibration.unknown(geometry)
        known = self._prior
        self._reader = WheelOdometry(geometry, leg_zero=known.leg_zero, steer_zero=known.steer_zero)
        p = np.zeros((WHEELS + 2 * n, WHEELS + 2 * n))
        p[:3, :3] = np.diag(np.square(_three("pose_std", pose_std)))
        p[BIAS, BIAS] = self.noise.gyro_bias**2
        p[WHEELS:, WHEELS:] = known.covariance
        self._state = _State(-np.inf, np.concatenate([_three("pose0", pose0), np.zeros(2 + 2 * n)]), p)
        self._one = np.eye(p.shape[0])
        self._keep, self._past = history, deque[tuple[_State, _Step]]()
        self._last: Sample | None = None
        self._by_wheels = np.zeros((3, 2 * n))
        self._slip = _SlipIntensity(2 * n - 3, self.noise.slip_window)
        self.twist: Array = np.zeros(3)
        self.taken = self.refused = self._refusals = 0

    # ------------------------------------------------------------------ results
    @property
    def pose(self) -> Array:
        """(x, y, yaw), yaw not wrapped."""
        return self._state.mean[:3]

    @property
    def covariance(self) -> Array:
        """(3, 3) of the pose's error, in world axes."""
        return self._state.p[:3, :3]

    @property
    def twist_covariance(self) -> Array:
        """(3, 3) of the error of ``twist``, as the wheels of the last interval say; 0 before the first."""
        if not self._past:
            return np.zeros((3, 3))
        step = self._past[-1][1]
        return step.covariance / step.h**2

    @property
    def gyro_bias(self) -> float:
        """[rad/s]."""
        return float(self._state.mean[BIAS])

    @property
    def slip(self) -> float:
        """Root mean square [m/s] over the wheels, one component: 0 when they agree."""
        return float(np.sqrt(self._slip.now))

    @property
    def calibration(self) -> WheelCalibration:
        """What is known of the wheels by now."""
        n, prior, c = self._n, self._prior, self._state.mean[WHEELS:]
        radius = prior.wheel_radius * (1.0 + c[n:])
        return WheelCalibration(prior.steer_zero + c[:n], prior.leg_zero, radius, self._state.p[WHEELS:, WHEELS:])

    # ------------------------------------------------------------------ from outside
    def place(self, pose: ArrayLike, covariance: ArrayLike | None = None) -> None:
        """The base is at ``pose`` (3), exactly or with a ``covariance`` (3, 3); what is known of gyro and wheels stays. Older
        global poses no longer count."""
        mean, p = self._state.mean.copy(), self._state.p.copy()
        mean[:3] = _three("pose", pose)
        p[:3, :], p[:, :3] = 0.0, 0.0
        if covariance is not None:
            p[:3, :3] = covariance
        self._state = _State(self._state.t, mean, p)
        self._past.clear()

    def restart_clock(self) -> None:
        """Times start anew: the next message only starts; what is known stays."""
        self._state = _State(-np.inf, self._state.mean, self._state.p)
        self._past.clear()
        self._last = None

    # ------------------------------------------------------------------ wheels and gyro
    def update(
        self, t: float, leg: ArrayLike, steer: ArrayLike, wheel: ArrayLike, gyro: float | None = None,
        weights: Array | None = None,
    ) -> Array:  # fmt: skip
        """The pose after a message of time ``t`` [s]: positions (n) [rad] and ``gyro``, the mean yaw rate [rad/s] since the
        message before (the rate at its end is ahead of the wheels while a turn begins, as if their radii were wrong);
        ``weights`` (n): little for wheels that are known to slip.

        The first message only starts. Raises :class:`InputError` for numbers that are not finite or time that goes back.
        """
        now = self._reader.checked(leg, steer, wheel)
        if not np.isfinite(t) or t < self._state.t or (gyro is not None and not np.isfinite(gyro)):
            raise InputError(
                f"odometry: time and gyro must be finite and time must not go back, got {t} s, {gyro} rad/s"
            )
        h = t - self._state.t
        if self._last is None:
            self._state = self._started(t, 0.0 if gyro is None else gyro)
        elif h > 0.0:
            step = self._step(h, self._last, now, gyro, weights)
            self._past.append((self._state, step))
            self._state = self._advanced(self._state, step)
            self.twist = step.twist / h
            while self._past and self._past[0][0].t < t - self._keep:
                self._past.popleft()
        self._last = now
        return self.pose

    def _started(self, t: float, rate: float) -> _State:
        """The first message is late too, if the base turns already."""
        mean, p = self._state.mean.copy(), self._state.p.copy()
        p[LATE, :], p[:, LATE] = 0.0, 0.0
        mean[LATE], p[LATE, LATE] = -rate * self.noise.mean_age, (rate * self.noise.age) ** 2
        return _State(t, mean, p)

    def _step(self, h: float, before: Sample, now: Sample, gyro: float | None, weights: Array | None) -> _Step:
        n, c = self._n, self._state.mean[WHEELS:].copy()
        correct = lambda sample: (sample[0], sample[1] - c[:n], sample[2])
        radius = self._prior.wheel_radius * (1.0 + c[n:])
        moved = fit_twist(self.geometry, radius, correct(before), correct(now), weights)
        # Smoothed, and of the intervals before: the age of this message is in its own derivative and in what it is
        # compared with, and their product would look like a wrong radius.
        by_wheels = self._by_wheels * h
        now_by_wheels = np.concatenate([moved.by_steer_zero(), moved.by_radius()], axis=1)
        self._by_wheels = self._by_wheels + (1.0 - np.exp(-h / SMOOTHING)) * (now_by_wheels / h - self._by_wheels)
        turn = np.nan if gyro is None else gyro * h
        counts = self.noise.reading**2 * float(np.sum(moved.fit[2] ** 2))
        return _Step(h, moved.twist, by_wheels, c, self._twist_covariance(moved, h, weights), counts, turn)

    def _twist_covariance(self, moved: Increment, h: float, weights: Array | None) -> Array:
        """Of the twist of one interval: rolling noise by the way, slip by what the wheels contradict each other."""
        residual = moved.residual if weights is None else weights[:, None] * moved.residual
        slip = self._slip.update(residual / h, float(np.mean(np.abs(moved.rolled))) / h, h) * h
        cosine, sine, way = np.cos(moved.heading), np.sin(moved.heading), np.abs(moved.rolled)
        along = moved.fit[:, :, 0] * cosine + moved.fit[:, :, 1] * sine
        across = moved.fit[:, :, 1] * cosine - moved.fit[:, :, 0] * sine
        a, s = self.noise.along**2 * way + slip, self.noise.across**2 * way + slip
        return (along * a) @ along.T + (across * s) @ across.T

    def _advanced(self, state: _State, step: _Step) -> _State:
        """One interval on: the wheels' twist moves the pose, the gyro's turn corrects it and everything behind it."""
        h, noise, size = step.h, self.noise, state.mean.size
        twist = step.twist + step.by_wheels @ (state.mean[WHEELS:] - step.fitted)
        mean = state.mean.copy()
        mean[:3] = lie.se2_step(state.mean[:3], twist)
        way, yaw = mean[:2] - state.mean[:2], state.mean[2] + 0.5 * twist[2]
        g = np.array(
            [[np.cos(yaw), -np.sin(yaw), -0.5 * way[1]], [np.sin(yaw), np.cos(yaw), 0.5 * way[0]], [0, 0, 1.0]]
        )
        a = self._one.copy()
        a[0, 2], a[1, 2], a[LATE, LATE] = -way[1], way[0], 0.0
        a[:3, WHEELS:] = g @ step.by_wheels
        moved_noise = g @ step.covariance
        rate = twist[2] / h if step.turn != step.turn else step.turn / h - state.mean[BIAS]
        late = (rate * noise.age) ** 2 + step.counts
        p = a @ state.p @ a.T
        p[:3, :3] += moved_noise @ g.T
        p[BIAS, BIAS] += noise.gyro_walk**2 * h
        behind = rate * noise.mean_age
        p[LATE, LATE], mean[LATE] = late, -behind
        if step.turn == step.turn:
            # what the gyro says less what it should: its bias and noise, the wheels' turn, lateness before and now
            row = np.zeros(size)
            row[BIAS], row[LATE], row[WHEELS:] = h, 1.0, step.by_wheels[2]
            reached = state.p @ row
            variance = row @ reached + step.covariance[2, 2] + late + noise.gyro**2 * h
            cross = a @ reached
            cross[:3] += moved_noise[:, 2]
            cross[LATE] = -late
            gain = cross / variance
            mean += gain * (step.turn - state.mean[BIAS] * h - state.mean[LATE] - behind - twist[2])
            p -= np.outer(gain, cross)
        return _State(state.t + h, mean, p)

    # ------------------------------------------------------------------ global poses
    def correct(self, t: float, pose: ArrayLike, covariance: ArrayLike) -> bool:
        """Take in a global pose (x, y, yaw) that was true at time ``t`` [s], with its covariance (3, 3).

        The filter goes back to that time, corrects, and comes forward again. False when the pose is older than the
        history or does not fit (see ``GATE`` and ``PATIENCE``).
        """
        z, r = _three("global pose", pose), np.asarray(covariance, float)
        if r.shape != (3, 3) or not np.isfinite(r).all():
            raise InputError(f"global pose: a covariance of 3 by 3 finite numbers is needed, got shape {r.shape}")
        oldest = self._past[0][0].t if self._past else self._state.t
        if t < oldest:
            return False
        later: list[_Step] = []
        state = self._state
        while state.t > t:
            state, step = self._past.pop()
            later.append(step)
        corrected = self._corrected(state, later[-1] if later else None, t, z, r)
        self.refused += corrected is None
        self.taken += corrected is not None
        state = corrected or state
        for step in reversed(later):
            self._past.append((state, step))
            state = self._advanced(state, step)
        self._state = state
        return corrected is not None

    def _corrected(self, state: _State, step: _Step | None, t: float, z: Array, r: Array) -> _State | None:
        """The state with a pose taken in that belongs to a moment of the step after it; None where it does not fit."""
        share = 0.0 if step is None else (t - state.t) / step.h
        there = state.mean[:3] if step is None else lie.se2_step(state.mean[:3], share * step.twist)
        error = z - there
        error[2] = np.remainder(error[2] + np.pi, 2.0 * np.pi) - np.pi
        s = state.p[:3, :3] + r
        self._refusals += 1
        if error @ np.linalg.solve(s, error) > GATE:
            if self._refusals <= PATIENCE:
                return None
            # the filter is lost, e.g. it was carried away: it knows its pose only from the source
            p = state.p.copy()
            p[:3, 3:], p[3:, :3], p[:3, :3] = 0.0, 0.0, r
            self._refusals = 0
            return _State(state.t, np.concatenate([state.mean[:3] + error, state.mean[3:]]), p)
        self._refusals = 0
        gain = np.linalg.solve(s, state.p[:3]).T
        keep = np.eye(state.mean.size)
        keep[:, :3] -= gain
        return _State(state.t, state.mean + gain @ error, keep @ state.p @ keep.T + gain @ r @ gain.T)


def _three(name: str, value: ArrayLike) -> Array:
    """Three finite numbers, or :class:`InputError`."""
    array = np.asarray(value, float)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{name}: 3 finite numbers are needed, got {array}")
    return array
