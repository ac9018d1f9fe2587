"""A disturbance observer for robots with full dynamics: constant generalized forces that explain the motion.

The speed v̂ follows the model with the disturbance d̂; their innovation ṽ = v − v̂ corrects both:
v̂' = … + L1 ṽ, d̂' = L2 M(q) ṽ. L1 ṽ is the acceleration that d̂ does not explain, 1 / L1 late. A push is not a constant
disturbance: while ṽ is beyond the ``gate``, and for ``hold`` seconds after, d̂ stays as it is. But what goes on in one direction for
longer than a push, ``longest`` seconds, is a force that lasts (a person leans on the robot, a cable holds its ball up), or one
that has gone: d̂ then learns at full gain, whatever the gate says, until ``settled`` seconds after ṽ last went
on like that. A plan that does not know of such a force, or believes in one that has gone, leans wrongly for as long. (To go on
learning at every sign of motion makes a robot with an unknown 1 kg in its end effector swing against its own observer.)

At the start nothing has been learned, and the first disturbances are errors of the robot's own masses and its load: for ``longest`` seconds d̂ learns
:data:`EAGER` times as fast, whatever the gate says.

Nor is the inertia of a load that is not modeled: while the robot accelerates, its force comes and goes with the motion. An observer
that follows it, nearly as fast as the controller acts on it, makes the two swing against each other (1 kg in the end effector, a step of
0.4 m: 45 mm beyond the goal and a swing of 1.2 Hz that has not decayed four seconds later). So d̂ learns slowly while the
model says that the robot accelerates or turns: L2 / (1 + (|v̇| / ``calm``)² + …), first for the ball's acceleration, then for the
tilt rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.checks import finite, not_negative, numbers, positive_time, scales
from wbmpc.errors import InputError
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind

#: The share of the gate from which on a steady innovation counts: no push needs to be distinguished from it, only noise.
STEADY = 0.35
#: How many times as fast an observer learns that has just been started.
EAGER = 4.0


class Clock(IntEnum):
    """Entries of the array ``clock``: times [s]."""

    HELD_UNTIL = 0
    LASTS_UNTIL = 1
    SINCE = 2  # when the innovation that goes on began, infinite while none does
    NEW_UNTIL = 3


class Setting(IntEnum):
    """Entries of the array ``settings``."""

    SPEED_GAIN = 0
    FORCE_GAIN = 1
    HOLD = 2
    LONGEST = 3
    SETTLED = 4
    CALM = 5
    CALM_TURNING = 6


class Disturbance(NamedTuple):
    """What moves a robot of ``size`` coordinates beside what the model knows of, at a measured state; SI units."""

    size: int
    velocity: Floats  # (size), as measured
    after: Floats  # (size), what the model makes of the speed that was observed before
    innovation: Floats  # (size), of the speed
    mass: Floats  # (size, size)
    force: Floats  # (size), the estimate


class Gate(NamedTuple):
    """How the observer learns: the first ``gates`` coordinates have a gate."""

    gates: int
    speed: Floats  # (size), as observed
    gate: Floats  # (gates)
    felt: Floats  # (gates), the innovation as shares of the gate
    mean: Floats  # (gates), of that since it goes on
    clock: Floats  # Clock
    settings: Floats  # Setting


@compiled
def detect_lasting_force(g: Gate, largest: float, t: float, h: float) -> None:
    """Note whether the innovation, as ``largest`` and other shares of the gate, is that of a force that lasts: for longer than a push it has
    been one and the same, within 60 degrees of its own mean since it began."""
    if largest <= STEADY:
        g.clock[Clock.SINCE] = np.inf
        return
    along, square, mean_square = 0.0, 0.0, 0.0
    for i in range(g.gates):
        along += g.felt[i] * g.mean[i]
        square += g.felt[i] * g.felt[i]
        mean_square += g.mean[i] * g.mean[i]
    if not np.isfinite(g.clock[Clock.SINCE]) or along < 0.5 * np.sqrt(square) * np.sqrt(mean_square):
        g.clock[Clock.SINCE] = t
        for i in range(g.gates):
            g.mean[i] = g.felt[i]
    share = h / (t - g.clock[Clock.SINCE] + h)
    for i in range(g.gates):
        g.mean[i] += share * (g.felt[i] - g.mean[i])
    if t - g.clock[Clock.SINCE] >= g.settings[Setting.LONGEST]:
        g.clock[Clock.LASTS_UNTIL] = t + g.settings[Setting.SETTLED]


@step
def observe(d: Disturbance, g: Gate, t: float, h: float) -> float:
    """Of a velocity measured at ``t`` [s], a speed as observed before, and what the model makes of that in h [s]. Moves speed and force;
    returns how much of a constant disturbance that can have learned."""
    largest = 0.0
    for i in range(d.size):
        d.innovation[i] = d.velocity[i] - g.speed[i]
    for i in range(g.gates):
        g.felt[i] = d.innovation[i] / g.gate[i]
        largest = max(largest, abs(g.felt[i]))
    detect_lasting_force(g, largest, t, h)
    new = t < g.clock[Clock.NEW_UNTIL]
    if largest > 1.0 and not new:
        g.clock[Clock.HELD_UNTIL] = t + g.settings[Setting.HOLD]
    steady = new or t < g.clock[Clock.LASTS_UNTIL]
    held = t < g.clock[Clock.HELD_UNTIL] and not steady
    vx, vy = (d.after[0] - g.speed[0]) / h, (d.after[1] - g.speed[1]) / h
    moving = (vx * vx + vy * vy) / g.settings[Setting.CALM] ** 2
    moving += (d.velocity[3] ** 2 + d.velocity[4] ** 2) / g.settings[Setting.CALM_TURNING] ** 2
    gain, learning = g.settings[Setting.FORCE_GAIN] / (1.0 + moving), 1.0 / (1.0 + moving)
    if steady:
        gain, learning = g.settings[Setting.FORCE_GAIN], 0.0
    if new:
        gain *= EAGER
    if held:
        gain, learning = 0.0, 0.0
    for i in range(d.size):
        total = 0.0
        for j in range(d.size):
            total += d.mass[i * d.size + j] * d.innovation[j]
        d.force[i] += h * gain * total
        g.speed[i] = d.after[i] + h * g.settings[Setting.SPEED_GAIN] * d.innovation[i]
    return learning


@dataclass
class DisturbanceObserver:
    """``step(x, u, h)``: the model's state after h seconds; ``mass(q)``: M. Units: SI. ``gate`` (1 to ``size``): largest innovations of the
    first speeds that are none of a push."""

    step: Callable[[np.ndarray, np.ndarray, float], np.ndarray]
    mass: Callable[[np.ndarray], np.ndarray]
    size: int
    gate: np.ndarray
    speed_gain: float = 25.0
    force_gain: float = 75.0
    hold: float = 1.0
    longest: float = 0.5
    settled: float = 1.0
    calm: tuple[float, float] = (0.5, 0.2)  # m/s², rad/s

    def __post_init__(self) -> None:
        """Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be; ``gate`` and ``calm`` may be infinite."""
        who = "disturbance observer"
        not_negative(who, speed_gain=self.speed_gain, force_gain=self.force_gain, hold=self.hold)
        not_negative(who, longest=self.longest, settled=self.settled)
        self.gate = scales(who, "gate", self.gate)
        if scales(who, "calm", self.calm).shape != (2,) or not 1 <= self.gate.size <= self.size:
            raise InputError(
                f"{who}: 'calm' needs 2 numbers, 'gate' 1 to {self.size}, got {self.calm} and {self.gate.tolist()}"
            )
        n, gates = self.size, self.gate.size
        sizes = {
            "velocity": n, "speed": n, "after": n, "mass": n * n, "force": n, "felt": gates, "mean": gates,
            "innovation": n,
        }  # fmt: skip
        self._arrays = {name: np.zeros(length) for name, length in sizes.items()} | {
            "gate": np.array(self.gate, float), "clock": np.array([-np.inf, -np.inf, np.inf, -np.inf]),
            "settings": np.array([self.speed_gain, self.force_gain, self.hold, self.longest, self.settled, *self.calm], float),
        }  # fmt: skip
        self._observe = bind(observe, self._arrays, size=n, gates=gates)
        self._state = np.zeros(2 * n)
        self.started = False  # whether there has been a state
        self.learning = 1.0  # how much of a constant disturbance the last update can have learned

    @property
    def force(self) -> np.ndarray:
        """The estimate (nq)."""
        return self._arrays["force"].copy()

    @force.setter
    def force(self, value: np.ndarray) -> None:
        self._arrays["force"][:] = value

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Its arrays by their names above, for other steps to read and to change."""
        return self._arrays

    def update(self, t: float, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """Estimate (nq,) after a measured state x (2 nq) at time t [s]; the input u acts from then for h [s].

        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        n, a = self.size, self._arrays
        finite("disturbance observer", t=t)
        positive_time("disturbance observer", h)
        x = numbers("disturbance observer", "state", x, 2 * n)
        u = numbers("disturbance observer", "input", u, np.size(u))
        a["velocity"][:] = x[n:]
        if not self.started:
            a["speed"][:], self.started = x[n:], True
            a["clock"][Clock.NEW_UNTIL] = t + self.longest
        self._state[:n], self._state[n:] = x[:n], a["speed"]
        a["after"][:] = self.step(self._state.copy(), u, h)[n : 2 * n]
        a["mass"][:] = self.mass(x[:n]).reshape(-1)
        self.learning = self._observe(t, h)
        return self.force
