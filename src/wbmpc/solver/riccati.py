"""Compiled code of one direction: linearize every node, eliminate backwards, roll the step forwards."""

from __future__ import annotations

import numpy as np

from wbmpc.ocp.transcription import MIN_SOFTNESS
from wbmpc.solver.barriers import (
    BARRIER,
    INTERVAL,
    LANE_COST,
    add_barrier,
    add_barrier_of_lane,
    barrier_lanes,
    barrier_value,
)
from wbmpc.solver.compilation import LANES, Floats, Integers, call7, compiled
from wbmpc.solver.exact import costate_end, exact_end, exact_node
from wbmpc.solver.memory_layout import (
    AB,
    BASE,
    CURVATURE,
    DU,
    DX,
    END_BOXES,
    END_Q,
    END_ROW_GENERAL,
    EPS,
    EXACT,
    GRID,
    LANE_E,
    LANE_MATRIX,
    LANE_SMALL,
    LANE_U,
    LANE_VALUES,
    LANE_X,
    LANES_COST_Q,
    LANES_EQUALITY,
    LANES_EQUALITY_J,
    LANES_ROWS_J,
    LX,
    LZ,
    NG,
    NONLINEAR_EQUALITIES,
    NONLINEAR_INPUT_ROWS,
    NP,
    NU,
    NX,
    PATH_BOXES,
    PULLED,
    RICCATI,
    ROW_GENERAL,
    SCRATCH,
    SMALL,
    SOFT_RESIDUAL,
    STATE,
    STEP,
    TERMINAL,
    UNPACK_EQUALITIES,
    UNPACK_MATRIX,
    VALUE,
    E,
    G,
    H,
    K,
    N,
    P,
    StateField,
    U,
    X,
)
from wbmpc.solver.node_inequalities import (
    add_rows_of_lane,
    add_rows_product,
    linearize_end_rows,
    linearize_rows,
    row_jacobian,
)
from wbmpc.solver.nonlinear_input_constraints import add_curvature
from wbmpc.solver.settings import THRESHOLDS
from wbmpc.solver.simd_batch import (
    equality_size,
    linearize_dynamics,
    load_block,
    single_lane,
    stage_lanes,
    unpack,
)
from wbmpc.solver.stages import stage_end


@compiled
def linearize_block(m: Floats, o: Integers, first: int, count: int, slot: int) -> tuple[float, float]:
    """Dynamics, cost, equality rows and inequality rows of ``count`` ≤ 8 nodes from ``first`` on; Hessians into the buffers from
    ``slot`` on, equality rows into their eight. What is left to do is :func:`finish_node`. Returns (cost, violation) of the inequality rows."""
    nx, nu, lz = o[NX], o[NU], o[LZ]
    size, x, u = (nx + 1 + nu) * lz, o[LANE_X], o[LANE_U]
    matrix = o[H] + slot * size
    load_block(m, o, first, count, o[X], o[U])
    linearize_dynamics(m, o, first, count)
    if o[EXACT] + o[NONLINEAR_INPUT_ROWS] + o[NONLINEAR_EQUALITIES] > 0:
        # second derivatives add where the cost's functions write nothing
        for i in range(count * size):
            m[matrix + i] = 0.0
    stage_lanes(o, LANES_COST_Q, x, u, o[LANE_SMALL] + LANE_COST, o[LANE_MATRIX], o[LANE_MATRIX])
    if o[ROW_GENERAL] > 0:
        jacobian = row_jacobian(o, first)
        stage_lanes(o, LANES_ROWS_J, x, u, o[LANE_VALUES], jacobian, jacobian)
    row_cost, violation = linearize_rows(m, o, first, count)
    unpack(o, UNPACK_MATRIX, o[LANE_MATRIX], matrix, size, count)
    if o[PATH_BOXES] > 0:
        barrier_lanes(m, o, True)
    if o[NG] > 0:
        stage_lanes(o, LANES_EQUALITY_J, x, u, o[LANE_E], o[LANE_E], o[LANE_E])
        unpack(o, UNPACK_EQUALITIES, o[LANE_E], o[E], equality_size(o), count)
    m[o[STATE] + StateField.ROW_COST] += row_cost
    return row_cost, violation


