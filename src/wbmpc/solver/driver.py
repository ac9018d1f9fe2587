"""Compiled code of a solve: directions, line search, interior point, statuses. SQP and single shooting share everything."""

from __future__ import annotations

import numpy as np

from wbmpc.solver.barriers import barrier_value
from wbmpc.solver.compilation import BOOL, INT, INT2, INTS, LANES, NONE, NUM, NUM2, NUM4, NUM6, NUMS, compiled
from wbmpc.solver.curved import follow, forget_outside, hold_node
from wbmpc.solver.lanes import cost_and_equalities, evaluate_rows, gaps, load_block, take_rows_of_lane
from wbmpc.solver.places import (
    COST,
    CURVED,
    DU,
    DU_LAST,
    DUAL,
    DX,
    END_BOXES,
    END_COST,
    EPS,
    EXACT,
    FILTER,
    FILTERED,
    GRID,
    HOLD,
    LAST_ALPHA,
    LEFT,
    LIMIT_TOLERANCE,
    LONGEST,
    LX,
    MISSED,
    MU,
    NG,
    NP,
    NU,
    NX,
    PATH_BOXES,
    POLICY,
    PRIMAL,
    PRODUCT,
    QUATERNIONS,
    RESIDUAL,
    RHO,
    ROW_COST,
    ROW_SLOPE,
    SHIFT,
    SMALL,
    STATE,
    THETA,
    UT,
    VIOLATION,
    XT,
    K,
    N,
    P,
    U,
    X,
)  # fmt: skip
from wbmpc.solver.riccati import backward, forward, kkt_residual
from wbmpc.solver.rows import end_values, rows_merit, rows_step, start_rows, take_rows
from wbmpc.solver.settings import AT_REST, BIAS, HUGE, UNSETTLED
from wbmpc.solver.stages import interval, normalise, row_count, stage_end
from wbmpc.solver.workspace import LOG

CONVERGED, ITERATION_LIMIT, NO_STEP, NOT_FINITE, DIVERGED, LIMIT_MISSED = range(6)

#: Settings of a solve, one array of numbers: see :mod:`wbmpc.solver.settings`.
SETTINGS = (
    "iterations",
    "tolerance",
    "feasibility",
    "smallest_step",
    "certify",
    "force_step",
    "single_shooting",
    "use_filter",
    "mu_start",
    "mu_end",
    "keep_multipliers",
    "least_slack",
    "tau",
    "extra_when_cut",
    "largest_shift",
    "keep_slacks",
    "mu_floor",
)
(
    ITERATIONS, TOLERANCE, FEASIBILITY, SMALLEST, CERTIFY, FORCE, SINGLE, USE_FILTER, MU_START, MU_END, KEEP, LEAST_SLACK, TAU,
    EXTRA, LARGEST_SHIFT, KEEP_SLACKS, MU_FLOOR,
) = range(len(SETTINGS))  # fmt: skip
LOG_COLUMNS = len(LOG)
#: What overshooting directions shorten a step to at least.
SHORTEST = 0.15


@compiled(NONE, NUMS, INTS, INT, NUM)
def policy_input(m, o, k, alpha):  # type: ignore[no-untyped-def]
    """Trial input of node k at the trial state: ū + α k + K (x − x̄)."""
    nx, nu, lx = o[NX], o[NU], o[LX]
    x, before = o[XT] + k * nx, o[X] + k * nx
    for j in range(nu):
        row = o[K] + (k * nu + j) * lx
        total = m[o[U] + k * nu + j] + alpha * m[row + nx]
        for i in range(nx):
            total += m[row + i] * (m[x + i] - m[before + i])
        m[o[UT] + k * nu + j] = total


@compiled(NONE, NUMS, INTS, NUMS, NUM)
def roll_out_policy(m, o, x0, alpha):  # type: ignore[no-untyped-def]
    """The trial point of single shooting: the policy, feedback included, from ``x0`` on."""
    nx, hold = o[NX], m[o[STATE] + HOLD] > 0.0
    for i in range(nx):
        m[o[XT] + i] = x0[i]
    for k in range(o[N]):
        policy_input(m, o, k, alpha)
        if hold:
            hold_node(m, o, k, alpha)
        x = o[XT] + k * nx
        interval(m, o, k, x, o[UT] + k * o[NU], x + nx)


