"""Dry friction of drives that follow speeds, compiled: see :class:`wbmpc.control.drives.DryFriction`."""

from __future__ import annotations

import numpy as np

from wbmpc.control.compilation import step
from wbmpc.kernel.ir import Floats

#: Time [s] of turning over which friction is learned; the most that is taken for it, speeds below which a drive may stick and
#: shows nothing, and below which the sign of a command is not trusted [rad/s].
LEARNED_IN, MAXIMUM, TURNS, SLOW = 1.0, 0.1, 0.05, 0.02


@step
def learn(n: int, droop: Floats, mean: Floats, turned: Floats, h: float) -> None:
    """``droop`` (n) [rad/s] from joints that ``turned`` (n) [rad] in h [s] while ``mean`` (n) [rad/s] was to be expected."""
    share = 1.0 - np.exp(-h / LEARNED_IN)
    for i in range(n):
        if abs(mean[i]) > TURNS:
            lacks = mean[i] - turned[i] / h
            if mean[i] < 0.0:
                lacks = -lacks
            droop[i] = min(max(droop[i] + share * (lacks - droop[i]), 0.0), MAXIMUM)


@step
def drive(
    n: int, droop: Floats, command: Floats, rate: Floats, mean: Floats, target: Floats, maximum: Floats, change: Floats,
    blend: float, late: float,
) -> None:  # fmt: skip
    """The ``command`` (n) [rad/s] for a ``target`` (n), within ± ``maximum`` and by ``change`` at most beside the one before; ``rate`` and
    ``mean``: what drives make of it, at the end of the period and on the average of it."""
    for i in range(n):
        given = target[i] + droop[i] * min(max(target[i] / SLOW, -1.0), 1.0)
        given = min(max(given, -maximum[i]), maximum[i])
        given = min(max(given, command[i] - change[i]), command[i] + change[i])
        behind = rate[i] - given
        command[i], mean[i], rate[i] = given, given + behind * late, given + behind * (1.0 - blend)


@step
def smooth(
    n: int, read: Floats, rates: Floats, value: Floats, started: bool, age: float, time: float, h: float
) -> None:
    """``value`` (n): positions at a message, whose encoders ``read`` (n) ``age`` [s] before it on average, h [s] after the message before
    (``started``: there was one); ``rates`` (n): what drives should have moved at. Messages correct it over ``time`` [s]."""
    share = 1.0 - np.exp(-h / time)
    for i in range(n):
        now = read[i] + rates[i] * age
        if not started:
            value[i] = now
        elif h > 0.0:
            carried = value[i] + rates[i] * h
            value[i] = carried + share * (now - carried)
