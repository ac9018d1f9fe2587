"""The fused odometry from one message to the next, compiled: what wheels and gyro say of the interval.

The filter's step over it: :mod:`wbmpc.bases.swerve.kalman_step`; mathematics and state: :mod:`wbmpc.bases.swerve.odometry_filter`. Matrices
are stored by rows.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from wbmpc.bases.swerve.compilation import compiled, step
from wbmpc.bases.swerve.slip_step import slip_intensity
from wbmpc.bases.swerve.wheel_fit import Wheels, fit
from wbmpc.kernel.ir import Floats

#: Time constant [s] of the derivatives of the twist by the wheels' corrections. Contradictions of the wheels are added up over pieces of
#: way [m] of a length in which the counts of encoders cancel.
SMOOTHING, PIECE = 0.05, 0.05
#: Weights of wheels below this count as this in their variances: without a weight a wheel has no share.
SMALLEST = 1e-9
#: Standard deviation [m/√s] of a velocity by an inertial unit: 0.02 m/s that last for 0.3 s.
COASTING = 0.01
#: Wheels that contradict each other, or the gyro, by more than this [m/s], averaged over so long [s], for longer than this [s], slide: no noise
#: of each interval, but an error that adds up, until they have contradicted each other less for as long.
SLIDES, AVERAGED, BRIEF = 0.05, 0.1, 0.5
#: Standard deviation of the base's velocity then, as a share of the contradiction: by the wheels, and with an inertial unit's velocity. Of
#: its turn where a gyro contradicts them it is all of it: the base may be held, or the gyro be stuck.
UNSURE, COASTS = 0.7, 0.15
#: Wheels that turn otherwise than the gyro by so many standard deviations, averaged over AVERAGED, teach nothing, nor until BRIEF after it.
#: Below this [m/s] at the wheels, and for less than BRIEF, they slip on bumps: a wheel of radius r that meets an edge of height b turns
#: about it, its axis goes up at an angle of cosine 1 - b/r to the floor, and so it rolls faster than its base goes, by b/r: for 0.1 m,
#: a cable of 10 mm and 0.36 m/s by 0.036 m/s. Else they turn no base, nor until BRIEF after it.
#: Standard deviations of a turn [rad/s] by creep of tires, and by wheels that turn no base.
OTHERWISE, SLIPS, CREEP, UNKNOWN_TURN = 4.0, 0.036, 1.5e-3, 1.0
#: Places of gyro bias and lateness in the state; from WHEELS on the corrections of the wheels.
BIAS, LATE, WHEELS = 3, 4, 5


class Noise(IntEnum):
    """Entries of the array ``noise``: the fields of :class:`wbmpc.bases.swerve.odometry_filter.OdometryNoise`."""

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
    LOST = 4  # variance [m²] that wheels which slide add to each component of the pose for each second that their error has lasted
    LOST_TURN = 5  # and [rad²] to the yaw, where no gyro sees it or wheels contradict it
    SLIDING = 6  # for how long [s] wheels have slid, or turned no base
    FREEZES = 7  # 1 where wheels and gyro contradict each other, and until BRIEF after it: the gyro shows neither its bias nor zeros and radii
    SINCE = 8  # where wheels are found to turn no base: for how long [s] before the interval they may have turned none; else 0
    SIZE = 9


class Way(IntEnum):
    """Entries of the array ``way``: sums over the whole drive [m]."""

    APART = 0
    ROLLED = 1
    SIZE = 2


class Otherwise(IntEnum):
    """Entries of the array ``otherwise``."""

    OFF = 0  # rate [rad/s] of the gyro less that of the wheels, averaged
    REMAINING = 1  # for how long [s] wheels still turn no base, and the turn is the gyro's
    LOST = 2  # what the contradiction may have turned the base in the interval: its variance [rad²/s], for each second that it has lasted
    LASTED = 3  # how long ago [s] the contradiction began; 0 without one
    FROZEN = 4  # for how long [s] still nothing is learned
    SIZE = 5


class Odometry(NamedTuple):
    """The filter of n wheels: its state of ``size`` 5 + 2n, the last interval and what it remembers; matrices by rows."""

    mean: Floats  # (size)
    p: Floats  # (size, size)
    lasted: Floats  # (1) [s], for how long the error of wheels that slide has moved the pose; global poses shorten it
    interval: Floats  # Interval
    by_wheels: Floats  # (3, 2n), the twist's derivative by zeros and radii
    covariance: Floats  # (3, 3), of the twist
    noise: Floats  # Noise
    slip: Floats  # wbmpc.bases.swerve.slip_step.Slip
    slip_mean: Floats  # (windows, n, 2)
    off: Floats  # (n, 2) [m], contradictions in the present piece of way
    rolled_off: Floats  # (n) [m], and what wheels rolled in it
    way: Floats  # Way
    apart: Floats  # (n, 2) [m/s], contradictions of wheels and gyro, averaged; for how long [s] they have been large; and now small
    otherwise: Floats  # Otherwise
    smoothed: Floats  # (3, 2n), derivatives of the twist's rate, averaged
    pose: Floats  # derivative (3, 3) of the move by the twist, then the move (3)
    by: Floats  # (3, 2n), of the move by the wheels; scratch
    inertial: Floats  # velocity (2) [m/s] by an inertial unit, and its weight beside the wheels'
    spread: Floats  # (3, 3), scratch
    cross: Floats  # (size), scratch


@step
def farthest(n: int, before: Floats, now: Floats) -> float:
    """How far [rad] the wheel turned that turned most."""
    angle = 0.0
    for i in range(2 * n, 3 * n):
        angle = max(angle, abs(now[i] - before[i]))
    return angle


@compiled
def note_contradiction(w: Wheels, o: Odometry) -> None:
    """Add an interval to the present piece of way: ``off`` (n, 2) and ``rolled_off`` (n) [m], as far as wheels count."""
    n, residual, off, rolled_off, piece = w.n, w.residual, o.off, o.rolled_off, 0.0
    for i in range(n):
        off[2 * i] += w.weights[i] * residual[2 * i]
        off[2 * i + 1] += w.weights[i] * residual[2 * i + 1]
        rolled_off[i] += w.weights[i] * abs(w.rolled[i])
        piece += rolled_off[i]
    if piece < PIECE * n:
        return
    for i in range(n):
        o.way[Way.APART] += np.sqrt(off[2 * i] ** 2 + off[2 * i + 1] ** 2)
        off[2 * i], off[2 * i + 1], rolled_off[i] = 0.0, 0.0, 0.0
    o.way[Way.ROLLED] += piece


@compiled
def wheel_noise(w: Wheels, o: Odometry, slips: float, h: float) -> float:
    """The twist's ``covariance`` (3, 3), its derivative ``by_wheels`` (3, 2n) by (zeros, radii) and the variance of the wheels' turn
    by counts, which is returned; ``slips`` [m²]: variance of what wheels of weight 1 slip in the interval, others slip more.

    The derivative is ``smoothed``, and of the intervals before: the age of this message is in its own derivative and in what it is
    compared with, and their product would look like a wrong radius.
    """
    n, heading, slope, noise = w.n, w.heading, w.slope, o.noise
    smoothed, by_wheels, covariance = o.smoothed, o.by_wheels, o.covariance
    new, counts = 1.0 - np.exp(-h / SMOOTHING), 0.0
    for j in range(9):
        covariance[j] = 0.0
    for i in range(n):
        c, s, way, weight = np.cos(heading[i]), np.sin(heading[i]), w.rolled[i], max(w.weights[i], SMALLEST)
        along_variance = (noise[Noise.ALONG] ** 2 * abs(way) + slips) / weight
        across_variance = (noise[Noise.ACROSS] ** 2 * abs(way) + slips) / weight
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


@compiled
def middle(w: Wheels) -> tuple[float, float]:
    """Of the wheels' axes by their weights [m]."""
    total, mx, my = 0.0, 0.0, 0.0
    for i in range(w.n):
        total += w.weights[i]
        mx += w.weights[i] * w.axes[2 * i]
        my += w.weights[i] * w.axes[2 * i + 1]
    return mx / total, my / total