@compiled
def finish_node(m: Floats, o: Integers, k: int, lane: int, slot: int) -> tuple[float, float, float]:
    """What the block's functions do not do of node k: limits, gradient, shift, sums: (cost, gap, violation of equalities). The part of
    soft equalities in the cost is also added up in ``state``.
    """
    nx, nu, lz = o[NX], o[NU], o[LZ]
    small = o[LANE_SMALL]
    matrix, gradient = o[H] + slot * (nx + 1 + nu) * lz, o[G] + k * lz
    ab, rows = o[AB] + k * (nx + 1) * lz + nx, o[E] + lane * equality_size(o)
    h, gap, violation = m[small + INTERVAL + lane], 0.0, 0.0
    cost = m[small + LANE_COST + lane]
    if o[PATH_BOXES] > 0:
        cost += h * m[small + BARRIER + lane]
        add_barrier_of_lane(m, o, lane, matrix, lz)
    for i in range(nx):
        m[gradient + i] = m[matrix + nx * lz + i]
        gap += abs(m[ab + i * lz])
    for i in range(nx + 1, nx + 1 + nu):
        m[gradient + i] = m[matrix + i * lz + nx]
    add_rows_of_lane(m, o, k, lane, matrix)
    soft_cost = 0.0
    shift = m[o[STATE] + StateField.SHIFT]
    if shift > 0.0:
        for i in range(nx + 1 + nu):
            m[matrix + i * lz + i] += shift
    for q in range(o[NG]):
        violation += abs(m[rows + q * lz + nx])
        if m[o[EPS] + q] > MIN_SOFTNESS:
            e, r = m[rows + q * lz + nx], m[o[SOFT_RESIDUAL] + k * o[NG] + q]
            m[o[STATE] + StateField.SOFT_EQUALITY_VIOLATION] += abs(e) - abs(e - r)
            soft_cost += 0.5 * r * r / m[o[EPS] + q]
    if o[EXACT] > 0:
        single_lane(m, o, lane)
        exact_node(m, o, k, matrix, rows)
    elif o[NONLINEAR_INPUT_ROWS] + o[NONLINEAR_EQUALITIES] > 0:
        add_curvature(m, o, k, matrix, rows)
    m[o[STATE] + StateField.ROW_COST] += soft_cost
    return cost + soft_cost, gap, violation


@compiled
def linearize_end(m: Floats, o: Integers) -> tuple[float, float]:
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
    row_cost, violation = linearize_end_rows(m, o, x, end, lx)
    m[o[STATE] + StateField.ROW_COST], m[o[STATE] + StateField.SOFT_EQUALITY_VIOLATION] = row_cost, 0.0
    if o[EXACT] > 0:
        exact_end(m, o, end)
    elif o[NONLINEAR_EQUALITIES] > 0:
        costate_end(m, o)
    for i in range(nx):
        m[end + i * lx + i] += m[o[STATE] + StateField.SHIFT]
    for i in range((nx + 1) * lx):
        m[o[VALUE] + i] = m[end + i]
    m[o[VALUE] + nx * lx + nx] = 0.0  # squares of what rows miss: they are in the cost
    return cost + row_cost, violation


