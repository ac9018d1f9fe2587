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

from wbmpc.solver.barriers import add_square
from wbmpc.solver.compilation import LANES, Floats, Integers, call3, compiled
from wbmpc.solver.inequality_algebra import log_of_product, merits, steps, weights
from wbmpc.solver.inequality_table import (
    EQUAL,
    HARD,
    MULTIPLIER,
    counts,
    eight_rows,
    entry,
    kind_of,
    node_rows,
    record_violations,
    row_penalty,
)
from wbmpc.solver.memory_layout import (
    ADD_ROWS,
    BASE,
    DU,
    DX,
    END_J,
    END_ROW_GENERAL,
    END_ROW_VALUES,
    END_ROWS_J,
    GRID,
    LX,
    LZ,
    NP,
    NU,
    NX,
    PULLED,
    ROW_C,
    ROW_D,
    ROW_DS,
    ROW_DT,
    ROW_E,
    ROW_GENERAL,
    ROW_H,
    ROW_J,
    ROW_L,
    ROW_N,
    ROW_PRODUCTS,
    ROW_S,
    ROW_SCALED,
    ROW_T,
    ROW_TRIAL,
    ROW_Y,
    ROWS,
    SMALL,
    STATE,
    N,
    P,
    RowField,
    StateField,
    U,
    X,
)
from wbmpc.solver.simd_batch import evaluate_rows, load_block, take_rows_of_lane
from wbmpc.solver.stages import row_index, stage_end

#: Of a sum, as a share of its largest part.
ROUNDING = 1e-15


# ---------------------------------------------------------------------- all rows of a node
@compiled
def box_value(m: Floats, o: Integers, r: int, x: int, u: int) -> float:
    """h of a row of one variable."""
    i, first = o[row_index(o) + r], o[NX] + 1
    return (
        m[entry(o, RowField.SIGN, r)] * (m[x + i] if i < first else m[u + i - first]) + m[entry(o, RowField.OFFSET, r)]
    )


@compiled
def collect_values(m: Floats, o: Integers, k: int, x: int, u: int, out: int) -> None:
    """h of node k's rows at ``out``: those of one variable from x and u, general ones from where their function left them."""
    first, boxes, general = node_rows(o, k)
    for j in range(boxes):
        m[out + j] = box_value(m, o, first + j, x, u)
    for j in range(general):
        m[out + boxes + j] = m[o[SMALL] + 16 + j]


@compiled
def end_values(m: Floats, o: Integers, x: int) -> None:
    """Values of the general rows of the end into ``small`` from entry 16 on."""
    if o[END_ROW_GENERAL] > 0:
        out = o[SMALL] + 16
        stage_end(o, END_ROW_VALUES, x, o[P] + o[N] * o[NP], out, out)


@compiled
def rows_merit(m: Floats, o: Integers, k: int, x: int, u: int, alpha: float) -> tuple[float, float]:
    """(cost, violation) of node k's rows at the point x, u with slacks a step of ``alpha`` further; not yet times w.

    The values of its general rows are in ``small``."""
    first, boxes, general = node_rows(o, k)
    if boxes + general == 0:
        return 0.0, 0.0
    offset, mu, values = k * o[ROWS], m[o[STATE] + StateField.BARRIER], o[ROW_TRIAL]
    collect_values(m, o, k, x, u, values)
    if m[o[STATE] + StateField.CHECK_INPUT_ROWS] > 0.0:
        record_violations(m, o, k)
    cost, violation, product, logs = np.full(LANES, 0.0), np.full(LANES, 0.0), np.full(LANES, 1.0), 0.0
    for j in range(0, boxes + general, LANES):
        q, at = offset + j, values + j
        kind, penalty, active = eight_rows(m, o, first + j, k)
        h, l = m[at : at + LANES], m[o[ROW_L] + q : o[ROW_L] + q + LANES]  # noqa: E741
        t = m[o[ROW_T] + q : o[ROW_T] + q + LANES] + alpha * m[o[ROW_DT] + q : o[ROW_DT] + q + LANES]
        s = m[o[ROW_S] + q : o[ROW_S] + q + LANES] + alpha * m[o[ROW_DS] + q : o[ROW_DS] + q + LANES]
        c, v, factor = merits(kind, h, t, l, s, penalty)
        cost, violation = cost + np.where(active, c, 0.0), violation + np.where(active, v, 0.0)
        product = product * np.where(active, factor, 1.0)
        if not np.all((product > 1e-200) & (product < 1e200)):
            logs += log_of_product(m, o, product)
            product = np.full(LANES, 1.0)
    logs += log_of_product(m, o, product)
    return np.sum(cost) - mu * logs, np.sum(violation)


