"""Compiled code of the inequality rows of one node: their values, merit and part of the subproblem (see :mod:`wbmpc.solver.inequalities`)."""

from __future__ import annotations

import numpy as np

from wbmpc.solver.barriers import INTERVAL, add_square
from wbmpc.solver.compilation import LANES, Floats, Integers, call2, call3, call4, call5, call6, compiled
from wbmpc.solver.inequality_algebra import merits, weights
from wbmpc.solver.inequality_table import (
    HARD,
    ROUNDING,
    eight_rows,
    entry,
    node_rows,
    record_violations,
)
from wbmpc.solver.memory_layout import (
    ADD_BOXES,
    ADD_ROW_GRADIENT,
    ADD_ROWS,
    BASE,
    BOX_CHANGES,
    BOX_VALUES,
    DU,
    DX,
    END_J,
    END_ROW_GENERAL,
    END_ROW_VALUES,
    END_ROWS_J,
    GRID,
    LANE_MATRIX,
    LANE_PULLED,
    LANE_SMALL,
    LANE_U,
    LANE_VALUES,
    LANE_WEIGHTS,
    LANE_X,
    LX,
    LZ,
    NODE_ROWS,
    NP,
    NU,
    NX,
    PACK,
    PULLED,
    PULLED_ROWS,
    ROW_BOXES,
    ROW_C,
    ROW_D,
    ROW_DS,
    ROW_DT,
    ROW_E,
    ROW_ENTRIES,
    ROW_GENERAL,
    ROW_H,
    ROW_J,
    ROW_L,
    ROW_MATRIX,
    ROW_PRODUCTS,
    ROW_S,
    ROW_T,
    ROW_Y,
    ROWS,
    SIGNED,
    SMALL,
    STATE,
    UNPACK_ROWS,
    N,
    P,
    RowField,
    StateField,
    U,
    X,
)
from wbmpc.solver.stages import row_index, stage_end

#: How rows start: anew, with the multipliers that there are, with slacks, too.
FRESH, KEEP_MULTIPLIERS, KEEP_SLACKS = 1.0, 2.0, 3.0


@compiled
def box_value(m: Floats, o: Integers, r: int, x: int, u: int) -> float:
    """h of a row of one variable."""
    i, first = o[row_index(o) + r], o[NX] + 1
    return (
        m[entry(o, RowField.SIGN, r)] * (m[x + i] if i < first else m[u + i - first]) + m[entry(o, RowField.OFFSET, r)]
    )


@compiled
def evaluate_boxes(m: Floats, o: Integers, function: int, x: int, u: int, out: int) -> None:
    """h of the path's rows of one variable, or their changes by a step, of the states at ``x`` and the inputs at ``u``."""
    base, signs, offsets = o[BASE], entry(o, RowField.SIGN, 0), entry(o, RowField.OFFSET, 0)
    call5(o[function], base + 8 * x, base + 8 * u, base + 8 * signs, base + 8 * offsets, base + 8 * out)


@compiled
def collect_values(m: Floats, o: Integers, k: int, x: int, u: int, out: int) -> None:
    """h of node k's rows at ``out``: those of one variable from x and u, general ones from where their function left them."""
    first, boxes, general = node_rows(o, k)
    if k < o[N]:
        evaluate_boxes(m, o, BOX_VALUES, x, u, out)
    else:
        for j in range(boxes):
            m[out + j] = box_value(m, o, first + j, x, u)
    for j in range(general):
        m[out + boxes + j] = m[o[SMALL] + 16 + j]


@compiled
def values_of_block(m: Floats, o: Integers, first: int, count: int, at: tuple[int, int], out: int) -> None:
    """h of ``count`` nodes' rows from node ``first`` on, one node after the other at ``out``: as :func:`collect_values`; ``at``: where the
    trajectories are."""
    boxes, base = o[ROW_BOXES], o[BASE]
    x, u = at
    if o[ROW_GENERAL] > 0:
        call4(o[UNPACK_ROWS], base + 8 * o[LANE_VALUES], base + 8 * (out + boxes), 8 * o[ROWS], count - 1)
    for k in range(first, first + count):
        if boxes > 0:
            evaluate_boxes(m, o, BOX_VALUES, x + k * o[NX], u + k * o[NU], out + (k - first) * o[ROWS])


