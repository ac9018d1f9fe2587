"""A mass in the end effector, compiled: see :mod:`wbmpc.bases.ball.payload`.

One that comes into it, or leaves it, at once is detected by the arm within a tenth of a second: the acceleration of the arm that the
model does not explain, times its inertia, is a force; where that is the weight of a mass in all joints alike, it is one. To weigh
is more exact, and takes seconds: meanwhile the arm would fall.
Arrays: ``weight`` (n) [N, N m] of 1 kg, ``force`` (n) [N, N m] that is learned, ``load``.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.bases.ball.disturbance import Disturbance
from wbmpc.kernel.ir import Floats

#: How fast a mass is weighed [1/s]; the largest [kg]; standard deviation [kg] that the arm's torques alone must determine it with.
RATE, MAXIMUM, SURE = 2.0, 3.0, 0.5
#: By how much forces on the base and in the arm's joints are off where there is no mass [N m].
SPREADS = 2.5, 0.6
#: Gain [1/s] of the arm's speed under the model; of the mass [1/s]; masses [kg] from which on it counts, and until when.
SPEED_GAIN, MASS_GAIN, BEGINS, ENDS = 60.0, 40.0, 0.25, 0.05
#: A robot that moves slowly for so long [s] detects a load that comes until so long after it [s]: in fast motions the model's errors
#: look like one.
CALM, AFTER = 0.3, 0.1
#: What counts as slow: see ``learning`` of the disturbance observer.
STILL = 0.7
#: Coordinates of ball and base, before those of the arm.
BASE = 5
#: Largest share of the force that may be no weight; least share of what moves the arm by the model: less may be an error of its inertia.
UNLIKE, UNEXPLAINED = 0.5, 0.5


class Load(IntEnum):
    """Entries of the array ``load``: the mass [kg], for how long [s] the robot has moved slowly and will count as slow, whether a mass
    is coming or going, whether a speed is known."""

    MASS = 0
    CALM = 1
    LEFT = 2
    CHANGING = 3
    STARTED = 4


class Payload(NamedTuple):
    """What the mass of n coordinates is found by, beside a :class:`Disturbance`."""

    weight: Floats  # (n) [N, N m] of 1 kg
    model: Floats  # (n), the accelerations that the model explains
    believed: Floats  # (n), the speed under it
    apart: Floats  # (n), what is measured besides
    load: Floats  # Load
    spreads: Floats  # (2) [N m], SPREADS


@compiled
def arm_observes_mass(n: int, weight: Floats, spreads: Floats) -> bool:
    """Whether the arm observes a mass by itself and better than the base."""
    whole, own = 0.0, 0.0
    for i in range(n):
        spread = spreads[0] if i < BASE else spreads[1]
        each = weight[i] ** 2 / spread**2
        whole += each
        if i >= BASE:
            own += each
    return own >= max(0.5 * whole, 1.0 / SURE**2)


@compiled
def change(n: int, weight: Floats, force: Floats, load: Floats, by: float, known: float) -> None:
    """The mass changes ``by`` [kg], of which the ``force`` had the ``known`` share."""
    previous = load[Load.MASS]
    load[Load.MASS] = min(max(previous + by, 0.0), MAXIMUM)
    for i in range(n):
        force[i] -= known * (load[Load.MASS] - previous) * weight[i]


@step
def learn(n: int, weight: Floats, force: Floats, load: Floats, spreads: Floats, h: float) -> None:
    """What of the ``force`` is like the weight becomes mass, for ``h`` [s], where the arm observes it."""
    if not arm_observes_mass(n, weight, spreads):
        return
    alike, square = 0.0, 0.0
    for i in range(n):
        spread = spreads[0] if i < BASE else spreads[1]
        scaled = weight[i] / spread**2
        alike += scaled * force[i]
        square += scaled * weight[i]
    change(n, weight, force, load, h * RATE * alike / square, 1.0)


@compiled
def detect_change(d: Disturbance, p: Payload, learning: float, h: float) -> tuple[float, float]:
    """By how much [kg] the mass changes over ``h`` [s], and which share of that is in the force already. ``learning``: from 0 (fast
    motion) to 1 (at rest)."""
    for i in range(d.size):
        if p.load[Load.STARTED] == 0.0:
            p.believed[i] = d.velocity[i]
        p.apart[i] = SPEED_GAIN * (d.velocity[i] - p.believed[i])
        p.believed[i] += h * (p.model[i] + p.apart[i])
    p.load[Load.STARTED] = 1.0
    p.load[Load.CALM] = p.load[Load.CALM] + h if learning > STILL else 0.0
    p.load[Load.LEFT] = AFTER if p.load[Load.CALM] >= CALM else p.load[Load.LEFT] - h
    square, alike, known, whole, moved = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(BASE, d.size):
        own, moving = d.force[i], 0.0
        for j in range(d.size):
            own += d.mass[i * d.size + j] * p.apart[j]
            moving += d.mass[i * d.size + j] * p.model[j]
        square += p.weight[i] * p.weight[i]
        alike += p.weight[i] * own
        known += p.weight[i] * d.force[i]
        whole += own * own
        moved += moving * moving
    if square == 0.0:
        return 0.0, 0.0
    kilograms, changing = alike / square, p.load[Load.CHANGING] > 0.0
    size = abs(kilograms) * np.sqrt(square)
    enough = abs(kilograms) > ENDS
    if not changing:
        enough = abs(kilograms) > max(BEGINS, UNEXPLAINED * np.sqrt(moved / square)) and p.load[Load.LEFT] > 0.0
    unlike = np.sqrt(max(whole - size * size, 0.0))
    p.load[Load.CHANGING] = 1.0 if enough and unlike < UNLIKE * size else 0.0
    if p.load[Load.CHANGING] == 0.0:
        return 0.0, 0.0
    return h * MASS_GAIN * kilograms, min(max(known / (square * kilograms), 0.0), 1.0)


@step
def update_mass(d: Disturbance, p: Payload, learning: float, h: float) -> None:
    """The mass of this tick, at once where a load comes or goes, else as it is learned; the force goes without it. What is known of the
    disturbance is that of :func:`wbmpc.bases.ball.disturbance.observe`, ``h`` [s] ago."""
    if not arm_observes_mass(d.size, p.weight, p.spreads):
        return
    for i in range(d.size):
        p.model[i] = (d.after[i] - d.velocity[i] + d.innovation[i]) / h
    by, known = detect_change(d, p, learning, h)
    if p.load[Load.CHANGING] > 0.0:
        change(d.size, p.weight, d.force, p.load, by, known)
    else:
        learn(d.size, p.weight, d.force, p.load, p.spreads, learning * h)
