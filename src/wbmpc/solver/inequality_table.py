"""Compiled code: what the table of rows says, and by how much planned inputs and states are outside hard rows."""

from __future__ import annotations

import numpy as np

from wbmpc.ocp.constraint_classification import Kind
from wbmpc.solver.compilation import LANES, Floats, Integers, Mask, Vector, compiled
from wbmpc.solver.memory_layout import (
    END_ROW_BOXES,
    END_ROW_GENERAL,
    ROW_BOXES,
    ROW_D,
    ROW_END,
    ROW_GENERAL,
    ROW_H,
    ROW_L,
    ROW_N,
    ROW_TABLE,
    ROW_TOTAL,
    ROWS,
    STATE,
    N,
    RowField,
    StateField,
)
from wbmpc.solver.settings import THRESHOLDS

HARD, MULTIPLIER, EQUAL = int(Kind.HARD), int(Kind.MULTIPLIER), int(Kind.EQUAL)
#: Inputs that are less outside [ranges of the rows] are inside.
ROUNDING = 1e-9


@compiled
def node_rows(o: Integers, k: int) -> tuple[int, int, int]:
    """(first row in the row table, rows of one variable, general rows) of node k."""
    if k < o[N]:
        return 0, o[ROW_BOXES], o[ROW_GENERAL]
    return o[ROW_END], o[END_ROW_BOXES], o[END_ROW_GENERAL]


@compiled
def entry(o: Integers, column: int, r: int) -> int:
    """Offset of row r in a column of the row table."""
    return o[ROW_TABLE] + column * o[ROW_TOTAL] + r


@compiled
def counts(m: Floats, o: Integers, r: int, k: int) -> bool:
    """Whether row r (of path and end together) counts at node k: rows of the state alone not at the measured state."""
    return m[entry(o, RowField.COUNTS if k > 0 else RowField.COUNTS_FIRST, r)] > 0.0


@compiled
def kind_of(m: Floats, o: Integers, r: int) -> int:
    """HARD, MULTIPLIER or EQUAL."""
    return int(m[entry(o, RowField.KIND, r)])


@compiled
def row_penalty(m: Floats, o: Integers, r: int) -> float:
    """Weight of a hard row's L1 slack, or ρ of a multiplier row (which grows while its residual does not shrink)."""
    penalty = m[entry(o, RowField.PENALTY, r)]
    return penalty if kind_of(m, o, r) == HARD else penalty * m[o[STATE] + StateField.PENALTY_FACTOR]


@compiled
def eight_rows(m: Floats, o: Integers, r: int, k: int) -> tuple[Vector, Vector, Mask]:
    """(kinds, penalties, whether they count at node k) of the rows from r on."""
    kind, penalty = (
        m[entry(o, RowField.KIND, r) : entry(o, RowField.KIND, r) + LANES],
        m[entry(o, RowField.PENALTY, r) : entry(o, RowField.PENALTY, r) + LANES],
    )
    column = entry(o, RowField.COUNTS if k > 0 else RowField.COUNTS_FIRST, r)
    penalty = np.where(kind == HARD, penalty, penalty * m[o[STATE] + StateField.PENALTY_FACTOR])
    return kind, penalty, m[column : column + LANES] > 0.0


# ---------------------------------------------------------------------- inputs and states outside
@compiled
def bounds_inputs(m: Floats, o: Integers, r: int) -> bool:
    """Whether row r of the path is hard and depends on the inputs: those count at the first node too."""
    return kind_of(m, o, r) == HARD and m[entry(o, RowField.COUNTS_FIRST, r)] > 0.0


@compiled
def reset_violations(m: Floats, o: Integers) -> None:
    """Nothing is known to be outside."""
    m[o[STATE] + StateField.INPUT_VIOLATION], m[o[STATE] + StateField.MIXED_VIOLATION] = 0.0, 0.0
    m[o[STATE] + StateField.STATE_VIOLATION], m[o[STATE] + StateField.UNRELAXED_VIOLATION] = 0.0, 0.0