@compiled
def end_values(m: Floats, o: Integers, x: int) -> None:
    """Values of the general rows of the end into ``small`` from entry 16 on."""
    if o[END_ROW_GENERAL] > 0:
        out = o[SMALL] + 16
        stage_end(o, END_ROW_VALUES, x, o[P] + o[N] * o[NP], out, out)


@compiled
def rows_merit(m: Floats, o: Integers, k: int, values: int, alpha: float) -> tuple[float, float]:
    """(cost, violation) of node k's rows with the ``values``, and slacks a step of ``alpha`` further; not yet times w."""
    first, boxes, general = node_rows(o, k)
    if boxes + general == 0:
        return 0.0, 0.0
    offset, mu = k * o[ROWS], m[o[STATE] + StateField.BARRIER]
    zero, product = np.full(LANES, 0.0), np.full(LANES, 1.0)
    cost, violation, logs, outside = zero, zero, zero, zero
    for j in range(0, boxes + general, LANES):
        q, at = offset + j, values + j
        kind, penalty, active = eight_rows(m, o, first + j, k)
        h, l = m[at : at + LANES], m[o[ROW_L] + q : o[ROW_L] + q + LANES]  # noqa: E741
        t = m[o[ROW_T] + q : o[ROW_T] + q + LANES] + alpha * m[o[ROW_DT] + q : o[ROW_DT] + q + LANES]
        s = m[o[ROW_S] + q : o[ROW_S] + q + LANES] + alpha * m[o[ROW_DS] + q : o[ROW_DS] + q + LANES]
        c, v, factor = merits(kind, h, t, l, s, penalty)
        cost, violation = cost + np.where(active, c, 0.0), violation + np.where(active, v, 0.0)
        outside, product = np.maximum(outside, -h), product * np.where(active, factor, 1.0)
        if not np.all((product > 1e-200) & (product < 1e200)):
            logs = logs + np.log(product)
            product = np.full(LANES, 1.0)
    if m[o[STATE] + StateField.CHECK_INPUT_ROWS] > 0.0 and np.max(outside) > ROUNDING:
        record_violations(m, o, k, values)
    logs = logs + np.log(product)
    return np.sum(cost - mu * logs), np.sum(violation)


@compiled
def start_node(m: Floats, o: Integers, k: int, values: int, min_slack: float, how: float) -> None:
    """Slacks and multipliers of node k's rows, which have the ``values``; see :func:`wbmpc.solver.inequalities.start_rows`."""
    first, boxes, general = node_rows(o, k)
    mu = m[o[STATE] + StateField.BARRIER]
    kept = np.inf if how > FRESH else -1.0  # multipliers below it are kept
    slacks_kept = np.inf if how > KEEP_MULTIPLIERS else -1.0
    for j in range(0, boxes + general, LANES):
        q, at = k * o[ROWS] + j, values + j
        kind, penalty, _ = eight_rows(m, o, first + j, k)
        h, closed, hard = m[at : at + LANES], penalty < np.inf, kind == HARD
        t_old, l_old = m[o[ROW_T] + q : o[ROW_T] + q + LANES], m[o[ROW_L] + q : o[ROW_L] + q + LANES]
        s_old, y_old = m[o[ROW_S] + q : o[ROW_S] + q + LANES], m[o[ROW_Y] + q : o[ROW_Y] + q + LANES]
        t = np.where(h > min_slack, h, min_slack)  # also for a NaN
        l, stays = l_old, (l_old > 0.0) & (l_old < kept)  # noqa: E741
        if not np.all(stays):  # divisions are what a row costs
            l = np.where(stays, l_old, mu / t)  # noqa: E741
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


