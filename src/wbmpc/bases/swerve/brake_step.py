"""A look at the brakes of hinged legs, compiled: see :class:`wbmpc.bases.swerve.brake_monitor.BrakeMonitor`."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.swerve.compilation import step
from wbmpc.kernel.ir import Floats


@step
def monitor_brakes(
    n: int, angle: Floats, brake: Floats, rate: Floats, opened: Floats, since: Floats, anchor: Floats, gone: Floats,
    planned: Floats, resting: Floats, reported: Floats, settled: Floats, crawl: Floats, expected: Floats, moved: float,
    still: float, window: float, settle: float, patience: float, creep: float, t: float, h: float, unsettled: float,
) -> tuple[float, int]:  # fmt: skip
    """Take in measured angles ``angle`` (n) [rad] at ``t`` [s], ``h`` [s] after the look before, under ``brake`` (n, 1 = open) and
    planned rates ``rate`` (n) [rad/s]. Returns since when legs that were reported have not been held in the plan (``unsettled`` [s]),
    and how many legs are to be judged: those reported, and those whose brake seems not to answer."""
    any_stuck = False
    for i in range(n):
        is_open = 1.0 if brake[i] > 0.5 else 0.0
        if is_open != opened[i]:
            since[i], reported[i], opened[i] = t, 0.0, is_open
        settled[i] = 1.0 if t - since[i] >= settle - 1e-9 else 0.0
        if reported[i] > 0.0 and is_open > 0.0:
            any_stuck = True
            if abs(rate[i]) > crawl[i]:
                unsettled = t
    waits = any_stuck and t - unsettled < settle
    forgotten, count = np.exp(-h / window), 0
    for i in range(n):
        apart = angle[i] - anchor[i]
        loose = opened[i] > 0.0 or reported[i] > 0.0  # may move, as far as is known
        # a leg counts from where it was when its brake had settled; a loose one from where it was last seen to move
        afresh = settled[i] == 0.0 or (loose and (abs(apart) > still or (waits and reported[i] == 0.0)))
        if afresh:
            anchor[i], planned[i], resting[i] = angle[i], 0.0, 0.0
        else:
            if not loose:
                anchor[i] += min(max(apart, -h * creep), h * creep)
            counted = max(rate[i] - crawl[i], 0.0) - max(-rate[i] - crawl[i], 0.0)
            planned[i], resting[i] = forgotten * planned[i] + h * counted, resting[i] + h
        gone[i] = angle[i] - anchor[i]
        stands = abs(planned[i]) > expected[i] and resting[i] >= patience - 1e-9
        odd = stands if opened[i] > 0.0 else abs(gone[i]) > moved
        if reported[i] > 0.0 or (settled[i] > 0.0 and odd):
            count += 1
    return unsettled, count
