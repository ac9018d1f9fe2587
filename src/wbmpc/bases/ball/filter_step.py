"""The ball filter's step, compiled: the next state, residuals and their slopes, and how an error moves a state.

What it does and why: :class:`wbmpc.bases.ball.filter.BallFilter`. The arrays are in :class:`Filter`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.constants import GRAVITY
from wbmpc.kernel.ir import Floats

PI = float(np.pi)


class State(IntEnum):
    """Entries of a state: what :class:`~wbmpc.bases.ball.filter_state.BallState` has."""

    POSITION = 0
    VELOCITY = 3
    ROTATION = 6
    GYRO_BIAS = 15
    ACCEL_BIAS = 18
    SCALE = 21
    WHEEL = 22


class Error(IntEnum):
    """Entries of an error."""

    POSITION = 0
    VELOCITY = 3
    ATTITUDE = 6
    GYRO_BIAS = 9
    ACCEL_BIAS = 12
    SCALE = 15
    WHEEL = 16


class Row(IntEnum):
    """Where residuals begin."""

    TURNING = 0
    PUSH = 3
    SHIFT = 6
    WALKS = 9
    SCALE = 15
    ROLLING = 16


class Noise(IntEnum):
    """Entries of the array ``noise``: fields of :class:`~wbmpc.bases.ball.filter_state.BallNoise`."""

    GYRO = 0
    ACCEL = 1
    GYRO_WALK = 2
    ACCEL_WALK = 3
    ENCODER = 4
    AGE = 5
    JITTER = 6
    CREEP = 7
    SPIN = 8
    CREEPING = 9
    FLOOR = 10
    PATH = 11
    SCALE = 12
    SCALE_TIME = 13
    CHANGE = 14


class Filter(NamedTuple):
    """What the filter works on: n wheels, errors of ``size`` 16 + n, m = 17 + 2n rows; matrices by rows."""

    n: int
    radius: float  # of the ball [m]
    x: Floats  # State: the older one
    y: Floats  # the guess of the newer one, where residuals are linearized
    z: Floats  # the newer one
    gyro: Floats  # (3) [rad/s] of the message
    accel: Floats  # (3) [m/s²]
    wheel: Floats  # (n) [rad]
    mount: Floats  # (3) [m], from the base's origin to the inertial unit
    wheels: Floats  # (n, 3), from the ball's turning to the wheels'
    noise: Floats  # Noise
    turn: Floats  # (3) [rad], by the gyro
    turned: Floats  # (3, 3), its rotation
    half: Floats  # (3, 3), half of it
    middle: Floats  # (3, 3), the base in the middle of the interval
    after: Floats  # (3, 3), and at its end
    shift: Floats  # (3) [m]
    pushed: Floats  # (3) [rad], the ball's turning by the shift, in base axes
    slip: Floats  # (n, 3), the wheels' directions in the world
    p: Floats  # (size, size), covariance of the older state's error
    jx: Floats  # (m, size), slopes of the residuals by the older state's error
    jy: Floats  # (m, size), by the newer state's
    q: Floats  # (m, m), covariance of their noise
    r: Floats  # (m), residuals
    moved: Floats  # (m, size), scratch
    root: Floats  # (m, m), Cholesky factor of the residuals' covariance
    w: Floats  # (m, size + 1), whitened slopes by the newer state, and residuals
    a: Floats  # (size, size), information
    inverse: Floats  # (size, size), scratch
    slope: Floats  # (size), of the cost
    error: Floats  # (size), of the newer state
    covariance: Floats  # (size, size)
    best_error: Floats  # the same under the mildest explanation
    best_covariance: Floats
    plain: Floats  # (n, n), the rolling rows' covariance without a fault
    spin: Floats  # (n), the wheels' turning by a ball that spins about the vertical
    stalled: Floats  # (n), 1 for wheels whose rows count for nothing
    read: Floats  # (n) [rad], what encoders read when they last moved
    way: Floats  # (n) [rad], what their wheels must have turned since
    gone: Floats  # (n) [rad], what wheels turned in the interval
    rate: Floats  # (3) [rad/s], of the base by the last message that counted


@compiled
def rotation_of(x: float, y: float, z: float, r: Floats) -> None:
    """Rotation matrix of a rotation vector [rad] (Rodrigues)."""
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    a, b = 1.0 - square / 6.0, 0.5
    if angle > 1e-4:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    r[0], r[1], r[2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    r[3], r[4], r[5] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    r[6], r[7], r[8] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)


@compiled
def turned_by(x: Floats, r: Floats, out: Floats) -> None:
    """The rotation of a state times ``r`` (3, 3)."""
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += x[State.ROTATION + 3 * i + k] * r[3 * k + j]
            out[3 * i + j] = total


@compiled
def by_skew(a: float, b: float, c: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A row (a, b, c) times the matrix of (x, y, z) ×."""
    return b * z - c * y, c * x - a * z, a * y - b * x


