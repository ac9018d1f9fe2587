"""Compiled code of a solve: directions, the iteration, interior point, statuses."""

from __future__ import annotations

import numpy as np

from wbmpc.solver.barrier_update import adaptive_mu, next_mu, real_time_mu, start_adaptive
from wbmpc.solver.compilation import LANES, Floats, Integers, compiled
from wbmpc.solver.inequalities import (
    limit_products,
    raise_barrier,
    row_residual_at_iterate,
    rows_step,
    start_rows,
    start_rows_later,
    take_rows,
)
from wbmpc.solver.inequality_table import initial_violation, reset_violations
from wbmpc.solver.line_search import compare_with_last, longest_step, roll_out, search, take, trial
from wbmpc.solver.memory_layout import (
    NONLINEAR_INPUT_ROWS,
    NX,
    POLICY,
    SOFT_EQUALITIES,
    STATE,
    N,
    Setting,
    StateField,
    X,
)
from wbmpc.solver.riccati import backward, begin_step, end_step, kkt_residual, step_block, value_of_subproblem
from wbmpc.solver.settings import THRESHOLDS
from wbmpc.solver.soft_equalities import soft_residual_steps, start_soft_residuals, take_soft_residuals
from wbmpc.solver.stages import row_count
from wbmpc.solver.stall import forget_errors, stalled
from wbmpc.solver.termination import (
    CONTINUE,
    CONVERGED,
    ITERATION_LIMIT,
    LINE_SEARCH_FAILED,
    RETRY,
    STALLED,
    convergence_status,
    direction_status,
    extend_iterations,
    met,
    status_at_iteration_limit,
)
from wbmpc.solver.workspace import LOG

LOG_COLUMNS = len(LOG)


@compiled
def start_rows_of_solve(m: Floats, o: Integers, x0: Floats, s: Floats) -> None:
    """Slacks and multipliers to start from. Those of a solution stay where they nearly fit the iterate and the measured state: μ is
    then the mean of their products, and slacks are as large as what does not fit."""
    state, real_time, floor = o[STATE], s[Setting.KEEP_MULTIPLIERS] > 0.0, np.sqrt(s[Setting.BARRIER])
    misfit = np.inf
    if m[state + StateField.CONVERGED] > 0.0 and s[Setting.SINGLE_SHOOTING] == 0.0 and not real_time:
        misfit = row_residual_at_iterate(m, o)
        for i in range(o[NX]):
            misfit = max(misfit, abs(x0[i] - m[o[X] + i]))
    m[state + StateField.CONVERGED] = 0.0
    if not misfit < s[Setting.MIN_SLACK]:
        if s[Setting.SINGLE_SHOOTING] > 0.0:
            start_rows(m, o, s[Setting.MIN_SLACK], real_time, s[Setting.KEEP_SLACKS] > 0.0)
        else:
            start_rows_later(m, o, s[Setting.MIN_SLACK], real_time, s[Setting.KEEP_SLACKS] > 0.0)
        return
    slack = max(misfit, floor)
    m[state + StateField.BARRIER] = min(s[Setting.INITIAL_BARRIER], slack * slack)
    start_rows(m, o, slack, True, False)
    limit_products(m, o, s[Setting.INITIAL_BARRIER])
    mean, _ = take_rows(m, o, 0.0, 0.0, False, True)
    m[state + StateField.BARRIER] = min(s[Setting.INITIAL_BARRIER], max(mean, s[Setting.BARRIER]))


