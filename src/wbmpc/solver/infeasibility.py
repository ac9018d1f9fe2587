"""Compiled code that detects, in real time, constraints that cannot be met together.

**Which rows.** Rows with multipliers: augmented Lagrangians, equalities of the state alone and of the end of the horizon. A step
need not meet them; their multipliers grow until it does. Where they contradict each other, multipliers grow forever, so that
"not met yet" and "cannot be met" have to be distinguished while only one iteration is done per solve. Compiled solver only.

**The certificate.** Let v be changes of the inputs beyond the policy's feedback that keep the dynamics and the rows of the Riccati
recursion, J the Jacobian of the rows with multipliers by v, W the lengths of the intervals, and r what a full step leaves of these
rows. Rows that can be met have a v with J v = −r. Where the least-squares residual is what is left, the gradient vanishes:
g = Jᵀ W r = 0. So r is a certificate of infeasibility as far as g is zero, which rounding and multipliers that still grow prevent; the
measure is the cosine between r and J g in the norm of W,

    cos = gᵀ g / (‖J g‖ ‖r‖) ≤ ``stationary``,

which no scaling of all rows or of all inputs changes. It has to hold for ``confirmations`` solves in a row.

**Limits of the inputs.** Where hard limits are in the way, g is not zero but a sum of the gradients of active limits with
multipliers that are not negative (Farkas' lemma): the projection of g onto the directions that the limits leave is zero, to the share
``blocked`` of gᵀ g. That may pass: a goal comes nearer, a push is over. So it counts only after ``horizons`` horizons
during which the residual changed by less than ``unchanged``, that is at rest; if no state has a part in g (its costates vanish), no
motion will ever help, and it counts like a contradiction.

**Steps** of :func:`detect_infeasibility`: the largest residual relative to its row (:func:`largest_relative_residual`) is beyond
``equality_bound``; g (:func:`reduced_gradient`), ‖r‖² (:func:`squared_residual`) and ‖J g‖² (:func:`squared_response`) give the cosine;
if it is large, g without what limits block (:func:`remove_blocked_part`); blocked residuals are timed
(:func:`blocked_long_enough`). What is detected does not go into the multipliers (:func:`undo_multiplier_update`).
"""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class Detection:
    """Thresholds of the detection.

    ``stationary``: cosine below which rows cannot be met; contradictions had up to 2e-3, what limits or pushes kept away 0.1 and
    more. ``confirmations``: solves in a row. ``blocked``: share of gᵀ g below which limits let nothing of it pass. ``at_limit``: an
    input that is nearer to its hard limit [of the range] is held by it. ``horizons``: how long limits are waited for.
    ``unchanged``: a residual that changes by a larger share meanwhile may still vanish.
    """

    stationary: float = 1e-2
    confirmations: int = 10
    blocked: float = 1e-3
    at_limit: float = 0.02
    horizons: float = 2.0
    unchanged: float = 0.02


DETECTION = Detection()


@compiled
def remaining_residual(m: Floats, o: Integers, k: int, j: int) -> float:
    """r: what a full step leaves of row j of node k: h of an equality, h < 0 of an inequality; 0 of rows without multipliers."""
    first, _, _ = node_rows(o, k)
    q, kind = k * o[ROWS] + j, kind_of(m, o, first + j)
    if kind == HARD or not counts(m, o, first + j, k):
        return 0.0
    left = m[o[ROW_H] + q] + m[o[ROW_D] + q]
    return min(left, 0.0) if kind == MULTIPLIER else left


@compiled
def row_derivative(m: Floats, o: Integers, k: int, j: int, i: int) -> float:
    """Derivative of row j of node k by entry i of [x, 1, u]."""
    first, boxes, _ = node_rows(o, k)
    if j < boxes:
        return m[entry(o, RowField.SIGN, first + j)] if o[row_index(o) + first + j] == i else 0.0
    start = o[ROW_J] + k * o[ROW_GENERAL] * o[LZ] if k < o[N] else o[END_J]
    return m[start + (j - boxes) * o[LZ] + i]


