"""Compiled code of eight rows side by side: their part of the subproblem, of the merit, and the steps of slacks and multipliers.

The formulas are in :mod:`wbmpc.solver.inequalities`.
"""

from __future__ import annotations

import numpy as np

from wbmpc.solver.compilation import LANES, Floats, Integers, Vector, compiled
from wbmpc.solver.inequality_table import EQUAL, HARD, MULTIPLIER
from wbmpc.solver.memory_layout import LANES_OUT


@compiled
def weights(
    kind: Vector, h: Vector, t: Vector, lam: Vector, s: Vector, y: Vector, penalty: Vector, mu: float
) -> tuple[Vector, Vector]:
    """(σ, e)."""
    closed = penalty < np.inf
    scale, rest = np.where(closed, y, 1.0), np.where(closed, s * lam, 0.0)
    inverse = 1.0 / (lam * scale)  # divisions are what a row costs
    sigma = lam * scale / (t * scale + rest)
    e = h - mu * inverse * np.where(closed, y - lam, 1.0) - t - rest * lam * inverse
    if np.all(kind == HARD):
        return sigma, e
    other = np.where(kind == EQUAL, penalty, np.where(lam > penalty * h, penalty, 0.0))
    signed = np.where(kind == EQUAL, lam, -lam) / penalty
    return np.where(kind == HARD, sigma, other), np.where(kind == HARD, e, h + signed)


@compiled
def merits(
    kind: Vector, h: Vector, t: Vector, lam: Vector, s: Vector, penalty: Vector
) -> tuple[Vector, Vector, Vector]:
    """(cost without logarithms, violation, what the logarithms are taken of)."""
    hard, closed = kind == HARD, penalty < np.inf
    cost, violation = np.where(closed, penalty * s, 0.0), abs(h + np.where(closed, s, 0.0) - t)
    product = np.where(hard, t * np.where(closed, s, 1.0), 1.0)
    if np.all(hard):
        return cost, violation, product
    pull = np.maximum(lam - penalty * h, 0.0)
    other = np.where(kind == MULTIPLIER, 0.5 * (pull * pull - lam * lam) / penalty, 0.0)
    missing = np.where(kind == MULTIPLIER, 0.0, abs(h))
    return np.where(hard, cost, other), np.where(hard, violation, missing), product


@compiled
def steps(
    t: Vector, lam: Vector, s: Vector, y: Vector, penalty: Vector, following: Vector, ahead: Vector, mu: float
) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector]:
    """(δt, δs, δl, largest −δt/t or −δs/s, largest −δl/l or −δy/y, slope of logarithms and slack) of hard rows.

    ``following``: next multiplier; ``ahead`` = h + J δz.
    """
    closed = penalty < np.inf
    y, s = np.where(closed, y, 1.0), np.where(closed, s, 1.0)
    inverse, other = 1.0 / (lam * y), 1.0 / (t * s)
    by_l, by_y, by_t, by_s = y * inverse, lam * inverse, s * other, t * other
    dl = following - lam
    dt, ds = (mu - t * dl) * by_l - t, (mu + s * dl) * by_y - s
    carried = s * lam > t * y  # by the slack: δl is the small difference of large numbers
    ds = np.where(carried, t + dt - ahead - s, ds)
    dl = np.where(closed & carried, y - (mu - y * ds) * by_s, dl)
    slack_slope = np.where(closed, ds * (penalty - mu * by_s), 0.0)
    shrink = np.maximum(-dt * by_t, np.where(closed, -ds * by_s, 0.0))
    fall = np.maximum(-dl * by_l, np.where(closed, dl * by_y, 0.0))
    return dt, np.where(closed, ds, 0.0), dl, shrink, fall, slack_slope - mu * dt * by_t


@compiled
def log_of_product(m: Floats, o: Integers, product: Vector) -> float:
    """Σ log of eight numbers, with as few logarithms as their sizes allow."""
    lanes, total, one = o[LANES_OUT], 0.0, 1.0
    m[lanes : lanes + LANES] = product
    for i in range(LANES):
        if not 1e-200 < one < 1e200:
            total += np.log(one)
            one = 1.0
        if 1e-100 < m[lanes + i] < 1e100:
            one *= m[lanes + i]
        else:
            total += np.log(m[lanes + i])
    return total + np.log(one)
