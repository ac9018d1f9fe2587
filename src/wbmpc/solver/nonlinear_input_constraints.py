"""Compiled code of hard rows that are nonlinear in the inputs, a circle |u|² ≤ r² for one: their second derivatives, and inputs that
are held within the true rows.

A linearized row says little about where the true one ends. Two things help. The Hessian takes the rows' second derivatives by the
inputs, times the multipliers, at nodes where they are positive semidefinite, as those of convex sets are (Nocedal and Wright 2006,
section 18.1). And in real time every trial point is corrected node by node from the first one on: inputs outside a true row move
along the rows' gradients by the shortest way (Newton's method for one row, cyclic projection for several; Bauschke and Borwein
1996), and the states behind follow by the linearized dynamics. Roll-outs of single shooting are held within straight rows too:
their feedback takes inputs far beyond what the step was made for.
"""

from __future__ import annotations

import numpy as np

from wbmpc.solver.compilation import Floats, Integers, call2, compiled
from wbmpc.solver.exact import clear_second, costate_node, stage_with
from wbmpc.solver.inequality_table import bounds_inputs, entry, node_rows, record_input_violations, row_penalty
from wbmpc.solver.memory_layout import (
    AB,
    BASE,
    CHAINED,
    EPS,
    GRID,
    LAGRANGIAN,
    LANE_ROWS,
    LANE_U,
    LANE_VALUES,
    LANE_X,
    LANES_ROWS_J,
    LZ,
    NG,
    NODE_ROWS,
    NONLINEAR_EQUALITIES,
    NP,
    NU,
    NU_ROWS,
    NX,
    PULLED,
    ROW_DS,
    ROW_DT,
    ROW_GENERAL,
    ROW_L,
    ROW_MATRIX,
    ROW_S,
    ROW_T,
    ROW_TRIAL,
    ROWS,
    SECOND,
    SIGNED,
    SMALL,
    STATE,
    U_BEST,
    UT,
    XT,
    P,
    RowField,
    StateField,
    U,
    X,
)
from wbmpc.solver.node_inequalities import collect_values
from wbmpc.solver.settings import THRESHOLDS
from wbmpc.solver.simd_batch import load_block, stage_lanes, take_rows_of_lane
from wbmpc.solver.stages import row_index


@compiled
def held(m: Floats, o: Integers, r: int) -> bool:
    """Whether inputs are held within row r: with an L1 slack, which may be there to be used, in real time only."""
    return bounds_inputs(m, o, r) and (m[o[STATE] + StateField.HOLD_INPUTS] > 1.0 or not row_penalty(m, o, r) < np.inf)


@compiled
def inside(m: Floats, o: Integers, k: int, j: int) -> float:
    """Where a correction onto row j of node k aims: what a step may leave of its slack."""
    _, boxes, _ = node_rows(o, k)
    q = k * o[ROWS] + j
    if j < boxes:
        return min(THRESHOLDS.inside, THRESHOLDS.kept_slack * m[o[ROW_T] + q])
    return THRESHOLDS.kept_slack * max(
        m[o[ROW_T] + q], min(m[o[STATE] + StateField.BARRIER] / m[o[ROW_L] + q], THRESHOLDS.kept_slack)
    )


# ---------------------------------------------------------------------- second derivatives
@compiled
def semidefinite(m: Floats, o: Integers) -> bool:
    """Whether the inputs' block of ``second`` is positive semidefinite up to rounding; its factor goes to ``chained``."""
    nu, lz, first = o[NU], o[LZ], o[NX] + 1
    rounding = 1e-300
    for i in range(first, first + nu):
        rounding += 1e-9 * abs(m[o[SECOND] + i * lz + i])
    for a in range(nu):
        for b in range(a + 1):
            total = m[o[SECOND] + (first + a) * lz + first + b] + (rounding if a == b else 0.0)
            for c in range(b):
                total -= m[o[CHAINED] + a * lz + c] * m[o[CHAINED] + b * lz + c]
            if a == b:
                if not total > 0.0:
                    return False
                total = np.sqrt(total)
            else:
                total /= m[o[CHAINED] + b * lz + b]
            m[o[CHAINED] + a * lz + b] = total
    return True


@compiled
def hard_multipliers(m: Floats, o: Integers, k: int) -> None:
    """−l of node k's general hard rows of the inputs to ``signed``, 0 for the others and for equalities."""
    _, boxes, general = node_rows(o, k)
    for j in range(general):
        hard = bounds_inputs(m, o, boxes + j)
        m[o[SIGNED] + j] = -m[o[ROW_L] + k * o[ROWS] + boxes + j] if hard else 0.0
    m[o[SMALL] + 2] = m[o[GRID] + k + 1] - m[o[GRID] + k]