@compiled(NONE, NUMS, INTS, NUM)
def move(m, o, alpha):  # type: ignore[no-untyped-def]
    """The trial point of multiple shooting: a step of ``alpha``, in real time with inputs within the true rows."""
    n, nx, nu = o[N], o[NX], o[NU]
    for k in range(n + 1):
        for i in range(nx):
            m[o[XT] + k * nx + i] = m[o[X] + k * nx + i] + alpha * m[o[DX] + k * o[LX] + i]
    for i in range(n * nu):
        m[o[UT] + i] = m[o[U] + i] + alpha * m[o[DU] + i]
    if m[o[STATE] + HOLD] > 0.0:
        for k in range(n):
            policy_input(m, o, k, alpha)
            hold_node(m, o, k, alpha)
            follow(m, o, k, alpha)


@compiled(NUM2, NUMS, INTS, NUMS, NUM, BOOL)
def trial(m, o, x0, alpha, single):  # type: ignore[no-untyped-def]
    """Cost and violation (1-norm of gaps, equalities, rows and start) at step length ``alpha``; fills the trial point.

    ``single``: the policy is rolled out, feedback included; else states and inputs move along the step.
    """
    n, nx, nu = o[N], o[NX], o[NU]
    forget_outside(m, o)
    if single:
        roll_out_policy(m, o, x0, alpha)
    else:
        move(m, o, alpha)
    cost, violation, of_rows = 0.0, 0.0, 0.0
    for i in range(nx):
        violation += abs(x0[i] - m[o[XT] + i])
    for first in range(0, n, LANES):
        count = min(LANES, n - first)
        load_block(m, o, first, count, o[XT], o[UT])
        if not single:
            violation += gaps(m, o, first, count, o[XT], o[UT])
        path_cost, equalities = cost_and_equalities(m, o)
        cost, violation = cost + path_cost, violation + equalities
        evaluate_rows(m, o)
        for k in range(first, first + count):
            h, x, u = m[o[GRID] + k + 1] - m[o[GRID] + k], o[XT] + k * nx, o[UT] + k * nu
            take_rows_of_lane(m, o, k - first)
            row_cost, row_violation = rows_merit(m, o, k, x, u, alpha)
            of_rows, violation = of_rows + h * row_cost, violation + h * row_violation
    last, small = o[XT] + n * nx, o[SMALL]
    stage_end(o, END_COST, last, o[P] + n * o[NP], small, small)
    cost += m[small] + barrier_value(m, o, o[PATH_BOXES], o[END_BOXES], last, last)
    end_values(m, o, last)
    row_cost, row_violation = rows_merit(m, o, n, last, last, alpha)
    of_rows, violation = of_rows + row_cost, violation + row_violation
    m[o[STATE] + COST], m[o[STATE] + VIOLATION] = cost, violation
    return cost + of_rows, violation


@compiled(BOOL, NUM, NUM, NUM, NUM, NUM, NUM, NUM, NUM)
def accept(cost, violation, base_cost, base_violation, slope, drop, penalty, alpha):  # type: ignore[no-untyped-def]
    """Armijo's rule on the merit cost + penalty · violation (Nocedal and Wright 2006, equations 18.27 to 18.36).

    ``slope``, ``drop``: how fast the cost rises and the violation falls along the step.
    """
    merit, base = cost + penalty * violation, base_cost + penalty * base_violation
    rounding = 1e-9 * (1.0 + abs(base_cost) + penalty)  # of sums of many terms
    return np.isfinite(merit) and merit <= base + 1e-4 * alpha * (slope - penalty * drop) + rounding


@compiled(BOOL, NUMS, INTS, NUM4, NUM, NUM)
def accept_by_filter(m, o, costs, slope, alpha):  # type: ignore[no-untyped-def]
    """Filter: (cost, violation) of the trial point and of the iterate, in ``costs``; remembers the iterate when it helps.

    Source: Wächter and Biegler 2006, "On the implementation of an interior-point filter line-search algorithm", section 2.3.
    """
    cost, violation, base_cost, base_violation = costs
    rounding = 1e-9 * (1.0 + abs(base_cost))
    count = int(m[o[STATE] + FILTERED])
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
        m[o[STATE] + FILTERED] = count + 1.0
    return better


@compiled(NONE, NUMS, INTS)
def take(m, o):  # type: ignore[no-untyped-def]
    """The trial point becomes the iterate."""
    n, nx = o[N], o[NX]
    for i in range((n + 1) * nx):
        m[o[X] + i] = m[o[XT] + i]
    for i in range(n * o[NU]):
        m[o[U] + i] = m[o[UT] + i]
    if o[QUATERNIONS] > 0:
        for k in range(n + 1):
            normalise(m, o, o[X] + k * nx)


@compiled(NONE, NUMS, INTS, NUMS)
def roll_out(m, o, x0):  # type: ignore[no-untyped-def]
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