@compiled
def turn_variance(w: Wheels, o: Odometry, h: float, rate: float) -> float:
    """Variance [rad²/s²] of what the averaged rates of gyro and wheels may differ by at a ``rate`` [rad/s]: by the gyro and its bias, by
    zeros and radii, by what the wheels' way is uncertain, by lateness, whose differences cancel, and by creep."""
    p, noise, by, size = o.p, o.noise, o.by_wheels, WHEELS + 2 * w.n
    variance = p[BIAS * size + BIAS] + CREEP**2
    for j in range(2 * w.n):
        row = (WHEELS + j) * size
        total = 2.0 * p[row + BIAS]
        for k in range(2 * w.n):
            total += p[row + WHEELS + k] * by[4 * w.n + k] / h
        variance += total * by[4 * w.n + j] / h
    late = (rate * noise[Noise.AGE]) ** 2 + o.interval[Interval.COUNTS]
    return variance + (o.covariance[8] / h + noise[Noise.GYRO] ** 2) / (2.0 * AVERAGED) + late / AVERAGED**2


@compiled
def count_down(o: Odometry, h: float) -> None:
    """Move the times of ``otherwise`` on by ``h`` [s], whether a gyro says something or not. A contradiction ends with its freeze: one that
    noise hides now and then lasts."""
    otherwise = o.otherwise
    otherwise[Otherwise.REMAINING] = max(otherwise[Otherwise.REMAINING] - h, 0.0)
    otherwise[Otherwise.FROZEN] = max(otherwise[Otherwise.FROZEN] - h, 0.0)
    if otherwise[Otherwise.LASTED] > 0.0:
        otherwise[Otherwise.LASTED] += h
        if otherwise[Otherwise.FROZEN] == 0.0:
            otherwise[Otherwise.LASTED] = 0.0
            otherwise[Otherwise.OFF] *= o.interval[Interval.HAS_GYRO]  # without a gyro nothing shows what it has become