@compiled
def row_magnitude(m: Floats, o: Integers, k: int, j: int) -> float:
    """|J| + Σ |J_i z_i| of row j of node k: the magnitude that states and inputs give it."""
    nx, square, size = o[NX], 0.0, 0.0
    for i in range(nx):
        slope = row_derivative(m, o, k, j, i)
        square, size = square + slope * slope, size + abs(slope * m[o[X] + k * nx + i])
    if k < o[N]:
        for i in range(o[NU]):
            slope = row_derivative(m, o, k, j, nx + 1 + i)
            square, size = square + slope * slope, size + abs(slope * m[o[U] + k * o[NU] + i])
    return max(np.sqrt(square) + size, 1e-12)


@compiled
def largest_relative_residual(m: Floats, o: Integers) -> float:
    """The largest |r| as a share of the row's magnitude; which row goes to ``state``."""
    worst = 0.0
    for k in range(o[N] + 1):
        _, boxes, general = node_rows(o, k)
        for j in range(boxes + general):
            left = abs(remaining_residual(m, o, k, j))
            if left > 0.0:
                share = left / row_magnitude(m, o, k, j)
                if share > worst:
                    worst, m[o[STATE] + StateField.EQUALITY_ROW] = share, o[NG] + k * o[ROWS] + j
    return worst


@compiled
def add_weighted_gradient(m: Floats, o: Integers, k: int) -> None:
    """w Jᵀ r of node k onto the gradient by [x, 1, u] in ``chained``."""
    _, boxes, general = node_rows(o, k)
    w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
    size = o[NX] + 1 + o[NU] if k < o[N] else o[NX]
    for j in range(boxes + general):
        left = w * remaining_residual(m, o, k, j)
        if left != 0.0:
            for i in range(size):
                if i != o[NX]:
                    m[o[CHAINED] + i] += left * row_derivative(m, o, k, j, i)


@compiled
def remove_blocked_part(m: Floats, o: Integers, k: int, largest: float) -> float:
    """Subtracts from node k's gradient in ``chained`` what active hard rows of the inputs block: their gradients times multipliers
    that are not negative. Returns the largest such part, if it is more than ``largest``; which row goes to ``state``."""
    _, boxes, general = node_rows(o, k)
    first, gradient = o[NX] + 1, o[CHAINED]
    for j in range(boxes + general):
        q = k * o[ROWS] + j
        if not bounds_inputs(m, o, j) or row_penalty(m, o, j) < np.inf or m[o[ROW_H] + q] > DETECTION.at_limit:
            continue
        along, square = 0.0, 0.0
        for i in range(first, first + o[NU]):
            slope = row_derivative(m, o, k, j, i)
            along, square = along + slope * m[gradient + i], square + slope * slope
        if along <= 0.0:  # the row is no obstacle to less of what is missed
            continue
        for i in range(first + o[NU]):
            if i != o[NX]:
                m[gradient + i] -= along / square * row_derivative(m, o, k, j, i)
        if along / np.sqrt(square) > largest:
            largest, m[o[STATE] + StateField.BLOCKING_ROW] = along / np.sqrt(square), q
    return largest