@compiled
def record_input_violations(m: Floats, o: Integers, k: int, values: int) -> None:
    """Remember in ``state`` by how much node k's inputs are outside: rows of inputs alone, rows with states too. ``values``: of its rows."""
    _, boxes, general = node_rows(o, k)
    for j in range(boxes + general):
        if bounds_inputs(m, o, j):
            mixed, by = row_penalty(m, o, j) < np.inf, -m[values + j]
            field = o[STATE] + (StateField.MIXED_VIOLATION if mixed else StateField.INPUT_VIOLATION)
            if by > m[field]:
                which = StateField.MIXED_VIOLATION_ROW if mixed else StateField.INPUT_VIOLATION_ROW
                m[field], m[o[STATE] + which] = by, k * o[ROWS] + j


@compiled
def record_state_violations(m: Floats, o: Integers, k: int, values: int) -> None:
    """Remember in ``state`` by how much node k's state is outside: all rows, and those that do not give way a step further."""
    first, boxes, general = node_rows(o, k)
    state = o[STATE]
    for j in range(boxes + general):
        r, q, by = first + j, k * o[ROWS] + j, -m[values + j]
        if (
            by <= THRESHOLDS.limit_tolerance
            or bounds_inputs(m, o, r)
            or kind_of(m, o, r) != HARD
            or not counts(m, o, r, k)
        ):
            continue
        if by > m[state + StateField.STATE_VIOLATION]:
            m[state + StateField.STATE_VIOLATION], m[state + StateField.STATE_VIOLATION_ROW] = by, q
        following = m[o[ROW_L] + q] + m[state + StateField.MAX_DUAL_STEP] * (m[o[ROW_N] + q] - m[o[ROW_L] + q])
        if following < THRESHOLDS.gives_way * row_penalty(m, o, r):
            m[state + StateField.UNRELAXED_VIOLATION] = max(m[state + StateField.UNRELAXED_VIOLATION], by)


@compiled
def initial_violation(m: Floats, o: Integers) -> float:
    """By how much the measured state is outside hard rows of the state of which the iterate's start is inside, or nearly, after a
    direction; 0 where there is none. (The rows do not count there.)"""
    _, boxes, general = node_rows(o, 0)
    worst = 0.0
    for j in range(boxes + general):
        if kind_of(m, o, j) == HARD and counts(m, o, j, 1) and not bounds_inputs(m, o, j):
            outside, change = -(m[o[ROW_H] + j] + m[o[ROW_D] + j]), -m[o[ROW_D] + j]
            worst = max(worst, outside if change > 0.5 * outside else 0.0)
    return worst


@compiled
def record_violations(m: Floats, o: Integers, k: int, values: int) -> None:
    """As :func:`record_input_violations` and :func:`record_state_violations`, for nodes that rarely violate anything."""
    first, boxes, general = node_rows(o, k)
    inputs, states = np.full(LANES, 0.0), np.full(LANES, 0.0)
    for j in range(0, boxes + general, LANES):
        r, at, bounds = first + j, values + j, entry(o, RowField.COUNTS_FIRST, first + j)
        kind = m[entry(o, RowField.KIND, r) : entry(o, RowField.KIND, r) + LANES]
        column = entry(o, RowField.COUNTS if k > 0 else RowField.COUNTS_FIRST, r)
        over = np.where((kind == HARD) & (m[column : column + LANES] > 0.0), -m[at : at + LANES], 0.0)
        of_inputs = m[bounds : bounds + LANES] > 0.0
        inputs = np.maximum(inputs, np.where(of_inputs, over, 0.0))
        states = np.maximum(states, np.where(of_inputs, 0.0, over))
    if np.max(inputs) > ROUNDING:
        record_input_violations(m, o, k, values)
    if np.max(states) > THRESHOLDS.limit_tolerance:
        record_state_violations(m, o, k, values)