@compiled
def backward(m: Floats, o: Integers, keep: bool) -> tuple[float, float, float, float]:
    """Linearize and eliminate, from the last node to the first: (cost, Σ|gap|, Σ|equality|, Σ|row|).

    ``keep``: every node keeps its Hessian (for the KKT residual); else eight buffers are enough.
    """
    cost, rows = linearize_end(m, o)
    gaps, violations = 0.0, 0.0
    base, nx, nu, lx, lz = o[BASE], o[NX], o[NU], o[LX], o[LZ]
    for block in range((o[N] - 1) // LANES, -1, -1):
        start = block * LANES
        count, slot = min(LANES, o[N] - start), start if keep else 0
        c, v = linearize_block(m, o, start, count, slot)
        cost, rows = cost + c, rows + v
        for lane in range(count - 1, -1, -1):
            k = start + lane
            c, g, v = finish_node(m, o, k, lane, slot + lane)
            cost, gaps, violations = cost + c, gaps + g, violations + v
            call7(
                o[RICCATI],
                base + 8 * (o[AB] + k * (nx + 1) * lz),
                base + 8 * (o[H] + (slot + lane) * (nx + 1 + nu) * lz),
                base + 8 * (o[E] + lane * equality_size(o)),
                base + 8 * o[EPS],
                base + 8 * o[VALUE],
                base + 8 * (o[K] + k * nu * lx),
                base + 8 * o[SCRATCH],
            )
    return cost, gaps, violations, rows


@compiled
def first_equalities(m: Floats, o: Integers) -> float:
    """The worst equality of the plan's first input, as a share of what its row [C e D] makes of inputs: |g| / (|D| + Σ |D_i u_i|).

    Rows with a softness to speak of are soft. The buffer still has the first node's rows: they were eliminated last.
    """
    nu, lz, values, state = o[NU], o[LZ], o[LANE_VALUES], o[STATE]
    m[state + StateField.EQUALITY_RESIDUAL] = 0.0
    load_block(m, o, 0, min(LANES, o[N]), o[X], o[U])
    stage_lanes(o, LANES_EQUALITY, o[LANE_X], o[LANE_U], values, values, values)
    for q in range(o[NG]):
        row, square, size = o[E] + q * lz + o[NX] + 1, 0.0, 0.0
        for i in range(nu):
            square += m[row + i] ** 2
            size += abs(m[row + i] * m[o[U] + i])
        by = abs(m[values + LANES * q]) / (max(np.sqrt(square), THRESHOLDS.min_slope) + size)
        if m[o[EPS] + q] <= MIN_SOFTNESS and by > m[state + StateField.EQUALITY_RESIDUAL]:
            m[state + StateField.EQUALITY_RESIDUAL], m[state + StateField.EQUALITY_ROW] = by, q
    return m[state + StateField.EQUALITY_RESIDUAL]


@compiled
def begin_step(m: Floats, o: Integers, x0: Floats) -> None:
    """The step of the first state; :func:`step_block` follows for all blocks, from the first on, then :func:`end_step`."""
    sums = o[PULLED] + o[LZ] + LANES
    for i in range(2 * LANES):
        m[sums + i] = 0.0
    for i in range(o[NX]):
        m[o[DX] + i] = x0[i] - m[o[X] + i]


@compiled
def step_block(m: Floats, o: Integers, first: int) -> None:
    """The step of the inputs of up to eight nodes from ``first`` on, and of the states that follow."""
    nx, nu, lx, lz, base = o[NX], o[NU], o[LX], o[LZ], o[BASE]
    slopes = o[PULLED] + lz + LANES
    for k in range(first, min(first + LANES, o[N])):
        call7(
            o[STEP],
            base + 8 * (o[AB] + k * (nx + 1) * lz),
            base + 8 * (o[K] + k * nu * lx),
            base + 8 * (o[DX] + k * lx),
            base + 8 * (o[DU] + k * nu),
            base + 8 * (o[G] + k * lz),
            base + 8 * o[PULLED],
            base + 8 * slopes,
        )


@compiled
def end_step(m: Floats, o: Integers) -> tuple[float, float]:
    """(Largest component of the step, directional derivative of the cost)."""
    n, slopes = o[N], o[PULLED] + o[LZ] + LANES
    sizes, slope = slopes + LANES, np.sum(m[slopes : slopes + LANES])
    for r in range(o[NX]):
        slope += m[o[DX] + n * o[LX] + r] * m[o[G] + n * o[LZ] + r]
    return np.max(m[sizes : sizes + LANES]), slope


@compiled
def value_of_subproblem(m: Floats, o: Integers) -> float:
    """The least value of the quadratic problem without the constant of its cost, after :func:`end_step`: what the recursion leaves in the
    extended value function of the first node, at the first node's step."""
    total, nx = m[o[VALUE] + o[NX] * o[LX] + o[NX]], o[NX]
    for i in range(nx):
        row, along = o[VALUE] + i * o[LX], 2.0 * m[o[VALUE] + i * o[LX] + nx]
        for j in range(nx):
            along += m[row + j] * m[o[DX] + j]
        total += along * m[o[DX] + i]
    return 0.5 * total


@compiled
def kkt_residual(m: Floats, o: Integers) -> tuple[float, float]:
    """(max |H δz|, δzᵀ H δz), after :func:`wbmpc.solver.inequalities.rows_step`.

    With the quadratic problem's multipliers −H δz is the Lagrangian's gradient at the iterate, H without what the rows and
    the shift have put into it; the second number is with them.
    """
    n, nx, nu, lx, lz, base = o[N], o[NX], o[NU], o[LX], o[LZ], o[BASE]
    shift, curvatures = m[o[STATE] + StateField.SHIFT], o[SCRATCH] + lz + LANES
    residuals = curvatures + LANES
    m[curvatures : curvatures + LANES] = np.full(LANES, 0.0)
    m[residuals : residuals + LANES] = np.full(LANES, 0.0)
    for k in range(n):
        add_rows_product(m, o, k, m[o[GRID] + k + 1] - m[o[GRID] + k])
        call7(
            o[CURVATURE],
            base + 8 * (o[H] + k * (nx + 1 + nu) * lz),
            base + 8 * (o[DX] + k * lx),
            base + 8 * (o[DU] + k * nu),
            base + 8 * o[PULLED],
            base + 8 * (o[STATE] + StateField.SHIFT),
            base + 8 * o[SCRATCH],
            base + 8 * curvatures,
        )
    largest, curvature = 0.0, 0.0
    add_rows_product(m, o, n, 1.0)
    for i in range(nx):
        total = 0.0
        for j in range(nx):
            total += m[o[TERMINAL] + i * lx + j] * m[o[DX] + n * lx + j]
        curvature += total * m[o[DX] + n * lx + i]
        largest = max(largest, abs(total - shift * m[o[DX] + n * lx + i] - m[o[PULLED] + i]))
    most = np.max(m[residuals : residuals + LANES])
    return max(largest, most), curvature + np.sum(m[curvatures : curvatures + LANES])