@compiled
def integrate(f: Filter, h: float) -> None:
    """The state ``y`` after ``x`` by strapdown integration and rolling: where the residuals are linearized. ``pushed`` (3): turning of
    the ball by the way ``shift``, in base axes."""
    n, x, y, gyro, accel, mount, wheels, turn = f.n, f.x, f.y, f.gyro, f.accel, f.mount, f.wheels, f.turn
    turned = f.turned
    half, middle, after, shift, pushed = f.half, f.middle, f.after, f.shift, f.pushed
    for i in range(3):
        turn[i] = h * (gyro[i] - x[State.GYRO_BIAS + i])
    rotation_of(turn[0], turn[1], turn[2], turned)
    rotation_of(0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2], half)
    turned_by(x, half, middle)
    turned_by(x, turned, after)
    for i in range(State.WHEEL + n):
        y[i] = x[i]
    y[State.VELOCITY + 2] -= h * GRAVITY
    for i in range(3):
        v = State.VELOCITY + i
        for j in range(3):
            y[State.ROTATION + 3 * i + j] = after[3 * i + j]
            y[v] += h * middle[3 * i + j] * (accel[j] - x[State.ACCEL_BIAS + j])
        way = 0.5 * h * (x[v] + y[v])
        for j in range(3):
            way -= (after[3 * i + j] - x[State.ROTATION + 3 * i + j]) * mount[j]
        shift[i] = way
        y[State.POSITION + i] += way
    factor = np.exp(-x[State.SCALE])
    for i in range(3):
        pushed[i] = (middle[3 + i] * shift[0] - middle[i] * shift[1]) / f.radius
    for i in range(n):
        for j in range(3):
            y[State.WHEEL + i] += factor * wheels[3 * i + j] * (pushed[j] - turn[j])


