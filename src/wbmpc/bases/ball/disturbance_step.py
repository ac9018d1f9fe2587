"""One update of a disturbance observer, compiled: see :class:`wbmpc.bases.ball.disturbance.DisturbanceObserver`."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.kernel.ir import Floats

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
