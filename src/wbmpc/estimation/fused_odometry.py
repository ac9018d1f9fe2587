"""Wheels, gyro and, where there is one, a source of global poses in one filter, with an honest covariance.

An extended Kalman filter on (x, y, yaw; gyro bias; lateness; steer zeros; wheel radii). The wheels' least-squares twist
moves it (:mod:`wbmpc.estimation.wheel_odometry`), the gyro measures the turn of the same interval, global poses come late and
are taken in at the time they belong to. The calibration is part of the state because its errors make the drift: they are
not noise, they last. The lateness is the turn between the moment at which encoders were read and their message: it ends
with the next message, and a filter that took it for noise of each interval would add it up. Equations and sources:
docs/explanation.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.checks import covariance as checked_covariance
from wbmpc.checks import finite, numbers
from wbmpc.errors import InputError
from wbmpc.estimation import odometry_filter as fused_filter
from wbmpc.estimation.odometry_filter import BIAS, LATE, WHEELS, LegsShow, OdometryNoise, State, Step, advanced
from wbmpc.estimation.wheel_calibration import WheelCalibration
from wbmpc.estimation.wheel_odometry import Increment, Mask, Sample, WheelOdometry, fit_twist
from wbmpc.estimation.wheel_slip import SlipIntensity
from wbmpc.model.wheels import ModuleGeometry

Array = NDArray[np.float64]

#: A global pose whose normalised error squared is above this is rejected: 99.99 % of chi-square with 3 degrees of freedom.
GATE = 21.1
#: So many rejection in a row mean that the estimate is wrong and not the source: its next pose is taken as it is.
PATIENCE = 10
#: A pose so little [s] ahead of the last message counts as of then (another clock, a message on its way); others do not count.
AHEAD = 0.1


#: Contradictions of the wheels are added up over pieces of way [m] of this length.
PIECE = 0.05
#: Time constant [s] of the derivatives of the twist by the wheels' corrections.
SMOOTHING = 0.05
#: An interval longer than this [s] is a gap: a mean of the gyro over it is none, and the wheels show only where it ended.
GAP = 0.1
#: Standard deviation of where a base is after a gap: this share of the wheels' way, and by this [m/s] whatever they show.
GAP_SHARE, GAP_SPEED = 0.1, 0.02
#: Wheels that moved farther [m], and faster [m/s], than any base does: their encoders count anew, and the base stood by
#: :data:`LEAP_STD` [m, and over the wheels' distance rad].
LEAP, LEAP_SPEED, LEAP_STD = 0.5, 20.0, 0.1
#: A gap over which the clock was no clock counts as one of this length [s].
UNKNOWN_GAP = 1.0


class FusedOdometry:
    """Planar pose of a base on steered wheels with its covariance.

    ``calibration``: what is known of the wheels (:meth:`WheelCalibration.unknown` when left out); ``pose_std`` (x, y, yaw)
    of the start; ``history`` [s]: how old a global pose may be. ``twist`` (3): body twist of the last interval;
    ``slip`` [m/s]: root mean square by which the wheels contradict each other over the slip window; ``taken``, ``rejected``: how
    many global poses did and did not fit; ``misfit``: mean of the normalised squared errors of those that did (3 is expected);
    ``contradiction``: by how much of their way the wheels contradicted each other. Raises :class:`InputError` for a calibration of
    another number of modules, and for numbers that are not finite, of another length or negative.
    """

    def __init__(
        self,
        geometry: ModuleGeometry,
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
        if known.modules != n:
            raise InputError(f"odometry: 'calibration' is of {known.modules} modules, the base has {n}")
        self._reader = WheelOdometry(geometry, leg_offset=known.leg_offset, steer_offset=known.steer_offset)
        p = np.zeros((WHEELS + 2 * n, WHEELS + 2 * n))
        p[:3, :3] = np.diag(np.square(_not_negative("pose_std", numbers("odometry", "pose_std", pose_std, 3))))
        p[BIAS, BIAS] = self.noise.gyro_bias**2
        p[WHEELS:, WHEELS:] = known.covariance
        self._state = State(-np.inf, np.concatenate([numbers("odometry", "pose0", pose0, 3), np.zeros(2 + 2 * n)]), p)
        finite("odometry", history=history)
        self._keep, self._past = float(_not_negative("history", history)), deque[tuple[State, Step]]()
        self._last: Sample | None = None
        self._open = np.zeros(n, dtype=bool)
        self._by_wheels = np.zeros((3, 2 * n))
        self._slip = SlipIntensity(2 * n - 3, self.noise.slip_window)
        self.twist: Array = np.zeros(3)
        self.taken = self.rejected = self._rejections = 0
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
        return WheelCalibration(prior.steer_offset + c[:n], prior.leg_offset, radius, self._state.p[WHEELS:, WHEELS:])

    # ------------------------------------------------------------------ from outside
    def place(self, pose: ArrayLike, covariance: ArrayLike | None = None) -> None:
        """The base is at ``pose`` (3), exactly or with a ``covariance`` (3, 3); what is known of gyro and wheels stays. Older
        global poses no longer count."""
        mean, p = self._state.mean.copy(), self._state.p.copy()
        mean[:3] = numbers("place", "pose", pose, 3)
        p[:3, :], p[:, :3] = 0.0, 0.0
        if covariance is not None:
            p[:3, :3] = checked_covariance("place", covariance)
        self._state = State(self._state.t, mean, p)
        self._past.clear()

    def restart_clock(self) -> None:
        """Times start anew: the next message only starts; what is known stays."""
        self._state = State(-np.inf, self._state.mean, self._state.p)
        self._past.clear()
        self._last = None

    def bridge(self, t: float) -> None:
        """The clock jumped: the next message, of time ``t`` [s] or later, ends a gap whose length nobody knows; it counts as one
        of :data:`UNKNOWN_GAP`. Raises :class:`InputError` for a time that is not finite."""
        finite("odometry", t=t)
        if self._last is not None:
            self._state = replace(self._state, t=t - UNKNOWN_GAP)
            self._past.clear()

    @property
    def time(self) -> float:
        """Of the last message [s]; minus infinity before the first."""
        return self._state.t

    def move_clock(self, by: float) -> None:
        """The clock's zero moves: what was at time t [s] was at t + ``by``. Raises :class:`InputError` for no finite number."""
        finite("odometry", by=by)
        self._state = replace(self._state, t=self._state.t + by)
        self._past = deque((replace(state, t=state.t + by), step) for state, step in self._past)

    # ------------------------------------------------------------------ wheels and gyro
    def update(
        self,
        t: float,
        leg: ArrayLike,
        steer: ArrayLike,
        wheel: ArrayLike,
        gyro: float | None = None,
        brake: ArrayLike | None = None,
        weights: ArrayLike | None = None,
    ) -> Array:
        """The pose after a message of time ``t`` [s]: positions (n) [rad] and ``gyro``, the mean yaw rate [rad/s] since the
        message before (the rate at its end is ahead of the wheels while a turn begins, as if their radii were wrong);
        ``weights`` (n): little for wheels that are known to slip, of two or more above 0.

        ``brake`` (n): which hinges turn freely by now (1 = open; left out: none is taken to). A leg that gives way shows where its
        wheel goes, and so the zeros. The first message only starts. After a gap (:data:`GAP`) the gyro does not count: the wheels'
        way over it moves the pose, the covariance grows (:data:`GAP_SHARE`, :data:`GAP_SPEED`), and global poses from before
        its end no longer count. Raises :class:`InputError` for numbers that are not finite or time that goes back.
        """
        now = self._reader.checked(leg, steer, wheel)
        if not np.isfinite(t) or t < self._state.t or (gyro is not None and not np.isfinite(gyro)):
            raise InputError(
                f"odometry: time and gyro must be finite and time must not go back, got {t} s, {gyro} rad/s"
            )
        weighed = None if weights is None else self._checked_weights(weights)
        h, is_open = t - self._state.t, self._opened(brake)
        if self._last is None:
            self._state = self._started(t, 0.0 if gyro is None else gyro)
        elif h > 0.0:
            self._advance(h, self._last, now, gyro, self._open & is_open, weighed)
            while self._past and self._past[0][0].t < t - self._keep:
                self._past.popleft()
        self._last, self._open = now, is_open
        return self.pose

    def _advance(
        self, h: float, before: Sample, now: Sample, gyro: float | None, is_open: Mask, weights: Array | None
    ) -> None:
        way = float(np.max(np.abs(now[2] - before[2]))) * self.geometry.wheel_radius
        leap = way > LEAP and way > LEAP_SPEED * h
        gap = h > GAP or leap
        if leap:
            before = now
        step = (
            self._bridged(h, before, now, LEAP_STD if leap else 0.0)
            if gap
            else self._step(h, before, now, gyro, is_open, weights)
        )
        self._past.append((self._state, step))
        self._state = advanced(self._state, step, self.noise)
        self.twist = step.twist / h
        if gap:
            self._past.clear()

    def _bridged(self, h: float, before: Sample, now: Sample, least: float) -> Step:
        """Over a gap: one motion from its begin to its end, as uncertain as what the wheels did meanwhile, and by ``least`` [m]."""
        n, c = self._n, self._state.mean[WHEELS:].copy()
        correct = lambda sample: (sample[0], sample[1] - c[:n], sample[2])
        moved = fit_twist(self.geometry, self._prior.wheel_radius * (1.0 + c[n:]), correct(before), correct(now))
        turned = np.abs(now[1] - before[1])  # steering that turned meanwhile: the way's direction is as uncertain
        apart = float(np.max((GAP_SHARE + turned) * np.abs(moved.rolled))) + GAP_SPEED * h + least
        axes = self.geometry.steer_axes(now[0])
        arm = float(np.sqrt(np.mean(np.sum((axes - axes.mean(axis=0)) ** 2, axis=1))))
        covariance = np.diag([apart, apart, apart / arm]) ** 2
        self._by_wheels = np.zeros((3, 2 * n))
        return Step(h, moved.twist, self._by_wheels, c, covariance, 0.0, np.nan)

    def _checked_weights(self, given: ArrayLike) -> Array:
        """Weights (n) of wheels, two or more above 0, or :class:`InputError`."""
        weights = numbers("odometry", "weights", given, self._n)
        if (weights < 0.0).any() or np.sum(weights > 0.0) < 2:
            raise InputError(f"odometry: 'weights' needs {self._n} numbers, none negative, two above 0, got {weights}")
        return weights

    def _opened(self, brake: ArrayLike | None) -> Mask:
        """Hinges (n) that turn freely."""
        if brake is None or not self.geometry.has_hinge:
            return np.zeros(self._n, dtype=bool)
        return np.asarray(numbers("odometry", "brake", brake, self._n) > 0.5)

    def _started(self, t: float, rate: float) -> State:
        """The first message is late too, if the base turns already."""
        mean, p = self._state.mean.copy(), self._state.p.copy()
        p[LATE, :], p[:, LATE] = 0.0, 0.0
        mean[LATE], p[LATE, LATE] = -rate * self.noise.mean_age, (rate * self.noise.age) ** 2
        return State(t, mean, p)

    def _step(
        self, h: float, before: Sample, now: Sample, gyro: float | None, is_open: Mask, weights: Array | None
    ) -> Step:
        n, c = self._n, self._state.mean[WHEELS:].copy()
        correct = lambda sample: (sample[0], sample[1] - c[:n], sample[2])
        radius = self._prior.wheel_radius * (1.0 + c[n:])
        moved = fit_twist(self.geometry, radius, correct(before), correct(now), weights)
        # Smoothed, and of the intervals before: the age of this message is in its own derivative and in what it is
        # compared with, and their product would look like a wrong radius.
        by_wheels = self._by_wheels * h
        now_by_wheels = np.concatenate([moved.by_steer_offset(), moved.by_radius()], axis=1)
        self._by_wheels = self._by_wheels + (1.0 - np.exp(-h / SMOOTHING)) * (now_by_wheels / h - self._by_wheels)
        turn = np.nan if gyro is None else gyro * h
        counts = self.noise.reading**2 * float(np.sum(moved.fit[2] ** 2))
        self._note_contradiction(moved)
        covariance = self._twist_covariance(moved, h, weights)
        legs = self._shown(moved, 0.5 * (before[0] + now[0]), is_open, h) if is_open.any() and weights is None else None
        return Step(h, moved.twist, by_wheels, c, covariance, counts, turn, legs)

    def _note_contradiction(self, moved: Increment) -> None:
        """Over pieces of way, in which the counts of encoders cancel."""
        self._off += moved.residual
        self._rolled += np.abs(moved.rolled)
        if float(np.mean(self._rolled)) >= PIECE:
            self._apart += float(np.sum(np.hypot(self._off[:, 0], self._off[:, 1])))
            self._way += float(np.sum(self._rolled))
            self._off[:], self._rolled[:] = 0.0, 0.0

    def _shown(self, moved: Increment, leg: Array, is_open: Mask, h: float) -> LegsShow:
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
        return LegsShow(rows @ moved.residual.ravel(), np.concatenate([by_zero, by_radius], axis=1), variance)

    def _twist_covariance(self, moved: Increment, h: float, weights: Array | None) -> Array:
        """Of the twist of one interval: rolling noise by the way, slip by what the wheels contradict each other."""
        residual = moved.residual if weights is None else weights[:, None] * moved.residual
        slip = self._slip.update(residual / h, float(np.mean(np.abs(moved.rolled))) / h, h) * h
        cosine, sine, way = np.cos(moved.heading), np.sin(moved.heading), np.abs(moved.rolled)
        along = moved.fit[:, :, 0] * cosine + moved.fit[:, :, 1] * sine
        across = moved.fit[:, :, 1] * cosine - moved.fit[:, :, 0] * sine
        a, s = self.noise.along**2 * way + slip, self.noise.across**2 * way + slip
        return (along * a) @ along.T + (across * s) @ across.T

    # ------------------------------------------------------------------ global poses
    def correct(self, t: float, pose: ArrayLike, covariance: ArrayLike) -> bool:
        """Take in a global pose (x, y, yaw) that was true at time ``t`` [s], with its covariance (3, 3).

        The filter goes back to that time, corrects, and comes forward again. False when the pose is older than the
        history, of a future that no message has come from (see ``AHEAD``), or does not fit (see ``GATE`` and ``PATIENCE``).
        Raises :class:`InputError` for what is not finite, for a covariance that is none, and where pose and filter are both
        certain: which one is right cannot be reported. Nothing is lost then.
        """
        z, r = numbers("global pose", "pose", pose, 3), checked_covariance("global pose", covariance)
        if not np.isfinite(t):
            raise InputError(f"global pose: its time must be finite, got {t}")
        oldest = self._past[0][0].t if self._past else self._state.t
        if t < oldest or -np.inf < self._state.t < t - AHEAD:
            return False
        later: list[Step] = []
        state, past = self._state, reversed(self._past)
        while state.t > t:
            state, step = next(past)
            later.append(step)
        corrected = self._corrected(state, later[-1] if later else None, t, z, r)
        self.rejected += corrected is None
        self.taken += corrected is not None
        state = corrected or state
        for _ in later:
            self._past.pop()
        for step in reversed(later):
            self._past.append((state, step))
            state = advanced(state, step, self.noise)
        self._state = state
        return corrected is not None

    def _corrected(self, state: State, step: Step | None, t: float, z: Array, r: Array) -> State | None:
        """The state with a pose taken in that belongs to a moment of the step after it; None where it does not fit."""
        error = fused_filter.apart(state, step, t, z)
        misfit = fused_filter.misfit(state, error, r)
        if misfit > GATE:
            self._rejections += 1
            if self._rejections <= PATIENCE:
                return None
            # the filter is lost: carried away, or by wheels that are worse than believed. Its pose is the source's
            self._rejections = 0
            return fused_filter.replaced(state, error, r)
        self._rejections = 0
        self._misfits += misfit
        return fused_filter.corrected(state, error, r)


def _not_negative(name: str, value: Array | float) -> Array | float:
    """``value``, or :class:`InputError` by ``name`` where it is below 0."""
    if np.min(value) < 0.0:
        raise InputError(f"odometry: '{name}' must not be negative, got {value}")
    return value
