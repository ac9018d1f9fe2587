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
from wbmpc.estimation.odometry import Increment, Mask, Sample, WheelOdometry, fit_twist
from wbmpc.estimation.slip import SlipIntensity
from wbmpc.estimation.wheels import WheelCalibration
from wbmpc.model.swerve import SwerveGeometry

Array = NDArray[np.float64]

#: A global pose whose normalised error squared is above this is refused: 99.99 % of chi-square with 3 degrees of freedom.
GATE = 21.1
#: So many refusals in a row mean that the estimate is wrong and not the source: its next pose is taken as it is.
PATIENCE = 10
#: By so much the wheels' standard deviations grow then: a base that nobody carried away has wheels that are worse than believed.
DOUBTED = 3.0
#: A pose so little [s] ahead of the last message counts as of then (another clock, a message on its way); others do not count.
AHEAD = 0.1


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
class _Shown:
    """What legs show that give way: ``apart`` (k) [m], by which wheels and legs contradict each other at the correction ``fitted``
    of the step, its derivative (k, 2n) by (zeros, radii), its variance [m²], the same for each."""

    apart: Array
    by_wheels: Array
    variance: float


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
    legs: _Shown | None = None


@dataclass(frozen=True)
class _State:
    """``mean``: x, y, yaw, gyro bias, lateness [rad], corrections of steer zeros and of radii; ``p``: covariance of its
    error."""

    t: float
    mean: Array
    p: Array


#: Smallest eigenvalue of a matrix of correlations that has an inverse.
_CERTAIN = 1e-12
#: Contradictions of the wheels are added up over pieces of way [m] of this length.
PIECE = 0.05
#: Time constant [s] of the derivatives of the twist by the wheels' corrections.
SMOOTHING = 0.05
#: Places of gyro bias and lateness in the state; from WHEELS on the corrections of the wheels.
BIAS, LATE, WHEELS = 3, 4, 5


