"""Which wheels go as the base does, by its accelerometer: where several slip at once, those that agree may all be wrong."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.arrays import Array
from wbmpc.bases.swerve.compilation import step
from wbmpc.bases.swerve.slipping_wheels import OVER
from wbmpc.constants import GRAVITY
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind

#: Time [s] over which tilts are forgotten; over which the rates' zeros are learned by a base at rest, and by one that moves; speed
#: [m/s] of a base at rest.
TILT, ZEROS_AT_REST, ZEROS, REST = 2.0, 2.0, 30.0, 0.005
#: Times [s] in which the velocity goes to the wheels', and in which accelerations' zeros are learned.
FOLLOW, ACCELERATION_ZEROS = 0.05, 3.0
#: A wheel whose velocity is off by this [m/s] counts half.
NEAR = 0.01
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
    n: int, seen: Floats, announced: Floats, wheel_weights: Floats, weights: Floats, unit: Unit, memory: Memory, over: float, h: float,
    yaw_rate: float, calm: bool,
) -> None:  # fmt: skip
    """Over h [s] with the readings of the ``unit`` and ``yaw_rate`` [rad/s] without its bias: the ``memory``, whose velocity is
    averaged over a time ``over`` [s] as velocities ``seen`` (n, 2) by wheels are, and ``weights`` (n) of the wheels, 1 of those that
    go as the unit does. ``calm``: the wheels agree, and the velocity follows them, but for those ``announced`` (n), 1 for wheels that
    are known to slip; else it follows those near it, the less the fewer they are. Wheels count by ``wheel_weights`` (n)."""
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
    total, ahead, aside, wheels = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        off_x, off_y = seen[2 * i] - averaged[0], seen[2 * i + 1] - averaged[1]
        weights[i] = 1.0 / (1.0 + (off_x * off_x + off_y * off_y) / (NEAR * NEAR))
        share = weights[i]
        if calm:
            share = ANNOUNCED if announced[i] > 0.5 else 1.0
        share *= wheel_weights[i]
        total += share
        wheels += wheel_weights[i]
        ahead += share * off_x
        aside += share * off_y
    gain = h / FOLLOW / (max(total, 1e-9) if calm else wheels)
    for j in range(2):
        off = gain * (ahead if j == 0 else aside)
        inertial[j] += off
        averaged[j] += off
        if calm:
            zero[j] -= off / ACCELERATION_ZEROS


#: An inertial unit that reads less [m/s²] is none, for gravity is missing; nor is one that reads more [m/s², rad/s].
NO_GRAVITY, BROKEN = 1.0, 1e3
#: After a longer time [s] without a message the wheels' mean velocity counts.
GAP = 0.1


class InertialVelocity:
    """Velocity of a base by accelerations and rates, which wheels that agree correct. ``seen`` (n, 2) [m/s]: the base's velocity by each
    wheel, an array that goes on. ``mount`` (3) [m]: where the inertial unit is, in axes of the base. ``weights`` (n): 1 for wheels that
    go with the base, less for others. ``wheel_weights`` (n): what each counts by what is known of it (None: all alike).

    Where no wheel is near, the velocity coasts: integrals of accelerations are off by a few mm/s after half a second. What lasts (zeros,
    tilt of the floor) is learned from wheels that agree. So wheels that agree are believed, also those that roll straight ahead while the
    base stands on blocks, which no gyro shows. The accelerometer hardly does: while these accelerate by 1 m/s² they are ahead of the velocity
    by 1 m/s² times :data:`FOLLOW`, 50 mm/s, and at a constant speed by nothing. Bumps make differences as large: no threshold separates
    the two.
    """

    def __init__(self, seen: Array, mount: ArrayLike = (0.0, 0.0, 0.0), wheel_weights: Array | None = None) -> None:
        n = seen.size // 2
        self._own = np.ones(n) if wheel_weights is None else wheel_weights.copy()
        self._mount, self._yaw_rate, self._counts = np.array(mount, float), 0.0, False
        pairs = ("inertial", "averaged", "zero", "tilt", "rate_zero")
        self.weights, self._announced, self._arrays = np.ones(n), np.zeros(n), {name: np.zeros(2) for name in pairs}
        self._gyro, self._accel, self._seen = np.zeros(3), np.zeros(3), seen
        arrays = {
            **self._arrays, "seen": seen, "weights": self.weights, "announced": self._announced, "wheel_weights": self._own,
            "gyro": self._gyro, "accel": self._accel, "mount": self._mount,
        }  # fmt: skip
        self._step = bind(inertial_velocity, arrays, n=n, over=OVER)

    @property
    def _lever(self) -> Array:
        """Velocity (2) [m/s] of the inertial unit by a yaw rate of 1 rad/s."""
        return np.array([-self._mount[1], self._mount[0]])

    @property
    def velocity(self) -> Array:
        """(2) [m/s] of the base's origin, in axes of the base."""
        return self._arrays["inertial"] - self._yaw_rate * self._lever

    @property
    def slip(self) -> float | None:
        """Speed [m/s] of the wheel that is farthest from the base's velocity, of those that count in full and are not announced to slip;
        None before there was a message of an inertial unit."""
        if not self._counts:
            return None
        off = self._seen.reshape(-1, 2) - self._arrays["averaged"]
        return float(
            np.sqrt(np.max(np.where((self._announced > 0.5) | (self._own < 0.5), 0.0, np.sum(off**2, axis=1))))
        )

    def update(
        self, h: float, gyro: Array, accel: Array, yaw_rate: float, announced: NDArray[np.bool_] | None,
        calm: bool = True,
    ) -> bool:  # fmt: skip
        """Over h [s] to a message: ``gyro`` (3) [rad/s], ``accel`` (3) [m/s²], mean ``yaw_rate`` [rad/s] without its bias; ``announced`` (n):
        wheels that slip, as the controller says; ``calm``: whether the wheels agree. Whether ``weights`` are of this message: there is an
        inertial unit, and no gap before it."""
        self._counts = False
        if not (NO_GRAVITY < math.hypot(*accel.tolist()) < BROKEN and math.hypot(*gyro.tolist()) < BROKEN):
            return False
        if not 0.0 < h < GAP:
            self._arrays["averaged"][:] = np.average(self._seen.reshape(-1, 2), axis=0, weights=self._own)
            self._arrays["inertial"][:] = self._arrays["averaged"] + yaw_rate * self._lever
            return False
        self._gyro[:], self._accel[:], self._yaw_rate = gyro, accel, yaw_rate
        self._announced[:] = 0.0 if announced is None else announced
        self._step(h, yaw_rate, calm)
        self._counts = True
        return True
