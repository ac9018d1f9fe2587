"""Compiled code of one direction: linearise every node, eliminate backwards, roll the step forwards."""

from __future__ import annotations

from wbmpc.solver.compilation import BOOL, INT, INTS, NONE, NUM, NUM2, NUM4, NUMS, call7, compiled
from wbmpc.solver.exact import exact_end, exact_node
from wbmpc.solver.places import (
    AB,
    BASE,
    COST_Q,
    DU,
    DX,
    END_BOXES,
    END_J,
    END_Q,
    END_ROW_GENERAL,
    EPS,
    EQUALITY_J,
    EXACT,
    GRID,
    LX,
    LZ,
    NG,
    NP,
    NU,
    NX,
    PATH_BOXES,
    RICCATI,
    ROW_C,
    ROW_COST,
    ROW_D,
    ROW_GENERAL,
    ROW_J,
    ROW_TABLE,
    ROWS,
    SCRATCH,
    SHIFT,
    SMALL,
    STATE,
    TERMINAL,
    VALUE,
    E,
    G,
    H,
    K,
    N,
    P,
    U,
    X,
)  # fmt: skip
from wbmpc.solver.rows import add_barrier, barrier_value, counts, linearise_rows, node_rows
from wbmpc.solver.stages import linearise_dynamics, row_index, stage, stage_end


@compiled(NUM4, NUMS, INTS, INT, INT)
def linearise_node(m, o, k, slot):  # type: ignore[no-untyped-def]
    """All of node k, its Hessian into buffer ``slot``: (cost, gap, violation of equalities, of rows).

    The rows' part of the cost is also added up in ``state``.
    """
    nx, nu, ng, lz = o[NX], o[NU], o[NG], o[LZ]
    h = m[o[GRID] + k + 1] - m[o[GRID] + k]
    x, u, p = o[X] + k * nx, o[U] + k * nu, o[P] + k * o[NP]
    matrix, small, gradient = o[H] + slot * (nx + 1 + nu) * lz, o[SMALL], o[G] + k * lz
    gap = linearise_dynamics(m, o, k)
    m[small + 2] = h
    if o[ROW_GENERAL] + o[EXACT] > 0:  # rows and second derivatives add where the cost's functions write nothing
        for i in range((nx + 1 + nu) * lz):
            m[matrix + i] = 0.0
    stage(o, COST_Q, x, u, p, small + 3, matrix, matrix)
    cost = m[small + 3] + h * barrier_value(m, o, 0, o[PATH_BOXES], x, u)
    add_barrier(m, o, 0, o[PATH_BOXES], x, u, h, matrix, lz)
    for i in range(nx):
        m[gradient + i] = m[matrix + nx * lz + i]
    for i in range(nx + 1, nx + 1 + nu):
        m[gradient + i] = m[matrix + i * lz + nx]
    row_cost, row_violation = linearise_rows(m, o, k, x, u, matrix, lz)
    shift = m[o[STATE] + SHIFT]
    if shift > 0.0:
        for i in range(nx + 1 + nu):
            m[matrix + i * lz + i] += shift
    violation = 0.0
    if ng > 0:
        stage(o, EQUALITY_J, x, u, p, o[E], o[E], o[E])
        for q in range(ng):
            violation += abs(m[o[E] + q * lz + nx])
    if o[EXACT] > 0:
        exact_node(m, o, k, matrix)
    m[o[STATE] + ROW_COST] += row_cost
    return cost + row_cost, gap, violation, row_violation


@compiled(NUM2, NUMS, INTS)
def linearise_end(m, o):  # type: ignore[no-untyped-def]
    """Terminal cost and rows' violation; Hessian and gradient into ``terminal`` and the value function."""
    n, nx, lx = o[N], o[NX], o[LX]
    x, end = o[X] + n * nx, o[TERMINAL]
    if o[END_ROW_GENERAL] + o[EXACT] > 0:
        for i in range((nx + 1) * lx):
            m[end + i] = 0.0
    stage_end(o, END_Q, x, o[P] + n * o[NP], o[SMALL], end)
    add_barrier(m, o, o[PATH_BOXES], o[END_BOXES], x, x, 1.0, end, lx)
    for i in range(nx):
        m[o[G] + n * o[LZ] + i] = m[end + nx * lx + i]
    cost = m[o[SMALL]] + barrier_value(m, o, o[PATH_BOXES], o[END_BOXES], x, x)
    row_cost, violation = linearise_rows(m, o, n, x, x, end, lx)
    m[o[STATE] + ROW_COST] = row_cost
    if o[EXACT] > 0:
        exact_end(m, o, end)
    for i in range(nx):
        m[end + i * lx + i] += m[o[STATE] + SHIFT]
    for i in range((nx + 1) * lx):
        m[o[VALUE] + i] = m[end + i]
    return cost + row_cost, violation


@compiled(NONE, NUMS, INTS)
def symmetrise(m, o):  # type: ignore[no-untyped-def]
    """Mirror the value function: an antisymmetric rounding error would grow with the open loop's unstable modes."""
    value, lx = o[VALUE], o[LX]
    for i in range(o[NX]):
        for j in range(i):
            m[value + j * lx + i] = m[value + i * lx + j]


