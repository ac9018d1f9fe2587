"""Compiled code of eight rows side by side: their part of the subproblem, of the merit, and the steps of slacks and multipliers.

The formulas are in :mod:`wbmpc.solver.inequalities`.
"""

from __future__ import annotations

import numpy as np

from wbmpc.solver.compilation import Vector, compiled
from wbmpc.solver.inequality_table import EQUAL, HARD, MULTIPLIER


@compiled
def weights(
    kind: Vector, h: Vector, t: Vector, lam: Vector, s: Vector, y: Vector, penalty: Vector, mu: float
) -> tuple[Vector, Vector]:
    """(σ, e)."""
    closed = penalty < np.inf
    scale, rest = np.where(closed, y, 1.0), np.where(closed, s * lam, 0.0)
    up, down = lam * scale, t * scale + rest
    both = 1.0 / (up * down)  # divisions are what a row costs
    inverse, sigma = down * both, up * up * both
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
    of_multipliers, of_slacks = lam * y, t * s
    both = 1.0 / (of_multipliers * of_slacks)
    inverse, other = of_slacks * both, of_multipliers * both
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