@compiled(NUM, NUM, NUM, NUM)
def next_longest(longest, last, along):  # type: ignore[no-untyped-def]
    """Longest step to try after a step of ``last``, when ``along`` of the direction before is in the new one.

    Where the subproblem's curvature is too small by a factor c, a step α leaves 1 − c α of the direction: c = (1 − along) / α, and
    1/c arrives (Aitken's Δ²; Nocedal and Wright 2006, section 3.5, has it as a secant of the slope).
    """
    longer = min(1.5 * longest, 1.0)
    return min(max(last / (1.0 - along), SHORTEST), longer) if along < 0.5 else longer


@compiled(NUM, NUMS, INTS, BOOL)
def longest_step(m, o, first):  # type: ignore[no-untyped-def]
    """Longest step to try, from how the direction has turned since the last iteration of the same solve; keeps the direction.

    ``first``: this is the solve's first one. Between solves the measured state has changed too, so nothing can be told."""
    state, along, size = o[STATE], 0.0, 0.0
    for i in range(o[N] * o[NU]):
        new, old = m[o[DU] + i], m[o[DU_LAST] + i]
        along, size = along + new * old, size + old * old
        m[o[DU_LAST] + i] = new
    if m[state + LONGEST] == 0.0:
        m[state + LONGEST] = 1.0
    elif first:
        m[state + LONGEST] = min(1.1 * m[state + LONGEST], 1.0)
    elif size > 0.0:
        m[state + LONGEST] = next_longest(m[state + LONGEST], m[state + LAST_ALPHA], along / size)
    return m[state + LONGEST]


@compiled(NUM2, NUMS, INTS, NUMS, NUMS, NUM4, NUM, NUM)
def search(m, o, x0, s, base, penalty, first):  # type: ignore[no-untyped-def]
    """Step length from ``first`` down, 0 when none is accepted; the trial point is filled. ``base``: cost, violation,
    slope, drop. Returns (α, cost at the trial point)."""
    cost, violation, slope, drop = base
    reach, single, ratio = m[o[STATE] + PRIMAL], s[SINGLE] > 0.0, first
    while ratio >= s[SMALLEST]:
        alpha = ratio * reach
        c, v = trial(m, o, x0, alpha, single)
        if s[USE_FILTER] > 0.0:
            if accept_by_filter(m, o, (c, v, cost, violation), slope, alpha):
                return alpha, c
        elif accept(c, v, cost, violation, slope, drop, penalty, alpha):
            return alpha, c
        ratio *= 0.5
    if s[FORCE] > 0.0:
        c, v = trial(m, o, x0, first * reach, single)
        if np.isfinite(c) and np.isfinite(v):
            return first * reach, c
    return 0.0, np.inf


@compiled(NUM, NUM, NUM, NUM, NUM)
def next_mu(mu, last, error, complementarity):  # type: ignore[no-untyped-def]
    """μ for the next iteration: smaller once the present barrier problem is solved well enough (monotone rule)."""
    while mu > last and max(error, complementarity - mu) <= 10.0 * mu:
        mu = max(last, min(0.2 * mu, mu**1.5))
    return mu


@compiled(NONE, NUMS, INTS, NUMS, NUMS)
def begin(m, o, x0, s):  # type: ignore[no-untyped-def]
    """What a solve starts from: its state, slacks and multipliers, for single shooting a motion."""
    state, rows = o[STATE], row_count(o) > 0
    m[state + MU], m[state + FILTERED], m[state + SHIFT] = s[MU_START], 0.0, 0.0
    m[state + PRIMAL], m[state + DUAL], m[state + ROW_SLOPE] = 1.0, 1.0, 0.0
    m[state + PRODUCT], m[state + RESIDUAL], m[state + LEFT], m[state + ROW_COST] = 0.0, 0.0, 0.0, 0.0
    m[state + RHO], m[state + THETA] = 1.0, 1.0
    # in real time feedback would take the inputs of a roll-out anywhere, and one iteration does not bring them back
    rolled = 1.0 if rows and s[SINGLE] * s[KEEP] > 0.0 else 0.0
    m[state + HOLD] = 1.0 + s[KEEP] if o[CURVED] > 0 else rolled
    forget_outside(m, o)
    if rows:
        start_rows(m, o, s[LEAST_SLACK], s[KEEP] > 0.0, s[KEEP_SLACKS] > 0.0)
    if s[SINGLE] > 0.0:
        roll_out(m, o, x0)
        if rows:
            start_rows(m, o, s[LEAST_SLACK], s[KEEP] > 0.0, s[KEEP_SLACKS] > 0.0)


