"""Compiled code that decides how a solve goes on: what counts as converged, and the statuses that it can end with."""

from __future__ import annotations

import numpy as np

from wbmpc.solver.barrier_update import next_mu
from wbmpc.solver.compilation import Floats, Integers, compiled
from wbmpc.solver.infeasibility import detect_infeasibility
from wbmpc.solver.memory_layout import (
    DU,
    DX,
    EPS,
    EXACT,
    LX,
    NG,
    NU,
    NX,
    STATE,
    K,
    N,
    Setting,
    StateField,
    U,
    X,
)
from wbmpc.solver.riccati import backward, first_equalities
from wbmpc.solver.settings import THRESHOLDS
from wbmpc.solver.stages import row_count

CONVERGED, ITERATION_LIMIT, LINE_SEARCH_FAILED, NOT_FINITE, DIVERGED, INPUT_INFEASIBLE, EQUALITY_INFEASIBLE = range(7)


#: No status of a solution: Gauss-Newton steps contract the error too slowly.
STALLED = 7


#: No statuses either: the solve continues, or the direction is computed once more.
CONTINUE, RETRY = -1, -2


@compiled
def moved(m: Floats, o: Integers) -> float:
    """The largest relative step: of each entry over 1 + |x| or 1 + |u|.

    Where only a logarithm depends on a variable its gradient fades towards infinity, and every step doubles it.
    """
    n, nx, nu, lx = o[N], o[NX], o[NU], o[LX]
    largest = 0.0
    for k in range(n + 1):
        for i in range(nx):
            largest = max(largest, abs(m[o[DX] + k * lx + i]) / (1.0 + abs(m[o[X] + k * nx + i])))
    for i in range(n * nu):
        largest = max(largest, abs(m[o[DU] + i]) / (1.0 + abs(m[o[U] + i])))
    return largest


@compiled
def met(m: Floats, o: Integers, violation: float, equalities: float, limit: float) -> bool:
    """Whether the constraints are met. Equality rows with a softness keep a residual, which is theirs once nothing moves."""
    if m[o[STATE] + StateField.MAX_ROW_RESIDUAL] > limit:
        return False
    soft = False
    for j in range(o[NG]):
        soft = soft or m[o[EPS] + j] > 1e-13
    return violation <= limit or (soft and violation - equalities <= limit and moved(m, o) <= THRESHOLDS.at_rest)


@compiled
def make_convex(m: Floats, o: Integers, s: Floats) -> bool:
    """Fewer second derivatives, then a larger shift, for a subproblem that is not convex; whether there is one to try."""
    state = o[STATE]
    if o[EXACT] > 0 and m[state + StateField.SECOND_ORDER_SHARE] > 0.0:
        m[state + StateField.SECOND_ORDER_SHARE] = (
            0.25 * m[state + StateField.SECOND_ORDER_SHARE] if m[state + StateField.SECOND_ORDER_SHARE] > 0.02 else 0.0
        )
        return True
    m[state + StateField.SHIFT] = max(10.0 * m[state + StateField.SHIFT], 1e-6)
    return m[state + StateField.SHIFT] <= s[Setting.MAX_REGULARIZATION]


@compiled
def misses_equality(m: Floats, o: Integers, s: Floats) -> bool:
    """Whether, in real time, the plan's first input misses an equality by more than ``equality_bound``."""
    return s[Setting.KEEP_MULTIPLIERS] > 0.0 and o[NG] > 0 and first_equalities(m, o) > s[Setting.EQUALITY_BOUND]


@compiled
def status_at_iteration_limit(m: Floats, o: Integers, s: Floats, status: int) -> int:
    """``status`` of a solve that has done its iterations, unless, in real time, its plan cannot be used."""
    if m[o[STATE] + StateField.INPUT_VIOLATION] > THRESHOLDS.limit_tolerance:
        return INPUT_INFEASIBLE
    if misses_equality(m, o, s):
        return EQUALITY_INFEASIBLE
    if s[Setting.KEEP_MULTIPLIERS] > 0.0:
        return EQUALITY_INFEASIBLE if detect_infeasibility(m, o, s) else status
    return status


