"""Compiled code of trial points and the line search. SQP and single shooting share everything."""

from __future__ import annotations

import numpy as np

from wbmpc.solver.barriers import barrier_value
from wbmpc.solver.compilation import LANES, Floats, Integers, compiled
from wbmpc.solver.inequality_table import reset_violations
from wbmpc.solver.memory_layout import (
    DU,
    DU_LAST,
    DX,
    END_BOXES,
    END_COST,
    FILTER,
    GRID,
    LX,
    NP,
    NU,
    NX,
    PATH_BOXES,
    POLICY,
    QUATERNIONS,
    ROW_TRIAL,
    ROWS,
    SMALL,
    SOFT_EQUALITIES,
    STATE,
    UT,
    XT,
    K,
    N,
    P,
    Setting,
    StateField,
    U,
    X,
)
from wbmpc.solver.node_inequalities import collect_values, end_values, rows_merit, values_of_block
from wbmpc.solver.nonlinear_input_constraints import follow, hold_node
from wbmpc.solver.riccati import backward
from wbmpc.solver.settings import THRESHOLDS
from wbmpc.solver.simd_batch import cost_and_equalities, evaluate_rows, gaps, load_block
from wbmpc.solver.soft_equalities import soft_equality_terms_of_block
from wbmpc.solver.stages import interval, normalize, stage_end


@compiled
def policy_input(m: Floats, o: Integers, k: int, alpha: float) -> None:
    """Trial input of node k at the trial state: ū + α k + K (x − x̄)."""
    nx, nu, lx = o[NX], o[NU], o[LX]
    x, previous = o[XT] + k * nx, o[X] + k * nx
    for j in range(nu):
        row = o[K] + (k * nu + j) * lx
        total = m[o[U] + k * nu + j] + alpha * m[row + nx]
        for i in range(nx):
            total += m[row + i] * (m[x + i] - m[previous + i])
        m[o[UT] + k * nu + j] = total


@compiled
def roll_out_policy(m: Floats, o: Integers, x0: Floats, alpha: float) -> None:
    """The trial point of single shooting: the policy, feedback included, from ``x0`` on."""
    nx, hold = o[NX], m[o[STATE] + StateField.HOLD_INPUTS] > 0.0
    for i in range(nx):
        m[o[XT] + i] = x0[i]
    for k in range(o[N]):
        policy_input(m, o, k, alpha)
        if hold:
            hold_node(m, o, k, alpha)
        x = o[XT] + k * nx
        interval(m, o, k, x, o[UT] + k * o[NU], x + nx)


@compiled
def move(m: Floats, o: Integers, alpha: float) -> None:
    """The trial point of multiple shooting: a step of ``alpha``, in real time with inputs within the true rows."""
    n, nx, nu = o[N], o[NX], o[NU]
    for k in range(n + 1):
        for i in range(nx):
            m[o[XT] + k * nx + i] = m[o[X] + k * nx + i] + alpha * m[o[DX] + k * o[LX] + i]
    for i in range(n * nu):
        m[o[UT] + i] = m[o[U] + i] + alpha * m[o[DU] + i]
    if m[o[STATE] + StateField.HOLD_INPUTS] > 0.0:
        for k in range(n):
            policy_input(m, o, k, alpha)
            hold_node(m, o, k, alpha)
            follow(m, o, k, alpha)


