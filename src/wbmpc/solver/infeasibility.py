"""Compiled code that tells, in real time, whether equalities with multipliers contradict each other.

Augmented Lagrangians, equalities of the state alone and of the end have multipliers, so that a step need not meet them. What a
full step leaves of them, r, is a certificate where they cannot be met: with the dynamics and the rows of the Riccati recursion
eliminated, J by what is left of the inputs, r is the residual of least squares, Jᵀ W r = 0 (W: the intervals' lengths). Where
the multipliers have not grown far enough yet it is not. How far they could still be met is the cosine between r and J Jᵀ W r,
which no scaling of all rows or of all inputs changes.

Where hard limits of inputs are in the way, Jᵀ W r is a sum of their gradients with multipliers that are not negative (Farkas). That
may pass: a goal comes nearer, a swing comes back, a push is over. So limits are waited for two horizons, and longer while
what is missed changes, that is while something moves; not where no state has a part in it.
"""

from __future__ import annotations

import numpy as np

from wbmpc.solver.compilation import LANES, Floats, Integers, compiled
from wbmpc.solver.exact import least_squares_multipliers
from wbmpc.solver.inequality_table import (
    HARD,
    MULTIPLIER,
    bounds_inputs,
    counts,
    entry,
    kind_of,
    node_rows,
    row_penalty,
)
from wbmpc.solver.memory_layout import (
    AB,
    ADJOINT,
    CHAINED,
    END_J,
    GRID,
    LANE_E,
    LANE_U,
    LANE_X,
    LANES_EQUALITY_J,
    LX,
    LZ,
    MULTIPLIERS,
    NG,
    NU,
    NU_ROWS,
    NX,
    PULLED,
    ROW_D,
    ROW_GENERAL,
    ROW_H,
    ROW_J,
    ROW_L,
    ROW_N,
    ROWS,
    STATE,
    UNPACK_EQUALITIES,
    UT,
    XT,
    E,
    K,
    N,
    RowField,
    Setting,
    StateField,
    U,
    X,
)
from wbmpc.solver.simd_batch import equality_size, load_block, stage_lanes, unpack
from wbmpc.solver.stages import row_index

#: Below this cosine what is missed cannot be met: contradictions had up to 2e-3, what limits or pushes kept away 0.1 and more.
STUCK = 1e-2
#: So many solves in a row.
PATIENCE = 10
#: Below this share of the square of Jᵀ W r limits let nothing of it pass.
HELD = 1e-3
#: An input that is nearer to its hard limit than this [the range] is held by it.
AT_LIMIT = 0.02
#: So many horizons long.
HORIZONS = 2.0
#: What changes by this share while it is waited for may still be met.
SAME = 0.02


@compiled
def left_over(m: Floats, o: Integers, k: int, j: int) -> float:
    """What a full step leaves of row j of node k: h of an equality, h < 0 of an inequality; 0 of rows without multipliers."""
    first, _, _ = node_rows(o, k)
    q, kind = k * o[ROWS] + j, kind_of(m, o, first + j)
    if kind == HARD or not counts(m, o, first + j, k):
        return 0.0
    left = m[o[ROW_H] + q] + m[o[ROW_D] + q]
    return min(left, 0.0) if kind == MULTIPLIER else left


@compiled
def row_slope(m: Floats, o: Integers, k: int, j: int, i: int) -> float:
    """Derivative of row j of node k by entry i of [x, 1, u]."""
    first, boxes, _ = node_rows(o, k)
    if j < boxes:
        return m[entry(o, RowField.SIGN, first + j)] if o[row_index(o) + first + j] == i else 0.0
    start = o[ROW_J] + k * o[ROW_GENERAL] * o[LZ] if k < o[N] else o[END_J]
    return m[start + (j - boxes) * o[LZ] + i]


@compiled
def row_size(m: Floats, o: Integers, k: int, j: int) -> float:
    """|J| + Σ |J_i z_i| of a row: what it makes of states and inputs."""
    nx, square, size = o[NX], 0.0, 0.0
    for i in range(nx):
        slope = row_slope(m, o, k, j, i)
        square, size = square + slope * slope, size + abs(slope * m[o[X] + k * nx + i])
    if k < o[N]:
        for i in range(o[NU]):
            slope = row_slope(m, o, k, j, nx + 1 + i)
            square, size = square + slope * slope, size + abs(slope * m[o[U] + k * o[NU] + i])
    return max(np.sqrt(square) + size, 1e-12)