@compiled
def add_end_general(m: Floats, o: Integers, offset: int, general: int, matrix: int, ld: int) -> None:
    """Jᵀ σ J of the end's general rows, and Jᵀ σ e in the constant's row and column, onto a matrix of [x, 1]."""
    nx = o[NX]
    for j in range(general):
        scale, row = m[o[ROW_C] + offset + j], o[END_J] + j * o[LZ]
        m[row + nx] = m[o[ROW_E] + offset + j]
        for a in range(nx + 1):
            for b in range(nx + 1):
                m[matrix + a * ld + b] += scale * m[row + a] * m[row + b]


@compiled
def add_path_boxes(m: Floats, o: Integers, offset: int, w: float, matrix: int) -> None:
    """As :func:`add_boxes` of a node of the path, times ``w``."""
    base, signs, weight = o[BASE], entry(o, RowField.SIGN, 0), o[PULLED]
    m[weight] = w
    sigma, e = base + 8 * (o[ROW_C] + offset), base + 8 * (o[ROW_E] + offset)
    call5(o[ADD_BOXES], base + 8 * signs, sigma, e, base + 8 * weight, base + 8 * matrix)


@compiled
def add_boxes(m: Floats, o: Integers, first: int, offset: int, boxes: int, matrix: int, ld: int) -> None:
    """σ sign² and σ sign e of the end's rows of one variable onto a matrix of [x, 1]."""
    index, signs = row_index(o) + first, entry(o, RowField.SIGN, first)
    for j in range(boxes):
        slope = m[o[ROW_C] + offset + j] * m[signs + j]
        add_square(m, o, matrix, ld, o[index + j], slope * m[signs + j], slope * m[o[ROW_E] + offset + j])


@compiled
def weigh_rows(m: Floats, o: Integers, k: int) -> tuple[float, float]:
    """σ and e of node k's rows, whose values are there: w times (cost, violation)."""
    first, boxes, general = node_rows(o, k)
    w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
    mu, offset, how = m[o[STATE] + StateField.BARRIER], k * o[ROWS], m[o[STATE] + StateField.START]
    if how > 0.0:
        start_node(m, o, k, o[ROW_H] + offset, m[o[STATE] + StateField.START_SLACK], how)
    zero, product = np.full(LANES, 0.0), np.full(LANES, 1.0)
    cost, violation, logs = zero, zero, zero
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
            logs = logs + np.log(product)
            product = np.full(LANES, 1.0)
    logs = logs + np.log(product)
    return w * np.sum(cost - mu * logs), w * np.sum(violation)


@compiled
def linearize_rows(m: Floats, o: Integers, first: int, count: int) -> tuple[float, float]:
    """σ and e of all rows of a block that is loaded, and what its general rows add to the Hessians in ``lane_matrix`` and, in ``lane_pulled``,
    to the gradients: w times (cost, violation). The functions of general rows have been called."""
    boxes, general, cost, violation = o[ROW_BOXES], o[ROW_GENERAL], 0.0, 0.0
    if boxes + general == 0:
        return 0.0, 0.0
    at, stride, base = first * o[ROWS] + boxes, 8 * o[ROWS], o[BASE]
    values_of_block(m, o, first, count, (o[X], o[U]), o[ROW_H] + first * o[ROWS])
    for k in range(first, first + count):
        c, v = weigh_rows(m, o, k)
        cost, violation = cost + c, violation + v
    if general > 0:
        groups, sigma = (general + 7) // 8, o[LANE_WEIGHTS]
        e = sigma + LANES * LANES * groups
        call5(o[PACK], base + 8 * (o[ROW_C] + at), stride, groups, base + 8 * sigma, count - 1)
        call5(o[PACK], base + 8 * (o[ROW_E] + at), stride, groups, base + 8 * e, count - 1)
        call6(
            o[ADD_ROWS],
            base + 8 * row_jacobian(o, first),
            base + 8 * sigma,
            base + 8 * e,
            base + 8 * (o[LANE_SMALL] + INTERVAL),
            base + 8 * o[LANE_MATRIX],
            base + 8 * o[LANE_PULLED],
        )
    return cost, violation