@compiled(NUM4, NUMS, INTS, BOOL)
def backward(m, o, keep):  # type: ignore[no-untyped-def]
    """Linearise and eliminate, from the last node to the first: (cost, Σ|gap|, Σ|equality|, Σ|row|).

    ``keep``: every node keeps its Hessian (for the KKT residual); else all share one buffer.
    """
    cost, rows = linearise_end(m, o)
    gaps, violations = 0.0, 0.0
    base, nx, nu, lx, lz = o[BASE], o[NX], o[NU], o[LX], o[LZ]
    for k in range(o[N] - 1, -1, -1):
        slot = k if keep else 0
        c, g, v, r = linearise_node(m, o, k, slot)
        cost, gaps, violations, rows = cost + c, gaps + g, violations + v, rows + r
        call7(
            o[RICCATI],
            base + 8 * (o[AB] + k * (nx + 1) * lz),
            base + 8 * (o[H] + slot * (nx + 1 + nu) * lz),
            base + 8 * o[E],
            base + 8 * o[EPS],
            base + 8 * o[VALUE],
            base + 8 * (o[K] + k * nu * lx),
            base + 8 * o[SCRATCH],
        )
        symmetrise(m, o)
    return cost, gaps, violations, rows


@compiled(NUM2, NUMS, INTS, NUMS)
def forward(m, o, x0):  # type: ignore[no-untyped-def]
    """The step: (largest component, directional derivative of the cost)."""
    n, nx, nu, lx, lz = o[N], o[NX], o[NU], o[LX], o[LZ]
    largest, slope = 0.0, 0.0
    for i in range(nx):
        m[o[DX] + i] = x0[i] - m[o[X] + i]
    for k in range(n):
        dx, du, g = o[DX] + k * lx, o[DU] + k * nu, o[G] + k * lz
        for j in range(nu):
            row, total = o[K] + (k * nu + j) * lx, 0.0
            for i in range(nx + 1):
                total += m[row + i] * m[dx + i]
            m[du + j] = total
            slope += total * m[g + nx + 1 + j]
            largest = max(largest, abs(total))
        for r in range(nx):
            row, total = o[AB] + (k * (nx + 1) + r) * lz, 0.0
            for i in range(nx + 1):
                total += m[row + i] * m[dx + i]
            for j in range(nu):
                total += m[row + nx + 1 + j] * m[du + j]
            m[dx + lx + r] = total
            slope += m[dx + r] * m[g + r]
            largest = max(largest, abs(m[dx + r]))
    for r in range(nx):
        slope += m[o[DX] + n * lx + r] * m[o[G] + n * lz + r]
        largest = max(largest, abs(m[o[DX] + n * lx + r]))
    return largest, slope


@compiled(NUM, NUMS, INTS, INT, INT, INT)
def rows_product(m, o, k, i, place):  # type: ignore[no-untyped-def]
    """Component ``i`` (of [x, 1, u]) of w Jᵀ σ J δz of node k: what the rows have put into H δz."""
    first, boxes, general = node_rows(o, k)
    w, total = (m[o[GRID] + k + 1] - m[o[GRID] + k]), 0.0
    for j in range(boxes):
        r = first + j
        if o[row_index(o) + r] == i and counts(o, r, k):
            total += w * m[o[ROW_C] + place + j] * m[o[ROW_D] + place + j] * m[o[ROW_TABLE] + 3 * r]
    for j in range(general):
        q = place + boxes + j
        total += w * m[o[ROW_C] + q] * m[o[ROW_D] + q] * m[o[ROW_J] + (k * general + j) * o[LZ] + i]
    return total


@compiled(NUM, NUMS, INTS, INT)
def end_product(m, o, i):  # type: ignore[no-untyped-def]
    """Component ``i`` of Jᵀ σ J δx of the end's rows."""
    first, boxes, general = node_rows(o, o[N])
    place, total = o[N] * o[ROWS], 0.0
    for j in range(boxes):
        if o[row_index(o) + first + j] == i:
            total += m[o[ROW_C] + place + j] * m[o[ROW_D] + place + j] * m[o[ROW_TABLE] + 3 * (first + j)]
    for j in range(general):
        q = place + boxes + j
        total += m[o[ROW_C] + q] * m[o[ROW_D] + q] * m[o[END_J] + j * o[LZ] + i]
    return total


@compiled(NUM2, NUMS, INTS)
def kkt_residual(m, o):  # type: ignore[no-untyped-def]
    """(max |H δz|, δzᵀ H δz), after :func:`wbmpc.solver.rows.rows_step`.

    With the quadratic problem's multipliers −H δz is the Lagrangian's gradient at the iterate, H without what the rows and
    the shift have put into it; the second number is with them.
    """
    n, nx, nu, lx, lz = o[N], o[NX], o[NU], o[LX], o[LZ]
    largest, curvature, nz, shift = 0.0, 0.0, nx + 1 + nu, m[o[STATE] + SHIFT]
    for k in range(n):
        h, dx, du = o[H] + k * nz * lz, o[DX] + k * lx, o[DU] + k * nu - nx - 1
        for i in range(nz):
            if i == nx:
                continue
            total = 0.0
            for j in range(nz):
                if j != nx:
                    low, high = (j, i) if j < i else (i, j)
                    total += m[h + high * lz + low] * (m[dx + j] if j < nx else m[du + j])
            step = m[dx + i] if i < nx else m[du + i]
            curvature += total * step
            largest = max(largest, abs(total - shift * step - rows_product(m, o, k, i, k * o[ROWS])))
    for i in range(nx):
        total = 0.0
        for j in range(nx):
            total += m[o[TERMINAL] + i * lx + j] * m[o[DX] + n * lx + j]
        curvature += total * m[o[DX] + n * lx + i]
        largest = max(largest, abs(total - shift * m[o[DX] + n * lx + i] - end_product(m, o, i)))
    return largest, curvature