@compiled
def add_general(
    m: Floats, o: Integers, k: int, jacobian: int, offset: int, general: int, w: float, matrix: int, ld: int
) -> None:
    """Jᵀ w σ J of general rows (with e in the constant's column) onto a matrix of the extended node vector."""
    lz, base = o[LZ], o[BASE]
    if k < o[N]:
        for j in range(general):
            scale = w * m[o[ROW_C] + offset + j]
            for c in range(0, lz, LANES):
                out, row = o[ROW_SCALED] + j * lz + c, jacobian + j * lz + c
                m[out : out + LANES] = scale * m[row : row + LANES]
        call3(o[ADD_ROWS], base + 8 * jacobian, base + 8 * o[ROW_SCALED], base + 8 * matrix)
        return
    for j in range(general):
        scale, row = w * m[o[ROW_C] + offset + j], jacobian + j * lz
        for a in range(o[NX] + 1):
            for b in range(o[NX] + 1):
                m[matrix + a * ld + b] += scale * m[row + a] * m[row + b]


@compiled
def add_boxes(m: Floats, o: Integers, first: int, offset: int, boxes: int, w: float, matrix: int, ld: int) -> None:
    """w σ sign² and w σ sign e of the rows of one variable onto a matrix of the extended node vector."""
    index, signs = row_index(o) + first, entry(o, RowField.SIGN, first)
    for j in range(boxes):
        slope = w * m[o[ROW_C] + offset + j] * m[signs + j]
        add_square(m, o, matrix, ld, o[index + j], slope * m[signs + j], slope * m[o[ROW_E] + offset + j])


@compiled
def linearize_rows(m: Floats, o: Integers, k: int, x: int, u: int, matrix: int, ld: int) -> tuple[float, float]:
    """σ and e of node k's rows, and their part of the node's Hessian and gradient at ``matrix``: w times (cost, violation).

    The functions of general rows along the path have been called: values in ``small``, Jacobian where it belongs.
    """
    first, boxes, general = node_rows(o, k)
    if boxes + general == 0:
        return 0.0, 0.0
    w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
    mu, offset, lz = m[o[STATE] + StateField.BARRIER], k * o[ROWS], o[LZ]
    jacobian = o[ROW_J] + k * o[ROW_GENERAL] * lz if k < o[N] else o[END_J]
    if general > 0 and k == o[N]:
        stage_end(o, END_ROWS_J, x, o[P] + k * o[NP], o[SMALL] + 16, jacobian)
    collect_values(m, o, k, x, u, o[ROW_H] + offset)
    cost, violation, product, logs = np.full(LANES, 0.0), np.full(LANES, 0.0), np.full(LANES, 1.0), 0.0
    for j in range(0, boxes + general, LANES):
        q = offset + j
        kind, penalty, active = eight_rows(m, o, first + j, k)
        h, t = m[o[ROW_H] + q : o[ROW_H] + q + LANES], m[o[ROW_T] + q : o[ROW_T] + q + LANES]
        l, s = m[o[ROW_L] + q : o[ROW_L] + q + LANES], m[o[ROW_S] + q : o[ROW_S] + q + LANES]  # noqa: E741
        sigma, e = weights(kind, h, t, l, s, m[o[ROW_Y] + q : o[ROW_Y] + q + LANES], penalty, mu)
        m[o[ROW_C] + q : o[ROW_C] + q + LANES] = np.where(active, sigma, 0.0)
        m[o[ROW_E] + q : o[ROW_E] + q + LANES] = np.where(active, e, 0.0)
        c, v, factor = merits(kind, h, t, l, s, penalty)
        cost, violation = cost + np.where(active, c, 0.0), violation + np.where(active, v, 0.0)
        product = product * np.where(active, factor, 1.0)
        if not np.all((product > 1e-200) & (product < 1e200)):
            logs += log_of_product(m, o, product)
            product = np.full(LANES, 1.0)
    logs += log_of_product(m, o, product)
    add_boxes(m, o, first, offset, boxes, w, matrix, ld)
    for j in range(general):
        m[jacobian + j * lz + o[NX]] = m[o[ROW_E] + offset + boxes + j]
    if general > 0:
        add_general(m, o, k, jacobian, offset + boxes, general, w, matrix, ld)
    return w * (np.sum(cost) - mu * logs), w * np.sum(violation)