@compiled
def add_rows_of_lane(m: Floats, o: Integers, k: int, lane: int, matrix: int) -> None:
    """What is left to add of node k's rows onto its Hessian: rows of one variable, and the gradient of general ones."""
    base = o[BASE]
    if o[ROW_BOXES] > 0:
        add_path_boxes(m, o, k * o[ROWS], m[o[LANE_SMALL] + INTERVAL + lane], matrix)
    if o[ROW_GENERAL] > 0:
        call2(o[ADD_ROW_GRADIENT], base + 8 * (o[LANE_PULLED] + lane), base + 8 * matrix)


@compiled
def linearize_end_rows(m: Floats, o: Integers, x: int, matrix: int, ld: int) -> tuple[float, float]:
    """As :func:`linearize_rows`, of the end of the horizon: onto its Hessian."""
    n = o[N]
    first, boxes, general = node_rows(o, n)
    offset = n * o[ROWS]
    if boxes + general == 0:
        return 0.0, 0.0
    if general > 0:
        stage_end(o, END_ROWS_J, x, o[P] + n * o[NP], o[SMALL] + 16, o[END_J])
    collect_values(m, o, n, x, x, o[ROW_H] + offset)
    cost, violation = weigh_rows(m, o, n)
    add_boxes(m, o, first, offset, boxes, matrix, ld)
    add_end_general(m, o, offset + boxes, general, matrix, ld)
    return cost, violation


@compiled
def row_jacobian(o: Integers, k: int) -> int:
    """Where the Jacobian of the general rows of node k's block is."""
    return o[ROW_J] + LANES * o[ROW_ENTRIES] * (k // LANES)


@compiled
def node_matrix(o: Integers, k: int) -> None:
    """The Jacobian of node k's general rows with all columns to ``row_matrix``."""
    base = o[BASE]
    if o[ROW_GENERAL] > 0 and k < o[N]:
        call2(o[NODE_ROWS], base + 8 * (row_jacobian(o, k) + k % LANES), base + 8 * o[ROW_MATRIX])


@compiled
def general_row_changes(m: Floats, o: Integers, first: int, count: int) -> None:
    """J δz of the general rows of a block into ``rows_d``."""
    base, step, inputs, out = o[BASE], o[LANE_X], o[LANE_U], o[LANE_VALUES]
    dx, du = o[DX] + first * o[LX], o[DU] + first * o[NU]
    call5(o[PACK], base + 8 * dx, 8 * o[LX], (o[NX] + 7) // 8, base + 8 * step, count - 1)
    call5(o[PACK], base + 8 * du, 8 * o[NU], (o[NU] + 7) // 8, base + 8 * inputs, count - 1)
    call4(o[ROW_PRODUCTS], base + 8 * row_jacobian(o, first), base + 8 * step, base + 8 * inputs, base + 8 * out)
    place = o[ROW_D] + first * o[ROWS] + o[ROW_BOXES]
    call4(o[UNPACK_ROWS], base + 8 * out, base + 8 * place, 8 * o[ROWS], count - 1)


@compiled
def row_changes(m: Floats, o: Integers, k: int) -> None:
    """J δz of node k's rows into ``rows_d``; nodes are asked for one after the other."""
    first, boxes, general = node_rows(o, k)
    dx, du, nx, lz, out = o[DX] + k * o[LX], o[DU] + k * o[NU], o[NX], o[LZ], o[ROW_D] + k * o[ROWS]
    if k < o[N]:
        if general > 0 and k % LANES == 0:
            general_row_changes(m, o, k, min(LANES, o[N] - k))
        evaluate_boxes(m, o, BOX_CHANGES, dx, du, out)
        return
    for j in range(boxes):
        m[out + j] = m[entry(o, RowField.SIGN, first + j)] * m[dx + o[row_index(o) + first + j]]
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
    for j in range(general):
        m[o[SIGNED] + j] = w * m[o[ROW_C] + offset + boxes + j] * m[o[ROW_D] + offset + boxes + j]
    if k < o[N] and general > 0:
        base = o[BASE]
        jacobian = row_jacobian(o, k) + k % LANES
        call3(o[PULLED_ROWS], base + 8 * jacobian, base + 8 * o[SIGNED], base + 8 * out)
        return
    for j in range(general):
        for i in range(o[NX]):
            m[out + i] += m[o[SIGNED] + j] * m[o[END_J] + j * lz + i]