@compiled
def most_missed(m: Floats, o: Integers) -> float:
    """The largest miss of a row with a multiplier, as a share of the row's size; which one goes to ``state``."""
    worst = 0.0
    for k in range(o[N] + 1):
        _, boxes, general = node_rows(o, k)
        for j in range(boxes + general):
            left = abs(left_over(m, o, k, j))
            if left > 0.0:
                share = left / row_size(m, o, k, j)
                if share > worst:
                    worst, m[o[STATE] + StateField.EQUALITY_ROW] = share, o[NG] + k * o[ROWS] + j
    return worst


@compiled
def add_missed(m: Floats, o: Integers, k: int) -> None:
    """w Jᵀ r of node k onto the gradient by [x, 1, u] in ``chained``."""
    _, boxes, general = node_rows(o, k)
    w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
    size = o[NX] + 1 + o[NU] if k < o[N] else o[NX]
    for j in range(boxes + general):
        left = w * left_over(m, o, k, j)
        if left != 0.0:
            for i in range(size):
                if i != o[NX]:
                    m[o[CHAINED] + i] += left * row_slope(m, o, k, j, i)


@compiled
def take_limits(m: Floats, o: Integers, k: int, most: float) -> float:
    """Takes from node k's gradient in ``chained`` what hard rows of the inputs do not let pass: J times a multiplier ≥ 0 of those
    that are active. Returns the largest such part, if it is more than ``most``; which row goes to ``state``."""
    _, boxes, general = node_rows(o, k)
    first, gradient = o[NX] + 1, o[CHAINED]
    for j in range(boxes + general):
        q = k * o[ROWS] + j
        if not bounds_inputs(m, o, j) or row_penalty(m, o, j) < np.inf or m[o[ROW_H] + q] > AT_LIMIT:
            continue
        along, square = 0.0, 0.0
        for i in range(first, first + o[NU]):
            slope = row_slope(m, o, k, j, i)
            along, square = along + slope * m[gradient + i], square + slope * slope
        if along <= 0.0:  # the row is no obstacle to less of what is missed
            continue
        for i in range(first + o[NU]):
            if i != o[NX]:
                m[gradient + i] -= along / square * row_slope(m, o, k, j, i)
        if along / np.sqrt(square) > most:
            most, m[o[STATE] + StateField.BLOCKING_ROW] = along / np.sqrt(square), q
    return most


@compiled
def steepest(m: Floats, o: Integers, limited: bool) -> tuple[float, float]:
    """Jᵀ W r into ``u_trial``, inputs beyond the policy's feedback that keep the rows of the recursion; its square's sum, and that
    of the states' part (costates). ``limited``: without what limits of the inputs do not let pass."""
    nx, nu, lx, lz, costate, gradient = o[NX], o[NU], o[LX], o[LZ], o[ADJOINT], o[CHAINED]
    total, of_states, most = 0.0, 0.0, 0.0
    for i in range(lz):
        m[gradient + i] = 0.0
    add_missed(m, o, o[N])
    for i in range(nx):
        m[costate + i] = m[gradient + i]
    for k in range(o[N] - 1, -1, -1):
        if o[NG] > 0 and (k % LANES == LANES - 1 or k == o[N] - 1):
            start = k // LANES * LANES
            load_block(m, o, start, k - start + 1, o[X], o[U])
            stage_lanes(o, LANES_EQUALITY_J, o[LANE_X], o[LANE_U], o[LANE_E], o[LANE_E], o[LANE_E])
            unpack(o, UNPACK_EQUALITIES, o[LANE_E], o[E], equality_size(o), k - start + 1)
        ab, rows, free = o[AB] + k * (nx + 1) * lz, o[E] + (k % LANES) * equality_size(o), o[UT] + k * nu
        for i in range(lz):
            m[gradient + i] = 0.0
        for r in range(nx):
            for i in range(nx + 1 + nu):
                if i != nx:
                    m[gradient + i] += m[ab + r * lz + i] * m[costate + r]
        add_missed(m, o, k)
        if limited:
            most = take_limits(m, o, k, most)
        for j in range(nu):
            m[free + j] = m[gradient + nx + 1 + j]
        if o[NG] > 0:
            least_squares_multipliers(m, o, rows)
            for q in range(o[NG]):
                for j in range(nu):
                    m[free + j] += m[o[NU_ROWS] + q] * m[rows + q * lz + nx + 1 + j]
        for j in range(nu):
            total += m[free + j] ** 2
        for i in range(nx):
            m[costate + i] = m[gradient + i]
            for j in range(nu):
                m[costate + i] += m[o[K] + (k * nu + j) * lx + i] * m[gradient + nx + 1 + j]
            of_states += m[costate + i] ** 2
    return total, of_states