@compiled
def row_changes(m: Floats, o: Integers, k: int) -> None:
    """J δz of node k's rows into ``rows_d``."""
    first, boxes, general = node_rows(o, k)
    dx, du, nx, lz, out = o[DX] + k * o[LX], o[DU] + k * o[NU], o[NX], o[LZ], o[ROW_D] + k * o[ROWS]
    index, signs = row_index(o) + first, entry(o, RowField.SIGN, first)
    for j in range(boxes):
        i = o[index + j]
        m[out + j] = m[signs + j] * (m[dx + i] if i < nx else m[du + i - nx - 1])
    if general > 0 and k < o[N]:
        step, base = o[PULLED], o[BASE]
        for i in range(nx):
            m[step + i] = m[dx + i]
        m[step + nx] = 0.0
        for i in range(o[NU]):
            m[step + nx + 1 + i] = m[du + i]
        for i in range(nx + 1 + o[NU], lz):
            m[step + i] = 0.0
        jacobian = o[ROW_J] + k * o[ROW_GENERAL] * lz
        call3(o[ROW_PRODUCTS], base + 8 * jacobian, base + 8 * step, base + 8 * (out + boxes))
    elif general > 0:
        for j in range(general):
            row, total = o[END_J] + j * lz, 0.0
            for i in range(nx):
                total += m[row + i] * m[dx + i]
            m[out + boxes + j] = total


@compiled
def add_rows_product(m: Floats, o: Integers, k: int, w: float) -> None:
    """w Jᵀ σ J δz of node k by [x, 1, u] into ``pulled``: what the rows have put into H δz."""
    first, boxes, general = node_rows(o, k)
    offset, lz, out = k * o[ROWS], o[LZ], o[PULLED]
    for i in range(lz):
        m[out + i] = 0.0
    for j in range(boxes):
        q = offset + j
        m[out + o[row_index(o) + first + j]] += (
            w * m[o[ROW_C] + q] * m[o[ROW_D] + q] * m[entry(o, RowField.SIGN, first + j)]
        )
    size = lz if k < o[N] else o[NX]
    for j in range(general):
        q = offset + boxes + j
        row = (o[ROW_J] + k * o[ROW_GENERAL] * lz if k < o[N] else o[END_J]) + j * lz
        for i in range(size):
            m[out + i] += w * m[o[ROW_C] + q] * m[o[ROW_D] + q] * m[row + i]


