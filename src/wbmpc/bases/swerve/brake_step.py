"""Brakes of hinged legs, checked at one moment, compiled: see :class:`wbmpc.bases.swerve.brake_monitor.BrakeMonitor`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.bases.swerve.compilation import step
from wbmpc.kernel.ir import Floats


class Brakes(NamedTuple):
    """Legs (n), their brakes, and what a monitor remembers of them."""

    n: int
    angle: Floats  # (n) [rad], measured
    brake: Floats  # (n), 1 = open
    rate: Floats  # (n) [rad/s], planned
    opened: Floats  # (n), the brakes at the last call
    since: Floats  # (n) [s], when that changed
    anchor: Floats  # (n) [rad], where motion is counted from
    gone: Floats  # (n) [rad], motion since
    planned: Floats  # (n) [rad], motion that was planned since, fading
    resting: Floats  # (n) [s], since the anchor
    reported: Floats  # (n), 1 for legs with a fault
    settled: Floats  # (n), 1 for brakes that have had time to answer
    crawl: Floats  # (n) [rad/s], planned rates that do not count
    expected: Floats  # (n) [rad], planned motion after which a loose leg must have moved
    moved: float  # [rad], motion of a leg that is held
    still: float  # [rad], motion that is none
    window: float  # [s], time constant of planned motion
    settle: float  # [s], that a brake takes
    patience: float  # [s], before a loose leg that stands is judged
    creep: float  # [rad/s], of legs that are held


@step
def monitor_brakes(b: Brakes, t: float, h: float, unsettled: float) -> tuple[float, int]:
    """Take in what is measured at ``t`` [s], ``h`` [s] after the call before. Returns since when legs that were reported have not been
    held in the plan (``unsettled`` [s]), and how many legs are to be judged: those reported, and those whose brake seems not to answer."""
    any_stuck = False
    for i in range(b.n):
        is_open = 1.0 if b.brake[i] > 0.5 else 0.0
        if is_open != b.opened[i]:
            b.since[i], b.reported[i], b.opened[i] = t, 0.0, is_open
        b.settled[i] = 1.0 if t - b.since[i] >= b.settle - 1e-9 else 0.0
        if b.reported[i] > 0.0 and is_open > 0.0:
            any_stuck = True
            if abs(b.rate[i]) > b.crawl[i]:
                unsettled = t
    waits = any_stuck and t - unsettled < b.settle
    forgotten, count = np.exp(-h / b.window), 0
    for i in range(b.n):
        apart = b.angle[i] - b.anchor[i]
        loose = b.opened[i] > 0.0 or b.reported[i] > 0.0  # may move, as far as is known
        # a leg counts from where it was when its brake had settled; a loose one from where it was last seen to move
        afresh = b.settled[i] == 0.0 or (loose and (abs(apart) > b.still or (waits and b.reported[i] == 0.0)))
        if afresh:
            b.anchor[i], b.planned[i], b.resting[i] = b.angle[i], 0.0, 0.0
        else:
            if not loose:
                b.anchor[i] += min(max(apart, -h * b.creep), h * b.creep)
            counted = max(b.rate[i] - b.crawl[i], 0.0) - max(-b.rate[i] - b.crawl[i], 0.0)
            b.planned[i], b.resting[i] = forgotten * b.planned[i] + h * counted, b.resting[i] + h
        b.gone[i] = b.angle[i] - b.anchor[i]
        stands = abs(b.planned[i]) > b.expected[i] and b.resting[i] >= b.patience - 1e-9
        odd = stands if b.opened[i] > 0.0 else abs(b.gone[i]) > b.moved
        if b.reported[i] > 0.0 or (b.settled[i] > 0.0 and odd):
            count += 1
    return unsettled, count
