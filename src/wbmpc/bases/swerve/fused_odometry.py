"""Wheels, gyro and, where there is one, a source of global poses in one filter, with an honest covariance.

An extended Kalman filter on (x, y, yaw; gyro bias; lateness; steer zeros; wheel radii). The wheels' least-squares twist
moves it (:mod:`wbmpc.bases.swerve.wheel_odometry`), the gyro measures the turn of the same interval, global poses come late and
are taken in at the time they belong to. The calibration is part of the state because its errors make the drift: they are
not noise, they last. The lateness is the turn between the moment at which encoders were read and their message: it ends
with the next message, and a filter that took it for noise of each interval would add it up. Equations and sources:
docs/explanation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.swerve.late_poses import LatePoses
from wbmpc.bases.swerve.odometry_filter import LegEvidence, OdometryNoise, State
from wbmpc.bases.swerve.odometry_memory import OdometryMemory
from wbmpc.bases.swerve.odometry_step import BIAS, LATE, UNSURE, WHEELS, Interval, Way
from wbmpc.bases.swerve.slip_step import Slip
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.bases.swerve.wheel_odometry import Increment, Mask, Sample, WheelOdometry
from wbmpc.checks import covariance as checked_covariance
from wbmpc.checks import finite, numbers
from wbmpc.errors import InputError
from wbmpc.estimation.repetition import Repetition
from wbmpc.model.wheels import ModuleGeometry

#: An interval longer than this [s] is a gap: a mean of the gyro over it is none, and the wheels show only where it ended.
GAP = 0.1
#: Standard deviation of where a base is after a gap: this share of the wheels' way, and by this [m/s] whatever they show.
GAP_SHARE, GAP_SPEED = 0.1, 0.02
#: Wheels that moved farther [m], and faster [m/s], than any base does: their encoders count from zero again, and the base stood by
#: :data:`LEAP_STD` [m, and over the wheels' distance rad].
LEAP, LEAP_SPEED, LEAP_STD = 0.5, 20.0, 0.1
#: Weight of a velocity by an inertial unit beside wheels, of which each has 1 if it goes as the unit does: little, for at 2 m/s it is off by
#: 20 mm/s, and wheels that slip far have less.
INERTIAL_WEIGHT = 0.02
#: A gap over which the clock was no clock counts as one of this length [s].
UNKNOWN_GAP = 1.0


class FusedOdometry:
    """Planar pose of a base on steered wheels with its covariance.

    ``calibration``: what is known of the wheels (:meth:`WheelCalibration.unknown` when left out); ``pose_std`` (x, y, yaw)
    of the start; ``history`` [s]: how old a global pose may be. ``twist`` (3): body twist of the last interval;
    ``slip`` [m/s]: root mean square by which the wheels contradict each other over the slip window; ``global_poses``: those that were
    taken in and rejected; ``contradiction``: by how much of their way the wheels contradicted each other. Raises :class:`InputError` for
    a calibration of another number of modules, and for numbers that are not finite, of another length or negative.
    """

    def __init__(
        self, geometry: ModuleGeometry, pose0: ArrayLike = (0.0, 0.0, 0.0), *,
        calibration: WheelCalibration | None = None, noise: OdometryNoise | None = None,
        pose_std: ArrayLike = (0.0, 0.0, 0.0), history: float = 0.5,
    ) -> None:  # fmt: skip
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
        start = np.concatenate([numbers("odometry", "pose0", pose0, 3), np.zeros(2 + 2 * n)])
        self._memory = OdometryMemory(geometry, known.wheel_radius, self.noise)
        self._memory.set_state(State(-np.inf, start, p))
        finite("odometry", history=history)
        self._keep, self.global_poses = float(_not_negative("history", history)), LatePoses(self._memory)
        self._started, self._closed = False, np.zeros(n, dtype=bool)
        self._open: Mask = self._closed
        self._repetition = Repetition()
        self.twist: Array = np.zeros(3)

    # ------------------------------------------------------------------ results
    @property
    def _state(self) -> State:
        return self._memory.state

    @property
    def pose(self) -> Array:
        """(x, y, yaw), yaw not wrapped."""
        return self._memory.arrays["mean"][:3].copy()

    @property
    def mean(self) -> Array:
        """The filter's state, ``pose`` first, as an array that goes on: for steps that read it."""
        return self._memory.arrays["mean"]

    @property
    def covariance(self) -> Array:
        """(3, 3) of the pose's error, in world axes."""
        return self._state.p[:3, :3].copy()

    @property
    def twist_covariance(self) -> Array:
        """(3, 3) of the error of ``twist``, as the wheels of the last interval say; 0 before the first."""
        if not self.global_poses.past:
            return np.zeros((3, 3))
        a = self._memory.arrays
        return a["covariance"].reshape(3, 3) / a["interval"][Interval.H] ** 2

    @property
    def gyro_bias(self) -> float:
        """[rad/s]."""
        return float(self._memory.arrays["mean"][BIAS])

    @property
    def slip(self) -> float:
        """Root mean square [m/s] over the wheels, one component: 0 when they agree."""
        return float(np.sqrt(self._memory.arrays["slip"][Slip.NOW]))

    @property
    def contradiction(self) -> float:
        """By how much of their way the wheels contradicted each other, over the whole drive: 0 when they agree."""
        way = self._memory.arrays["way"]
        return float(way[Way.APART] / way[Way.ROLLED]) if way[Way.ROLLED] > 0.0 else 0.0

    @property
    def calibration(self) -> WheelCalibration:
        """What is known of the wheels by now."""
        n, prior, state = self._n, self._prior, self._state
        c = state.mean[WHEELS:]
        radius = prior.wheel_radius * (1.0 + c[n:])
        return WheelCalibration(prior.steer_offset + c[:n], prior.leg_offset, radius, state.p[WHEELS:, WHEELS:].copy())

    # ------------------------------------------------------------------ from outside
    def place(self, pose: ArrayLike, covariance: ArrayLike | None = None) -> None:
        """The base is at ``pose`` (3), exactly or with a ``covariance`` (3, 3); what is known of gyro and wheels stays. Older
        global poses no longer count."""
        mean, p = self._state.mean.copy(), self._state.p.copy()
        mean[:3] = numbers("place", "pose", pose, 3)
        p[:3, :], p[:, :3] = 0.0, 0.0
        if covariance is not None:
            p[:3, :3] = checked_covariance("place", covariance)
        self._memory.set_state(State(self._state.t, mean, p))
        self._memory.forget_sliding()
        self.global_poses.clear()

    def restart_clock(self) -> None:
        """Times restart: the next message only starts; what is known stays."""
        self._memory.record[0] = -np.inf
        self._repetition.forget()
        self.global_poses.clear()
        self._started = False

    def restart_encoders(self) -> None:
        """Encoders count from elsewhere, and times restart: the next message only starts. The pose stays, as uncertain as
        :data:`LEAP_STD`, for nothing says where the base went meanwhile."""
        self.restart_clock()
        spread = np.array([1.0, 1.0, 1.0 / self._arm(self._memory.arrays["before"][: self._n])]) * LEAP_STD
        self.place(self.pose, self.covariance + np.diag(spread**2))
        self.twist = np.zeros(3)

    def _arm(self, leg: Array) -> float:
        """Root mean square distance [m] of the wheels, at hinge angles (n) [rad], from their middle."""
        axes = self.geometry.steer_axes(leg)
        return float(np.sqrt(np.mean(np.sum((axes - axes.mean(axis=0)) ** 2, axis=1))))

    def bridge(self, t: float) -> None:
        """The clock jumped: the next message, of time ``t`` [s] or later, ends a gap of unknown length; it counts as one
        of :data:`UNKNOWN_GAP`. Raises :class:`InputError` for a time that is not finite."""
        finite("odometry", t=t)
        if self._started:
            self._memory.record[0] = t - UNKNOWN_GAP
            self._repetition.forget()
            self.global_poses.clear()

    @property
    def time(self) -> float:
        """Of the last message [s]; minus infinity before the first."""
        return float(self._memory.record[0])

    def move_clock(self, by: float) -> None:
        """The clock's zero moves: what was at time t [s] was at t + ``by``. Raises :class:`InputError` for no finite number."""
        finite("odometry", by=by)
        self._repetition.move_clock(by)
        for record in (self._memory.record, *(moment.record for moment in self.global_poses.past)):
            record[0] += by

    # ------------------------------------------------------------------ wheels and gyro
    def update(
        self, t: float, leg: ArrayLike, steer: ArrayLike, wheel: ArrayLike, gyro: float | None = None,
        brake: ArrayLike | None = None, weights: ArrayLike | None = None,
    ) -> Array:  # fmt: skip
        """The pose after a message of time ``t`` [s]: positions (n) [rad] and ``gyro``, the mean yaw rate [rad/s] since the
        message before (the rate at its end is ahead of the wheels while a turn begins, as if their radii were wrong);
        ``weights`` (n): little for wheels that are known to slip, of two or more above 0.

        ``brake`` (n): which hinges turn freely by now (1 = open; left out: none is taken to). A leg that gives way shows where its
        wheel goes, and so the zeros. The first message only starts. After a gap (:data:`GAP`) the gyro does not count: the wheels'
        way over it moves the pose, the covariance grows (:data:`GAP_SHARE`, :data:`GAP_SPEED`), and global poses from before
        its end no longer count. Wheels that repeat themselves while the gyro turns wait for those that move
        (:class:`~wbmpc.estimation.repetition.Repetition`). Raises :class:`InputError` for numbers that are not finite or time that goes back.
        """
        return self.advance(t, self._reader.checked(leg, steer, wheel), gyro, brake, weights)

    def advance(
        self, t: float, sample: Sample, gyro: float | None = None, brake: ArrayLike | None = None,
        weights: ArrayLike | None = None, velocity: Array | None = None,
    ) -> Array:  # fmt: skip
        """As :meth:`update`, after true positions that :class:`WheelOdometry` with the same zeros has checked. ``velocity`` (2) [m/s]: of
        the base's origin in its axes, by an inertial unit; it counts like a part of a wheel (:data:`INERTIAL_WEIGHT`)."""
        arrays, time = self._memory.arrays, self.time
        if (
            not math.isfinite(t)
            or t < max(time, self._repetition.time)
            or (gyro is not None and not math.isfinite(gyro))
        ):
            raise InputError(
                f"odometry: time and gyro must be finite and time must not go back, got {t} s, {gyro} rad/s"
            )
        weighed = None if weights is None else self._checked_weights(weights)
        h, is_open = t - time, self._opened(brake)
        arrays["inertial"][2] = 0.0
        if velocity is not None:
            arrays["inertial"][:2], arrays["inertial"][2] = velocity, INERTIAL_WEIGHT
        np.concatenate(sample, out=arrays["now"])
        counts, turning = self._repetition.count(t, time, sample[2], gyro, self.gyro_bias)
        if velocity is not None:  # who knows it knows of wheels that stand and slide
            counts, turning = True, gyro
            self._repetition.forget()
        if not counts:
            self._open = self._open & is_open
            return self.pose
        gyro = turning
        if not self._started:
            self._start(t, 0.0 if gyro is None else gyro)
        elif h > 0.0:
            self._advance(h, gyro, self._closed if is_open is self._closed else self._open & is_open, weighed)
            self.global_poses.forget(t - self._keep)
        arrays["before"][:] = arrays["now"]
        self._started, self._open = True, is_open
        return self.pose

    def _advance(self, h: float, gyro: float | None, is_open: Mask, weights: Array | None) -> None:
        memory, arrays = self._memory, self._memory.arrays
        way = memory.farthest() * self.geometry.wheel_radius
        leap = way > LEAP and way > LEAP_SPEED * h
        gap = h > GAP or leap
        arrays["weights"][:] = 1.0 if weights is None or gap else weights
        memory.legs = None
        if leap:
            arrays["before"][:] = arrays["now"]
        if gap:
            self._bridge(h, LEAP_STD if leap else 0.0)
        else:
            memory.measure(h, 0.0 if gyro is None else gyro * h, gyro is not None)
            if weights is None and is_open is not self._closed and is_open.any():
                memory.legs = self._shown(is_open, h)
        self.global_poses.remember()
        memory.propagate()
        self.twist = arrays["twist"] / h
        if gap:
            self.global_poses.clear()

    def _bridge(self, h: float, minimum: float) -> None:
        """Over a gap: one motion from its begin to its end, as uncertain as what the wheels did meanwhile, and by ``minimum`` [m]."""
        n, a = self._n, self._memory.arrays
        a["correction"][:] = a["mean"][WHEELS:]
        self._memory.wheels.run()
        turned = np.abs(a["now"][n : 2 * n] - a["before"][n : 2 * n])  # the way's direction is as uncertain
        apart = float(np.max((GAP_SHARE + turned) * np.abs(a["rolled"]))) + GAP_SPEED * h + minimum
        slid = UNSURE * float(np.linalg.norm(a["residual"])) / np.sqrt(max(2 * n - 3, 1))
        apart = float(np.hypot(apart, slid))
        a["covariance"][:] = (np.diag([apart, apart, apart / self._arm(a["now"][:n])]) ** 2).ravel()
        a["smoothed"][:], a["by_wheels"][:], a["interval"][:] = 0.0, 0.0, 0.0
        a["interval"][Interval.H] = h
        self._memory.forget_sliding()

    def _checked_weights(self, values: ArrayLike) -> Array:
        """Weights (n) of wheels, two or more above 0, or :class:`InputError`."""
        weights = numbers("odometry", "weights", values, self._n)
        if (weights < 0.0).any() or np.sum(weights > 0.0) < 2:
            raise InputError(f"odometry: 'weights' needs {self._n} numbers, none negative, two above 0, got {weights}")
        return weights

    def _opened(self, brake: ArrayLike | None) -> Mask:
        """Hinges (n) that turn freely."""
        if brake is None or not self.geometry.legs_move:
            return self._closed
        return np.asarray(numbers("odometry", "brake", brake, self._n) > 0.5)

    def _start(self, t: float, rate: float) -> None:
        """The first message is late too, if the base turns already."""
        state = self._state
        mean, p = state.mean, state.p
        p[LATE, :], p[:, LATE] = 0.0, 0.0
        mean[LATE], p[LATE, LATE] = -rate * self.noise.mean_age, (rate * self.noise.age) ** 2
        self._memory.record[0] = t

    def _shown(self, is_open: Mask, h: float) -> LegEvidence:
        """What open legs say about the wheels. Noise that is alike in all directions makes this residual
        independent of the noise of the twist, which is taken in apart from it."""
        n, arrays, moved = self._n, self._memory.arrays, Increment.of(self._memory.wheels)
        leg = 0.5 * (arrays["before"][:n] + arrays["now"][:n])
        rows = moved.leg_residual_basis(self.geometry.leg_motions(leg, self.geometry.steer_axes(leg)), is_open)
        along = np.stack([np.cos(moved.heading), np.sin(moved.heading)], axis=1) * moved.rolled[:, None]
        each = rows.reshape(len(rows), n, 2)
        by_zero = each[:, :, 0] * along[:, 1] - each[:, :, 1] * along[:, 0]
        by_radius = np.sum(each * along, axis=2)
        way, slip = float(np.mean(np.abs(moved.rolled))), float(arrays["slip"][Slip.INTENSITY])
        variance = max(self.noise.along, self.noise.across) ** 2 * way + slip * h + self.noise.reading**2
        return LegEvidence(rows @ moved.residual.ravel(), np.concatenate([by_zero, by_radius], axis=1), variance)

    def correct(self, t: float, pose: ArrayLike, covariance: ArrayLike) -> bool:
        """Take in a global pose, see :meth:`wbmpc.bases.swerve.late_poses.LatePoses.correct`."""
        return self.global_poses.correct(t, pose, covariance)


def _not_negative(name: str, value: Array | float) -> Array | float:
    """``value``, or :class:`InputError` by ``name`` where it is below 0."""
    if np.min(value) < 0.0:
        raise InputError(f"odometry: '{name}' must not be negative, got {value}")
    return value