@compiled
def add_curvature(m: Floats, o: Integers, k: int, matrix: int, rows: int) -> None:
    """Second derivatives by the inputs of node k's rows, times their multipliers, onto its Hessian, where the subproblem stays
    convex. ``rows``: where its equality rows are."""
    nx, nu, lz = o[NX], o[NU], o[LZ]
    if o[NONLINEAR_EQUALITIES] > 0:
        costate_node(m, o, k, rows)
    else:
        hard_multipliers(m, o, k)
    clear_second(m, o)
    x, u, p = o[X] + k * nx, o[U] + k * nu, o[P] + k * o[NP]
    stage_with(o, LAGRANGIAN, x, u, p, o[NU_ROWS], o[SIGNED], o[SECOND])
    share, along = 1.0, 0.0
    if not semidefinite(m, o):
        along = steepness(m, o, rows) if o[NONLINEAR_EQUALITIES] > 0 else 0.0
        share = largest_share(m, o, matrix, rows, along)
    if share == 0.0:
        return
    for i in range(nx + 1, nx + 1 + nu):
        for j in range(nx + 1, nx + 1 + nu):
            m[matrix + i * lz + j] += share * m[o[SECOND] + i * lz + j]
    if along > 0.0:
        add_along(m, o, matrix, rows, along)


@compiled
def steepness(m: Floats, o: Integers, rows: int) -> float:
    """c for c Eᵀ E of the equality rows E: ten times the size of ``second`` across the least of the rows."""
    nx, nu, lz, size, minimum = o[NX], o[NU], o[LZ], 0.0, np.inf
    for i in range(nx + 1, nx + 1 + nu):
        for j in range(nx + 1, i + 1):
            size += m[o[SECOND] + i * lz + j] ** 2
    for q in range(o[NG]):
        square = 0.0
        for i in range(nx + 1, nx + 1 + nu):
            square += m[rows + q * lz + i] ** 2
        if square > 1e-12 and m[o[EPS] + q] <= 1e-13:
            minimum = min(minimum, square)
    return 10.0 * np.sqrt(size) / minimum


@compiled
def largest_share(m: Floats, o: Integers, matrix: int, rows: int, along: float) -> float:
    """Largest share of ``second`` with which the node's Hessian by the inputs stays positive definite where equalities let them
    move: with ``along`` Eᵀ E, which does not change the step, since E is zero along it."""
    share = 1.0 if along > 0.0 else 0.0
    while share > 0.01:
        if definite(m, o, matrix, rows, share, along):
            return share
        share *= 0.5
    return 0.0


@compiled
def definite(m: Floats, o: Integers, matrix: int, rows: int, share: float, along: float) -> bool:
    """Whether the inputs' block of the Hessian + share second + along Eᵀ E is safely positive definite."""
    nu, lz, first, chained = o[NU], o[LZ], o[NX] + 1, o[CHAINED]
    for a in range(nu):
        for b in range(a + 1):
            i = (first + a) * lz + first + b
            total = m[matrix + i] + share * m[o[SECOND] + i]
            for q in range(o[NG]):
                if m[o[EPS] + q] <= 1e-13:
                    total += along * m[rows + q * lz + first + a] * m[rows + q * lz + first + b]
            minimum = 0.1 * m[matrix + i] if a == b else 0.0
            for c in range(b):
                total -= m[chained + a * lz + c] * m[chained + b * lz + c]
            if a == b:
                if not total > minimum:
                    return False
                total = np.sqrt(total)
            else:
                total /= m[chained + b * lz + b]
            m[chained + a * lz + b] = total
    return True


@compiled
def add_along(m: Floats, o: Integers, matrix: int, rows: int, along: float) -> None:
    """along [C e D]ᵀ [C e D] of the exact equality rows onto the matrix of the extended node vector."""
    nz, lz = o[NX] + 1 + o[NU], o[LZ]
    for q in range(o[NG]):
        if m[o[EPS] + q] <= 1e-13:
            row = rows + q * lz
            for i in range(nz):
                for j in range(nz):
                    m[matrix + i * lz + j] += along * m[row + i] * m[row + j]


# ---------------------------------------------------------------------- inputs within the true rows
@compiled
def evaluate_trial(m: Floats, o: Integers, k: int) -> None:
    """True rows of node k at the trial point: values to ``row_trial``, Jacobians of general ones to ``row_matrix``."""
    if o[ROW_GENERAL] > 0:
        values = o[LANE_VALUES]
        load_block(m, o, k, 1, o[XT], o[UT])
        stage_lanes(o, LANES_ROWS_J, o[LANE_X], o[LANE_U], values, o[LANE_ROWS], o[LANE_ROWS])
        call2(o[NODE_ROWS], o[BASE] + 8 * o[LANE_ROWS], o[BASE] + 8 * o[ROW_MATRIX])
        take_rows_of_lane(m, o, 0)
    collect_values(m, o, k, o[XT] + k * o[NX], o[UT] + k * o[NU], o[ROW_TRIAL])


