"""Infeasibility: constraints cannot be met together, near a motion, where what they miss is stationary and not zero.

Let φ be half the sum of the squares of what rows miss, weighted by the lengths W of the intervals. Where constraints can be met φ has
a minimum of 0; where its gradient vanishes before that, no small change of the motion makes them hold better
(docs/explanation/inequalities.md). The gradient is asked for twice:

- After a solve that ended away from the constraints :func:`least_violation` minimizes φ from there: one more optimal control problem,
  which has the same dynamics and no cost but φ, for the same solver.
- In real time there is one iteration per solve. :func:`detect_infeasibility` (compiled, without allocation) takes the gradient of φ at
  the plan. Its rows are those with multipliers, which no step has to meet: augmented Lagrangians, equalities of the state alone and of
  the end of the horizon. With r what a full step leaves of them, and J their derivative by changes of the inputs beyond the policy's
  feedback (which keep the dynamics and the rows of the Riccati recursion), g = Jᵀ W r. "Zero" is a cosine that no scaling changes,
  gᵀ g / (‖J g‖ ‖r‖) ≤ ``stationary``, for ``confirmations`` solves. Where active limits of the inputs are in the way, g is a sum of
  their gradients with multipliers that are not negative (Farkas' lemma). That may pass: it counts once the residual has been at rest
  for ``horizons``, or at once if no state has a part in g. What is detected does not go into the multipliers.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from wbmpc.ocp.violation import violation_problem
from wbmpc.solver.certificate import rows_that_must_hold
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
    ROW_H,
    ROW_L,
    ROW_MATRIX,
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
from wbmpc.solver.node_inequalities import node_matrix
from wbmpc.solver.settings import SQP
from wbmpc.solver.simd_batch import equality_size, load_block, stage_lanes, unpack
from wbmpc.solver.solution import Status
from wbmpc.solver.stages import row_index

if TYPE_CHECKING:
    from wbmpc.solver.solver import Solver


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
def weight(m: Floats, o: Integers, k: int) -> float:
    """Weight of node k's rows in φ: the length of its interval, 1 at the end of the horizon."""
    return m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0


@compiled
def row_derivative(m: Floats, o: Integers, k: int, j: int, i: int) -> float:
    """Derivative of row j of node k by entry i of [x, 1, u], after :func:`node_matrix`."""
    first, boxes, _ = node_rows(o, k)
    if j < boxes:
        return m[entry(o, RowField.SIGN, first + j)] if o[row_index(o) + first + j] == i else 0.0
    start = o[ROW_MATRIX] if k < o[N] else o[END_J]
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
        node_matrix(o, k)
        for j in range(boxes + general):
            left = abs(remaining_residual(m, o, k, j))
            if left > 0.0:
                share = left / row_magnitude(m, o, k, j)
                if share > worst:
                    worst, m[o[STATE] + StateField.EQUALITY_ROW] = share, o[NG] + k * o[ROWS] + j
    return worst


@compiled
def add_weighted_gradient(m: Floats, o: Integers, k: int) -> None:
    """w Jᵀ r of node k onto the gradient by [x, 1, u] in ``chained``, after :func:`node_matrix`."""
    _, boxes, general = node_rows(o, k)
    size = o[NX] + 1 + o[NU] if k < o[N] else o[NX]
    for j in range(boxes + general):
        left = weight(m, o, k) * remaining_residual(m, o, k, j)
        if left != 0.0:
            for i in range(size):
                if i != o[NX]:
                    m[o[CHAINED] + i] += left * row_derivative(m, o, k, j, i)