@compiled
def turns_no_base(w: Wheels, o: Odometry, h: float, more: float) -> bool:
    """Whether wheels say so that turned by ``more`` [rad] less than the gyro. Where they contradict it by more than either is uncertain it is
    no error of radii, zeros or bias, which last: what is known of them freezes from the first moment on until BRIEF after it. But a
    contradiction that is small and brief is one of wheels on bumps, whose turn counts as far as it is certain. One to the other side is
    another one."""
    otherwise, square, before = o.otherwise, 0.0, o.otherwise[Otherwise.OFF]
    otherwise[Otherwise.OFF] += (1.0 - np.exp(-h / AVERAGED)) * (more / h - otherwise[Otherwise.OFF])
    off = otherwise[Otherwise.OFF]
    if off * before < 0.0:
        otherwise[Otherwise.LASTED] = 0.0
    if off**2 <= OTHERWISE**2 * turn_variance(w, o, h, (w.twist[2] + more) / h):
        return False
    otherwise[Otherwise.FROZEN], otherwise[Otherwise.LASTED] = BRIEF, max(otherwise[Otherwise.LASTED], h)
    mx, my = middle(w)
    for i in range(w.n):
        square += ((w.axes[2 * i] - mx) ** 2 + (w.axes[2 * i + 1] - my) ** 2) / w.n
    bumps = off**2 * square < SLIPS**2 and otherwise[Otherwise.LASTED] < BRIEF
    return not bumps or otherwise[Otherwise.REMAINING] > 0.0


@compiled
def follow_gyro(w: Wheels, o: Odometry, h: float) -> None:
    """Where the wheels turn otherwise than the gyro, by more than they do on bumps, as on blocks or where something holds the base: the
    turn is the gyro's, about the middle of the wheels, and shows neither radii nor bias. All of it is in the interval, for a replay. Wheels
    that roll straight ahead on blocks contradict no gyro, and gently started no accelerometer: nothing shows that the base stands."""
    interval, otherwise, twist = o.interval, o.otherwise, w.twist
    count_down(o, h)
    otherwise[Otherwise.LOST], interval[Interval.SINCE], interval[Interval.FREEZES] = 0.0, 0.0, 0.0
    if interval[Interval.HAS_GYRO] == 0.0:
        return
    more = interval[Interval.TURN] - o.mean[BIAS] * h - twist[2]
    if turns_no_base(w, o, h, more):
        if otherwise[Otherwise.REMAINING] == 0.0:
            # an average that began just now is, times AVERAGED, the turn by then
            interval[Interval.SINCE] = otherwise[Otherwise.LASTED] - h
            otherwise[Otherwise.LOST] = otherwise[Otherwise.OFF] ** 2 * max(otherwise[Otherwise.LASTED], AVERAGED)
        otherwise[Otherwise.REMAINING] = BRIEF
    interval[Interval.FREEZES] = float(otherwise[Otherwise.FROZEN] > 0.0)
    by_gyro = otherwise[Otherwise.REMAINING] > 0.0
    if not by_gyro and interval[Interval.FREEZES] == 0.0:
        return
    # an error of a rate that lasts is, over longer, noise of this variance
    variance = (UNKNOWN_TURN * h) ** 2 if by_gyro else 2.0 * otherwise[Otherwise.OFF] ** 2 * AVERAGED * h
    mx, my = middle(w)
    by = o.cross  # scratch
    by[0], by[1], by[2] = my, -mx, 1.0
    for row in range(3):
        for k in range(3):
            o.covariance[3 * row + k] += variance * by[row] * by[k]
    if not by_gyro:
        return
    if otherwise[Otherwise.LOST] == 0.0:
        otherwise[Otherwise.LOST] = 2.0 * max(otherwise[Otherwise.OFF] * more, 0.0)
    for row in range(3):
        twist[row] += more * by[row]
    for j in range(6 * w.n):
        o.by_wheels[j] = 0.0


