"""Compiled code of the exact Hessian of the Lagrangian: what the Gauss-Newton Hessian leaves out.

With the midpoint rule x⁺ = x + h f(x₂, u), x₂ = x + h/2 f(x, u), costate λ of x⁺ and M = ∂(x₂, u)/∂(x, u):
∇²(λᵀ x⁺) = Mᵀ ∇²(h λᵀ f)(x₂, u) M + ∇²(aᵀ f)(x, u), a = h²/2 f_xᵀ(x₂) λ. The classic rule has four such terms: stage i has the
adjoint aᵢ = wᵢ h λ + cᵢ₊₁ f_xᵀ(xᵢ₊₁) aᵢ₊₁ and Mᵢ = [I + cᵢ Tᵢ₋₁; I by u], T of the sensitivities (docs/explanation/solver.md).
Costates and equality multipliers are those of least squares at the iterate: Dᵀ ν = −(∇_u cost + Bᵀ λ) (Nocedal and Wright 2006,
section 18.3).
"""

from __future__ import annotations

import numpy as np

from wbmpc.solver.compilation import LANES, Floats, Integers, call2, compiled
from wbmpc.solver.inequality_table import HARD, MULTIPLIER, counts, entry, kind_of, node_rows, row_penalty
from wbmpc.solver.memory_layout import (
    AB,
    ADJOINT,
    ARG,
    BASE,
    CHAINED,
    DYNAMICS_H,
    END_J,
    END_LAGRANGIAN,
    GRID,
    J1,
    J2,
    LAGRANGIAN,
    LANE_F,
    LANE_J1,
    LANE_J2,
    LANE_J3,
    LANE_J4,
    LANE_S1,
    LANE_S2,
    LX,
    LZ,
    NG,
    NORMAL,
    NP,
    NU,
    NU_ROWS,
    NX,
    RES,
    RK4,
    ROW_H,
    ROW_L,
    ROW_MATRIX,
    ROWS,
    SECOND,
    SIGNED,
    SLOPES,
    SMALL,
    STATE,
    G,
    N,
    P,
    RowField,
    StateField,
    U,
    W,
    X,
)
from wbmpc.solver.node_inequalities import node_matrix
from wbmpc.solver.stages import offset_state, row_index


@compiled
def stage_with(o: Integers, function: int, x: int, u: int, p: int, first: int, second: int, result: int) -> None:
    """Call a stage function of (x, u, p, w, h, first, second)."""
    base = o[BASE]
    o[ARG], o[ARG + 1], o[ARG + 2], o[ARG + 3] = base + 8 * x, base + 8 * u, base + 8 * p, base + 8 * o[W]
    o[ARG + 4], o[ARG + 5], o[ARG + 6] = base + 8 * (o[SMALL] + 2), base + 8 * first, base + 8 * second
    o[RES] = base + 8 * result
    call2(o[function], o.ctypes.data + 8 * ARG, o.ctypes.data + 8 * RES)


@compiled
def signed_multiplier(m: Floats, o: Integers, k: int, j: int) -> float:
    """Multiplier of row j of node k as it stands before the row's value in the Lagrangian."""
    first, _, _ = node_rows(o, k)
    r, q = first + j, k * o[ROWS] + j
    if not counts(m, o, r, k):
        return 0.0
    kind, l, h = kind_of(m, o, r), m[o[ROW_L] + q], m[o[ROW_H] + q]  # noqa: E741
    if kind == HARD:
        return -l
    if kind == MULTIPLIER:
        return -max(0.0, l - row_penalty(m, o, r) * h)
    return l


@compiled
def add_row_gradient(m: Floats, o: Integers, k: int, jacobian: int, gradient: int, w: int) -> None:
    """w κᵀ J of the node's rows onto a gradient by [x, 1, u]; ``w`` is an offset into the memory. Fills ``signed``."""
    first, boxes, general = node_rows(o, k)
    for j in range(boxes + general):
        value = m[w] * signed_multiplier(m, o, k, j)
        if j < boxes:
            m[gradient + o[row_index(o) + first + j]] += value * m[entry(o, RowField.SIGN, first + j)]
            continue
        m[o[SIGNED] + j - boxes] = signed_multiplier(m, o, k, j)
        row = jacobian + (j - boxes) * o[LZ]
        for i in range(o[NX]):
            m[gradient + i] += value * m[row + i]
        if k < o[N]:
            for i in range(o[NX] + 1, o[NX] + 1 + o[NU]):
                m[gradient + i] += value * m[row + i]


