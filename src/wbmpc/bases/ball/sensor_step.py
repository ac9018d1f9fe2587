"""What a simulated ball robot's sensors see of a physics step, compiled: see :class:`wbmpc.bases.ball.sensors.BallSensors`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.constants import GRAVITY
from wbmpc.kernel.ir import Floats, Integers


@compiled
def matrix_of(q: Floats, at: int, r: Floats) -> None:
    """Rotation matrix ``r`` (3, 3) of the quaternion that begins at ``q[at]``."""
    w, x, y, z = q[at], q[at + 1], q[at + 2], q[at + 3]
    r[0], r[1], r[2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    r[3], r[4], r[5] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    r[6], r[7], r[8] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


class Sensors(NamedTuple):
    """What is measured where, and what a step leaves for the next one."""

    mount: Floats  # (3) [m], of the inertial unit in the base
    wheels: Floats  # (n, 3), wheel speeds over the ball's
    row: Floats  # what is seen: see measure
    velocity: Floats  # (3) [m/s], of the mount
    rotation: Floats  # (3, 3), of the base
    last: Floats  # (3, 3), a step before
    turned: Floats  # (3, 3), of the ball against the base


@step
def measure(
    n: int, nq: int, nv: int, ball_q: int, ball_v: int, q: Floats, v: Floats, sensors: Sensors, h: float, first: bool
) -> None:
    """``row``: positions ``q`` (nq) and velocities ``v`` (nv) in MuJoCo's conventions, integrals since the start of turning (3) [rad]
    and specific force (3) [m/s] in base axes, how many steps that are, wheel angles (n) [rad]; ``h`` [s] of a step. ``first``: at the start.

    Specific force: what changes the ``velocity`` of the ``mount``, gravity taken away. The ball's motion is relative to the base and
    begins at ``q[ball_q]``, ``v[ball_v]``."""
    mount, wheels, row, velocity = sensors.mount, sensors.wheels, sensors.row, sensors.velocity
    rotation, last, turned = sensors.rotation, sensors.last, sensors.turned
    for i in range(nq):
        row[i] = q[i]
    for i in range(nv):
        row[nq + i] = v[i]
    for i in range(9):
        last[i] = rotation[i]
    matrix_of(q, 3, rotation)
    ax = v[4] * mount[2] - v[5] * mount[1]
    ay = v[5] * mount[0] - v[3] * mount[2]
    az = v[3] * mount[1] - v[4] * mount[0]
    vx = v[0] + (rotation[0] * ax + rotation[1] * ay + rotation[2] * az)
    vy = v[1] + (rotation[3] * ax + rotation[4] * ay + rotation[5] * az)
    vz = v[2] + (rotation[6] * ax + rotation[7] * ay + rotation[8] * az)
    if not first:
        cx, cy, cz = vx - velocity[0], vy - velocity[1], vz - velocity[2] + GRAVITY * h
        turn = nq + nv
        for i in range(3):
            row[turn + i] += h * v[3 + i]
            mx, my, mz = last[i] + rotation[i], last[3 + i] + rotation[3 + i], last[6 + i] + rotation[6 + i]
            row[turn + 3 + i] += 0.5 * (mx * cx + my * cy + mz * cz)
        row[turn + 6] += 1.0
        matrix_of(q, ball_q, turned)
        b = ball_v
        wx = turned[0] * v[b] + turned[1] * v[b + 1] + turned[2] * v[b + 2]
        wy = turned[3] * v[b] + turned[4] * v[b + 1] + turned[5] * v[b + 2]
        wz = turned[6] * v[b] + turned[7] * v[b + 1] + turned[8] * v[b + 2]
        for i in range(n):
            row[turn + 7 + i] += h * (wheels[3 * i] * wx + wheels[3 * i + 1] * wy + wheels[3 * i + 2] * wz)
    velocity[0], velocity[1], velocity[2] = vx, vy, vz


@step
def minimal_state(m: int, q: Floats, v: Floats, arm_q: Integers, arm_v: Integers, state: Floats) -> None:
    """The minimal ``state``, x, y, yaw, pitch, roll, m joints and their rates, of positions ``q`` and velocities ``v`` in MuJoCo's
    conventions; joints are at ``arm_q`` (m) and ``arm_v`` (m)."""
    w, x, y, z = q[3], q[4], q[5], q[6]
    roll = np.arctan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(min(max(2.0 * (w * y - x * z), -1.0), 1.0))
    state[0], state[1], state[3], state[4] = q[0], q[1], pitch, roll
    state[2] = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    s, c = np.sin(roll), np.cos(roll)
    yaw_rate = (s * v[4] + c * v[5]) / np.cos(pitch)
    n = 5 + m
    state[n], state[n + 1], state[n + 2] = v[0], v[1], yaw_rate
    state[n + 3], state[n + 4] = c * v[4] - s * v[5], v[3] + np.sin(pitch) * yaw_rate
    for i in range(m):
        state[5 + i], state[n + 5 + i] = q[arm_q[i]], v[arm_v[i]]
