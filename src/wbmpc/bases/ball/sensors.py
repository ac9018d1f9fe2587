"""Encoders and inertial unit of a ball robot, with their noise, biases and faults.

The inertial unit averages between two messages, as units do that sample fast and decimate (ADIS16448: 819 samples a second
through an averaging filter; 0.0135 °/s/√Hz and 0.23 mg/√Hz; the densities of :class:`BallPerturbation` are of that order).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.description import BallBaseDescription
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.bases.ball.sensor_step import GRAVITY, measure
from wbmpc.errors import unknown_name
from wbmpc.kernel.step import bind
from wbmpc.simulation.perturbation import PlantSample, quantize


class Seen(NamedTuple):
    """What belongs to a moment: positions and velocities in MuJoCo's conventions; integrals since the start, ``turn`` [rad] and
    specific force, ``push`` [m/s], base axes; ``steps`` of physics; true ``wheel`` angles (n) [rad]."""

    q: Array
    v: Array
    turn: Array
    push: Array
    steps: int
    wheel: Array


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
    """Called after every physics step; gives messages. ``mount`` (3) [m]: the inertial unit in base axes. ``sizes``: of positions and
    velocities in MuJoCo; ``ball``: where those of the ball's joint begin."""

    def __init__(
        self, p: BallPerturbation, draw: PlantSample, wheels: WheelGeometry, mount: Array, timestep: float, jitter: int,
        rng: np.random.Generator, sizes: tuple[int, int], ball: tuple[int, int],
    ) -> None:  # fmt: skip
        self._p, self._h, self._rng, self._jitter = p, timestep, rng, jitter
        self.mount, self.arm_offset = mount, draw.arm_offset
        self.bias = {"gyro": draw.gyro_bias.copy(), "accel": draw.accel_bias.copy()}
        self.faults: tuple[SensorFault, ...] = ()
        n, (nq, nv) = len(wheels.turn), sizes
        ends = np.cumsum([nq, nv, 3, 3, 1, n]).tolist()
        self._q, self._v, self._turn, self._push, _, self._wheel = map(slice, [0, *ends], ends)
        self._steps = ends[4] - 1
        lengths = {"q": nq, "v": nv, "row": ends[-1], "velocity": 3, "rotation": 9, "last": 9, "turned": 9}
        self._arrays = {name: np.zeros(length) for name, length in lengths.items()} | {
            "mount": np.array(mount, float), "wheels": np.array(wheels.turn, float).ravel(),
        }  # fmt: skip
        self._indices = {"n": n, "nq": nq, "nv": nv, "ball_q": ball[0], "ball_v": ball[1]}
        self._measure = bind(measure, self._arrays, h=timestep, **self._indices)
        self.restart()

    def attach(self, q: Array, v: Array) -> None:
        """From now on :meth:`measure` reads these positions and velocities, which a simulator goes on writing."""
        self._measure = bind(measure, self._arrays | {"q": q, "v": v}, h=self._h, **self._indices)

    def restart(self) -> None:
        """Integrals and wheel angles start at zero."""
        self._row = self._arrays["row"]
        self._row[:] = 0.0
        self._first, self._rest = True, np.zeros(3)
        self._given: tuple[Array, Array, int] = np.zeros(3), np.zeros(3), 0
        self._held: dict[tuple[str, int], float] = {}

    # ------------------------------------------------------------------ physics
    def measure(self) -> Array:
        """What there is to be seen (see :meth:`seen`) after a physics step, the first time at the start."""
        self._measure(self._first)
        if self._first:
            self._rest, self._first = GRAVITY * self._arrays["rotation"][6:9], False
        elif self.faults:
            for fault in self._acting("slip"):
                self._row[self._wheel][fault.number] += self._h * fault.speed
        return self._row.copy()

    def seen(self, row: Array) -> Seen:
        """A result of :meth:`advance` by its parts."""
        parts = row[self._q], row[self._v], row[self._turn], row[self._push]
        return Seen(*parts, int(row[self._steps]), row[self._wheel])

    @property
    def wheel(self) -> Array:
        """True wheel angles (n) [rad] now."""
        return self._arrays["row"][self._wheel].copy()

    def _acting(self, kind: str) -> list[SensorFault]:
        t = self._arrays["row"][self._steps] * self._h
        return [f for f in self.faults if f.kind == kind and f.acts(t)]

    # ------------------------------------------------------------------ messages
    def jitter(self) -> int:
        """How many physics steps older than the message its encoder values are (drawn)."""
        return int(self._rng.integers(0, self._jitter + 1))

    def inertial(self, now: Seen) -> tuple[Array, Array]:
        """Averages since the message before: gyro (3) [rad/s] and accelerometer (3) [m/s²]."""
        p, (turn, push, steps) = self._p, self._given
        interval = (now.steps - steps) * self._h
        self._given = now.turn, now.push, now.steps
        draws = self._rng.normal(size=(4, 3))
        if interval <= 0.0:  # before the first interval: as at rest
            return self.bias["gyro"].copy(), self._rest + self.bias["accel"]
        root = np.sqrt(interval)
        self.bias["gyro"] = self.bias["gyro"] + p.gyro_walk * root * draws[0]
        self.bias["accel"] = self.bias["accel"] + p.accel_walk * root * draws[1]
        gyro = (now.turn - turn) / interval + self.bias["gyro"] + p.gyro_noise / root * draws[2]
        accel = (now.push - push) / interval + self.bias["accel"] + p.accel_noise / root * draws[3]
        return gyro, accel

    def encoders(self, wheel: Array, arm: Array) -> tuple[Array, Array]:
        """Readings of wheels (n) and arm (m) [rad]: quantized, with the arm's zero errors."""
        readings = {
            "wheel": quantize(wheel, self._p.arm_counts),
            "arm": quantize(arm + self.arm_offset, self._p.arm_counts),
        }
        if not (self.faults or self._held):
            return readings["wheel"], readings["arm"]
        stalled = {(f.of, f.number) for f in self._acting("stalled")}
        self._held = {(of, i): self._held.get((of, i), float(readings[of][i])) for of, i in stalled}
        for (of, i), value in self._held.items():
            readings[of][i] = value
        return readings["wheel"], readings["arm"]