@compiled
def trial(m: Floats, o: Integers, x0: Floats, alpha: float, single: bool) -> tuple[float, float]:
    """Cost and violation (1-norm of gaps, equalities, rows and start) at step length ``alpha``; fills the trial point.
    Equalities that are soft have a variable of their own.

    ``single``: the policy is rolled out, feedback included; else states and inputs move along the step.
    """
    n, nx = o[N], o[NX]
    reset_violations(m, o)
    m[o[STATE] + StateField.TRIAL_POINTS] += 1.0
    if single:
        roll_out_policy(m, o, x0, alpha)
    else:
        move(m, o, alpha)
    cost, violation, of_rows, of_soft = 0.0, 0.0, 0.0, 0.0
    for i in range(nx):
        violation += abs(x0[i] - m[o[XT] + i])
    for block in range((n - 1) // LANES, -1, -1):  # the last nodes were used last, and are in the cache
        first = block * LANES
        count = min(LANES, n - first)
        load_block(m, o, first, count, o[XT], o[UT])
        if not single:
            violation += gaps(m, o, first, count, o[XT], o[UT])
        path_cost, equalities = cost_and_equalities(m, o)
        cost, violation = cost + path_cost, violation + equalities
        if o[SOFT_EQUALITIES] > 0:
            paid, apart, missed = soft_equality_terms_of_block(m, o, first, alpha)
            of_rows, violation, of_soft = of_rows + paid, violation + apart, of_soft + missed - apart
        evaluate_rows(m, o)
        values_of_block(m, o, first, count, (o[XT], o[UT]), o[ROW_TRIAL])
        for k in range(first, first + count):
            h, values = m[o[GRID] + k + 1] - m[o[GRID] + k], o[ROW_TRIAL] + (k - first) * o[ROWS]
            row_cost, row_violation = rows_merit(m, o, k, values, alpha)
            of_rows, violation = of_rows + h * row_cost, violation + h * row_violation
    last, small = o[XT] + n * nx, o[SMALL]
    stage_end(o, END_COST, last, o[P] + n * o[NP], small, small)
    cost += m[small] + barrier_value(m, o, o[PATH_BOXES], o[END_BOXES], last, last)
    end_values(m, o, last)
    collect_values(m, o, n, last, last, o[ROW_TRIAL])
    row_cost, row_violation = rows_merit(m, o, n, o[ROW_TRIAL], alpha)
    of_rows, violation = of_rows + row_cost, violation + row_violation
    m[o[STATE] + StateField.COST], m[o[STATE] + StateField.VIOLATION] = cost, violation + of_soft
    return cost + of_rows, violation


@compiled
def accept(
    cost: float,
    violation: float,
    base_cost: float,
    base_violation: float,
    slope: float,
    drop: float,
    penalty: float,
    alpha: float,
) -> bool:
    """Armijo's rule on the merit cost + penalty · violation (Nocedal and Wright 2006, equations 18.27 to 18.36).

    ``slope``, ``drop``: how fast the cost rises and the violation falls along the step.
    """
    merit, base = cost + penalty * violation, base_cost + penalty * base_violation
    rounding = 1e-9 * (1.0 + abs(base_cost) + penalty)  # of sums of many terms
    return np.isfinite(merit) and merit <= base + 1e-4 * alpha * (slope - penalty * drop) + rounding


@compiled
def accept_by_filter(
    m: Floats, o: Integers, costs: tuple[float, float, float, float], slope: float, alpha: float
) -> bool:
    """Filter: (cost, violation) of the trial point and of the iterate, in ``costs``; remembers the iterate when it helps.

    Source: Wächter and Biegler 2006, "On the implementation of an interior-point filter line-search algorithm", section 2.3.
    """
    cost, violation, base_cost, base_violation = costs
    rounding = 1e-9 * (1.0 + abs(base_cost))
    count = int(m[o[STATE] + StateField.FILTER_SIZE])
    if not (np.isfinite(cost) and np.isfinite(violation)):
        return False
    for i in range(min(count, 64)):
        c, v = m[o[FILTER] + 2 * i], m[o[FILTER] + 2 * i + 1]
        if cost >= c - 1e-5 * v + rounding and violation >= (1.0 - 1e-5) * v:
            return False
    if slope < 0.0 and alpha * (-slope) ** 2.3 > base_violation**1.1 and base_violation < 1e-4:
        return cost <= base_cost + 1e-4 * alpha * slope + rounding
    better = violation <= (1.0 - 1e-5) * base_violation or cost <= base_cost - 1e-5 * base_violation + rounding
    if better and base_violation > 1e-10:
        i = count % 64
        m[o[FILTER] + 2 * i], m[o[FILTER] + 2 * i + 1] = base_cost, base_violation
        m[o[STATE] + StateField.FILTER_SIZE] = count + 1.0
    return better


@compiled
def take(m: Floats, o: Integers) -> None:
    """The trial point becomes the iterate."""
    n, nx = o[N], o[NX]
    for i in range((n + 1) * nx):
        m[o[X] + i] = m[o[XT] + i]
    for i in range(n * o[NU]):
        m[o[U] + i] = m[o[UT] + i]
    if o[QUATERNIONS] > 0:
        for k in range(n + 1):
            normalize(m, o, o[X] + k * nx)


@compiled
def roll_out(m: Floats, o: Integers, x0: Floats) -> None:
    """A motion from ``x0``, what single shooting starts from: by the last policy, or by feedback around the guess (without it
    an unstable model would leave the guess at once), or open loop where that is not finite."""
    if o[POLICY] == 0:
        backward(m, o, False)
    cost, violation = trial(m, o, x0, 0.0, True)
    if not (np.isfinite(cost) and np.isfinite(violation)):
        for i in range(o[N] * o[NU] * o[LX]):
            m[o[K] + i] = 0.0
        trial(m, o, x0, 0.0, True)
    take(m, o)


@compiled
def next_longest(longest: float, last: float, along: float) -> float:
    """Longest step to try after a step of ``last``, when ``along`` of the direction before is in the new one.

    Where the subproblem's curvature is too small by a factor c, a step α leaves 1 − c α of the direction: c = (1 − along) / α, and
    1/c arrives (Aitken's Δ²; Nocedal and Wright 2006, section 3.5, has it as a secant of the slope).
    """
    longer = min(1.5 * longest, 1.0)
    return min(max(last / (1.0 - along), THRESHOLDS.overshot), longer) if along < 0.5 else longer


@compiled
def compare_with_last(m: Floats, o: Integers) -> tuple[float, float]:
    """(Product of the new direction with that of the iteration before, square of the latter); the new one is kept."""
    along, size = 0.0, 0.0
    for i in range(o[N] * o[NU]):
        new, old = m[o[DU] + i], m[o[DU_LAST] + i]
        along, size = along + new * old, size + old * old
        m[o[DU_LAST] + i] = new
    return along, size


@compiled
def longest_step(m: Floats, o: Integers, first: bool) -> float:
    """Longest step to try, from how the direction has turned since the last iteration of the same solve; keeps the direction.

    ``first``: this is the solve's first one, or μ is another one. Between solves the measured state has changed too, so nothing can be
    reported."""
    state = o[STATE]
    along, size = compare_with_last(m, o)
    if m[state + StateField.MAX_STEP] == 0.0:
        m[state + StateField.MAX_STEP] = 1.0
    elif first:
        m[state + StateField.MAX_STEP] = min(1.1 * m[state + StateField.MAX_STEP], 1.0)
    elif size > 0.0:
        m[state + StateField.MAX_STEP] = next_longest(
            m[state + StateField.MAX_STEP], m[state + StateField.LAST_STEP], along / size
        )
    return m[state + StateField.MAX_STEP]


@compiled
def search(
    m: Floats, o: Integers, x0: Floats, s: Floats, base: tuple[float, float, float, float], penalty: float, first: float
) -> tuple[float, float]:
    """Step length from ``first`` down, 0 when none is accepted; the trial point is filled. ``base``: cost, violation,
    slope, drop. Returns (α, cost at the trial point).

    A first step that opens gaps more than it closes violations is tried again as a motion, by the policy: its gaps are closed, as by a
    second-order correction (Nocedal and Wright 2006, sections 15.5 and 15.6)."""
    cost, violation, slope, drop = base
    reach, single, ratio = m[o[STATE] + StateField.MAX_PRIMAL_STEP], s[Setting.SINGLE_SHOOTING] > 0.0, first
    corrects = s[Setting.COMPUTE_KKT] > 0.0 and not single and s[Setting.USE_FILTER] == 0.0
    while ratio >= s[Setting.MIN_STEP]:
        alpha = ratio * reach
        c, v = trial(m, o, x0, alpha, single)
        if s[Setting.USE_FILTER] > 0.0:
            if accept_by_filter(m, o, (c, v, cost, violation), slope, alpha):
                return alpha, c
        elif accept(c, v, cost, violation, slope, drop, penalty, alpha):
            return alpha, c
        if corrects and ratio == first and v > violation:
            c, v = trial(m, o, x0, alpha, True)
            if accept(c, v, cost, violation, slope, drop, penalty, alpha):
                return alpha, c
        ratio *= 0.5
    if s[Setting.ACCEPT_MIN_STEP] > 0.0:
        c, v = trial(m, o, x0, first * reach, single)
        if np.isfinite(c) and np.isfinite(v):
            return first * reach, c
    return 0.0, np.inf