@compiled
def begin(m: Floats, o: Integers, x0: Floats, s: Floats) -> None:
    """What a solve starts from: its state, slacks and multipliers, for single shooting a motion."""
    state, rows = o[STATE], row_count(o) > 0
    m[state + StateField.BARRIER], m[state + StateField.FILTER_SIZE], m[state + StateField.SHIFT] = (
        max(s[Setting.INITIAL_BARRIER], s[Setting.KEEP_MULTIPLIERS] * m[state + StateField.BARRIER]),
        0.0,
        0.0,
    )
    m[state + StateField.MAX_PRIMAL_STEP], m[state + StateField.MAX_DUAL_STEP], m[state + StateField.ROW_SLOPE] = (
        1.0,
        1.0,
        0.0,
    )
    (
        m[state + StateField.MAX_COMPLEMENTARITY],
        m[state + StateField.MAX_ROW_RESIDUAL],
        m[state + StateField.REMAINING_VIOLATION],
        m[state + StateField.ROW_COST],
    ) = 0.0, 0.0, 0.0, 0.0
    m[state + StateField.PENALTY_FACTOR], m[state + StateField.SECOND_ORDER_SHARE] = 1.0, 1.0
    m[state + StateField.START] = 0.0
    m[state + StateField.DIRECTIONS], m[state + StateField.TRIAL_POINTS] = 0.0, 0.0
    start_adaptive(m, state)
    forget_errors(m, o)
    # in real time feedback would take the inputs of a roll-out anywhere, and one iteration does not bring them back
    rolled = 1.0 if rows and s[Setting.SINGLE_SHOOTING] * s[Setting.KEEP_MULTIPLIERS] > 0.0 else 0.0
    m[state + StateField.HOLD_INPUTS] = 1.0 + s[Setting.KEEP_MULTIPLIERS] if o[NONLINEAR_INPUT_ROWS] > 0 else rolled
    m[state + StateField.CHECK_INPUT_ROWS], m[state + StateField.EQUALITY_RESIDUAL] = s[Setting.KEEP_MULTIPLIERS], 0.0
    reset_violations(m, o)
    if rows:
        start_rows_of_solve(m, o, x0, s)
    if s[Setting.SINGLE_SHOOTING] > 0.0:
        roll_out(m, o, x0)
        if rows:
            start_rows(m, o, s[Setting.MIN_SLACK], s[Setting.KEEP_MULTIPLIERS] > 0.0, s[Setting.KEEP_SLACKS] > 0.0)
    if o[SOFT_EQUALITIES] > 0:
        start_soft_residuals(m, o)


@compiled
def direction(
    m: Floats, o: Integers, x0: Floats, s: Floats, log: Floats, row: int
) -> tuple[float, float, float, float, float, float]:
    """One direction: (cost, violation, KKT residual, curvature, largest component, slope). Fills a row of the log, whose violation
    has the equalities that are soft too."""
    state, compute_kkt = o[STATE], s[Setting.COMPUTE_KKT] > 0.0
    m[state + StateField.DIRECTIONS] += 1.0
    cost, gaps, equalities, violation = backward(m, o, compute_kkt)
    m[state + StateField.START] = 0.0
    for i in range(o[NX]):
        gaps += abs(x0[i] - m[o[X] + i])
    violation += gaps + equalities
    of_rows, soft_squares = 0.0, 0.0
    begin_step(m, o, x0)
    if row_count(o) > 0:
        of_rows = rows_step(m, o, s[Setting.FRACTION_TO_BOUNDARY])
    else:
        for first in range(0, o[N], LANES):
            step_block(m, o, first)
    largest, slope = end_step(m, o)
    tilt = slope + of_rows
    if o[SOFT_EQUALITIES] > 0:
        soft_slope, soft_squares = soft_residual_steps(m, o)
        slope += soft_slope
    kkt, curvature = np.nan, 2.0 * (value_of_subproblem(m, o) - tilt) - soft_squares
    if compute_kkt:
        kkt, curvature = kkt_residual(m, o)
    log[row], log[row + 1], log[row + 2], log[row + 3] = cost - m[state + StateField.ROW_COST], violation, kkt, largest
    m[state + StateField.COST], m[state + StateField.VIOLATION] = log[row], violation
    log[row + 4], log[row + 5], log[row + 6] = 0.0, gaps, equalities
    log[row + 7] = m[state + StateField.MAX_ROW_RESIDUAL]
    log[row + 8], log[row + 9] = m[state + StateField.MAX_COMPLEMENTARITY], m[state + StateField.BARRIER]
    log[row + 10], log[row + 11] = m[state + StateField.SHIFT], m[state + StateField.MAX_DUAL_STEP]
    return (
        cost,
        violation - m[state + StateField.SOFT_EQUALITY_VIOLATION],
        kkt,
        curvature,
        largest,
        slope + m[state + StateField.ROW_SLOPE],
    )