@compiled
def inertial_rows(f: Filter, h: float) -> None:
    """Turning, push and shift, which are zero at the guess; walks of the biases, and the scale."""
    n, x, after, accel, mount, noise, turned = f.n, f.x, f.after, f.accel, f.mount, f.noise, f.turned
    middle, jx = f.middle, f.jx
    jy, q = f.jy, f.q
    size, m = 16 + n, 17 + 2 * n
    ax, ay, az = (
        accel[0] - x[State.ACCEL_BIAS], accel[1] - x[State.ACCEL_BIAS + 1], accel[2] - x[State.ACCEL_BIAS + 2],
    )  # fmt: skip
    for i in range(3):
        # Log(Rxᵀ Ry) − h (gyro − bias)
        row = (Row.TURNING + i) * size
        jy[row + Error.ATTITUDE + i], jx[row + Error.GYRO_BIAS + i] = 1.0, h
        for j in range(3):
            jx[row + Error.ATTITUDE + j] = -turned[3 * j + i]
        q[(Row.TURNING + i) * (m + 1)] = noise[Noise.GYRO] ** 2 * h
        # vy − vx − h (R (accel − bias) − g)
        row = (Row.PUSH + i) * size
        jy[row + Error.VELOCITY + i], jx[row + Error.VELOCITY + i] = 1.0, -1.0
        a, b, c = by_skew(middle[3 * i], middle[3 * i + 1], middle[3 * i + 2], ax, ay, az)
        jx[row + Error.ATTITUDE], jx[row + Error.ATTITUDE + 1], jx[row + Error.ATTITUDE + 2] = h * a, h * b, h * c
        for j in range(3):
            jx[row + Error.ACCEL_BIAS + j] = h * middle[3 * i + j]
        q[(Row.PUSH + i) * (m + 1)] = noise[Noise.ACCEL] ** 2 * h
        # py − px − h/2 (vx + vy) + (Ry − Rx) mount
        row = (Row.SHIFT + i) * size
        jy[row + Error.POSITION + i], jx[row + Error.POSITION + i] = 1.0, -1.0
        jy[row + Error.VELOCITY + i], jx[row + Error.VELOCITY + i] = -0.5 * h, -0.5 * h
        a, b, c = by_skew(after[3 * i], after[3 * i + 1], after[3 * i + 2], mount[0], mount[1], mount[2])
        jy[row + Error.ATTITUDE], jy[row + Error.ATTITUDE + 1], jy[row + Error.ATTITUDE + 2] = -a, -b, -c
        k = State.ROTATION + 3 * i
        a, b, c = by_skew(x[k], x[k + 1], x[k + 2], mount[0], mount[1], mount[2])
        jx[row + Error.ATTITUDE], jx[row + Error.ATTITUDE + 1], jx[row + Error.ATTITUDE + 2] = a, b, c
        q[(Row.SHIFT + i) * (m + 1)] = noise[Noise.PATH] ** 2
    for i in range(6):
        row = (Row.WALKS + i) * size + Error.GYRO_BIAS + i
        jy[row], jx[row] = 1.0, -1.0
        walk = noise[Noise.GYRO_WALK] if i < 3 else noise[Noise.ACCEL_WALK]
        q[(Row.WALKS + i) * (m + 1)] = walk**2 * h
    kept = np.exp(-h / noise[Noise.SCALE_TIME])
    f.r[Row.SCALE] = (1.0 - kept) * x[State.SCALE]
    jy[Row.SCALE * size + Error.SCALE], jx[Row.SCALE * size + Error.SCALE] = 1.0, -kept
    q[Row.SCALE * (m + 1)] = noise[Noise.SCALE] ** 2 * (1.0 - kept**2)