@compiled
def coast(w: Wheels, o: Odometry, h: float) -> None:
    """Mix what the wheels say of an interval of ``h`` [s] with the velocity of an inertial unit, by their weights."""
    own, total = o.inertial[2], o.inertial[2]
    if own <= 0.0:
        return
    for i in range(w.n):
        total += w.weights[i]
    share = 1.0 - own / total
    for j in range(2):
        w.twist[j] = share * w.twist[j] + (1.0 - share) * h * o.inertial[j]
        for k in range(2 * w.n):
            o.by_wheels[2 * w.n * j + k] *= share
        for k in range(3):
            o.covariance[3 * j + k] *= share
            o.covariance[3 * k + j] *= share
        o.covariance[4 * j] += ((1.0 - share) * COASTING) ** 2 * h


@compiled
def slide(w: Wheels, o: Odometry, h: float, more: float) -> None:
    """What wheels add to the uncertainty that have contradicted each other, or the gyro (by ``more`` [rad]), for long, and still do: the
    longer, the more in each interval; where the turn is the gyro's, from the first moment on. A wheel that counts little is none, but one of two."""
    n, apart, interval, covariance = w.n, o.apart, o.interval, o.covariance
    top, total, arm = SMALLEST, 0.0, 0.0
    for i in range(n):
        top, total = max(top, w.weights[i]), total + w.weights[i]
    mx, my = middle(w)
    has_gyro = interval[Interval.HAS_GYRO] > 0.0
    new, square, freedoms = 1.0 - np.exp(-h / AVERAGED), 0.0, -2.0 if has_gyro else -3.0
    for i in range(n):
        x, y = w.axes[2 * i] - mx, w.axes[2 * i + 1] - my
        share = w.weights[i] / top if total > 1.5 * top else 1.0
        apart[2 * i] += new * ((w.residual[2 * i] - more * y) / h - apart[2 * i])
        apart[2 * i + 1] += new * ((w.residual[2 * i + 1] + more * x) / h - apart[2 * i + 1])
        square += share * (apart[2 * i] ** 2 + apart[2 * i + 1] ** 2)
        freedoms += 2.0 * share
        arm += (x * x + y * y) / n
    square /= max(freedoms, 1.0)
    by_gyro = o.otherwise[Otherwise.REMAINING] > 0.0
    large = by_gyro or square > SLIDES**2
    already = max(apart[2 * n], BRIEF + interval[Interval.SINCE] if by_gyro else 0.0)
    apart[2 * n] = already + h if large else max(apart[2 * n] - h, 0.0)
    apart[2 * n + 1] = 0.0 if large else apart[2 * n + 1] + h
    if apart[2 * n + 1] > BRIEF:
        apart[2 * n] = 0.0
    interval[Interval.SLIDING] = max(apart[2 * n] - BRIEF, 0.0)
    interval[Interval.LOST], interval[Interval.LOST_TURN] = 0.0, 0.0
    if large and interval[Interval.SLIDING] > 0.0:
        square *= (COASTS if o.inertial[2] > 0.0 else UNSURE) ** 2
        if by_gyro:  # a way along a heading that is off by e is too long by its share 1 - cos e, of which derivatives know nothing
            off = 0.5 * o.p[2 * (WHEELS + 2 * n) + 2] / h
            square += min(off * off, 1.5 / (h * h)) * (w.twist[0] ** 2 + w.twist[1] ** 2)
        # an error v of the velocity has moved the base by v t: what its variance grows by, but for t; from 0 on where it is found
        since = interval[Interval.SINCE]
        interval[Interval.LOST] = square * (since + h if since > 0.0 else 2.0 * h)
        interval[Interval.LOST_TURN] = o.otherwise[Otherwise.LOST] if has_gyro else interval[Interval.LOST] / arm
        covariance[0] += square * h * h
        covariance[4] += square * h * h


@step
def measure(w: Wheels, o: Odometry, h: float, turn: float, has_gyro: bool) -> None:
    """What the wheels say of the interval of ``h`` [s] from ``before`` to ``now``, into ``interval``, ``twist``, ``by_wheels``,
    ``correction`` (at which both are) and ``covariance``."""
    for j in range(2 * w.n):
        w.correction[j] = o.mean[WHEELS + j]
    fit(w)
    note_contradiction(w, o)
    window, interval = o.noise[Noise.SLIP_WINDOW], o.interval
    slips = h * slip_intensity(o.slip, o.slip_mean, w.n, w.residual, w.weights, w.rolled, window, h)
    interval[Interval.COUNTS] = wheel_noise(w, o, slips, h)
    interval[Interval.H], interval[Interval.TURN], interval[Interval.HAS_GYRO] = h, turn, float(has_gyro)
    more = w.twist[2] - turn + o.mean[BIAS] * h if has_gyro else 0.0
    follow_gyro(w, o, h)
    coast(w, o, h)
    slide(w, o, h, more)
