"""The ball filter's step, compiled: the next state, residuals and their slopes, and how an error moves a state.

What it does and why: :class:`wbmpc.bases.ball.filter.BallFilter`. Matrices are stored by rows; n wheels, errors of ``size`` 16 + n,
17 + 2n rows of residuals.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.kernel.ir import Floats

GRAVITY, PI = 9.81, float(np.pi)


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
def integrate(
    n: int, h: float, x: Floats, y: Floats, gyro: Floats, accel: Floats, mount: Floats, wheels: Floats, radius: float,
    turn: Floats, turned: Floats, half: Floats, middle: Floats, after: Floats, shift: Floats, pushed: Floats,
) -> None:  # fmt: skip
    """The state ``y`` after ``x`` by strapdown integration and rolling: where the residuals are linearized. ``pushed`` (3): turning of
    the ball by the way ``shift``, in base axes."""
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
        pushed[i] = (middle[3 + i] * shift[0] - middle[i] * shift[1]) / radius
    for i in range(n):
        for j in range(3):
            y[State.WHEEL + i] += factor * wheels[3 * i + j] * (pushed[j] - turn[j])


@compiled
def inertial_rows(
    n: int, h: float, x: Floats, after: Floats, accel: Floats, mount: Floats, noise: Floats, turned: Floats,
    middle: Floats, jx: Floats, jy: Floats, q: Floats, r: Floats,
) -> None:  # fmt: skip
    """Turning, push and shift, which are zero at the guess; walks of the biases, and the scale."""
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
    r[Row.SCALE] = (1.0 - kept) * x[State.SCALE]
    jy[Row.SCALE * size + Error.SCALE], jx[Row.SCALE * size + Error.SCALE] = 1.0, -kept
    q[Row.SCALE * (m + 1)] = noise[Noise.SCALE] ** 2 * (1.0 - kept**2)


@compiled
def rolling_rows(
    n: int, h: float, x: Floats, y: Floats, wheel: Floats, wheels: Floats, radius: float, torque: float, noise: Floats,
    turn: Floats, turned: Floats, middle: Floats, pushed: Floats, slip: Floats, jx: Floats, jy: Floats, q: Floats,
    r: Floats,
) -> None:  # fmt: skip
    """Wheel increments − turn · (ball's turning − base's), zero at the guess; encoders, what they read was true a little before; and
    the floor. ``torque`` [N m]: what lasts about the vertical; ``slip`` (n, 3) is scratch."""
    size, m, factor = 16 + n, 17 + 2 * n, np.exp(-x[State.SCALE])
    spin = noise[Noise.SPIN] ** 2 + (noise[Noise.CREEPING] * torque) ** 2
    for i in range(n):
        row, t = (Row.ROLLING + i) * size, 3 * i
        fx, fy, fz = factor * wheels[t], factor * wheels[t + 1], factor * wheels[t + 2]
        jy[row + Error.WHEEL + i], jx[row + Error.WHEEL + i] = 1.0, -1.0
        along = (fx * middle[3] + fy * middle[4] + fz * middle[5]) / radius
        across = -(fx * middle[0] + fy * middle[1] + fz * middle[2]) / radius
        jy[row + Error.POSITION], jy[row + Error.POSITION + 1] = -along, -across
        jx[row + Error.POSITION], jx[row + Error.POSITION + 1] = along, across
        a, b, c = by_skew(fx, fy, fz, 0.5 * pushed[0], 0.5 * pushed[1], 0.5 * pushed[2])
        k = row + Error.ATTITUDE
        jy[k], jy[k + 1], jy[k + 2] = fx - a, fy - b, fz - c
        jx[k] = -a - (fx * turned[0] + fy * turned[1] + fz * turned[2])
        jx[k + 1] = -b - (fx * turned[3] + fy * turned[4] + fz * turned[5])
        jx[k + 2] = -c - (fx * turned[6] + fy * turned[7] + fz * turned[8])
        jx[row + Error.SCALE] = fx * (pushed[0] - turn[0]) + fy * (pushed[1] - turn[1]) + fz * (pushed[2] - turn[2])
        for k in range(3):
            slip[t + k] = (
                wheels[t] * middle[3 * k] + wheels[t + 1] * middle[3 * k + 1] + wheels[t + 2] * middle[3 * k + 2]
            )
    for i in range(n):
        row, e = (Row.ROLLING + n + i) * size, Row.ROLLING + n + i
        speed, age = (y[State.WHEEL + i] - x[State.WHEEL + i]) / h, noise[Noise.AGE]
        r[e] = y[State.WHEEL + i] - age * speed - wheel[i]
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
def linearize(
    n: int, x: Floats, y: Floats, gyro: Floats, accel: Floats, wheel: Floats, mount: Floats, wheels: Floats,
    radius: float, noise: Floats, turn: Floats, turned: Floats, half: Floats, middle: Floats, after: Floats,
    shift: Floats, pushed: Floats, slip: Floats, jx: Floats, jy: Floats, q: Floats, r: Floats, h: float, torque: float,
    gyro_more: float, accel_more: float,
) -> None:  # fmt: skip
    """The guess ``y`` after ``x``, residuals ``r`` between the two, their slopes ``jx`` and ``jy`` by the errors of both, and the
    covariance ``q`` of their noise; ``gyro_more`` [rad²], ``accel_more`` [m²/s²]: more variance of turning and push."""
    size, m = 16 + n, 17 + 2 * n
    for i in range(m):
        r[i] = 0.0
    for i in range(m * size):
        jx[i], jy[i] = 0.0, 0.0
    for i in range(m * m):
        q[i] = 0.0
    integrate(
        n=n, h=h, x=x, y=y, gyro=gyro, accel=accel, mount=mount, wheels=wheels, radius=radius, turn=turn, turned=turned,
        half=half, middle=middle, after=after, shift=shift, pushed=pushed,
    )  # fmt: skip
    inertial_rows(
        n=n, h=h, x=x, after=after, accel=accel, mount=mount, noise=noise, turned=turned, middle=middle, jx=jx, jy=jy,
        q=q, r=r,
    )  # fmt: skip
    rolling_rows(
        n=n, h=h, x=x, y=y, wheel=wheel, wheels=wheels, radius=radius, torque=torque, noise=noise, turn=turn,
        turned=turned, middle=middle, pushed=pushed, slip=slip, jx=jx, jy=jy, q=q, r=r,
    )  # fmt: skip
    for i in range(3):
        q[(Row.TURNING + i) * (m + 1)] += gyro_more
        q[(Row.PUSH + i) * (m + 1)] += accel_more


@compiled
def apply(n: int, y: Floats, error: Floats, turned: Floats, after: Floats, z: Floats) -> None:
    """The state ``z`` is ``y`` with an ``error``."""
    rotation_of(error[Error.ATTITUDE], error[Error.ATTITUDE + 1], error[Error.ATTITUDE + 2], turned)
    turned_by(y, turned, after)
    for i in range(3):
        z[State.POSITION + i] = y[State.POSITION + i] + error[Error.POSITION + i]
        z[State.VELOCITY + i] = y[State.VELOCITY + i] + error[Error.VELOCITY + i]
        z[State.GYRO_BIAS + i] = y[State.GYRO_BIAS + i] + error[Error.GYRO_BIAS + i]
        z[State.ACCEL_BIAS + i] = y[State.ACCEL_BIAS + i] + error[Error.ACCEL_BIAS + i]
    for i in range(9):
        z[State.ROTATION + i] = after[i]
    z[State.SCALE] = y[State.SCALE] + error[Error.SCALE]
    for i in range(n):
        z[State.WHEEL + i] = y[State.WHEEL + i] + error[Error.WHEEL + i]


@compiled
def detect_stalled(
    n: int, gone: Floats, wheel: Floats, read: Floats, way: Floats, stalled: Floats, still: float, most: float
) -> None:  # fmt: skip
    """An encoder that stays within ``still`` [rad] of what it ``read`` (one may flicker by a count) while its wheel must have turned
    by ``most`` [rad] since: ``way`` being by how much, ``gone`` (n) [rad] what the last interval gives to it."""
    for i in range(n):
        if abs(wheel[i] - read[i]) > still:
            way[i], stalled[i], read[i] = 0.0, 0.0, wheel[i]
        else:
            way[i] += gone[i]
            stalled[i] = 1.0 if abs(way[i]) > most else 0.0


@step
def advance(
    n: int, x: Floats, y: Floats, z: Floats, p: Floats, best_covariance: Floats, gone: Floats, gyro: Floats, rate: Floats,
    wheel: Floats, read: Floats, way: Floats, stalled: Floats, still: float, most: float,
) -> None:  # fmt: skip
    """:func:`accept`, the ``rate`` (3) [rad/s] of the base by the last message that counted, and :func:`detect_stalled`."""
    accept(n, x, y, z, p, best_covariance, gone)
    for i in range(3):
        rate[i] = gyro[i] - x[State.GYRO_BIAS + i]
    detect_stalled(n, gone, wheel, read, way, stalled, still, most)


@compiled
def accept(n: int, x: Floats, y: Floats, z: Floats, p: Floats, best_covariance: Floats, gone: Floats) -> None:
    """The newer state ``z`` becomes the older one, ``x`` and ``p``; ``gone`` (n) [rad]: what the wheels turned between them."""
    for i in range(n):
        gone[i] = y[State.WHEEL + i] - x[State.WHEEL + i]
    for i in range(State.WHEEL + n):
        x[i] = z[i]
    for i in range((16 + n) * (16 + n)):
        p[i] = best_covariance[i]


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