@compiled
def rolling_rows(f: Filter, h: float, torque: float) -> None:
    """Wheel increments − turn · (ball's turning − base's), zero at the guess; encoders, what they read was true a little before; and
    the floor. ``torque`` [N m]: what lasts about the vertical."""
    n, x, y, wheels, noise, turned, middle, pushed = f.n, f.x, f.y, f.wheels, f.noise, f.turned, f.middle, f.pushed
    slip = f.slip
    jx, jy, q, r = f.jx, f.jy, f.q, f.r
    size, m, factor = 16 + n, 17 + 2 * n, np.exp(-x[State.SCALE])
    spin = noise[Noise.SPIN] ** 2 + (noise[Noise.CREEPING] * torque) ** 2
    for i in range(n):
        row, t = (Row.ROLLING + i) * size, 3 * i
        fx, fy, fz = factor * wheels[t], factor * wheels[t + 1], factor * wheels[t + 2]
        jy[row + Error.WHEEL + i], jx[row + Error.WHEEL + i] = 1.0, -1.0
        along = (fx * middle[3] + fy * middle[4] + fz * middle[5]) / f.radius
        across = -(fx * middle[0] + fy * middle[1] + fz * middle[2]) / f.radius
        jy[row + Error.POSITION], jy[row + Error.POSITION + 1] = -along, -across
        jx[row + Error.POSITION], jx[row + Error.POSITION + 1] = along, across
        a, b, c = by_skew(fx, fy, fz, 0.5 * pushed[0], 0.5 * pushed[1], 0.5 * pushed[2])
        k = row + Error.ATTITUDE
        jy[k], jy[k + 1], jy[k + 2] = fx - a, fy - b, fz - c
        jx[k] = -a - (fx * turned[0] + fy * turned[1] + fz * turned[2])
        jx[k + 1] = -b - (fx * turned[3] + fy * turned[4] + fz * turned[5])
        jx[k + 2] = -c - (fx * turned[6] + fy * turned[7] + fz * turned[8])
        jx[row + Error.SCALE] = (
            fx * (pushed[0] - f.turn[0]) + fy * (pushed[1] - f.turn[1]) + fz * (pushed[2] - f.turn[2])
        )
        for k in range(3):
            slip[t + k] = (
                wheels[t] * middle[3 * k] + wheels[t + 1] * middle[3 * k + 1] + wheels[t + 2] * middle[3 * k + 2]
            )
    for i in range(n):
        row, e = (Row.ROLLING + n + i) * size, Row.ROLLING + n + i
        speed, age = (y[State.WHEEL + i] - x[State.WHEEL + i]) / h, noise[Noise.AGE]
        r[e] = y[State.WHEEL + i] - age * speed - f.wheel[i]
        jy[row + Error.WHEEL + i], jx[row + Error.WHEEL + i] = 1.0 - age / h, age / h
        for j in range(n):
            level = slip[3 * i] * slip[3 * j] + slip[3 * i + 1] * slip[3 * j + 1]
            upright = slip[3 * i + 2] * slip[3 * j + 2]
            q[(Row.ROLLING + i) * m + Row.ROLLING + j] = h * (noise[Noise.CREEP] ** 2 * level + spin * upright)
            other = (y[State.WHEEL + j] - x[State.WHEEL + j]) / h
            q[e * m + Row.ROLLING + n + j] = noise[Noise.JITTER] ** 2 * speed * other
        q[e * m + e] += noise[Noise.ENCODER] ** 2
    r[m - 1], jy[(m - 1) * size + Error.POSITION + 2] = y[State.POSITION + 2], 1.0
    q[m * m - 1] = noise[Noise.FLOOR] ** 2


@step
def linearize(f: Filter, h: float, torque: float, gyro_more: float, accel_more: float) -> None:
    """The guess ``y`` after ``x``, residuals ``r`` between the two, their slopes ``jx`` and ``jy`` by the errors of both, and the
    covariance ``q`` of their noise; ``gyro_more`` [rad²], ``accel_more`` [m²/s²]: more variance of turning and push."""
    n, jx, jy, q, r = f.n, f.jx, f.jy, f.q, f.r
    size, m = 16 + n, 17 + 2 * n
    for i in range(m):
        r[i] = 0.0
    for i in range(m * size):
        jx[i], jy[i] = 0.0, 0.0
    for i in range(m * m):
        q[i] = 0.0
    integrate(f, h)
    inertial_rows(f, h)
    rolling_rows(f, h, torque)
    for i in range(3):
        q[(Row.TURNING + i) * (m + 1)] += gyro_more
        q[(Row.PUSH + i) * (m + 1)] += accel_more


@compiled
def apply(f: Filter) -> None:
    """The state ``z`` is ``y`` with the ``best_error``."""
    y, z, error, after = f.y, f.z, f.best_error, f.after
    rotation_of(error[Error.ATTITUDE], error[Error.ATTITUDE + 1], error[Error.ATTITUDE + 2], f.turned)
    turned_by(y, f.turned, after)
    for i in range(3):
        z[State.POSITION + i] = y[State.POSITION + i] + error[Error.POSITION + i]
        z[State.VELOCITY + i] = y[State.VELOCITY + i] + error[Error.VELOCITY + i]
        z[State.GYRO_BIAS + i] = y[State.GYRO_BIAS + i] + error[Error.GYRO_BIAS + i]
        z[State.ACCEL_BIAS + i] = y[State.ACCEL_BIAS + i] + error[Error.ACCEL_BIAS + i]
    for i in range(9):
        z[State.ROTATION + i] = after[i]
    z[State.SCALE] = y[State.SCALE] + error[Error.SCALE]
    for i in range(f.n):
        z[State.WHEEL + i] = y[State.WHEEL + i] + error[Error.WHEEL + i]