@compiled(NUM6, NUMS, INTS, NUMS, NUMS, NUMS, INT)
def direction(m, o, x0, s, log, row):  # type: ignore[no-untyped-def]
    """One direction: (cost, violation, KKT residual, curvature, largest component, slope). Fills a row of the log."""
    state, certify = o[STATE], s[CERTIFY] > 0.0
    cost, gaps, equalities, violation = backward(m, o, certify)
    for i in range(o[NX]):
        gaps += abs(x0[i] - m[o[X] + i])
    violation += gaps + equalities
    largest, slope = forward(m, o, x0)
    if row_count(o) > 0:
        rows_step(m, o, s[TAU])
    kkt, curvature = kkt_residual(m, o) if certify else (np.nan, 0.0)
    log[row], log[row + 1], log[row + 2], log[row + 3] = cost - m[state + ROW_COST], violation, kkt, largest
    m[state + COST], m[state + VIOLATION] = log[row], violation
    log[row + 4], log[row + 5], log[row + 6], log[row + 7] = 0.0, gaps, equalities, m[state + RESIDUAL]
    log[row + 8], log[row + 9] = m[state + PRODUCT], m[state + MU]
    log[row + 10], log[row + 11] = m[state + SHIFT], m[state + DUAL]
    return cost, violation, kkt, curvature, largest, slope + m[state + ROW_SLOPE]


@compiled(NUM, NUMS, INTS)
def moved(m, o):  # type: ignore[no-untyped-def]
    """The largest part of the step beside 1 + |x| or 1 + |u|.

    Where nothing but a logarithm looks at a variable its gradient fades towards infinity, and every step doubles it.
    """
    n, nx, nu, lx = o[N], o[NX], o[NU], o[LX]
    largest = 0.0
    for k in range(n + 1):
        for i in range(nx):
            largest = max(largest, abs(m[o[DX] + k * lx + i]) / (1.0 + abs(m[o[X] + k * nx + i])))
    for i in range(n * nu):
        largest = max(largest, abs(m[o[DU] + i]) / (1.0 + abs(m[o[U] + i])))
    return largest


@compiled(BOOL, NUMS, INTS, NUM, NUM, NUM)
def met(m, o, violation, equalities, limit):  # type: ignore[no-untyped-def]
    """Whether the constraints are met. Equality rows with a compliance keep a residual, which is theirs once nothing moves."""
    if m[o[STATE] + RESIDUAL] > limit:
        return False
    soft = False
    for j in range(o[NG]):
        soft = soft or m[o[EPS] + j] > 1e-13
    return violation <= limit or (soft and violation - equalities <= limit and moved(m, o) <= AT_REST)


@compiled(BOOL, NUMS, INTS, NUMS)
def make_convex(m, o, s):  # type: ignore[no-untyped-def]
    """Fewer second derivatives, then a larger shift, for a subproblem that is not convex; whether there is one to try."""
    state = o[STATE]
    if o[EXACT] > 0 and m[state + THETA] > 0.0:
        m[state + THETA] = 0.25 * m[state + THETA] if m[state + THETA] > 0.02 else 0.0
        return True
    m[state + SHIFT] = max(10.0 * m[state + SHIFT], 1e-6)
    return m[state + SHIFT] <= s[LARGEST_SHIFT]


@compiled(NUM2, NUMS, INTS, NUMS, NUM, NUM, NUM, NUM, NUM)
def settle_rows(m, o, s, alpha, kkt, violation, last_residual, level):  # type: ignore[no-untyped-def]
    """Slacks and multipliers after a step of ``alpha``; μ and ρ for the next one.

    Returns the residual to compare the next one with, and 1 when the problem is another one now (μ or ρ has changed).
    """
    state, certify = o[STATE], s[CERTIFY] > 0.0
    mu, residual, product, changed = m[state + MU], m[state + RESIDUAL], m[state + PRODUCT], 0.0
    # multipliers wait until their subproblem is solved well enough (Nocedal and Wright 2006, framework 17.3)
    solved = not certify or kkt <= max(s[TOLERANCE], 0.1 * residual)
    take_rows(m, o, alpha, m[state + DUAL], solved)
    feasible = violation <= s[FEASIBILITY] and residual <= s[FEASIBILITY]
    error = 0.0 if feasible else max(violation, residual)
    after = next_mu(mu, level, max(kkt, error) if certify else 0.0, product)
    if m[state + PRIMAL] < 0.1:  # the slacks are at the boundary, far from the central path
        after = min(s[MU_START], 10.0 * mu)
    if certify and (solved or alpha > 0.9):
        if residual > s[FEASIBILITY] and residual > 0.25 * last_residual:
            m[state + RHO], changed = min(4.0 * m[state + RHO], 1e6), 1.0
        last_residual = residual
    if after != mu:
        m[state + MU], m[state + FILTERED], changed = after, 0.0, 1.0
    return last_residual, changed


