"""A base's velocity by its inertial unit from one message to the next, compiled: see
:class:`wbmpc.bases.swerve.inertial_velocity.InertialVelocity`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.bases.swerve.compilation import step
from wbmpc.constants import GRAVITY
from wbmpc.kernel.ir import Floats

#: Time [s] over which tilts are forgotten; over which the rates' zeros are learned by a base at rest, and by one that moves; speed
#: [m/s] of a base at rest.
TILT, ZEROS_AT_REST, ZEROS, REST = 2.0, 2.0, 30.0, 0.005
#: Times [s] in which the velocity goes to the wheels', and in which accelerations' zeros are learned.
FOLLOW, ACCELERATION_ZEROS = 0.05, 3.0
#: A wheel whose velocity is off by this [m/s] counts half.
NEAR = 0.02
#: What a wheel counts at most of which the controller knows that it slips.
ANNOUNCED = 0.05


class Unit(NamedTuple):
    """An inertial unit and its readings."""

    mount: Floats  # (3) [m]
    gyro: Floats  # (3) [rad/s]
    accel: Floats  # (3) [m/s²]


class Memory(NamedTuple):
    """What is known of the motion, and of the unit."""

    inertial: Floats  # (2) [m/s], velocity of the unit
    averaged: Floats  # (2) [m/s], that of the base, averaged as the wheels' is
    zero: Floats  # (2) [m/s²], of accelerations
    tilt: Floats  # (2) [rad], about x and y
    rate_zero: Floats  # (2) [rad/s], of the rates about x and y


@step
def inertial_velocity(
    n: int, seen: Floats, announced: Floats, weights: Floats, unit: Unit, memory: Memory, over: float, h: float, yaw_rate: float,
    calm: bool,
) -> None:  # fmt: skip
    """Over h [s] with the readings of the ``unit`` and ``yaw_rate`` [rad/s] without its bias: the ``memory``, whose velocity is
    averaged over a time ``over`` [s] as velocities ``seen`` (n, 2) by wheels are, and ``weights`` (n) of the wheels, 1 of those that
    go as the unit does. ``calm``: the wheels agree, and the velocity follows them, but for those ``announced`` (n), 1 for wheels that
    are known to slip; else it follows those near it, the less the fewer they are."""
    mount, gyro, accel, inertial, averaged = unit.mount, unit.gyro, unit.accel, memory.inertial, memory.averaged
    zero, tilt, rate_zero = memory.zero, memory.tilt, memory.rate_zero
    rests = max(abs(inertial[0]), abs(inertial[1])) < REST
    for j in range(2):
        rate_zero[j] += h / (ZEROS_AT_REST if rests else ZEROS) * (gyro[j] - rate_zero[j])
        tilt[j] += h * (gyro[j] - rate_zero[j] - tilt[j] / TILT)
    x, y = inertial[0], inertial[1]
    inertial[0] += h * (accel[0] + GRAVITY * tilt[1] - zero[0] + yaw_rate * y)
    inertial[1] += h * (accel[1] - GRAVITY * tilt[0] - zero[1] - yaw_rate * x)
    share = 1.0 - np.exp(-h / over)
    averaged[0] += share * (inertial[0] + yaw_rate * mount[1] - averaged[0])
    averaged[1] += share * (inertial[1] - yaw_rate * mount[0] - averaged[1])
    total, ahead, aside = 0.0, 0.0, 0.0
    for i in range(n):
        off_x, off_y = seen[2 * i] - averaged[0], seen[2 * i + 1] - averaged[1]
        weights[i] = 1.0 / (1.0 + (off_x * off_x + off_y * off_y) / (NEAR * NEAR))
        share = weights[i]
        if calm:
            share = ANNOUNCED if announced[i] > 0.5 else 1.0
        total += share
        ahead += share * off_x
        aside += share * off_y
    gain = h / FOLLOW / (max(total, 1e-9) if calm else n)
    for j in range(2):
        off = gain * (ahead if j == 0 else aside)
        inertial[j] += off
        averaged[j] += off
        if calm:
            zero[j] -= off / ACCELERATION_ZEROS
