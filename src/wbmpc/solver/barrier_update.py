"""Compiled code of the interior point's μ from one iteration to the next.

While the optimality error falls, μ follows the products of slacks and multipliers (the rule of LOQO: Vanderbei and Shanno 1999, "An
interior-point algorithm for nonconvex nonlinear programming", section 4). Where the error has not fallen for several iterations, μ
stays until its barrier problem is solved, and then falls by the monotone rule of Fiacco and McCormick. Source of the switch between
both: Nocedal, Wächter and Waltz 2009, "Adaptive barrier update strategies for nonlinear interior methods", section 4.
"""

from __future__ import annotations

import numpy as np

from wbmpc.solver.compilation import Floats, compiled
from wbmpc.solver.memory_layout import StateField
from wbmpc.solver.settings import THRESHOLDS


@compiled
def next_mu(mu: float, last: float, error: float, complementarity: float) -> float:
    """μ for the next iteration: smaller once the present barrier problem is solved well enough (monotone rule)."""
    while mu > last and max(error, complementarity - mu) <= 10.0 * mu:
        mu = max(last, min(0.2 * mu, mu**1.5))
    return mu


@compiled
def real_time_mu(mu: float, level: float, reach: float) -> float:
    """μ after a step in real time: where it was raised it falls with steps of which slacks allow more than half (``reach``)."""
    return max(level, 0.1 * mu) if reach > 0.5 else mu


@compiled
def raised_mu(mu: float, most: float, reach: float) -> float:
    """A larger μ, at most ``most``, where slacks cut a step to ``reach``: where the barrier decides how far steps go, they grow with it."""
    return min(mu / max(reach, 1e-3), most)


@compiled
def start_adaptive(m: Floats, state: int) -> None:
    """No error is known, and μ follows the products."""
    m[state + StateField.FREE_BARRIER] = 1.0
    for i in range(THRESHOLDS.error_memory):
        m[state + StateField.ERRORS + i] = np.inf


@compiled
def adaptive_mu(
    m: Floats,
    state: int,
    monotone: float,
    errors: tuple[float, float],
    products: tuple[float, float],
    step: float,
    level: float,
) -> float:
    """μ for the next iteration.

    ``monotone``: the monotone rule's; ``errors``: of the optimality conditions with products of 0 and of μ; ``products``: (mean,
    smallest) of slacks and multipliers after the step; ``step``: the longest that slacks allowed; ``level``: how far μ may fall."""
    error, of_barrier = errors
    mean, smallest = products
    worst = 0.0
    for i in range(THRESHOLDS.error_memory):
        worst = max(worst, m[state + StateField.ERRORS + i])
    falls = error <= THRESHOLDS.error_decrease * worst and step >= THRESHOLDS.short
    free = m[state + StateField.FREE_BARRIER] > 0.0
    if not free and falls and of_barrier <= 10.0 * m[state + StateField.BARRIER]:
        free = True
    elif free and not falls:
        m[state + StateField.FREE_BARRIER] = 0.0
        return max(0.8 * mean, level)
    m[state + StateField.FREE_BARRIER] = 1.0 if free else 0.0
    if not free:
        return monotone
    for i in range(THRESHOLDS.error_memory - 1):
        m[state + StateField.ERRORS + THRESHOLDS.error_memory - 1 - i] = m[
            state + StateField.ERRORS + THRESHOLDS.error_memory - 2 - i
        ]
    m[state + StateField.ERRORS] = error
    evenness = max(smallest / mean, 1e-10)
    centering = 0.1 * min(0.05 * (1.0 - evenness) / evenness, 2.0) ** 3
    return max(max(centering * mean, THRESHOLDS.steepest * mean**1.5), level)