@compiled
def settle_rows(
    m: Floats, o: Integers, s: Floats, alpha: float, kkt: float, violation: float, last_residual: float, level: float
) -> tuple[float, float]:
    """Slacks and multipliers after a step of ``alpha``; μ and ρ for the next one.

    Returns the residual to compare the next one with, and 1 when the problem is another one now (μ or ρ has changed).
    """
    state, compute_kkt = o[STATE], s[Setting.COMPUTE_KKT] > 0.0
    mu, residual, product, changed = (
        m[state + StateField.BARRIER],
        m[state + StateField.MAX_ROW_RESIDUAL],
        m[state + StateField.MAX_COMPLEMENTARITY],
        0.0,
    )
    # multipliers wait until their subproblem is solved well enough (Nocedal and Wright 2006, framework 17.3)
    solved = not compute_kkt or kkt <= max(s[Setting.TOLERANCE], 0.1 * residual)
    adapts = compute_kkt and s[Setting.KEEP_MULTIPLIERS] == 0.0
    mean, smallest = take_rows(m, o, alpha, m[state + StateField.MAX_DUAL_STEP], solved, adapts)
    feasible = violation <= s[Setting.FEASIBILITY] and residual <= s[Setting.FEASIBILITY]
    error = 0.0 if feasible else max(violation, residual)
    after = next_mu(mu, level, max(kkt, error) if compute_kkt else 0.0, product)
    adapts = adapts and mean > 0.0
    if adapts:
        errors = (max(max(kkt, violation), max(residual, product)), max(kkt, error))
        after = min(
            adaptive_mu(m, state, after, errors, (mean, smallest), m[state + StateField.MAX_PRIMAL_STEP], level),
            s[Setting.MAX_BARRIER],
        )
    if s[Setting.KEEP_MULTIPLIERS] > 0.0:
        after = real_time_mu(mu, level, m[state + StateField.MAX_PRIMAL_STEP])
    elif m[state + StateField.MAX_PRIMAL_STEP] < THRESHOLDS.short:  # slacks are far from the central path
        after = min(s[Setting.MAX_BARRIER], max(after, 10.0 * mu))
    if compute_kkt and (solved or alpha > 0.9):
        if residual > s[Setting.FEASIBILITY] and residual > 0.25 * last_residual:
            m[state + StateField.PENALTY_FACTOR], changed = min(4.0 * m[state + StateField.PENALTY_FACTOR], 1e6), 1.0
        last_residual = residual
    if after != mu:
        m[state + StateField.BARRIER], m[state + StateField.FILTER_SIZE] = after, 0.0
        # beside a residual that is much larger the change of μ is none: a step that overshoots is to be seen
        changed = changed if adapts and abs(after - mu) < 0.1 * kkt else 1.0
    return last_residual, changed


@compiled
def restart_from_rollout(m: Floats, o: Integers, x0: Floats, s: Floats, expected: float) -> bool:
    """Where the measured state is outside a hard limit, the iterate starts inside, and its slacks hardly let it go there: it
    becomes a motion from there, as in single shooting, with inputs held within their rows, and the slacks those of that motion.

    Steps from inside would be cut again and again, and in real time the plan would not start where the robot is. ``expected``: the
    cost that the step promises.
    """
    state = o[STATE]
    if (
        m[state + StateField.MAX_PRIMAL_STEP] > THRESHOLDS.jammed
        or initial_violation(m, o) <= THRESHOLDS.limit_tolerance
    ):
        return False
    hold, most = m[state + StateField.HOLD_INPUTS], THRESHOLDS.runaway * max(1.0, expected)
    if s[Setting.KEEP_MULTIPLIERS] == 0.0:  # many iterations bring any motion back
        most = np.inf
    m[state + StateField.HOLD_INPUTS] = max(hold, 1.0)
    cost, violation = trial(m, o, x0, 0.0, True)
    m[state + StateField.HOLD_INPUTS] = hold
    if not (np.isfinite(cost) and abs(cost) <= most and np.isfinite(violation)):  # an unstable system may run away
        return False
    take(m, o)
    start_rows(m, o, s[Setting.MIN_SLACK], s[Setting.KEEP_MULTIPLIERS] > 0.0, False)
    m[state + StateField.FILTER_SIZE] = 0.0
    return True