@compiled
def reduced_gradient(m: Floats, o: Integers, limited: bool) -> tuple[float, float]:
    """g = Jᵀ W r into ``u_trial``, by an adjoint sweep from the end of the horizon; (gᵀ g, Σ of the squared costates).
    ``limited``: without what limits of the inputs block."""
    nx, nu, lx, lz, costate, gradient = o[NX], o[NU], o[LX], o[LZ], o[ADJOINT], o[CHAINED]
    total, of_states, largest = 0.0, 0.0, 0.0
    for i in range(lz):
        m[gradient + i] = 0.0
    add_weighted_gradient(m, o, o[N])
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
        add_weighted_gradient(m, o, k)
        if limited:
            largest = remove_blocked_part(m, o, k, largest)
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
def squared_response(m: Floats, o: Integers) -> float:
    """‖J v‖² in the norm of W over the rows with multipliers that count, v in ``u_trial``: how these rows would change with v, by a
    sweep from the start of the horizon. Overwrites ``pulled`` and ``x_trial``."""
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
            if kind == MULTIPLIER and remaining_residual(m, o, k, j) == 0.0:
                continue
            change = 0.0
            for i in range(nx):
                change += row_derivative(m, o, k, j, i) * m[at + i]
            if k < o[N]:
                for i in range(nu):
                    change += row_derivative(m, o, k, j, nx + 1 + i) * m[du + i]
            total += w * change * change
    return total


@compiled
def squared_residual(m: Floats, o: Integers) -> float:
    """‖r‖² in the norm of W."""
    total = 0.0
    for k in range(o[N] + 1):
        _, boxes, general = node_rows(o, k)
        w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
        for j in range(boxes + general):
            total += w * remaining_residual(m, o, k, j) ** 2
    return total


@compiled
def undo_multiplier_update(m: Floats, o: Integers) -> None:
    """Multipliers as they were before the last full step: those of rows that contradict each other would grow forever."""
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        for j in range(boxes + general):
            left, q = remaining_residual(m, o, k, j), k * o[ROWS] + j
            if left != 0.0:
                change = row_penalty(m, o, first + j) * left
                m[o[ROW_L] + q] = m[o[ROW_N] + q] + (change if kind_of(m, o, first + j) == MULTIPLIER else -change)


@compiled
def blocked_long_enough(m: Floats, o: Integers, residual: float) -> bool:
    """Whether limits have blocked the ``residual`` for ``horizons`` horizons, and it has not changed meanwhile."""
    state = o[STATE]
    if (
        abs(residual - m[state + StateField.BLOCKED_RESIDUAL])
        > DETECTION.unchanged * m[state + StateField.BLOCKED_RESIDUAL]
    ):
        m[state + StateField.BLOCKED_RESIDUAL], m[state + StateField.BLOCKED_TIME] = residual, 0.0
    return m[state + StateField.BLOCKED_TIME] >= DETECTION.horizons * m[o[GRID] + o[N]]


@compiled
def detect_infeasibility(m: Floats, o: Integers, s: Floats) -> bool:
    """Whether rows with multipliers cannot be met, with what is known after this solve."""
    if o[MULTIPLIERS] == 0:
        return False
    state = o[STATE]
    residual, infeasible, blocked, waited = largest_relative_residual(m, o), False, False, False
    m[state + StateField.BLOCKING_ROW] = -1.0
    if residual > s[Setting.EQUALITY_BOUND]:
        gradient, _ = reduced_gradient(m, o, False)
        square = squared_residual(m, o)
        infeasible = gradient <= DETECTION.stationary * np.sqrt(squared_response(m, o) * square)
        if not infeasible:
            free, of_states = reduced_gradient(m, o, True)
            blocked = free <= DETECTION.blocked * gradient
            infeasible = blocked and of_states <= DETECTION.blocked * gradient
    if blocked:
        waited = blocked_long_enough(m, o, residual)
    else:
        m[state + StateField.BLOCKED_RESIDUAL], m[state + StateField.BLOCKED_TIME] = 0.0, 0.0
    m[state + StateField.INFEASIBLE_SOLVES] = m[state + StateField.INFEASIBLE_SOLVES] + 1.0 if infeasible else 0.0
    if infeasible or waited:
        undo_multiplier_update(m, o)
        m[state + StateField.EQUALITY_RESIDUAL] = residual
    return waited or m[state + StateField.INFEASIBLE_SOLVES] >= DETECTION.confirmations