@compiled
def extend_iterations(m: Floats, o: Integers, s: Floats, cut: bool, hold: float, limit: int) -> int:
    """How many iterations there are to be after the last of ``limit``; ``cut``: its step was.
    There are more while μ is raised, too: a plan that keeps far from limits is a slow one.

    Where inputs are still outside, a last one holds them within the rows."""
    state = o[STATE]
    short = (
        cut
        or m[state + StateField.BARRIER] > s[Setting.BARRIER]
        or max(m[state + StateField.INPUT_VIOLATION], m[state + StateField.UNRELAXED_VIOLATION])
        > THRESHOLDS.limit_tolerance
    )
    if limit < int(s[Setting.ITERATIONS]) + int(s[Setting.MAX_EXTRA_ITERATIONS]) and (
        short or misses_equality(m, o, s)
    ):
        return limit + 1
    if (
        m[state + StateField.INPUT_VIOLATION] > THRESHOLDS.limit_tolerance
        and s[Setting.KEEP_MULTIPLIERS] > 0.0
        and hold + o[NG] == 0.0
    ):
        m[state + StateField.HOLD_INPUTS] = 2.0
        return limit + 1
    return limit


@compiled
def is_minimum(m: Floats, o: Integers) -> bool:
    """Whether the exact Hessian is positive definite where dynamics and equalities let the step go, hard rows counted by their
    barrier: the recursion's factors, with all second derivatives and without shift, are then finite. Keeps the gains.
    """
    state, found = o[STATE], True
    theta, shift = m[state + StateField.SECOND_ORDER_SHARE], m[state + StateField.SHIFT]
    if theta == 1.0 and shift == 0.0:  # as it was solved
        return True
    m[state + StateField.SECOND_ORDER_SHARE], m[state + StateField.SHIFT] = 1.0, 0.0
    backward(m, o, False)
    for i in range(o[N] * o[NU] * o[LX]):
        found = found and np.isfinite(m[o[K] + i])
    m[state + StateField.SECOND_ORDER_SHARE], m[state + StateField.SHIFT] = theta, shift
    backward(m, o, False)
    return found


@compiled
def direction_status(
    m: Floats, o: Integers, s: Floats, log: Floats, row: int, found: tuple[float, float, float, float], size: float
) -> int:
    """The status that a direction ends a solve with, RETRY where it is to be sought once more with a convex subproblem, or CONTINUE.
    ``found``: cost, violation, largest component, slope; ``size``: of cost and state at the start."""
    cost, violation, largest, slope = found
    if not (np.isfinite(cost) and np.isfinite(violation) and np.isfinite(slope)):
        known = np.isfinite(cost) and np.isfinite(violation)
        log[row + 2] = np.nan
        if known and s[Setting.MAX_REGULARIZATION] > 0.0 and make_convex(m, o, s):
            return RETRY
        return NOT_FINITE
    if abs(cost) > THRESHOLDS.divergence * size or largest > THRESHOLDS.divergence * size:
        return DIVERGED
    return CONTINUE


@compiled
def convergence_status(
    m: Floats, o: Integers, s: Floats, feasible: bool, kkt: float, barrier: tuple[float, float, float]
) -> tuple[float, float, float]:
    """(CONVERGED, RETRY where the barrier problem is solved and μ has been lowered, or CONTINUE; next level and bias).

    ``barrier``: the level that μ is to fall to, μ of the iteration before, and how far the plan would still move with μ."""
    level, last_mu, bias = barrier
    state, compute_kkt, rows = o[STATE], s[Setting.COMPUTE_KKT] > 0.0, row_count(o) > 0
    mu, product = m[state + StateField.BARRIER], m[state + StateField.MAX_COMPLEMENTARITY]
    if compute_kkt and mu < last_mu:
        bias = moved(m, o) * mu / (last_mu - mu)
    last = mu <= level or not rows
    # where rounding of one multiplier holds back the steps of all
    close = 100.0 if m[state + StateField.MAX_DUAL_STEP] < THRESHOLDS.short else 10.0
    solved = compute_kkt and kkt <= s[Setting.TOLERANCE] and feasible and product <= close * mu
    if solved and (not last or moved(m, o) <= THRESHOLDS.settled):
        if last and (not rows or bias <= THRESHOLDS.bias or mu <= s[Setting.MIN_BARRIER]):
            return 1.0 * CONVERGED, level, bias
        level = max(0.2 * mu, s[Setting.MIN_BARRIER]) if last else level
        m[state + StateField.BARRIER], m[state + StateField.FILTER_SIZE] = next_mu(mu, level, 0.0, mu), 0.0
        return 1.0 * RETRY, level, bias
    return 1.0 * CONTINUE, level, bias
