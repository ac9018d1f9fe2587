"""Compiled code of inequalities and multiplier rows: relaxed barriers, interior point, augmented Lagrangian.

A row h(z) contributes the quadratic ½ w σ (J δz + e)² to its node's subproblem (w: the interval's length) and gets the
multiplier −σ (J δz + e) after the step:

- HARD, slack t, multiplier l, L1 slack s with y = ν − l: σ = 1 / (t/l + s/y), e = h − μ/l + μ/y − l/σ;
- MULTIPLIER: σ = ρ where λ > ρ h, else 0; e = h − λ/ρ;
- EQUAL: σ = ρ, e = h + λ/ρ, multiplier +σ (J δz + e).

The rows of a node come in vectors of eight (:mod:`wbmpc.solver.inequality_algebra`): first those of one variable, then general
ones, then rows that do nothing, up to a multiple of eight. Without L1 slack ("open", infinite ν): s = 0, and y counts as 1
wherever it only scales.

Sources: Nocedal and Wright 2006, sections 19.2 and 17.4; derivation in docs/explanation/inequalities.md.
"""

from __future__ import annotations

import numpy as np

from wbmpc.solver.barrier_update import raised_mu
from wbmpc.solver.compilation import LANES, Floats, Integers, compiled
from wbmpc.solver.inequality_algebra import steps
from wbmpc.solver.inequality_table import (
    EQUAL,
    HARD,
    MULTIPLIER,
    counts,
    eight_rows,
    entry,
    kind_of,
    node_rows,
    row_penalty,
)
from wbmpc.solver.memory_layout import (
    GRID,
    NU,
    NX,
    ROW_C,
    ROW_D,
    ROW_DS,
    ROW_DT,
    ROW_E,
    ROW_H,
    ROW_L,
    ROW_N,
    ROW_S,
    ROW_T,
    ROW_TOTAL,
    ROW_TRIAL,
    ROW_Y,
    ROWS,
    STATE,
    N,
    RowField,
    Setting,
    StateField,
    U,
    X,
)
from wbmpc.solver.node_inequalities import (
    FRESH,
    KEEP_MULTIPLIERS,
    KEEP_SLACKS,
    collect_values,
    end_values,
    row_changes,
    start_node,
)
from wbmpc.solver.riccati import step_block
from wbmpc.solver.settings import THRESHOLDS
from wbmpc.solver.simd_batch import evaluate_rows, load_block, take_rows_of_lane

#: Of a sum, as a share of its largest part.
ROUNDING = 1e-15


@compiled
def rows_step(m: Floats, o: Integers, tau: float) -> float:
    """Steps of inputs and states, and, block by block while its numbers are in the cache, those of slacks and multipliers; what they say of the
    whole step goes to ``state`` (see memory_layout.py). Returns Σ w σ e J δz, what rows add to the subproblem's slope.

    ``tau``: fraction to the boundary.
    """
    state, mu, zero = o[STATE], m[o[STATE] + StateField.BARRIER], np.full(LANES, 0.0)
    primal, dual, slope, product, residual, left, tilt = zero, zero, zero, zero, zero, zero, zero
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
        if k % LANES == 0:
            step_block(m, o, k)
        row_changes(m, o, k)
        for j in range(0, boxes + general, LANES):
            q = k * o[ROWS] + j
            kind, penalty, active = eight_rows(m, o, first + j, k)
            change, h = m[o[ROW_D] + q : o[ROW_D] + q + LANES], m[o[ROW_H] + q : o[ROW_H] + q + LANES]
            t, l = m[o[ROW_T] + q : o[ROW_T] + q + LANES], m[o[ROW_L] + q : o[ROW_L] + q + LANES]  # noqa: E741
            s, y = m[o[ROW_S] + q : o[ROW_S] + q + LANES], m[o[ROW_Y] + q : o[ROW_Y] + q + LANES]
            sigma, e = m[o[ROW_C] + q : o[ROW_C] + q + LANES], m[o[ROW_E] + q : o[ROW_E] + q + LANES]
            reach, hard = change + e, active & (kind == HARD)
            tilt, following = tilt + (w * sigma) * (e * change), -sigma * reach
            dt, ds, dl, shrink, fall, rise = steps(t, l, s, y, penalty, following, h + change, mu)
            m[o[ROW_DT] + q : o[ROW_DT] + q + LANES] = np.where(hard, dt, 0.0)
            m[o[ROW_DS] + q : o[ROW_DS] + q + LANES] = np.where(hard, ds, 0.0)
            primal = np.maximum(primal, np.where(hard, shrink, 0.0))
            dual = np.maximum(dual, np.where(hard, fall, 0.0))
            slope = slope + w * np.where(hard, rise, 0.0)
            closed = penalty < np.inf
            # beside a penalty multipliers are differences of numbers of its size
            noise = np.where(closed, ROUNDING * penalty, 0.0)
            of_slack = np.where(closed, (y - noise) * s, 0.0)
            product = np.maximum(product, np.where(hard, np.maximum((l - noise) * t, of_slack), 0.0))
            slack = np.where(closed, s, 0.0)
            residual = np.maximum(residual, np.where(hard, abs(h + slack - t), 0.0))
            following = np.where(hard, l + dl, l)
            if not np.all(kind == HARD):
                equal, one_sided = active & (kind == EQUAL), active & (kind == MULTIPLIER)
                pull = np.maximum(l - penalty * h, 0.0)
                after = np.maximum(l - penalty * (h + change), 0.0)
                slope = slope - w * np.where(one_sided, pull * change, 0.0)
                residual = np.maximum(residual, np.where(one_sided, abs(np.minimum(h, l / penalty)), 0.0))
                residual = np.maximum(residual, np.where(equal, abs(h), 0.0))
                left = left + w * np.where(equal, abs(h + change), 0.0)
                following = np.where(one_sided, after, np.where(equal, penalty * reach, following))
            m[o[ROW_N] + q : o[ROW_N] + q + LANES] = following
    m[state + StateField.MAX_PRIMAL_STEP], m[state + StateField.MAX_DUAL_STEP] = (
        tau / max(np.max(primal), tau),
        tau / max(np.max(dual), tau),
    )
    m[state + StateField.ROW_SLOPE], m[state + StateField.MAX_COMPLEMENTARITY] = np.sum(slope), np.max(product)
    m[state + StateField.MAX_ROW_RESIDUAL], m[state + StateField.REMAINING_VIOLATION] = np.max(residual), np.sum(left)
    return np.sum(tilt)