@compiled(INT2, NUMS, INTS, NUMS, NUMS, NUMS)
def solve(m, o, x0, s, log):  # type: ignore[no-untyped-def]
    """Up to ``iterations`` steps: (status, steps done). ``s``: see SETTINGS; rows of ``log``: see workspace.LOG."""
    penalty, first, last_kkt, last_residual, certify = 0.0, 1.0, np.inf, np.inf, s[CERTIFY] > 0.0
    rows, state, limit, it = row_count(o) > 0, o[STATE], int(s[ITERATIONS]), 0
    # the level μ is to fall to, and how far the plan would still move with it: costs in tiny units need a smaller one
    level, last_mu, bias = s[MU_END], s[MU_START], 0.0
    begin(m, o, x0, s)
    hold = m[state + HOLD]
    while it < limit:
        row = it * LOG_COLUMNS
        cost, violation, kkt, curvature, largest, slope = direction(m, o, x0, s, log, row)
        it += 1
        if not (np.isfinite(cost) and np.isfinite(violation) and np.isfinite(slope)):
            known = np.isfinite(cost) and np.isfinite(violation)
            if it < limit and known and s[LARGEST_SHIFT] > 0.0 and make_convex(m, o, s):
                continue
            return NOT_FINITE, it
        if abs(cost) > HUGE or largest > HUGE:
            return DIVERGED, it
        mu, product = m[state + MU], m[state + PRODUCT]
        feasible = met(m, o, violation, log[row + 6], s[FEASIBILITY])
        if certify and mu < last_mu:
            bias = moved(m, o) * mu / (last_mu - mu)
        last, last_mu = mu <= level or not rows, mu
        small = not last or moved(m, o) <= UNSETTLED
        if certify and kkt <= s[TOLERANCE] and feasible and product <= 10.0 * mu and small:
            if last and (not rows or bias <= BIAS or mu <= s[MU_FLOOR]):
                return CONVERGED, it
            level = max(0.2 * mu, s[MU_FLOOR]) if last else level
            m[state + MU], m[state + FILTERED], first, last_kkt = next_mu(mu, level, 0.0, mu), 0.0, 1.0, np.inf
            continue
        drop = violation - m[state + LEFT]
        if drop > 1e-10:
            penalty = max(penalty, 2.0 * (slope + 0.5 * curvature) / drop)
        # Where differences of the cost drown in rounding, the KKT residual tells that Gauss-Newton overshoots.
        invisible = abs(slope) + penalty * drop < 1e-5 * (1.0 + abs(cost))
        first = max(0.5 * first, 0.1) if kkt > last_kkt and invisible else min(1.3 * first, 1.0)
        last_kkt = kkt
        if not certify:
            first = longest_step(m, o, it == 1)
        alpha, _ = search(m, o, x0, s, (cost, violation, slope, drop), penalty, first)
        shift = m[state + SHIFT]
        if alpha == 0.0:
            m[state + COST], m[state + VIOLATION] = log[row], violation
            if m[state + HOLD] == 1.0 and s[KEEP] == 0.0:  # once more along the step itself
                m[state + HOLD] = 0.0
                continue
            m[state + SHIFT] = max(10.0 * shift, 1e-4)
            if m[state + SHIFT] > s[LARGEST_SHIFT]:
                return NO_STEP, it
            continue
        m[state + SHIFT], m[state + THETA] = (
            0.2 * shift if shift > 1e-6 else 0.0,
            min(1.0, 2.0 * m[state + THETA] + 0.01),
        )
        take(m, o)
        if rows:
            last_residual, changed = settle_rows(m, o, s, alpha, kkt, violation, last_residual, level)
            if changed > 0.0:
                last_kkt = np.inf
        log[row + 4], m[state + LAST_ALPHA] = alpha, alpha
        if hold > 0.0:
            m[state + HOLD] = hold
        o[POLICY] = 1
        if it == limit and alpha < 0.9 * first and limit < int(s[ITERATIONS]) + int(s[EXTRA]):
            limit += 1
    return (LIMIT_MISSED if m[state + MISSED] > LIMIT_TOLERANCE else ITERATION_LIMIT), it
