"""Time grids of the horizon."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import real_number
from wbmpc.errors import InputError

#: A horizon is at most so many times its first interval.
LONGEST = 1e6
#: Intervals of a problem; seconds of its horizon.
MAX_INTERVALS, MAX_HORIZON = 100_000, 1e6


def uniform_grid(horizon: float, intervals: int) -> Array:
    """Times of the ``intervals + 1`` nodes [s], equally spaced, from 0 to ``horizon``."""
    _check(horizon, intervals)
    return np.linspace(0.0, horizon, intervals + 1)


def geometric_grid(horizon: float, intervals: int, first: float) -> Array:
    """Times of the nodes [s] of a grid that is fine near now and coarse far away.

    The first interval is ``first`` [s]; each interval is a constant ratio longer than the one before it, and the
    ratio is chosen so that the last node is at ``horizon``.
    """
    _check(horizon, intervals)
    first = real_number("first_interval", first)
    if not 0.0 < first <= horizon / intervals:
        raise InputError(
            f"first_interval: {first:g} s must be positive and at most horizon / intervals = {horizon / intervals:g} s"
        )
    if first * LONGEST < horizon:
        raise InputError(
            f"first_interval: {first:g} s is too short for a horizon of {horizon:g} s; valid: at least {horizon / LONGEST:g} s"
        )
    low, high = 1.0, 2.0 + horizon / first
    powers = np.arange(intervals)
    for _ in range(200):
        ratio = 0.5 * (low + high)
        with np.errstate(over="ignore"):  # an infinite length is too long, which is what the comparison says
            length = first * np.sum(ratio**powers)
        low, high = (ratio, high) if length < horizon else (low, ratio)
    steps = first * low**powers
    return np.concatenate([[0.0], np.cumsum(steps * horizon / steps.sum())])


def _check(horizon: float, intervals: int) -> None:
    if isinstance(intervals, bool) or not isinstance(intervals, (int, np.integer)) or intervals < 1:
        raise InputError(f"intervals: a whole number of intervals is needed, at least one, got {intervals!r}")
    if intervals > MAX_INTERVALS:
        raise InputError(f"intervals: at most {MAX_INTERVALS} are possible, got {intervals}")
    if (
        isinstance(horizon, bool)
        or not isinstance(horizon, (int, float, np.integer, np.floating))
        or not 0.0 < horizon <= MAX_HORIZON
    ):
        raise InputError(f"horizon: must be a positive time in seconds, at most {MAX_HORIZON:g}, got {horizon!r}")
