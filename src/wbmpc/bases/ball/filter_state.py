"""What the filter of a ball-balancing base estimates, and what it believes of its sensors."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import finite, numbers, positive
from wbmpc.errors import InputError

#: Where position, velocity, attitude and the biases of gyro and accelerometer stand in the error state.
P, V, A, BG, BA = (slice(k, k + 3) for k in (0, 3, 6, 9, 12))


@dataclass(frozen=True)
class BallGeometry:
    """``radius`` [m] of the ball; ``turn`` (n, 3): wheel speeds over the ball's rate relative to the base, base axes;
    ``mount`` (3) [m] of the inertial unit in the base's frame, whose origin is the ball's center."""

    radius: float
    turn: Array
    mount: Array

    def __post_init__(self) -> None:
        """Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        positive("ball filter", radius=self.radius)
        numbers("ball filter", "mount", self.mount, 3)
        for row in self.turn:
            numbers("ball filter", "turn", row, 3)


@dataclass(frozen=True)
class BallNoise:
    """What the filter believes of its sensors (standard deviations, SI units).

    Densities and random walks of gyro and accelerometer; ``encoder`` [rad] of one reading; ``age`` [s]: mean age of the
    encoders' values in a message, ``jitter`` [s] its spread. ``creep`` [rad/√s]: turning of the ball that is not rolling,
    about horizontal axes, and ``spin`` about the vertical, where friction holds it as well: what is believed of it decides how
    fast the wheels show the gyro's bias, and so how far the heading drifts. Under a torque about the vertical that lasts longer
    than ``lasting`` [s] the ball's patch creeps steadily one way (0.011 rad/s for each N m in simulation), which would pass for
    a bias of the gyro: ``creeping`` [rad/√s] for each N m of it is added to ``spin``. ``floor`` [m]: height of the ball's
    center; ``path`` [m]: of the way between two messages, what a straight line of velocities does not describe. Priors:
    ``tilt`` [rad], ``start`` ([m], [rad] of yaw), ``speed`` [m/s], ``gyro_bias``, ``accel_bias``, ``scale``: relative error
    of the wheels' radius, which does not stay longer than ``scale_time`` [s]: the accelerometer sees it too well to be
    believed. ``change``: error of the inertial unit's means over the difference between two in a row: motions that change
    within an interval (a robot that is hit, an arm at its stops) turn and push otherwise than their mean does.
    """

    gyro: float = 2e-4
    accel: float = 1e-3
    gyro_walk: float = 2e-5
    accel_walk: float = 3e-3
    encoder: float = 2.0 * np.pi / 2**17 / np.sqrt(12.0)
    age: float = 1e-3
    jitter: float = 7e-4
    creep: float = 5e-4
    spin: float = 5e-4
    creeping: float = 0.03
    lasting: float = 1.0
    floor: float = 1e-3
    path: float = 5e-6
    tilt: float = 0.02
    start: float = 1e-4
    speed: float = 1e-3
    gyro_bias: float = 0.01 / np.sqrt(3.0)
    accel_bias: float = 0.01 / np.sqrt(3.0)
    scale: float = 0.002 / np.sqrt(3.0)
    scale_time: float = 1.0
    change: float = 0.05

    def __post_init__(self) -> None:
        finite("ball filter's noise", **asdict(self))
        for name, value in asdict(self).items():
            if value < 0.0 or (name in ("lasting", "scale_time") and value == 0.0):
                raise InputError(f"ball filter's noise: '{name}' is too small, got {value}")


@dataclass
class BallState:
    """``position`` (3) [m] of the ball's center, ``velocity`` (3) [m/s] of the inertial unit, ``rotation`` of the base, all in
    the world; biases (3) of gyro and accelerometer; ``wheel`` (n) [rad] angles; ``scale``: log of the radius factor."""

    position: Array
    velocity: Array
    rotation: Array
    gyro_bias: Array = field(default_factory=lambda: np.zeros(3))
    accel_bias: Array = field(default_factory=lambda: np.zeros(3))
    wheel: Array = field(default_factory=lambda: np.zeros(3))
    scale: float = 0.0

    def moved(self, d: Array) -> BallState:
        """With an error (16 + n) added: see :class:`BallFilter` for its order."""
        n = self.wheel.size
        return BallState(
            self.position + d[P], self.velocity + d[V], self.rotation @ rotation_of(d[A]), self.gyro_bias + d[BG],
            self.accel_bias + d[BA], self.wheel + d[16 : 16 + n], self.scale + float(d[15]),
        )  # fmt: skip


def skew(a: Array) -> Array:
    """The matrix of a ×."""
    x, y, z = a.tolist()  # one by one, Python's own numbers are several times as fast
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_of(vector: Array) -> Array:
    """Rotation matrix of a rotation vector [rad] (Rodrigues)."""
    angle = float(np.sqrt(vector @ vector))
    k = skew(vector)
    a, b = (np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2) if angle > 1e-4 else (1.0 - angle**2 / 6.0, 0.5)
    rotation: Array = np.eye(3) + a * k + b * (k @ k)
    return rotation