@compiled
def remove_blocked_part(m: Floats, o: Integers, k: int, largest: float) -> float:
    """Subtracts from node k's gradient in ``chained`` what active hard rows of the inputs block: their gradients times multipliers
    that are not negative, after :func:`node_matrix`. Returns the largest such part, if it is more than ``largest``; which row goes to
    ``state``."""
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
        node_matrix(o, k)
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
def squared_lengths(m: Floats, o: Integers) -> tuple[float, float]:
    """‖r‖² and ‖J v‖² in the norm of W over the rows with multipliers that count, v in ``u_trial``: how these rows would change with v,
    by a sweep from the start of the horizon. Overwrites ``pulled`` and ``x_trial``."""
    nx, nu, lx, lz, dx, du = o[NX], o[NU], o[LX], o[LZ], o[XT], o[PULLED]
    residual, response = 0.0, 0.0
    for i in range(nx):
        m[dx + i] = 0.0
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        node_matrix(o, k)
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
        for j in range(boxes + general):
            kind, left, change = kind_of(m, o, first + j), remaining_residual(m, o, k, j), 0.0
            if kind == HARD or not counts(m, o, first + j, k) or (kind == MULTIPLIER and left == 0.0):
                continue
            for i in range(nx):
                change += row_derivative(m, o, k, j, i) * m[at + i]
            if k < o[N]:
                for i in range(nu):
                    change += row_derivative(m, o, k, j, nx + 1 + i) * m[du + i]
            residual += weight(m, o, k) * left * left
            response += weight(m, o, k) * change * change
    return residual, response


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
def at_rest(m: Floats, o: Integers, residual: float) -> bool:
    """Whether the ``residual``, which limits block, has not changed for ``horizons`` horizons."""
    state = o[STATE]
    last = m[state + StateField.BLOCKED_RESIDUAL]
    if abs(residual - last) > DETECTION.unchanged * last:
        m[state + StateField.BLOCKED_RESIDUAL], m[state + StateField.BLOCKED_TIME] = residual, 0.0
    return m[state + StateField.BLOCKED_TIME] >= DETECTION.horizons * m[o[GRID] + o[N]]


@compiled
def detect_infeasibility(m: Floats, o: Integers, s: Floats) -> bool:
    """Whether rows with multipliers cannot be met, with what is known after this solve."""
    if o[MULTIPLIERS] == 0:
        return False
    state = o[STATE]
    residual, infeasible, blocked = largest_relative_residual(m, o), False, False
    m[state + StateField.BLOCKING_ROW] = -1.0
    if residual > s[Setting.EQUALITY_BOUND]:
        gradient, _ = reduced_gradient(m, o, False)
        square, response = squared_lengths(m, o)
        infeasible = gradient <= DETECTION.stationary * np.sqrt(response * square)
        if not infeasible:
            free, of_states = reduced_gradient(m, o, True)
            blocked = free <= DETECTION.blocked * gradient
            infeasible = blocked and of_states <= DETECTION.blocked * gradient
    if not blocked:
        m[state + StateField.BLOCKED_RESIDUAL], m[state + StateField.BLOCKED_TIME] = 0.0, 0.0
    waited = blocked and at_rest(m, o, residual)
    m[state + StateField.INFEASIBLE_SOLVES] = m[state + StateField.INFEASIBLE_SOLVES] + 1.0 if infeasible else 0.0
    if infeasible or waited:
        undo_multiplier_update(m, o)
        m[state + StateField.EQUALITY_RESIDUAL] = residual
    return waited or m[state + StateField.INFEASIBLE_SOLVES] >= DETECTION.confirmations


# ---------------------------------------------------------------------- after a solve
#: Iterations at most of a solve that minimizes φ: where constraints are nearly parallel it takes hundreds; of the interpreted twin, whose
#: iterations take thousands of times as long.
STEPS, INTERPRETED_STEPS = 1000, 100


class Finding(Enum):
    """What minimizing φ came to."""

    MET = "the constraints can be met"
    INFEASIBLE = "a minimum of what they miss"
    OPEN = "neither"


def violation_solver(solver: Solver) -> Solver:
    """Minimizes φ of all rows that must hold."""
    ocp = violation_problem(solver.problem, rows_that_must_hold(solver.problem))
    backend = solver.settings.backend
    steps = STEPS if backend == "compiled" else INTERPRETED_STEPS
    return type(solver)(ocp, SQP(steps, backend=backend), solver.use_cache)


def least_violation(solver: Solver) -> Finding:
    """Whether constraints contradict each other near the iterate of the last solve."""
    ws, rows = solver.ws, rows_that_must_hold(solver.problem)
    if not (np.isfinite(ws.x).all() and np.isfinite(ws.u).all()):
        return Finding.OPEN
    if not rows:  # any motion of the model
        return Finding.MET
    least = solver.violation
    for name in least.problem.references.slices:
        if (reference := solver.references.get(name.rpartition(", ")[0])) is not None:
            least.set_reference(name, reference)
    least.set_schedule(solver.schedule)
    least.set_parameters(ws.w[solver.problem.constant.slices["parameters"]])
    least.warm_start(ws.x, ws.u)
    found, feasibility = least.solve(solver.x0, solver.t0), solver.settings.feasibility
    if not (np.isfinite(found.x).all() and np.isfinite(found.u).all()) or found.violation > feasibility:
        return Finding.OPEN
    missed_by = solver.checks.violations(found.x, found.u, ws.p, ws.w, rows)
    if max((v.value for v in missed_by.values()), default=0.0) <= feasibility:
        return Finding.MET
    return Finding.INFEASIBLE if found.status is Status.CONVERGED else Finding.OPEN
