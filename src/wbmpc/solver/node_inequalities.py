"""Compiled code of the inequality rows of one node: their values, merit and part of the subproblem (see :mod:`wbmpc.solver.inequalities`)."""

from __future__ import annotations

import numpy as np

from wbmpc.solver.barriers import add_square
from wbmpc.solver.compilation import LANES, Floats, Integers, call3, call5, compiled
from wbmpc.solver.inequality_algebra import log_of_product, merits, weights
from wbmpc.solver.inequality_table import (
    eight_rows,
    entry,
    node_rows,
    record_violations,
)
from wbmpc.solver.memory_layout import (
    ADD_BOXES,
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
    ROW_PRODUCTS,
    ROW_S,
    ROW_T,
    ROW_TRIAL,
    ROW_Y,
    ROWS,
    SIGNED,
    SMALL,
    STATE,
    N,
    P,
    RowField,
    StateField,
)
from wbmpc.solver.stages import row_index, stage_end


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
        weights = o[SIGNED]
        for j in range(0, general, LANES):
            q = offset + j
            m[weights + j : weights + j + LANES] = w * m[o[ROW_C] + q : o[ROW_C] + q + LANES]
        call3(o[ADD_ROWS], base + 8 * jacobian, base + 8 * weights, base + 8 * matrix)
        return
    for j in range(general):
        scale, row = w * m[o[ROW_C] + offset + j], jacobian + j * lz
        for a in range(o[NX] + 1):
            for b in range(o[NX] + 1):
                m[matrix + a * ld + b] += scale * m[row + a] * m[row + b]


@compiled
def add_path_boxes(m: Floats, o: Integers, offset: int, w: float, matrix: int) -> None:
    """As :func:`add_boxes`, of a node of the path."""
    base, signs, weight = o[BASE], entry(o, RowField.SIGN, 0), o[PULLED]
    m[weight] = w
    sigma, e = base + 8 * (o[ROW_C] + offset), base + 8 * (o[ROW_E] + offset)
    call5(o[ADD_BOXES], base + 8 * signs, sigma, e, base + 8 * weight, base + 8 * matrix)


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
    if k < o[N]:
        add_path_boxes(m, o, offset, w, matrix)
    else:
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
    if k < o[N]:
        evaluate_boxes(m, o, BOX_CHANGES, dx, du, out)
    else:
        for j in range(boxes):
            m[out + j] = m[entry(o, RowField.SIGN, first + j)] * m[dx + o[row_index(o) + first + j]]
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