@compiled
def least_squares_multipliers(m: Floats, o: Integers, rows: int) -> None:
    """ν of the equality rows [C e D] at ``rows`` from the gradient by u in ``chained``: (D Dᵀ + ε) ν = −D g."""
    ng, nu, lz, first = o[NG], o[NU], o[LZ], o[NX] + 1
    normal, nu_rows, gradient = o[NORMAL], o[NU_ROWS], o[CHAINED]
    for a in range(ng):
        right = 0.0
        for b in range(a + 1):
            total = 0.0
            for i in range(nu):
                total += m[rows + a * lz + first + i] * m[rows + b * lz + first + i]
            m[normal + a * ng + b] = total
        for i in range(nu):
            right -= m[rows + a * lz + first + i] * m[gradient + first + i]
        m[nu_rows + a] = right
        m[normal + a * ng + a] += 1e-10 * m[normal + a * ng + a] + 1e-12
    for a in range(ng):  # Cholesky, then both triangular solves
        for b in range(a + 1):
            total = m[normal + a * ng + b]
            for c in range(b):
                total -= m[normal + a * ng + c] * m[normal + b * ng + c]
            m[normal + a * ng + b] = np.sqrt(max(total, 1e-300)) if a == b else total / m[normal + b * ng + b]
    for a in range(ng):
        for b in range(a):
            m[nu_rows + a] -= m[normal + a * ng + b] * m[nu_rows + b]
        m[nu_rows + a] /= m[normal + a * ng + a]
    for a in range(ng - 1, -1, -1):
        for b in range(a + 1, ng):
            m[nu_rows + a] -= m[normal + b * ng + a] * m[nu_rows + b]
        m[nu_rows + a] /= m[normal + a * ng + a]


@compiled
def add_second(m: Floats, o: Integers, matrix: int, ld: int) -> None:
    """``second`` onto a matrix of the extended node vector (or its part by [x, 1])."""
    size, theta = o[NX] + 1 + (o[NU] if ld == o[LZ] else 0), m[o[STATE] + StateField.SECOND_ORDER_SHARE]
    for i in range(size):
        for j in range(size):
            if i != o[NX] and j != o[NX]:
                m[matrix + i * ld + j] += theta * m[o[SECOND] + i * ld + j]


@compiled
def add_chained(m: Floats, o: Integers, matrix: int, c: float) -> None:
    """Mᵀ S M onto the matrix: S in ``second``, M = [I + c J1; I by u]."""
    nx, nz, lz = o[NX], o[NX] + 1 + o[NU], o[LZ]
    s, t, j1, theta = o[SECOND], o[CHAINED], o[J1], m[o[STATE] + StateField.SECOND_ORDER_SHARE]
    for i in range(nz):  # T = S M, row by row
        for j in range(nz):
            m[t + i * lz + j] = theta * m[s + i * lz + j]
        for q in range(nx):
            factor = theta * c * m[s + i * lz + q]
            for j in range(nz):
                m[t + i * lz + j] += factor * m[j1 + q * lz + j]
    for i in range(nz):
        for j in range(nz):
            if i != nx and j != nx:
                m[matrix + i * lz + j] += m[t + i * lz + j]
    for q in range(nx):
        for i in range(nz):
            factor = c * m[j1 + q * lz + i]
            if i != nx and factor != 0.0:
                for j in range(nz):
                    if j != nx:
                        m[matrix + i * lz + j] += factor * m[t + q * lz + j]


@compiled
def costate_end(m: Floats, o: Integers) -> None:
    """The costate at the end of the horizon."""
    n, one = o[N], o[SMALL] + 2
    for i in range(o[NX]):
        m[o[ADJOINT] + i] = m[o[G] + n * o[LZ] + i]
    m[one] = 1.0
    add_row_gradient(m, o, n, o[END_J], o[ADJOINT], one)


@compiled
def costate_node(m: Floats, o: Integers, k: int, rows: int) -> None:
    """Multipliers of node k's equality rows, which are at ``rows``, to ``multiplier``, those of its other rows to ``signed``; the
    costate moves from node k + 1 to node k."""
    nx, nu, lz = o[NX], o[NU], o[LZ]
    gradient, ab, costate = o[CHAINED], o[AB] + k * (nx + 1) * lz, o[ADJOINT]
    m[o[SMALL] + 2] = m[o[GRID] + k + 1] - m[o[GRID] + k]
    for i in range(lz):
        m[gradient + i] = m[o[G] + k * lz + i]
    for r in range(nx):
        for i in range(nx + 1 + nu):
            m[gradient + i] += m[ab + r * lz + i] * m[costate + r]
    node_matrix(o, k)
    add_row_gradient(m, o, k, o[ROW_MATRIX], gradient, o[SMALL] + 2)
    least_squares_multipliers(m, o, rows)
    for i in range(nx):
        total = m[gradient + i]
        for q in range(o[NG]):
            total += m[rows + q * lz + i] * m[o[NU_ROWS] + q]
        m[costate + i] = total


@compiled
def exact_end(m: Floats, o: Integers, end: int) -> None:
    """Second derivatives of the end of the horizon, and its costate."""
    n, nx, base = o[N], o[NX], o[BASE]
    costate_end(m, o)
    x, p = o[X] + n * nx, o[P] + n * o[NP]
    o[ARG], o[ARG + 1], o[ARG + 2], o[ARG + 3] = base + 8 * x, base + 8 * p, base + 8 * o[W], base + 8 * o[SIGNED]
    o[RES] = base + 8 * o[SECOND]
    clear_second(m, o)
    call2(o[END_LAGRANGIAN], o.ctypes.data + 8 * ARG, o.ctypes.data + 8 * RES)
    add_second(m, o, end, o[LX])