@compiled
def update_merit(
    m: Floats,
    o: Integers,
    found: tuple[float, float, float, float],
    optimality: tuple[float, float],
    penalty: float,
    first: float,
) -> tuple[float, float]:
    """(Weight of the violation in the merit, first step length to try) from those before.

    ``found``: cost, slope, curvature, drop of the violation; ``optimality``: KKT residual, that of the iteration before (NaN: unknown)."""
    cost, slope, curvature, drop = found
    kkt, last_kkt = optimality
    along = 0.0
    if np.isfinite(kkt):  # else longest_step compares them
        along, _ = compare_with_last(m, o)
    if drop > 1e-10:
        penalty = max(penalty, 2.0 * (slope + 0.5 * curvature) / drop)
    # Where differences of the cost are lost in rounding, a KKT residual that grows while the direction turns back shows that
    # Gauss-Newton overshoots. Where the direction goes on, the curvature along it is negative, as beside a saddle.
    invisible = abs(slope) + penalty * drop < 1e-5 * (1.0 + abs(cost))
    first = max(0.5 * first, 0.01) if kkt > last_kkt and invisible and along < 0.0 else min(1.3 * first, 1.0)
    return penalty, first


@compiled
def line_search_gives_up(m: Floats, o: Integers, x0: Floats, s: Floats) -> bool:
    """Whether a solve ends where no step length was accepted; else another direction is to be tried."""
    state = o[STATE]
    if (
        m[state + StateField.HOLD_INPUTS] == 1.0 and s[Setting.KEEP_MULTIPLIERS] == 0.0
    ):  # once more along the step itself
        m[state + StateField.HOLD_INPUTS] = 0.0
        return False
    m[state + StateField.SHIFT] = max(10.0 * m[state + StateField.SHIFT], 1e-4)
    if m[state + StateField.SHIFT] <= s[Setting.MAX_REGULARIZATION]:
        return False
    if s[Setting.KEEP_MULTIPLIERS] > 0.0 and row_count(o) > 0:  # the trial point that is evaluated is to be the iterate
        trial(m, o, x0, 0.0, False)
    return True


@compiled
def accept_step(
    m: Floats, o: Integers, s: Floats, alpha: float, kkt: float, violation: float, last_residual: float, level: float
) -> tuple[float, float]:
    """The trial point becomes the iterate, with its slacks and multipliers. Returns as :func:`settle_rows`."""
    state, shift = o[STATE], m[o[STATE] + StateField.SHIFT]
    m[state + StateField.SHIFT], m[state + StateField.SECOND_ORDER_SHARE] = (
        0.2 * shift if shift > 1e-6 else 0.0,
        min(1.0, 2.0 * m[state + StateField.SECOND_ORDER_SHARE] + 0.01),
    )
    take(m, o)
    if o[SOFT_EQUALITIES] > 0:
        take_soft_residuals(m, o, alpha)
    m[state + StateField.LAST_STEP], o[POLICY] = alpha, 1
    if row_count(o) > 0:
        return settle_rows(m, o, s, alpha, kkt, violation, last_residual, level)
    return last_residual, 0.0


@compiled
def solve(m: Floats, o: Integers, x0: Floats, s: Floats, log: Floats) -> tuple[int, int]:
    """Up to ``iterations`` steps: (status, steps done). ``s``: see SETTINGS; rows of ``log``: see workspace.LOG."""
    begin(m, o, x0, s)
    return iterate(m, o, x0, s, log, 0)