@compiled
def detect_stalled(f: Filter, still: float, largest_step: float) -> None:
    """An encoder that stays within ``still`` [rad] of what it ``read`` (one may flicker by a count) while its wheel must have turned
    by ``largest_step`` [rad] since: ``way`` being by how much, ``gone`` (n) [rad] what the last interval gives to it."""
    wheel, read, way, stalled = f.wheel, f.read, f.way, f.stalled
    for i in range(f.n):
        if abs(wheel[i] - read[i]) > still:
            way[i], stalled[i], read[i] = 0.0, 0.0, wheel[i]
        else:
            way[i] += f.gone[i]
            stalled[i] = 1.0 if abs(way[i]) > largest_step else 0.0


@compiled
def advance(f: Filter, still: float, largest_step: float) -> None:
    """:func:`accept`, the ``rate`` (3) [rad/s] of the base by the last message that counted, and :func:`detect_stalled`."""
    accept(f)
    for i in range(3):
        f.rate[i] = f.gyro[i] - f.x[State.GYRO_BIAS + i]
    detect_stalled(f, still, largest_step)


@compiled
def accept(f: Filter) -> None:
    """The newer state ``z`` becomes the older one, ``x`` and ``p``; ``gone`` (n) [rad]: what the wheels turned between them."""
    n, x, y = f.n, f.x, f.y
    for i in range(n):
        f.gone[i] = y[State.WHEEL + i] - x[State.WHEEL + i]
    for i in range(State.WHEEL + n):
        x[i] = f.z[i]
    for i in range((16 + n) * (16 + n)):
        f.p[i] = f.best_covariance[i]


@step
def minimal_state(
    m: int, x: Floats, rate: Floats, mount: Floats, angle: Floats, joint_rate: Floats, yaw: Floats, out: Floats
) -> None:
    """The state ``out`` of the minimal model: (x, y, yaw, pitch, roll, m joints) and their rates, of a filter's ``x``, the base's
    ``rate`` (3) [rad/s] and joints. ``yaw`` (1) [rad] is not wrapped: it goes on from the last one."""
    r = State.ROTATION
    pitch = np.arcsin(min(max(-x[r + 6], -1.0), 1.0))
    roll = np.arctan2(x[r + 7], x[r + 8])
    turned = np.arctan2(x[r + 3], x[r]) - yaw[0] + PI
    yaw[0] += turned - 2.0 * PI * np.floor(turned / (2.0 * PI)) - PI
    s, c, cp, sp = np.sin(roll), np.cos(roll), np.cos(pitch), np.sin(pitch)
    yaw_rate = (s * rate[1] + c * rate[2]) / cp
    ax = rate[1] * mount[2] - rate[2] * mount[1]
    ay = rate[2] * mount[0] - rate[0] * mount[2]
    az = rate[0] * mount[1] - rate[1] * mount[0]
    out[0], out[1] = x[State.POSITION], x[State.POSITION + 1]
    out[2], out[3], out[4] = yaw[0], pitch, roll
    v = 5 + m
    for i in range(2):
        out[v + i] = x[State.VELOCITY + i] - (x[r + 3 * i] * ax + x[r + 3 * i + 1] * ay + x[r + 3 * i + 2] * az)
    out[v + 2], out[v + 3], out[v + 4] = yaw_rate, c * rate[1] - s * rate[2], rate[0] + sp * yaw_rate
    for i in range(m):
        out[5 + i], out[v + 5 + i] = angle[i], joint_rate[i]