@compiled
def response(m: Floats, o: Integers) -> float:
    """Σ w (J v)² over the rows with multipliers that count, v in ``u_trial``: how they would change with it. Overwrites ``pulled``
    and ``x_trial``."""
    nx, nu, lx, lz, dx, du = o[NX], o[NU], o[LX], o[LZ], o[XT], o[PULLED]
    total = 0.0
    for i in range(nx):
        m[dx + i] = 0.0
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        at = dx + k * nx
        if k < o[N]:
            for j in range(nu):
                m[du + j] = m[o[UT] + k * nu + j]
                for i in range(nx):
                    m[du + j] += m[o[K] + (k * nu + j) * lx + i] * m[at + i]
            for r in range(nx):
                row, change = o[AB] + (k * (nx + 1) + r) * lz, 0.0
                for i in range(nx):
                    change += m[row + i] * m[at + i]
                for j in range(nu):
                    change += m[row + nx + 1 + j] * m[du + j]
                m[at + nx + r] = change
        w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
        for j in range(boxes + general):
            kind = kind_of(m, o, first + j)
            if kind == HARD or not counts(m, o, first + j, k):
                continue
            if kind == MULTIPLIER and left_over(m, o, k, j) == 0.0:
                continue
            change = 0.0
            for i in range(nx):
                change += row_slope(m, o, k, j, i) * m[at + i]
            if k < o[N]:
                for i in range(nu):
                    change += row_slope(m, o, k, j, nx + 1 + i) * m[du + i]
            total += w * change * change
    return total


@compiled
def missed_square(m: Floats, o: Integers) -> float:
    """Σ w r²."""
    total = 0.0
    for k in range(o[N] + 1):
        _, boxes, general = node_rows(o, k)
        w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
        for j in range(boxes + general):
            total += w * left_over(m, o, k, j) ** 2
    return total


@compiled
def hold_multipliers(m: Floats, o: Integers) -> None:
    """Multipliers as they were before the last full step: what rows that contradict each other add to them would never end."""
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        for j in range(boxes + general):
            left, q = left_over(m, o, k, j), k * o[ROWS] + j
            if left != 0.0:
                change = row_penalty(m, o, first + j) * left
                m[o[ROW_L] + q] = m[o[ROW_N] + q] + (change if kind_of(m, o, first + j) == MULTIPLIER else -change)


@compiled
def keeps_on(m: Floats, o: Integers, share: float) -> bool:
    """Whether limits have been in the way for :data:`HORIZONS`, and ``share`` has been the same."""
    state = o[STATE]
    if abs(share - m[state + StateField.BLOCKED_RESIDUAL]) > SAME * m[state + StateField.BLOCKED_RESIDUAL]:
        m[state + StateField.BLOCKED_RESIDUAL], m[state + StateField.BLOCKED_TIME] = share, 0.0
    return m[state + StateField.BLOCKED_TIME] >= HORIZONS * m[o[GRID] + o[N]]


@compiled
def contradicts(m: Floats, o: Integers, s: Floats) -> bool:
    """Whether rows with multipliers have contradicted each other for :data:`PATIENCE` solves, this one the last, or limits of the
    inputs have been in the way for long enough."""
    if o[MULTIPLIERS] == 0:
        return False
    state = o[STATE]
    share, stuck, held, told = most_missed(m, o), False, False, False
    m[state + StateField.BLOCKING_ROW] = -1.0
    if share > s[Setting.EQUALITY_BOUND]:
        down, _ = steepest(m, o, False)
        size = missed_square(m, o)
        stuck = down <= STUCK * np.sqrt(response(m, o) * size)
        if not stuck:
            left, of_states = steepest(m, o, True)
            held = left <= HELD * down
            stuck = held and of_states <= HELD * down
    if held:
        told = keeps_on(m, o, share)
    else:
        m[state + StateField.BLOCKED_RESIDUAL], m[state + StateField.BLOCKED_TIME] = 0.0, 0.0
    m[state + StateField.INFEASIBLE_SOLVES] = m[state + StateField.INFEASIBLE_SOLVES] + 1.0 if stuck else 0.0
    if stuck or told:
        hold_multipliers(m, o)
        m[state + StateField.EQUALITY_RESIDUAL] = share
    return told or m[state + StateField.INFEASIBLE_SOLVES] >= PATIENCE