@compiled
def clear_second(m: Floats, o: Integers) -> None:
    """Set second derivatives to zero: the functions write their own non-zeros only, and share the buffer."""
    for i in range((o[NX] + 1 + o[NU]) * o[LZ]):
        m[o[SECOND] + i] = 0.0


@compiled
def take_lane(m: Floats, source: int, lane: int, count: int, out: int) -> None:
    """``count`` numbers of one of eight nodes that are side by side."""
    for i in range(count):
        m[out + i] = m[source + LANES * i + lane]


@compiled
def move_adjoint(m: Floats, o: Integers, share: float, c: float) -> None:
    """The adjoint of a stage from that of the next one: share λ + c f_xᵀ a, f_x in ``j2``."""
    costate, adjoint, before = o[ADJOINT], o[ADJOINT] + o[LX], o[ADJOINT] + 2 * o[LX]
    for i in range(o[NX]):
        m[before + i] = share * m[costate + i]
    for r in range(o[NX]):
        for i in range(o[NX]):
            m[before + i] += c * m[o[J2] + r * o[LZ] + i] * m[adjoint + r]
    for i in range(o[NX]):
        m[adjoint + i] = m[before + i]


@compiled
def exact_classic(m: Floats, o: Integers, k: int, matrix: int, h: float) -> None:
    """Second derivatives of a step of the classic Runge-Kutta rule, from its last stage to the first; node k is in its lane."""
    nx, lx, lane, size = o[NX], o[LX], k % LANES, o[NX] * o[LZ]
    x, u, p = o[X] + k * nx, o[U] + k * o[NU], o[P] + k * o[NP]
    costate, adjoint, middle = o[ADJOINT], o[ADJOINT] + lx, o[SLOPES] + 4 * lx
    for i in range(nx):
        m[adjoint + i] = h / 6.0 * m[costate + i]
    for s in range(3, 0, -1):
        c = h if s == 3 else 0.5 * h
        take_lane(m, o[LANE_F] + LANES * nx * (s - 1), lane, nx, o[SLOPES])
        offset_state(m, o, middle, x, o[SLOPES], c)
        before = o[LANE_J1] if s == 1 else (o[LANE_S1] if s == 2 else o[LANE_S2])
        own = o[LANE_J2] if s == 1 else (o[LANE_J3] if s == 2 else o[LANE_J4])
        take_lane(m, before, lane, size, o[J1])
        take_lane(m, own, lane, size, o[J2])
        clear_second(m, o)
        stage_with(o, DYNAMICS_H, middle, u, p, adjoint, adjoint, o[SECOND])
        add_chained(m, o, matrix, c)
        move_adjoint(m, o, h / 6.0 if s == 1 else h / 3.0, c)
    clear_second(m, o)
    stage_with(o, DYNAMICS_H, x, u, p, adjoint, adjoint, o[SECOND])
    add_second(m, o, matrix, o[LZ])


@compiled
def exact_midpoint(m: Floats, o: Integers, k: int, matrix: int, h: float) -> None:
    """Second derivatives of a step of the midpoint rule, after :func:`wbmpc.solver.simd_batch.single_lane`."""
    nx, lx = o[NX], o[LX]
    x, u, p = o[X] + k * nx, o[U] + k * o[NU], o[P] + k * o[NP]
    costate, adjoint = o[ADJOINT], o[ADJOINT] + lx
    for i in range(nx):
        m[adjoint + i] = h * m[costate + i]
    clear_second(m, o)
    stage_with(o, DYNAMICS_H, o[SLOPES] + 4 * lx, u, p, adjoint, adjoint, o[SECOND])
    add_chained(m, o, matrix, 0.5 * h)
    move_adjoint(m, o, 0.0, 0.5 * h)
    clear_second(m, o)
    stage_with(o, DYNAMICS_H, x, u, p, adjoint, adjoint, o[SECOND])
    add_second(m, o, matrix, o[LZ])


@compiled
def exact_node(m: Floats, o: Integers, k: int, matrix: int, rows: int) -> None:
    """Second derivatives of node k onto its Hessian, after its linearization; the costate moves to node k. ``rows``: where
    the node's equality rows are."""
    h = m[o[GRID] + k + 1] - m[o[GRID] + k]
    x, u, p = o[X] + k * o[NX], o[U] + k * o[NU], o[P] + k * o[NP]
    m[o[SMALL] + 2] = h
    if o[RK4] > 0:
        exact_classic(m, o, k, matrix, h)
    else:
        exact_midpoint(m, o, k, matrix, h)
    costate_node(m, o, k, rows)
    clear_second(m, o)
    stage_with(o, LAGRANGIAN, x, u, p, o[NU_ROWS], o[SIGNED], o[SECOND])
    add_second(m, o, matrix, o[LZ])