@compiled
def iterate(m: Floats, o: Integers, x0: Floats, s: Floats, log: Floats, done: int) -> tuple[int, int]:
    """As :func:`solve`, from the present iterate with its slacks and multipliers, after ``done`` steps."""
    penalty, first, last_kkt, last_residual, size, it = 0.0, 1.0, np.inf, np.inf, 1.0, done
    # the level μ is to fall to, and how far the plan would still move with it: costs in tiny units need a smaller one
    level, last_mu = s[Setting.BARRIER], m[o[STATE] + StateField.BARRIER]
    bias = 0.0 if last_mu >= s[Setting.INITIAL_BARRIER] else np.inf
    state, limit, hold = o[STATE], int(s[Setting.ITERATIONS]), m[o[STATE] + StateField.HOLD_INPUTS]
    restarts = s[Setting.MAX_EXTRA_ITERATIONS] > 0.0 and s[Setting.ROLLOUT_RESTART] > 0.0
    again = row_count(o) > 0 and (s[Setting.COMPUTE_KKT] > 0.0 or restarts) and s[Setting.SINGLE_SHOOTING] == 0.0
    most, other = limit + int(s[Setting.MAX_EXTRA_ITERATIONS]), True
    while it < limit:
        row = it * LOG_COLUMNS
        cost, violation, kkt, curvature, largest, slope = direction(m, o, x0, s, log, row)
        if it == done and np.isfinite(cost):
            size = min(max(1.0, abs(cost)), THRESHOLDS.divergence)
        it += 1
        ended = direction_status(m, o, s, log, row, (cost, violation, largest, slope), size)
        if ended == RETRY:
            continue
        if ended != CONTINUE:
            return ended, it
        mu, feasible = (
            m[state + StateField.BARRIER],
            met(m, o, violation, log[row + 6] - m[state + StateField.SOFT_EQUALITY_VIOLATION], s[Setting.FEASIBILITY]),
        )
        found, level, bias = convergence_status(m, o, s, feasible, kkt, (level, last_mu, bias))
        last_mu = mu
        if found == CONVERGED:
            m[state + StateField.CONVERGED] = 1.0
            return CONVERGED, it
        if found == RETRY:
            first, last_kkt = 1.0, np.inf
            continue
        if stalled(m, o, s, (kkt, violation), it):
            return STALLED, it - 1
        if again and restart_from_rollout(m, o, x0, s, max(abs(cost), cost + slope + 0.5 * curvature)):
            again, limit, last_kkt, first = False, limit + 1, np.inf, 1.0
            continue
        if it < most and m[state + StateField.MAX_PRIMAL_STEP] < THRESHOLDS.short and raise_barrier(m, o, s):
            limit, other = max(limit, it + 1), True
            continue
        drop = violation - m[state + StateField.REMAINING_VIOLATION]
        penalty, first = update_merit(m, o, (cost, slope, curvature, drop), (kkt, last_kkt), penalty, first)
        last_kkt = kkt
        if s[Setting.COMPUTE_KKT] == 0.0:
            first = longest_step(m, o, other)
        alpha, _ = search(m, o, x0, s, (cost, violation, slope, drop), penalty, first)
        if alpha == 0.0:
            m[state + StateField.COST], m[state + StateField.VIOLATION] = log[row], log[row + 1]
            if line_search_gives_up(m, o, x0, s):
                return status_at_iteration_limit(m, o, s, LINE_SEARCH_FAILED), it
            continue
        log[row + 4] = alpha
        last_residual, changed = accept_step(m, o, s, alpha, kkt, violation, last_residual, level)
        other = changed > 0.0
        if other:
            last_kkt = np.inf
            if s[Setting.COMPUTE_KKT] > 0.0 and s[Setting.SINGLE_SHOOTING] == 0.0:
                penalty *= THRESHOLDS.kept_weight
        if hold > 0.0:
            m[state + StateField.HOLD_INPUTS] = hold
        if it == limit:
            limit = extend_iterations(m, o, s, alpha < 0.9 * first, hold, limit)
            hold = max(hold, m[state + StateField.HOLD_INPUTS])
    return status_at_iteration_limit(m, o, s, ITERATION_LIMIT), it