@compiled
def outside(m: Floats, o: Integers, k: int) -> float:
    """By how much inputs of node k are outside a held row that was evaluated last, at most; infinite where one is NaN."""
    _, boxes, general = node_rows(o, k)
    worst = 0.0
    for j in range(boxes + general):
        h = m[o[ROW_TRIAL] + j]
        if held(m, o, j) and not h >= 0.0:
            worst = max(worst, -h) if h < 0.0 else np.inf
    return worst


@compiled
def correct(m: Floats, o: Integers, k: int, share: float) -> None:
    """Move the trial inputs of node k onto the linearized rows that they are outside of, one row after the other, and ``share``
    of the way inside that there may be."""
    _, boxes, general = node_rows(o, k)
    nu, first, change = o[NU], o[NX] + 1, o[PULLED]
    for i in range(first, first + nu):
        m[change + i] = 0.0
    for j in range(boxes):
        i = o[row_index(o) + j]
        if held(m, o, j):
            sign = m[entry(o, RowField.SIGN, j)]
            h = m[o[ROW_TRIAL] + j] + sign * m[change + i]
            if h < 0.0:
                m[change + i] += (share * inside(m, o, k, j) - h) / sign
    for j in range(general):
        row, h, square = o[ROW_MATRIX] + j * o[LZ], m[o[ROW_TRIAL] + boxes + j], 0.0
        if not held(m, o, boxes + j):
            continue
        for i in range(first, first + nu):
            h += m[row + i] * m[change + i]
            square += m[row + i] * m[row + i]
        aim = share * inside(m, o, k, boxes + j)
        if h < 0.0 and square > 1e-12:
            for i in range(first, first + nu):
                m[change + i] += m[row + i] * (aim - h) / square
    for i in range(nu):
        m[o[UT] + k * nu + i] += m[change + first + i]


@compiled
def pull_inside(m: Floats, o: Integers, k: int) -> None:
    """Correct the trial inputs of node k until no held row is left outside. Where rows contradict each other, those with an L1 slack give
    way to those without; else the best that was met. Rows are evaluated."""
    field, hold = o[STATE] + StateField.HOLD_INPUTS, m[o[STATE] + StateField.HOLD_INPUTS]
    if not pulled_inside(m, o, k) and hold > 1.0:
        m[field] = 1.0
        pulled_inside(m, o, k)
        m[field] = hold


@compiled
def pulled_inside(m: Floats, o: Integers, k: int) -> bool:
    """Whether corrections take the trial inputs of node k into all held rows; else these are the best that was met. Rows are evaluated."""
    nu, u, best, minimum, share = o[NU], o[UT] + k * o[NU], o[U_BEST], np.inf, 1.0
    for _ in range(THRESHOLDS.corrections):
        evaluate_trial(m, o, k)
        worst = outside(m, o, k)
        if worst == 0.0:
            return True
        if worst < minimum:
            minimum = worst
            for i in range(nu):
                m[best + i] = m[u + i]
        correct(m, o, k, share)
        share *= 0.5
    if minimum < np.inf:
        for i in range(nu):
            m[u + i] = m[best + i]
    evaluate_trial(m, o, k)
    return False


@compiled
def hold_node(m: Floats, o: Integers, k: int, alpha: float) -> None:
    """Trial inputs of node k within the true rows. The slacks then step to the rows' true values, L1 slacks as far as rows give way: left
    to the direction, they would say where inputs are not, and the slack nearest to zero would cut the steps that follow."""
    _, boxes, general = node_rows(o, k)
    pull_inside(m, o, k)
    record_input_violations(m, o, k, o[ROW_TRIAL])
    if alpha == 0.0:
        return
    for j in range(boxes + general):
        if held(m, o, j):
            q = k * o[ROWS] + j
            t, h, least = m[o[ROW_T] + q], m[o[ROW_TRIAL] + j], inside(m, o, k, j)
            if j < boxes:  # of which corrections aim nearer
                least = THRESHOLDS.kept_slack * t
            if row_penalty(m, o, j) < np.inf:
                h += m[o[ROW_S] + q] + alpha * m[o[ROW_DS] + q]
                if h < least:  # it gives way
                    m[o[ROW_DS] + q] += (least - h) / alpha
                    h = least
            m[o[ROW_DT] + q] = (max(h, least) - t) / alpha


@compiled
def follow(m: Floats, o: Integers, k: int, alpha: float) -> None:
    """Trial state of node k + 1 by the linearized dynamics from the trial point of node k."""
    nx, nu = o[NX], o[NU]
    x, previous, u, last = o[XT] + k * nx, o[X] + k * nx, o[UT] + k * nu, o[U] + k * nu
    for r in range(nx):
        row = o[AB] + (k * (nx + 1) + r) * o[LZ]
        total = m[previous + nx + r] + alpha * m[row + nx]
        for i in range(nx):
            total += m[row + i] * (m[x + i] - m[previous + i])
        for i in range(nu):
            total += m[row + nx + 1 + i] * (m[u + i] - m[last + i])
        m[x + nx + r] = total