# ---------------------------------------------------------------------- all nodes
@compiled
def rows_step(m: Floats, o: Integers, tau: float) -> None:
    """Steps of slacks and multipliers; what they say of the whole step goes to ``state`` (see memory_layout.py).

    ``tau``: fraction to the boundary.
    """
    state, mu, zero = o[STATE], m[o[STATE] + StateField.BARRIER], np.full(LANES, 0.0)
    primal, dual, slope, product, residual, left = zero, zero, zero, zero, zero, zero
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
        row_changes(m, o, k)
        for j in range(0, boxes + general, LANES):
            q = k * o[ROWS] + j
            kind, penalty, active = eight_rows(m, o, first + j, k)
            change, h = m[o[ROW_D] + q : o[ROW_D] + q + LANES], m[o[ROW_H] + q : o[ROW_H] + q + LANES]
            t, l = m[o[ROW_T] + q : o[ROW_T] + q + LANES], m[o[ROW_L] + q : o[ROW_L] + q + LANES]  # noqa: E741
            s, y = m[o[ROW_S] + q : o[ROW_S] + q + LANES], m[o[ROW_Y] + q : o[ROW_Y] + q + LANES]
            reach, hard = change + m[o[ROW_E] + q : o[ROW_E] + q + LANES], active & (kind == HARD)
            following = -m[o[ROW_C] + q : o[ROW_C] + q + LANES] * reach
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


@compiled
def take_rows(m: Floats, o: Integers, primal: float, dual: float, solved: bool) -> tuple[float, float]:
    """Slacks and multipliers move by their steps; those of MULTIPLIER rows only when ``solved``. Returns (mean, smallest)
    of the products of slacks and multipliers; (0, 0) without any."""
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
def start_rows(m: Floats, o: Integers, min_slack: float, keep: bool, keep_slacks: bool) -> None:
    """Slacks t = max(h, ``min_slack``) at the iterate; multipliers kept, or μ / t. Multiplier rows start at 0 when not kept.

    ``keep_slacks``: slacks that there are stay too.
    """
    mu = m[o[STATE] + StateField.BARRIER]
    kept = np.inf if keep else -1.0  # multipliers below it are kept
    slacks_kept = np.inf if keep and keep_slacks else -1.0
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        if boxes + general == 0:
            continue
        values_at_iterate(m, o, k)
        values = o[ROW_TRIAL]
        for j in range(0, boxes + general, LANES):
            q, at = k * o[ROWS] + j, values + j
            kind, penalty, _ = eight_rows(m, o, first + j, k)
            h, closed, hard = m[at : at + LANES], penalty < np.inf, kind == HARD
            t_old, l_old = m[o[ROW_T] + q : o[ROW_T] + q + LANES], m[o[ROW_L] + q : o[ROW_L] + q + LANES]
            s_old, y_old = m[o[ROW_S] + q : o[ROW_S] + q + LANES], m[o[ROW_Y] + q : o[ROW_Y] + q + LANES]
            t = np.where(h > min_slack, h, min_slack)  # also for a NaN
            l = np.where((l_old > 0.0) & (l_old < kept), l_old, mu / t)  # noqa: E741
            l = np.minimum(np.maximum(l, 1e-12), np.where(closed, 0.99 * penalty, np.inf))  # noqa: E741
            y = penalty - l
            s = np.where(closed, np.maximum(t - h, mu / y), 0.0)
            stay = (t_old > 0.0) & (abs(l_old) < slacks_kept)
            other = np.where(abs(l_old) < kept, l_old, 0.0)
            l = np.where(hard, np.where(stay, l_old, l), other)  # noqa: E741
            t, s = np.where(hard, np.where(stay, t_old, t), t_old), np.where(hard, np.where(stay, s_old, s), s_old)
            y = np.where(hard, np.where(stay, y_old, y), y_old)
            m[o[ROW_T] + q : o[ROW_T] + q + LANES] = t
            m[o[ROW_L] + q : o[ROW_L] + q + LANES] = l
            m[o[ROW_S] + q : o[ROW_S] + q + LANES] = s
            m[o[ROW_Y] + q : o[ROW_Y] + q + LANES] = y