@compiled
def take_rows(m: Floats, o: Integers, primal: float, dual: float, solved: bool, products: bool) -> tuple[float, float]:
    """Slacks and multipliers move by their steps; those of MULTIPLIER rows only when ``solved``. Returns (mean, smallest)
    of the ``products`` of slacks and multipliers, where they are asked for; (0, 0) without any."""
    moved = primal if solved else 0.0
    total, count, smallest = np.full(LANES, 0.0), np.full(LANES, 0.0), np.full(LANES, np.inf)
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        for j in range(0, boxes + general, LANES):
            q = k * o[ROWS] + j
            kind = m[entry(o, RowField.KIND, first + j) : entry(o, RowField.KIND, first + j) + LANES]
            length = np.where(kind == HARD, dual, np.where(kind == MULTIPLIER, moved, primal))
            change = length * (m[o[ROW_N] + q : o[ROW_N] + q + LANES] - m[o[ROW_L] + q : o[ROW_L] + q + LANES])
            m[o[ROW_L] + q : o[ROW_L] + q + LANES] += change
            m[o[ROW_Y] + q : o[ROW_Y] + q + LANES] -= change
            m[o[ROW_T] + q : o[ROW_T] + q + LANES] += primal * m[o[ROW_DT] + q : o[ROW_DT] + q + LANES]
            m[o[ROW_S] + q : o[ROW_S] + q + LANES] += primal * m[o[ROW_DS] + q : o[ROW_DS] + q + LANES]
            if not products:
                continue
            _, penalty, active = eight_rows(m, o, first + j, k)
            hard = active & (kind == HARD)
            closed = hard & (penalty < np.inf)
            lt = m[o[ROW_T] + q : o[ROW_T] + q + LANES] * m[o[ROW_L] + q : o[ROW_L] + q + LANES]
            ys = m[o[ROW_S] + q : o[ROW_S] + q + LANES] * m[o[ROW_Y] + q : o[ROW_Y] + q + LANES]
            total = total + np.where(hard, lt, 0.0) + np.where(closed, ys, 0.0)
            count = count + np.where(hard, 1.0, 0.0) + np.where(closed, 1.0, 0.0)
            smallest = np.minimum(smallest, np.minimum(np.where(hard, lt, np.inf), np.where(closed, ys, np.inf)))
    n = np.sum(count)
    return (np.sum(total) / n, -np.max(-smallest)) if n > 0.0 else (0.0, 0.0)


