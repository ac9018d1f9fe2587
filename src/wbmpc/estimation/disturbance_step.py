"""One update of a disturbance observer, compiled: see :class:`wbmpc.estimation.disturbance.DisturbanceObserver`."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from wbmpc.estimation.compilation import compiled, step
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


@compiled
def detect_lasting_force(
    gates: int, felt: Floats, mean: Floats, clock: Floats, settings: Floats, largest: float, t: float, h: float
) -> None:
    """Note whether the innovation ``felt``, as shares of the gate, is that of a force that lasts: for longer than a push it has
    been one and the same, within 60 degrees of its own mean since it began."""
    if largest <= STEADY:
        clock[Clock.SINCE] = np.inf
        return
    along, square, mean_square = 0.0, 0.0, 0.0
    for i in range(gates):
        along += felt[i] * mean[i]
        square += felt[i] * felt[i]
        mean_square += mean[i] * mean[i]
    if not np.isfinite(clock[Clock.SINCE]) or along < 0.5 * np.sqrt(square) * np.sqrt(mean_square):
        clock[Clock.SINCE] = t
        for i in range(gates):
            mean[i] = felt[i]
    share = h / (t - clock[Clock.SINCE] + h)
    for i in range(gates):
        mean[i] += share * (felt[i] - mean[i])
    if t - clock[Clock.SINCE] >= settings[Setting.LONGEST]:
        clock[Clock.LASTS_UNTIL] = t + settings[Setting.SETTLED]


@step
def observe(
    size: int, gates: int, velocity: Floats, speed: Floats, after: Floats, mass: Floats, force: Floats, gate: Floats,
    felt: Floats, mean: Floats, innovation: Floats, clock: Floats, settings: Floats, t: float, h: float,
) -> float:  # fmt: skip
    """``velocity`` (size) as measured at ``t`` [s], ``speed`` as observed before, ``after`` what the model makes of that in h [s];
    ``mass`` (size, size). Moves ``speed`` and ``force``; returns how much of a constant disturbance that can have learned."""
    largest = 0.0
    for i in range(size):
        innovation[i] = velocity[i] - speed[i]
    for i in range(gates):
        felt[i] = innovation[i] / gate[i]
        largest = max(largest, abs(felt[i]))
    detect_lasting_force(gates, felt, mean, clock, settings, largest, t, h)
    new = t < clock[Clock.NEW_UNTIL]
    if largest > 1.0 and not new:
        clock[Clock.HELD_UNTIL] = t + settings[Setting.HOLD]
    steady = new or t < clock[Clock.LASTS_UNTIL]
    held = t < clock[Clock.HELD_UNTIL] and not steady
    vx, vy = (after[0] - speed[0]) / h, (after[1] - speed[1]) / h
    moving = (vx * vx + vy * vy) / settings[Setting.CALM] ** 2
    moving += (velocity[3] ** 2 + velocity[4] ** 2) / settings[Setting.CALM_TURNING] ** 2
    gain, learning = settings[Setting.FORCE_GAIN] / (1.0 + moving), 1.0 / (1.0 + moving)
    if steady:
        gain, learning = settings[Setting.FORCE_GAIN], 0.0
    if new:
        gain *= EAGER
    if held:
        gain, learning = 0.0, 0.0
    for i in range(size):
        total = 0.0
        for j in range(size):
            total += mass[i * size + j] * innovation[j]
        force[i] += h * gain * total
        speed[i] = after[i] + h * settings[Setting.SPEED_GAIN] * innovation[i]
    return learning
