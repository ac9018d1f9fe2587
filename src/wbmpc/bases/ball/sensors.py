"""Encoders and inertial unit of a ball robot, with their noise, biases and faults.

The inertial unit averages between two messages, as units do that sample fast and decimate (ADIS16448: 819 samples a second
through an averaging filter; 0.0135 °/s/√Hz and 0.23 mg/√Hz; the densities of :class:`Perturbation` are of that order).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wbmpc import lie
from wbmpc.bases.ball.description import BallBaseDescription
from wbmpc.errors import unknown_name
from wbmpc.simulation.perturbation import Perturbation, PlantSample, quantise

Array = NDArray[np.float64]
GRAVITY = 9.81


class Inertial(NamedTuple):
    """Integrals since the start: turning [rad] and specific force [m/s], base axes; ``steps`` of physics."""

    turn: Array
    push: Array
    steps: int


@dataclass(frozen=True)
class WheelGeometry:
    """``turn`` (n, 3): wheel speeds are it times the ball's angular velocity relative to the base, in base axes."""

    turn: Array

    @classmethod
    def of(cls, base: BallBaseDescription, factors: Array) -> WheelGeometry:
        """Of a described base whose wheels' radii are ``factors`` (n) times as large."""
        z, b = base.wheels.zenith, np.array(base.wheels.azimuths)
        axes = np.stack([np.cos(z) * np.cos(b), np.cos(z) * np.sin(b), -np.sin(z) * np.ones_like(b)], axis=1)
        return cls(-base.ball_radius / (base.wheels.radius * np.asarray(factors)[:, None]) * axes)


@dataclass(frozen=True)
class SensorFault:
    """From ``start`` to ``stop`` [s] the encoder of a wheel (its ``number``), or of an arm joint (``of`` arm), stands still
    (``stalled``), or the wheel slips on the ball: it turns by ``speed`` [rad/s] too much."""

    kind: Literal["slip", "stalled"]
    number: int
    start: float
    stop: float
    speed: float = 0.0
    of: Literal["wheel", "arm"] = "wheel"

    def __post_init__(self) -> None:
        for key, choices in (("kind", ("slip", "stalled")), ("of", ("wheel", "arm"))):
            if getattr(self, key) not in choices:
                raise unknown_name(key, getattr(self, key), choices, where="fault of a sensor")

    def acts(self, t: float) -> bool:
        return self.start <= t < self.stop


class BallSensors:
    """Called after every physics step; gives messages. ``mount`` (3) [m]: the inertial unit in base axes."""

    def __init__(
        self, p: Perturbation, draw: PlantSample, wheels: WheelGeometry, mount: Array, timestep: float, jitter: int,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self._p, self._h, self._rng, self._jitter = p, timestep, rng, jitter
        self._turn, self.mount, self.arm_offset = wheels.turn, mount, draw.arm_offset
        self.bias = {"gyro": draw.gyro_bias.copy(), "accel": draw.accel_bias.copy()}
        self.faults: tuple[SensorFault, ...] = ()
        self.restart()

    def restart(self) -> None:
        """Integrals and wheel angles start at zero."""
        self._sum, self._wheel = Inertial(np.zeros(3), np.zeros(3), -1), np.zeros(len(self._turn))
        self._velocity: Array | None = None
        self._rotation, self._rest, self._given = np.eye(3), np.zeros(3), Inertial(np.zeros(3), np.zeros(3), 0)
        self._held: dict[tuple[str, int], float] = {}

    # ------------------------------------------------------------------ physics
    def advance(self, pose: Array, velocity: Array, ball: Array, ball_rate: Array) -> tuple[Inertial, Array]:
        """Integrals and true wheel angles (n) after a physics step (the first call: at the start).

        ``pose`` (7) and ``velocity`` (6) of the base, ``ball`` (4) and ``ball_rate`` (3): relative orientation and rate,
        all in MuJoCo's conventions. Specific force: what changes the velocity of the mount, gravity taken away.
        """
        rotation, omega = lie.quaternion_to_rotation(pose[3:7]), velocity[3:6]
        at = velocity[0:3] + rotation @ _cross(omega, self.mount)
        last, h = self._sum, self._h
        if self._velocity is None:
            self._rest = GRAVITY * rotation[2]
            self._sum = Inertial(last.turn, last.push, 0)
        else:
            change = at - self._velocity
            change[2] += GRAVITY * h
            middle = 0.5 * (self._rotation + rotation)
            self._sum = Inertial(last.turn + h * omega, last.push + middle.T @ change, last.steps + 1)
            self._wheel = self._wheel + h * (self._turn @ (lie.quaternion_to_rotation(ball) @ ball_rate))
            for fault in self._acting("slip"):
                self._wheel[fault.number] += h * fault.speed
        self._velocity, self._rotation = at, rotation
        return self._sum, self._wheel.copy()

    def _acting(self, kind: str) -> list[SensorFault]:
        t = self._sum.steps * self._h
        return [f for f in self.faults if f.kind == kind and f.acts(t)]

    # ------------------------------------------------------------------ messages
    def jitter(self) -> int:
        """How many physics steps older than the message its encoder values are (drawn)."""
        return int(self._rng.integers(0, self._jitter + 1))

    def inertial(self, now: Inertial) -> tuple[Array, Array]:
        """Averages since the message before: gyro (3) [rad/s] and accelerometer (3) [m/s²]."""
        p, last = self._p, self._given
        interval = (now.steps - last.steps) * self._h
        self._given = now
        draws = self._rng.normal(size=(4, 3))
        if interval <= 0.0:  # before the first interval: as at rest
            return self.bias["gyro"].copy(), self._rest + self.bias["accel"]
        root = np.sqrt(interval)
        self.bias["gyro"] = self.bias["gyro"] + p.gyro_walk * root * draws[0]
        self.bias["accel"] = self.bias["accel"] + p.accel_walk * root * draws[1]
        gyro = (now.turn - last.turn) / interval + self.bias["gyro"] + p.gyro_noise / root * draws[2]
        accel = (now.push - last.push) / interval + self.bias["accel"] + p.accel_noise / root * draws[3]
        return gyro, accel

    def encoders(self, wheel: Array, arm: Array) -> tuple[Array, Array]:
        """Readings of wheels (n) and arm (m) [rad]: quantised, with the arm's zero errors."""
        readings = {
            "wheel": quantise(wheel, self._p.arm_counts),
            "arm": quantise(arm + self.arm_offset, self._p.arm_counts),
        }
        stalled = {(f.of, f.number) for f in self._acting("stalled")}
        self._held = {(of, i): self._held.get((of, i), float(readings[of][i])) for of, i in stalled}
        for (of, i), value in self._held.items():
            readings[of][i] = value
        return readings["wheel"], readings["arm"]


def _cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors (np.cross is slow for single ones)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
