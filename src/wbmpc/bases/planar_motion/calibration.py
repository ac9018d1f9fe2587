"""What a drive with global poses shows of the errors of wheels.

What a drive that stands between its strokes shows of a base's wheels, by global poses of where it stood.

The strokes compare how far wheels say that the base went with how far it did, as in Borenstein and Feng, "Measurement and Correction of
Systematic Odometry Errors in Mobile Robots", IEEE Transactions on Robotics and Automation 12 (1996); here by least squares over any strokes
and for any wheels: the base type gives the motion by its wheels for errors that it names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.odometry import PlanarOdometry
from wbmpc.bases.planar_motion.wheel_errors import WheelErrors
from wbmpc.errors import InputError

#: A base stands while no wheel or steering joint turns by more than this [rad], for this time [s] at least: controllers that hold a base
#: turn its wheels a little.
STILL, STANDS = 0.03, 0.3
#: Motion by the wheels over a stroke is off, whatever their errors: share of the way [m over m], of the turn [rad over rad], and turn by
#: the way [rad/m].
SLIP, TURN, VEER = 1e-3, 1e-3, 3e-4
#: Steps of the least squares; change of an error for its derivative; mean normalized squared residual (1 is expected) above which wheels and
#: poses contradict each other.
STEPS, CHANGE, MISFIT = 3, 1e-4, 9.0


@dataclass(frozen=True)
class Strokes:
    """What the encoders read over each of k strokes, ``turned`` (rows, n) at ``times`` (rows) [s], from one of k + 1 stands to the next: its
    ends are where they were on average while the poses of the stands were taken, whose means ``poses`` (k + 1, 3) have standard deviations
    ``std`` (k + 1, 3).

    (A base creeps at the ends of a stand by more than its poses are off: what is compared must be of the same moments.)
    """

    turned: tuple[Array, ...]
    times: tuple[Array, ...]
    poses: Array
    std: Array

    @classmethod
    def of(cls, channels: Mapping[str, Array], source: str) -> Strokes:
        """From the channels "wheel", "steer" (may be missing) and "place" of a log, each with its times. Raises :class:`InputError` for a
        record without two stands that have poses."""
        for name in ("wheel", "place"):
            if name not in channels or f"{name}.time" not in channels:
                raise InputError(
                    f"{source}: there is no channel '{name}' with its '{name}.time'; a calibration needs it"
                )
        times = channels["wheel.time"]
        turned = np.hstack([channels[n] for n in ("wheel", "steer") if n in channels and channels[n].size])
        at, places = channels["place.time"], channels["place"]
        rows, middles, readings, poses, std = [], [], [], [], []
        for first, last in _stands(times, turned):
            within = (at >= times[first]) & (at <= times[last])
            if within.any():
                weights = 1.0 / places[within, 3:] ** 2
                std.append(1.0 / np.sqrt(weights.sum(axis=0)))
                weights /= weights.sum(axis=0)
                poses.append((weights * places[within, :3]).sum(axis=0))
                readings.append(weights.mean(axis=1) @ np.array([np.interp(at[within], times, a) for a in turned.T]).T)
                middles.append(at[within].mean())
                rows.append(int(np.argmin(np.abs(times - middles[-1]))))
        if len(rows) < 2:
            raise InputError(
                f"{source}: the base stands {len(rows)} times with global poses; a calibration needs strokes between two stands or more"
            )
        between = [slice(a + 1, b) for a, b in pairwise(rows)]
        strokes = [np.vstack([readings[k], turned[part], readings[k + 1]]) for k, part in enumerate(between)]
        when = [np.hstack([middles[k], times[part], middles[k + 1]]) for k, part in enumerate(between)]
        return cls(tuple(strokes), tuple(when), np.array(poses), np.array(std))

    def moved(self) -> tuple[Array, Array]:
        """How the base moved over each stroke (k, 3) in axes of where it began, and the derivative (k, 3, 6) by the poses of both its
        ends."""
        a, b = self.poses[:-1], self.poses[1:]
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, :2].T
        moved = np.stack([c * dx + s * dy, -s * dx + c * dy, lie.wrapped(b[:, 2] - a[:, 2])], axis=1)
        by = np.zeros((len(a), 3, 6))
        by[:, 0, 3], by[:, 0, 4], by[:, 1, 3], by[:, 1, 4], by[:, 2, 5] = c, s, -s, c, 1.0
        by[:, :, :3] = -by[:, :, 3:]
        by[:, 0, 2], by[:, 1, 2] = moved[:, 1], -moved[:, 0]
        return moved, by


def _stands(times: Array, turned: Array) -> list[tuple[int, int]]:
    """First and last rows of the parts of a record (k, n) in which nothing turns."""
    found, first, low, high = list[tuple[int, int]](), 0, turned[0], turned[0]
    for k, row in enumerate(turned):
        lower, higher = np.minimum(low, row), np.maximum(high, row)
        if (higher - lower).max() <= STILL:
            low, high = lower, higher
            continue
        if times[k - 1] - times[first] >= STANDS:
            found.append((first, k - 1))
        first, low, high = k, row, row
    if times[-1] - times[first] >= STANDS:
        found.append((first, len(times) - 1))
    return found


#: Motion (3) of the base by its wheels for errors (p) and what the encoders read (rows, n) at times (rows) [s], in axes of where it began,
#: and its length (2) [m, rad].
MotionByWheels = Callable[[Array, Array, Array], tuple[Array, Array]]


def fit_strokes(strokes: Strokes, motion: MotionByWheels, std: Array, source: str) -> tuple[Array, Array]:
    """Errors (p) of the wheels with which ``motion`` by them agrees best with where the base stood, and their covariance (p, p). ``std`` (p):
    what they may be off before. Raises :class:`InputError` where no errors explain the poses."""
    count, size = len(strokes.turned), len(std)
    precision = np.diag(1.0 / std**2)
    errors: Array = np.zeros(size)
    moved, by = strokes.moved()
    over = lambda e: [motion(e, turned, times) for turned, times in zip(strokes.turned, strokes.times, strict=True)]
    noise = _noise(strokes, by, np.array([way for _, way in over(errors)]))
    inverse = np.linalg.inv(noise)
    for step in range(STEPS + 1):
        own = np.array([m for m, _ in over(errors)])
        apart = moved - own
        apart[:, 2] = lie.wrapped(apart[:, 2])
        if step == STEPS:
            break
        slope = np.empty((3 * count, size))
        for p in range(size):
            other = errors.copy()
            other[p] += CHANGE
            slope[:, p] = (np.array([m for m, _ in over(other)]) - own).ravel() / CHANGE
        weighted = slope.T @ inverse
        information = weighted @ slope + precision
        errors = errors + np.linalg.solve(information, weighted @ apart.ravel() - precision @ errors)
    misfit = float(apart.ravel() @ inverse @ apart.ravel()) / (3 * count)
    if not misfit <= MISFIT:
        raise InputError(
            f"{source}: wheels and global poses contradict each other ({np.sqrt(misfit):.2g} standard deviations), whatever the wheels' "
            "errors are; check which wheel is which, their signs, and the clock and axes of the poses"
        )
    return errors, np.asarray(np.linalg.inv(information), float)


def _noise(strokes: Strokes, by: Array, way: Array) -> Array:
    """Covariance (3k, 3k) of the difference between the strokes' motions by poses and by wheels: strokes share the poses between them."""
    count = len(by)
    spread = np.zeros((3 * count, 3 * count + 3))
    for k in range(count):
        spread[3 * k : 3 * k + 3, 3 * k : 3 * k + 6] = by[k]
    poses = (spread * strokes.std.ravel() ** 2) @ spread.T
    own = np.stack([SLIP * way[:, 0], SLIP * way[:, 0], TURN * way[:, 1] + VEER * way[:, 0]], axis=1)
    return np.asarray(poses + np.diag(own.ravel() ** 2))