class FusedOdometry:
    """Planar pose of a swerve base with its covariance.

    ``calibration``: what is known of the wheels (:meth:`WheelCalibration.unknown` when left out); ``pose_std`` (x, y, yaw)
    of the start; ``history`` [s]: how old a global pose may be. ``twist`` (3): body twist of the last interval;
    ``slip`` [m/s]: root mean square by which the wheels contradict each other over the slip window; ``taken``, ``refused``: how
    many global poses did and did not fit; ``misfit``: mean of the normalised squared errors of those that did (3 is expected);
    ``contradiction``: by how much of their way the wheels contradicted each other.
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
        self._open = np.zeros(n, dtype=bool)
        self._by_wheels = np.zeros((3, 2 * n))
        self._slip = SlipIntensity(2 * n - 3, self.noise.slip_window)
        self.twist: Array = np.zeros(3)
        self.taken = self.refused = self._refusals = 0
        self._misfits = self._apart = self._way = 0.0
        self._off, self._rolled = np.zeros((self._n, 2)), np.zeros(self._n)  # since the last piece of way

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
    def misfit(self) -> float:
        """Mean of the normalised squared errors of the global poses taken in: 3 is expected."""
        return self._misfits / max(self.taken, 1)

    @property
    def contradiction(self) -> float:
        """By how much of their way the wheels contradicted each other, over the whole drive: 0 when they agree."""
        return self._apart / self._way if self._way > 0.0 else 0.0

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
            p[:3, :3] = _checked_covariance("place", covariance)
        self._state = _State(self._state.t, mean, p)
        self._past.clear()

    def restart_clock(self) -> None:
        """Times start anew: the next message only starts; what is known stays."""
        self._state = _State(-np.inf, self._state.mean, self._state.p)
        self._past.clear()
        self._last = None

    # ------------------------------------------------------------------ wheels and gyro
    def update(
        self,
        t: float,
        leg: ArrayLike,
        steer: ArrayLike,
        wheel: ArrayLike,
        gyro: float | None = None,
        brake: ArrayLike | None = None,
        weights: Array | None = None,
    ) -> Array:
        """The pose after a message of time ``t`` [s]: positions (n) [rad] and ``gyro``, the mean yaw rate [rad/s] since the
        message before (the rate at its end is ahead of the wheels while a turn begins, as if their radii were wrong);
        ``weights`` (n): little for wheels that are known to slip, of two or more above 0.

        ``brake`` (n): which hinges turn freely by now (1 = open; left out: none is taken to). A leg that gives way shows where its
        wheel goes, and so the zeros. The first message only starts. Raises :class:`InputError` for numbers that are not finite or
        time that goes back.
        """
        now = self._reader.checked(leg, steer, wheel)
        if not np.isfinite(t) or t < self._state.t or (gyro is not None and not np.isfinite(gyro)):
            raise InputError(
                f"odometry: time and gyro must be finite and time must not go back, got {t} s, {gyro} rad/s"
            )
        if weights is not None:
            self._check_weights(weights)
        h, is_open = t - self._state.t, self._opened(brake)
        if self._last is None:
            self._state = self._started(t, 0.0 if gyro is None else gyro)
        elif h > 0.0:
            step = self._step(h, self._last, now, gyro, self._open & is_open, weights)
            self._past.append((self._state, step))
            self._state = self._advanced(self._state, step)
            self.twist = step.twist / h
            while self._past and self._past[0][0].t < t - self._keep:
                self._past.popleft()
        self._last, self._open = now, is_open
        return self.pose

    def _check_weights(self, weights: Array) -> None:
        right = np.shape(weights) == (self._n,) and np.isfinite(weights).all() and (weights >= 0.0).all()
        if not right or np.sum(weights > 0.0) < 2:
            raise InputError(f"odometry: 'weights' needs {self._n} numbers, none negative, two above 0, got {weights}")

    def _opened(self, brake: ArrayLike | None) -> Mask:
        """Hinges (n) that turn freely."""
        values = np.zeros(self._n) if brake is None or not self.geometry.has_hinge else np.asarray(brake, float)
        if values.shape != (self._n,):
            raise InputError(f"odometry: 'brake' needs {self._n} numbers, got {values}")
        return np.asarray(values > 0.5)

    def _started(self, t: float, rate: float) -> _State:
        """The first message is late too, if the base turns already."""
        mean, p = self._state.mean.copy(), self._state.p.copy()
        p[LATE, :], p[:, LATE] = 0.0, 0.0
        mean[LATE], p[LATE, LATE] = -rate * self.noise.mean_age, (rate * self.noise.age) ** 2
        return _State(t, mean, p)

    def _step(
        self, h: float, before: Sample, now: Sample, gyro: float | None, is_open: Mask, weights: Array | None
    ) -> _Step:
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
        self._note_contradiction(moved)
        covariance = self._twist_covariance(moved, h, weights)
        legs = self._shown(moved, 0.5 * (before[0] + now[0]), is_open, h) if is_open.any() and weights is None else None
        return _Step(h, moved.twist, by_wheels, c, covariance, counts, turn, legs)

    def _note_contradiction(self, moved: Increment) -> None:
        """Over pieces of way, in which the counts of encoders cancel."""
        self._off += moved.residual
        self._rolled += np.abs(moved.rolled)
        if float(np.mean(self._rolled)) >= PIECE:
            self._apart += float(np.sum(np.hypot(self._off[:, 0], self._off[:, 1])))
            self._way += float(np.sum(self._rolled))
            self._off[:], self._rolled[:] = 0.0, 0.0

    def _shown(self, moved: Increment, leg: Array, is_open: Mask, h: float) -> _Shown:
        """What open legs at ``leg`` (n) say about the wheels. Noise that is alike in all directions makes this residual
        independent of the noise of the twist, which is taken in apart from it."""
        rows = moved.shown_by_legs(self.geometry.steer_axes(leg) - self.geometry.hinge, is_open)
        along = np.stack([np.cos(moved.heading), np.sin(moved.heading)], axis=1) * moved.rolled[:, None]
        each = rows.reshape(len(rows), -1, 2)
        by_zero = each[:, :, 0] * along[:, 1] - each[:, :, 1] * along[:, 0]
        by_radius = np.sum(each * along, axis=2)
        way = float(np.mean(np.abs(moved.rolled)))
        variance = (
            max(self.noise.along, self.noise.across) ** 2 * way + self._slip.intensity * h + self.noise.reading**2
        )
        return _Shown(rows @ moved.residual.ravel(), np.concatenate([by_zero, by_radius], axis=1), variance)

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
        if step.legs is not None:
            mean, p = _given_way(mean, p, step.legs, step.fitted)
        return _State(state.t + h, mean, p)

    # ------------------------------------------------------------------ global poses
    def correct(self, t: float, pose: ArrayLike, covariance: ArrayLike) -> bool:
        """Take in a global pose (x, y, yaw) that was true at time ``t`` [s], with its covariance (3, 3).

        The filter goes back to that time, corrects, and comes forward again. False when the pose is older than the
        history, of a future that no message has come from (see ``AHEAD``), or does not fit (see ``GATE`` and ``PATIENCE``).
        Raises :class:`InputError` for what is not finite, for a covariance that is none, and where pose and filter are both
        certain: which one is right cannot be told. Nothing is lost then.
        """
        z, r = _three("global pose", pose), _checked_covariance("global pose", covariance)
        if not np.isfinite(t):
            raise InputError(f"global pose: its time must be finite, got {t}")
        oldest = self._past[0][0].t if self._past else self._state.t
        if t < oldest or -np.inf < self._state.t < t - AHEAD:
            return False
        later: list[_Step] = []
        state, past = self._state, reversed(self._past)
        while state.t > t:
            state, step = next(past)
            later.append(step)
        corrected = self._corrected(state, later[-1] if later else None, t, z, r)
        self.refused += corrected is None
        self.taken += corrected is not None
        state = corrected or state
        for _ in later:
            self._past.pop()
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
        _refuse_certain(s)
        self._refusals += 1
        misfit = float(error @ np.linalg.solve(s, error))
        if misfit > GATE:
            if self._refusals <= PATIENCE:
                return None
            # the filter is lost: carried away, or by wheels that are worse than believed. Its pose is the source's
            p = state.p.copy()
            p[:3, 3:], p[3:, :3], p[:3, :3] = 0.0, 0.0, r
            p[WHEELS:, :] *= DOUBTED
            p[:, WHEELS:] *= DOUBTED
            self._refusals = 0
            return _State(state.t, np.concatenate([state.mean[:3] + error, state.mean[3:]]), p)
        self._refusals = 0
        self._misfits += misfit
        gain = np.linalg.solve(s, state.p[:3]).T
        keep = np.eye(state.mean.size)
        keep[:, :3] -= gain
        return _State(state.t, state.mean + gain @ error, keep @ state.p @ keep.T + gain @ r @ gain.T)


def _given_way(mean: Array, p: Array, shown: _Shown, fitted: Array) -> tuple[Array, Array]:
    """Mean and covariance with what open legs show: that they and the wheels do not contradict each other."""
    rows, apart = shown.by_wheels, shown.apart + shown.by_wheels @ (mean[WHEELS:] - fitted)
    cross = p[:, WHEELS:] @ rows.T
    s = rows @ cross[WHEELS:] + shown.variance * np.eye(len(rows))
    gain = np.linalg.solve(s, cross.T).T
    return mean - gain @ apart, p - gain @ cross.T


def _refuse_certain(covariance: Array) -> None:
    """Raise :class:`InputError` for the covariance (3, 3) of a difference that is certain in some direction. Units do not count:
    a yaw that is not known at all (1e9 rad²) is none."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not spread.all() or np.linalg.eigvalsh(covariance / np.outer(spread, spread))[0] < _CERTAIN:
        raise InputError(
            "global pose: its covariance and the filter's own are both 0 in a direction, so that nothing can be weighed; valid: a "
            "covariance of full rank, or place() for where the base is exactly"
        )


def is_covariance(matrix: ArrayLike) -> bool:
    """Whether a matrix of finite numbers can be a covariance: no variance is negative, in no direction."""
    values = np.linalg.eigvalsh(0.5 * (np.asarray(matrix) + np.asarray(matrix).T))
    return bool(values[0] >= -1e-9 * max(values[-1], 0.0))


def _checked_covariance(name: str, value: ArrayLike) -> Array:
    """(3, 3), or :class:`InputError`."""
    array = np.asarray(value, float)
    if array.shape != (3, 3) or not np.isfinite(array).all():
        raise InputError(f"{name}: a covariance of 3 by 3 finite numbers is needed, got shape {array.shape}")
    if not is_covariance(array):
        raise InputError(f"{name}: a covariance is needed, a variance of this one is negative")
    return array


def _three(name: str, value: ArrayLike) -> Array:
    """Three finite numbers, or :class:`InputError`."""
    array = np.asarray(value, float)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{name}: 3 finite numbers are needed, got {array}")
    return array
