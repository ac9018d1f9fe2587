"""The fused odometry's Kalman filter, compiled: its state over one interval of which wheels and gyro say what is in
:mod:`wbmpc.bases.swerve.odometry_step`.

Mathematics and state: :mod:`wbmpc.bases.swerve.odometry_filter`. Matrices are stored by rows.
"""

from __future__ import annotations

import numpy as np

from wbmpc.bases.swerve.compilation import compiled, step
from wbmpc.bases.swerve.odometry_step import AVERAGED, BIAS, LATE, WHEELS, Interval, Noise, Odometry
from wbmpc.bases.swerve.wheel_fit import Wheels, move
from wbmpc.kernel.ir import Floats


@compiled
def drive(w: Wheels, o: Odometry) -> None:
    """Move the pose of ``mean`` by the twist that the wheels give as they are believed to be by now. ``pose`` (12) becomes the
    derivative (3, 3) of the move by the twist, then (3) the move, and last (3) the twist."""
    n, mean, by_wheels, pose = w.n, o.mean, o.by_wheels, o.pose
    dx, dy, dyaw = w.twist[0], w.twist[1], w.twist[2]
    for j in range(2 * n):
        known = mean[WHEELS + j] - w.correction[j]
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


@compiled
def lose(o: Odometry, size: int) -> None:
    """What wheels that slide, or turn no base, add to the covariance of the pose in the interval: the more, the longer their error has
    moved it. Wheels that are found to turn no base have turned none since their contradiction of the gyro began. What they turn otherwise
    than the gyro is averaged: its error has lasted for no less than that."""
    p, interval, lasted = o.p, o.interval, o.lasted
    if interval[Interval.LOST] > 0.0:
        lasted[0] = max(lasted[0], interval[Interval.SINCE]) + interval[Interval.H]
    lasted[0] = min(lasted[0], interval[Interval.SLIDING])
    p[0] += interval[Interval.LOST] * lasted[0]
    p[size + 1] += interval[Interval.LOST] * lasted[0]
    p[2 * size + 2] += interval[Interval.LOST_TURN] * max(lasted[0], AVERAGED * interval[Interval.HAS_GYRO])


@step
def advance(w: Wheels, o: Odometry) -> None:
    """One interval on: the wheels' twist moves the pose, the gyro's turn corrects it and everything behind it."""
    n, mean, p, interval, by_wheels = w.n, o.mean, o.p, o.interval, o.by_wheels
    covariance, noise, pose, by, spread, cross = o.covariance, o.noise, o.pose, o.by, o.spread, o.cross
    size, m, h = WHEELS + 2 * n, 2 * n, interval[Interval.H]
    bias, late_before = mean[BIAS], mean[LATE]
    drive(w, o)
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
    lose(o, size)
    p[BIAS * size + BIAS] += noise[Noise.GYRO_WALK] ** 2 * h
    p[LATE * size + LATE], mean[LATE] = late, -behind
    if has_gyro:
        wrong = interval[Interval.TURN] - bias * h - late_before - behind - dyaw
        # with a gain of 0 for what is not learned (Schmidt): of the covariance only the block of what has none stays
        freezes = interval[Interval.FREEZES] > 0.0
        for i in range(size):
            gain, stays = cross[i] / variance, freezes and (i == BIAS or i >= WHEELS)
            if not stays:
                mean[i] += gain * wrong
            for j in range(size):
                if not stays or (j < BIAS or j == LATE):
                    p[i * size + j] -= gain * cross[j]