#: Standard deviations before any measurement (relative): of a radius, and of a speed of the base, which rollers that creep and tracks that
#: skid make slower; of the creep of tires in bends [s].
RADIUS, SPEED, CREEP = 0.01, 0.03, 0.01


def fit_errors(
    odometry: Callable[[WheelErrors], PlanarOdometry], size: tuple[int, int], channels: Mapping[str, Array], source: str
) -> WheelErrors:
    """What a log's ``channels`` show (:class:`Strokes`); ``odometry`` at the origin for errors of (n, m)
    ``size``."""
    wheels, _ = size
    strokes = Strokes.of(channels, source)
    encoders = channels["wheel"].shape[1]
    split = lambda errors, covariance: WheelErrors(errors[:wheels], errors[wheels:-1], covariance, errors[-1])
    unseen = np.zeros((sum(size), sum(size)))

    def motion(errors: Array, turned: Array, times: Array) -> tuple[Array, Array]:
        moving, way = odometry(split(errors, unseen)), np.zeros(2)
        before = moving.pose
        for t, row in zip(times, turned, strict=True):
            moving.turn(float(t), row[:encoders], row[encoders:], None)
            way += np.hypot(*(moving.pose - before)[:2]), abs(moving.pose[2] - before[2])
            before = moving.pose
        return moving.pose, way

    found, covariance = fit_strokes(strokes, motion, np.repeat([RADIUS, SPEED, CREEP], [*size, 1]), source)
    return split(found, covariance[:-1, :-1])
