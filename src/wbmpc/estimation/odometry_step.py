"""The fused odometry from one message to the next, compiled: what wheels and gyro say, and the Kalman filter's step.

Mathematics and state: :mod:`wbmpc.estimation.odometry_filter`. Matrices are stored by rows.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from wbmpc.estimation.compilation import compiled, step
from wbmpc.estimation.wheel_fit import fit, move
from wbmpc.estimation.wheel_slip import slip_intensity
from wbmpc.kernel.ir import Floats

#: Time constant [s] of the derivatives of the twist by the wheels' corrections.
SMOOTHING = 0.05
#: Weights of wheels below this count as this in their variances: without a weight a wheel has no share.
SMALLEST = 1e-9
#: Places of gyro bias and lateness in the state; from WHEELS on the corrections of the wheels.
BIAS, LATE, WHEELS = 3, 4, 5


class Noise(IntEnum):
    """Entries of the array ``noise``: the fields of :class:`wbmpc.estimation.odometry_filter.OdometryNoise`."""

    ALONG = 0
    ACROSS = 1
    SLIP_WINDOW = 2
    READING = 3
    AGE = 4
    MEAN_AGE = 5
    GYRO = 6
    GYRO_WALK = 7
    GYRO_BIAS = 8


class Interval(IntEnum):
    """Entries of the array ``interval``."""

    H = 0  # length [s]
    TURN = 1  # what the gyro saw [rad]
    HAS_GYRO = 2  # 1, or 0 without
    COUNTS = 3  # variance [rad²] of the wheels' turn by counts
    SIZE = 4


class Way(IntEnum):
    """Entries of the array ``way``: sums over the whole drive [m]."""

    APART = 0
    ROLLED = 1
    SIZE = 2


#: Contradictions of the wheels are added up over pieces of way [m] of this length, in which the counts of encoders cancel.
PIECE = 0.05


@step
def farthest(n: int, before: Floats, now: Floats) -> float:
    """How far [rad] the wheel turned that turned most."""
    angle = 0.0
    for i in range(2 * n, 3 * n):
        angle = max(angle, abs(now[i] - before[i]))
    return angle


@compiled
def note_contradiction(
    n: int, residual: Floats, rolled: Floats, off: Floats, rolled_off: Floats, way: Floats
) -> None:  # fmt: skip
    """Add an interval to the present piece of way: ``off`` (n, 2) and ``rolled_off`` (n) [m]."""
    piece = 0.0
    for i in range(n):
        off[2 * i] += residual[2 * i]
        off[2 * i + 1] += residual[2 * i + 1]
        rolled_off[i] += abs(rolled[i])
        piece += rolled_off[i]
    if piece < PIECE * n:
        return
    for i in range(n):
        way[Way.APART] += np.sqrt(off[2 * i] ** 2 + off[2 * i + 1] ** 2)
        off[2 * i], off[2 * i + 1], rolled_off[i] = 0.0, 0.0, 0.0
    way[Way.ROLLED] += piece


@compiled
def wheel_noise(
    n: int, rolled: Floats, heading: Floats, slope: Floats, weights: Floats, noise: Floats, slip: float, h: float,
    smoothed: Floats, by_wheels: Floats, covariance: Floats,
) -> float:  # fmt: skip
    """The twist's ``covariance`` (3, 3), its derivative ``by_wheels`` (3, 2n) by (zeros, radii) and the variance of the wheels' turn
    by counts, which is returned; ``slip`` [m²]: variance of what wheels of weight 1 slip in the interval, others slip more.

    The derivative is ``smoothed``, and of the intervals before: the age of this message is in its own derivative and in what it is
    compared with, and their product would look like a wrong radius.
    """
    new, counts = 1.0 - np.exp(-h / SMOOTHING), 0.0
    for j in range(9):
        covariance[j] = 0.0
    for i in range(n):
        c, s, way, weight = np.cos(heading[i]), np.sin(heading[i]), rolled[i], max(weights[i], SMALLEST)
        along_variance = (noise[Noise.ALONG] ** 2 * abs(way) + slip) / weight
        across_variance = (noise[Noise.ACROSS] ** 2 * abs(way) + slip) / weight
        for row in range(3):
            fx, fy = slope[row * 2 * n + 2 * i], slope[row * 2 * n + 2 * i + 1]
            along, across = fx * c + fy * s, fy * c - fx * s
            for k in range(3):
                gx, gy = slope[k * 2 * n + 2 * i], slope[k * 2 * n + 2 * i + 1]
                covariance[3 * row + k] += along * along_variance * (gx * c + gy * s)
                covariance[3 * row + k] += across * across_variance * (gy * c - gx * s)
            zero, radius = row * 2 * n + i, row * 2 * n + n + i
            by_wheels[zero], by_wheels[radius] = smoothed[zero] * h, smoothed[radius] * h
            smoothed[zero] += new * (-across * way / h - smoothed[zero])
            smoothed[radius] += new * (along * way / h - smoothed[radius])
        counts += slope[4 * n + 2 * i] ** 2 + slope[4 * n + 2 * i + 1] ** 2
    return noise[Noise.READING] ** 2 * counts


@step
def measure(
    hinge: Floats, length: Floats, leg_heading: Floats, slides: Floats, wheel_heading: Floats, n: int, radius: Floats, correction: Floats,
    weights: Floats, before: Floats, now: Floats, twist: Floats, residual: Floats, rolled: Floats, heading: Floats,
    slope: Floats, axes: Floats, moved: Floats, noise: Floats, slip: Floats, slip_mean: Floats, off: Floats,
    rolled_off: Floats, way: Floats, smoothed: Floats, mean: Floats, interval: Floats, by_wheels: Floats,
    covariance: Floats, h: float, turn: float, has_gyro: bool,
) -> None:  # fmt: skip
    """What the wheels say of the interval of ``h`` [s] from ``before`` to ``now``, into ``interval``, ``twist``, ``by_wheels``,
    ``correction`` (at which both are) and ``covariance``."""
    for j in range(2 * n):
        correction[j] = mean[WHEELS + j]
    fit(
        hinge=hinge, length=length, leg_heading=leg_heading, slides=slides, wheel_heading=wheel_heading, n=n, radius=radius,
        correction=correction, weights=weights, before=before, now=now, twist=twist, residual=residual, rolled=rolled,
        heading=heading, slope=slope, axes=axes, moved=moved,
    )  # fmt: skip
    note_contradiction(n, residual, rolled, off, rolled_off, way)
    slips = h * slip_intensity(slip, slip_mean, n, residual, weights, rolled, noise[Noise.SLIP_WINDOW], h)
    counts = wheel_noise(n, rolled, heading, slope, weights, noise, slips, h, smoothed, by_wheels, covariance)
    interval[Interval.H], interval[Interval.TURN], interval[Interval.HAS_GYRO] = h, turn, float(has_gyro)
    interval[Interval.COUNTS] = counts


@compiled
def drive(n: int, mean: Floats, twist: Floats, by_wheels: Floats, correction: Floats, pose: Floats) -> None:
    """Move the pose of ``mean`` by the twist that the wheels give as they are believed to be by now. ``pose`` (12) becomes the
    derivative (3, 3) of the move by the twist, then (3) the move, and last (3) the twist."""
    dx, dy, dyaw = twist[0], twist[1], twist[2]
    for j in range(2 * n):
        known = mean[WHEELS + j] - correction[j]
        dx += by_wheels[j] * known
        dy += by_wheels[2 * n + j] * known
        dyaw += by_wheels[4 * n + j] * known
    yaw = mean[2] + 0.5 * dyaw
    x, y = move(mean, dx, dy, dyaw)
    pose[0], pose[1], pose[2] = np.cos(yaw), -np.sin(yaw), -0.5 * y
    pose[3], pose[4], pose[5] = np.sin(yaw), np.cos(yaw), 0.5 * x
    pose[6], pose[7], pose[8] = 0.0, 0.0, 1.0
    pose[9], pose[10], pose[11] = x, y, dyaw


@compiled
def move_row(n: int, p: Floats, first: int, stride: int, x: float, y: float, by: Floats) -> None:
    """One column (``stride`` = size) or row (``stride`` = 1) of the covariance, from ``first`` on, times the derivative of the state
    by the one before: 1, but for the pose, which turns and depends on the wheels (``by``, (3, 2n)), and for lateness, which ends."""
    a, b = p[first] - y * p[first + 2 * stride], p[first + stride] + x * p[first + 2 * stride]
    c = p[first + 2 * stride]
    for j in range(2 * n):
        wheel = p[first + (WHEELS + j) * stride]
        a += by[j] * wheel
        b += by[2 * n + j] * wheel
        c += by[4 * n + j] * wheel
    p[first], p[first + stride], p[first + 2 * stride], p[first + LATE * stride] = a, b, c, 0.0


@step
def advance(
    n: int, mean: Floats, p: Floats, interval: Floats, twist: Floats, by_wheels: Floats, correction: Floats,
    covariance: Floats, noise: Floats, pose: Floats, by: Floats, spread: Floats, cross: Floats,
) -> None:  # fmt: skip
    """One interval on: the wheels' twist moves the pose, the gyro's turn corrects it and everything behind it. ``mean`` (size) and
    ``p`` (size, size) are the state; ``pose`` (12), ``by`` (3, 2n), ``spread`` (3, 3) and ``cross`` (size) are scratch."""
    size, m, h = WHEELS + 2 * n, 2 * n, interval[Interval.H]
    bias, late_before = mean[BIAS], mean[LATE]
    drive(n, mean, twist, by_wheels, correction, pose)
    x, y, dyaw = pose[9], pose[10], pose[11]
    for row in range(3):
        for j in range(m):
            total = 0.0
            for k in range(3):
                total += pose[3 * row + k] * by_wheels[k * m + j]
            by[row * m + j] = total
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += pose[3 * row + k] * covariance[3 * k + j]
            spread[3 * row + j] = total
    has_gyro = interval[Interval.HAS_GYRO] > 0.0
    rate = interval[Interval.TURN] / h - bias if has_gyro else dyaw / h
    late, behind = (rate * noise[Noise.AGE]) ** 2 + interval[Interval.COUNTS], rate * noise[Noise.MEAN_AGE]
    variance = 0.0
    if has_gyro:
        # what the gyro says less what it should: its bias and noise, the wheels' turn, lateness before and now
        for i in range(size):
            total = h * p[i * size + BIAS] + p[i * size + LATE]
            for j in range(m):
                total += p[i * size + WHEELS + j] * by_wheels[4 * n + j]
            cross[i] = total
        variance = h * cross[BIAS] + cross[LATE] + covariance[8] + late + noise[Noise.GYRO] ** 2 * h
        for j in range(m):
            variance += by_wheels[4 * n + j] * cross[WHEELS + j]
        move_row(n, cross, 0, 1, x, y, by)
        for row in range(3):
            cross[row] += spread[3 * row + 2]
        cross[LATE] = -late
    for i in range(size):
        move_row(n, p, i, size, x, y, by)
    for i in range(size):
        move_row(n, p, i * size, 1, x, y, by)
    for row in range(3):
        for j in range(3):
            for k in range(3):
                p[row * size + j] += spread[3 * row + k] * pose[3 * j + k]
    p[BIAS * size + BIAS] += noise[Noise.GYRO_WALK] ** 2 * h
    p[LATE * size + LATE], mean[LATE] = late, -behind
    if has_gyro:
        wrong = interval[Interval.TURN] - bias * h - late_before - behind - dyaw
        for i in range(size):
            gain = cross[i] / variance
            mean[i] += gain * wrong
            for j in range(size):
                p[i * size + j] -= gain * cross[j]