@compiled
def values_at_iterate(m: Floats, o: Integers, k: int) -> None:
    """h of node k's rows at the iterate into ``row_trial``; nodes are asked for one after the other."""
    _, _, general = node_rows(o, k)
    x, u = o[X] + k * o[NX], o[U] + min(k, o[N] - 1) * o[NU]
    if k == o[N]:
        end_values(m, o, x)
    elif general > 0:
        if k % LANES == 0:
            load_block(m, o, k, min(LANES, o[N] - k), o[X], o[U])
            evaluate_rows(m, o)
        take_rows_of_lane(m, o, k % LANES)
    collect_values(m, o, k, x, u, o[ROW_TRIAL])


@compiled
def row_residual_at_iterate(m: Floats, o: Integers) -> float:
    """By how much rows are not met at the iterate, or slacks are not theirs."""
    worst = 0.0
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        if boxes + general == 0:
            continue
        values_at_iterate(m, o, k)
        for j in range(boxes + general):
            r, q, h = first + j, k * o[ROWS] + j, m[o[ROW_TRIAL] + j]
            if not counts(m, o, r, k):
                continue
            kind, residual = kind_of(m, o, r), abs(h)
            if kind == HARD:
                slack = m[o[ROW_S] + q] if row_penalty(m, o, r) < np.inf else 0.0
                residual = abs(h + slack - m[o[ROW_T] + q])
            elif kind == MULTIPLIER:
                residual = abs(min(h, m[o[ROW_L] + q] / row_penalty(m, o, r)))
            worst = max(worst, residual)
    return worst


@compiled
def limit_products(m: Floats, o: Integers, largest: float) -> None:
    """Smaller multipliers of hard rows, where their product with the slack is more than ``largest``."""
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        for j in range(boxes + general):
            r, q = first + j, k * o[ROWS] + j
            if kind_of(m, o, r) == HARD and m[o[ROW_L] + q] * m[o[ROW_T] + q] > largest:
                m[o[ROW_L] + q] = largest / m[o[ROW_T] + q]
                m[o[ROW_Y] + q] = row_penalty(m, o, r) - m[o[ROW_L] + q]


@compiled
def raise_barrier(m: Floats, o: Integers, s: Floats) -> bool:
    """A larger μ, with multipliers that belong to it, in real time; whether it was not as large as it may be.

    After a jump of a reference the step passes many limits by far, which multipliers of the last solution do not feel, and the slack
    nearest to zero cuts it to nearly nothing: again and again, since each such step makes only few rows felt. With l = μ/t of a
    larger μ all are, at slacks that stay those of the iterate, which stays within its limits.
    """
    state = o[STATE]
    mu, most = m[state + StateField.BARRIER], s[Setting.MAX_BARRIER]
    for r in range(o[ROW_TOTAL]):
        if kind_of(m, o, r) == HARD:
            most = min(most, THRESHOLDS.slack_share * row_penalty(m, o, r))
    if s[Setting.KEEP_MULTIPLIERS] == 0.0 or mu >= most:
        return False
    mu = raised_mu(mu, most, m[state + StateField.MAX_PRIMAL_STEP])
    m[state + StateField.BARRIER] = mu
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        for j in range(boxes + general):
            r, q = first + j, k * o[ROWS] + j
            if kind_of(m, o, r) == HARD:
                penalty = row_penalty(m, o, r)
                m[o[ROW_L] + q] = min(max(m[o[ROW_L] + q], mu / m[o[ROW_T] + q]), 0.99 * penalty)
                m[o[ROW_Y] + q] = penalty - m[o[ROW_L] + q]
    return True


@compiled
def start_rows(m: Floats, o: Integers, min_slack: float, keep: bool, keep_slacks: bool) -> None:
    """Slacks t = max(h, ``min_slack``) at the iterate; multipliers kept, or μ / t. Multiplier rows start at 0 when not kept.

    ``keep_slacks``: slacks that there are stay too.
    """
    how = how_to_start(keep, keep_slacks)
    for k in range(o[N] + 1):
        values_at_iterate(m, o, k)
        start_node(m, o, k, o[ROW_TRIAL], min_slack, how)


@compiled
def how_to_start(keep: bool, keep_slacks: bool) -> float:
    """FRESH, KEEP_MULTIPLIERS or KEEP_SLACKS."""
    return (KEEP_SLACKS if keep_slacks else KEEP_MULTIPLIERS) if keep else FRESH


@compiled
def start_rows_later(m: Floats, o: Integers, min_slack: float, keep: bool, keep_slacks: bool) -> None:
    """As :func:`start_rows`, by the next linearization, which has the rows' values anyway; up to then they are those of before."""
    m[o[STATE] + StateField.START], m[o[STATE] + StateField.START_SLACK] = how_to_start(keep, keep_slacks), min_slack
