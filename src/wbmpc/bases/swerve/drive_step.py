"""Dry friction of drives that follow speeds, compiled: see :class:`wbmpc.bases.swerve.drives.DryFriction`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.bases.swerve.compilation import step
from wbmpc.kernel.ir import Floats

#: Time [s] of turning over which friction is learned; the most that is taken for it, speeds below which a drive may stick and
#: shows nothing, and below which the sign of a command is not trusted [rad/s].
LEARNED_IN, MAXIMUM, TURNS, SLOW = 1.0, 0.1, 0.05, 0.02


class Friction(NamedTuple):
    """Drives (n) with a lag, and their dry friction."""

    n: int
    droop: Floats  # (n) [rad/s], what friction takes
    command: Floats  # (n) [rad/s]
    rate: Floats  # (n) [rad/s], what drives make of it at the end of a period
    mean: Floats  # (n) [rad/s], and on the average of it
    turned: Floats  # (n) [rad], measured
    target: Floats  # (n) [rad/s]
    maximum: Floats  # (n) [rad/s], of the command
    change: Floats  # (n) [rad/s], of the command in a period, at most
    blend: float  # share of the way to a command that drives go in a period
    late: float  # blend · lag / period


@step
def learn(f: Friction, h: float) -> None:
    """``droop`` from joints that ``turned`` in h [s] while ``mean`` was to be expected."""
    mean, droop = f.mean, f.droop
    share = 1.0 - np.exp(-h / LEARNED_IN)
    for i in range(f.n):
        if abs(mean[i]) > TURNS:
            lacks = mean[i] - f.turned[i] / h
            if mean[i] < 0.0:
                lacks = -lacks
            droop[i] = min(max(droop[i] + share * (lacks - droop[i]), 0.0), MAXIMUM)


@step
def drive(f: Friction) -> None:
    """The ``command`` for a ``target``, and what drives make of it."""
    command, rate, target, maximum, change = f.command, f.rate, f.target, f.maximum, f.change
    for i in range(f.n):
        given = target[i] + f.droop[i] * min(max(target[i] / SLOW, -1.0), 1.0)
        given = min(max(given, -maximum[i]), maximum[i])
        given = min(max(given, command[i] - change[i]), command[i] + change[i])
        behind = rate[i] - given
        command[i], f.mean[i], rate[i] = given, given + behind * f.late, given + behind * (1.0 - f.blend)


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
