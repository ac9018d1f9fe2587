"""Where things are in the table ``o`` of :mod:`wbmpc.solver.workspace`: constants for the compiled code.

The letters are those of docs/explanation/solver.md. Every compiled function works on the memory ``m`` (doubles) and the table ``o``
(integers) and allocates nothing; arguments named after a block or an array are offsets into the memory.
"""

from __future__ import annotations

from enum import IntEnum

from wbmpc.solver import workspace as _w

_dimension = {name: i for i, name in enumerate(_w.DIMENSIONS)}
N, NX, NU, NG, LX, LZ, LG, NP = (_dimension[n] for n in ("n", "nx", "nu", "ng", "lx", "lz", "lg", "np"))
RK4, PATH_BOXES, END_BOXES = (_dimension[n] for n in ("rk4", "path_boxes", "terminal_boxes"))
QUATERNIONS, BASE, JUMPS, ALIGN = (_dimension[n] for n in ("quaternions", "base", "jumps", "align"))
ROW_BOXES, ROW_GENERAL, ROW_ENTRIES = (_dimension[n] for n in ("row_boxes", "row_general", "row_entries"))
END_ROW_BOXES, END_ROW_GENERAL = (_dimension[n] for n in ("end_boxes", "end_general"))
ROWS, ROW_END, ROW_TOTAL = (_dimension[n] for n in ("rows", "row_end", "row_total"))
EXACT, POLICY, MULTIPLIERS = (_dimension[n] for n in ("exact", "policy", "multipliers"))
NONLINEAR_INPUT_ROWS, NONLINEAR_EQUALITIES, SOFT_EQUALITIES = (
    _dimension[n] for n in ("nonlinear_input_rows", "nonlinear_equalities", "soft_equalities")
)

_block = {name: _w.OFFSETS + i for i, name in enumerate(_w.BLOCKS)}
GRID, X, U, XT, UT, U_BEST, DU_LAST = (_block[n] for n in ("grid", "x", "u", "x_trial", "u_trial", "u_best", "du_last"))
DX, DU, P, W, AB, H, E, EPS, K = (_block[n] for n in ("dx", "du", "p", "w", "ab", "h", "e", "eps", "k"))
VALUE, TERMINAL, SCRATCH, G = (_block[n] for n in ("value", "terminal", "scratch", "gradient"))
J1, J2, S1, S2, SLOPES, SMALL, BOXES = (_block[n] for n in ("j1", "j2", "s1", "s2", "f", "small", "boxes"))
ROW_H, ROW_T, ROW_L, ROW_S = (_block[n] for n in ("rows_h", "rows_t", "rows_l", "rows_s"))
ROW_C, ROW_E, ROW_D, ROW_N = (_block[n] for n in ("rows_c", "rows_e", "rows_d", "rows_n"))
ROW_DT, ROW_DS, ROW_Y = (_block[n] for n in ("rows_dt", "rows_ds", "rows_y"))
ROW_TABLE, ROW_J, ROW_MATRIX, END_J = (_block[n] for n in ("row_table", "row_jacobian", "row_matrix", "end_jacobian"))
SOFT_RESIDUAL, SOFT_RESIDUAL_STEP = (_block[n] for n in ("soft_residual", "soft_residual_step"))
ADJOINT, NU_ROWS, SIGNED = (_block[n] for n in ("adjoint", "multiplier", "signed"))
PULLED, ROW_TRIAL = (_block[n] for n in ("pulled", "row_trial"))
NORMAL, SECOND, CHAINED = (_block[n] for n in ("normal", "second", "chained"))
LANE_X, LANE_NEXT, LANE_U, LANE_P, LANE_SMALL = (_block[f"lane_{n}"] for n in ("x", "next", "u", "p", "small"))
LANE_F, LANE_S1, LANE_S2, LANE_S3 = (_block[f"lane_{n}"] for n in ("f", "s1", "s2", "s3"))
LANE_J1, LANE_J2, LANE_J3, LANE_J4 = (_block[f"lane_j{n}"] for n in (1, 2, 3, 4))
LANE_BARRIER, LANE_WEIGHTS, LANE_PULLED = (_block[f"lane_{n}"] for n in ("barrier", "weights", "pulled"))
LANE_AB, LANE_MATRIX, LANE_E, LANE_ROWS, LANE_VALUES = (
    _block[f"lane_{n}"] for n in ("ab", "matrix", "equalities", "rows", "values")
)
GRID_BASE, GRID_OLD, STATE, FILTER = (_block[n] for n in ("grid_base", "grid_old", "state", "filter"))


class RowField(IntEnum):
    """Columns of the row table."""

    SIGN = 0  # h = sign z + offset, of rows of one variable
    OFFSET = 1
    PENALTY = 2  # weight of the L1 slack, or ρ
    KIND = 3
    COUNTS_FIRST = 4  # whether the row counts at the first node (1 or 0)
    COUNTS = 5  # … and at the others
    MOVES = 6  # whether its multiplier moves with the plan: see :func:`wbmpc.solver.receding.shift_multipliers`


class StateField(IntEnum):
    """Entries of the block ``state``: what a solve passes from one function to the next, and reports.

    Rows are numbered node times ``ROWS`` plus row. Violations are shares of a row's range; 0 up to the tolerance.
    """

    BARRIER = 0  # μ of the interior point
    SHIFT = 1  # of the Hessian's diagonal
    FILTER_SIZE = 2  # entries in the filter of the line search
    # what the rows' step found
    MAX_PRIMAL_STEP = 3
    MAX_DUAL_STEP = 4
    ROW_SLOPE = 5  # slope of the rows' cost along the step
    MAX_COMPLEMENTARITY = 6  # largest product of slack and multiplier
    MAX_ROW_RESIDUAL = 7
    REMAINING_VIOLATION = 8  # of multiplier rows, after the full step
    ROW_COST = 9  # what the rows add to the cost
    PENALTY_FACTOR = 10  # of the multiplier rows' ρ
    SECOND_ORDER_SHARE = 11  # how much of the exact Hessian's second derivatives counts
    # hard rows of the inputs at trial points
    HOLD_INPUTS = (
        12  # trial inputs are held: 0 not at all, 1 within rows of inputs alone, 2 within rows with states too
    )
    INPUT_VIOLATION = 13  # of rows of inputs without slack
    MIXED_VIOLATION = 14  # of rows of inputs with one, as those with states have
    INPUT_VIOLATION_ROW = 15  # which of those without slack is violated most
    COST = 16  # of the iterate
    VIOLATION = 17
    LAST_STEP = 18  # last step length, without a certificate
    MAX_STEP = 19  # longest step length to try (0: not known, 1); outlives a solve
    CHECK_INPUT_ROWS = 20  # whether rows of the inputs are checked at trial points (in real time)
    # equalities
    EQUALITY_RESIDUAL = 21  # by what share of a row's size the plan misses an equality
    EQUALITY_ROW = 22  # which one
    SOFT_EQUALITY_VIOLATION = 23  # 1-norm of all equalities minus that of those that are not soft
    # hard rows of planned states
    STATE_VIOLATION = 24
    STATE_VIOLATION_ROW = 25
    UNRELAXED_VIOLATION = 26  # of the rows whose L1 slack is not what gives way
    # infeasibility.py: equalities with multipliers
    INFEASIBLE_SOLVES = 27  # for how many solves in a row they have contradicted each other
    BLOCKED_RESIDUAL = 28  # their residual since limits of the inputs are in the way (0: they are not)
    BLOCKED_TIME = 29  # since when [s]
    BLOCKING_ROW = 30  # which limit it is (−1: none)
    # barrier_update.py
    FREE_BARRIER = 31  # whether μ follows the products of slacks and multipliers
    ERRORS = 32  # of the last iterations that it did: four entries
    # stall.py
    SMALLEST_ERROR = 36  # of the present iterations in a row
    LAST_SMALLEST_ERROR = 37  # of those before
    CONVERGED = 38  # whether slacks and multipliers are those of a solution; outlives a solve
    # what the solve has cost
    DIRECTIONS = 39
    TRIAL_POINTS = 40
    MIXED_VIOLATION_ROW = 41  # which of those with one is violated most
    # what the next linearization does with slacks and multipliers first: node_inequalities.py
    START = 42  # 0: nothing
    START_SLACK = 43  # the least slack


class Setting(IntEnum):
    """Entries of the settings of a solve, one array of numbers: see :mod:`wbmpc.solver.settings`."""

    ITERATIONS = 0
    TOLERANCE = 1
    FEASIBILITY = 2
    MIN_STEP = 3
    COMPUTE_KKT = 4
    ACCEPT_MIN_STEP = 5
    SINGLE_SHOOTING = 6
    USE_FILTER = 7
    INITIAL_BARRIER = 8
    BARRIER = 9
    KEEP_MULTIPLIERS = 10
    MIN_SLACK = 11
    FRACTION_TO_BOUNDARY = 12
    MAX_EXTRA_ITERATIONS = 13
    MAX_REGULARIZATION = 14
    KEEP_SLACKS = 15
    MIN_BARRIER = 16
    EQUALITY_BOUND = 17
    ROLLOUT_RESTART = 18
    MAX_BARRIER = 19
    DETECT_STALL = 20


#: Names of the settings, in order.
SETTINGS = tuple(s.name.lower() for s in Setting)

_call = {name: _w.ADDRESSES + i for i, name in enumerate(_w.FUNCTIONS)}
DYNAMICS, END_COST, END_ROW_VALUES, JUMP = (_call[n] for n in ("dynamics", "terminal", "end_rows", "jump"))
END_Q, END_ROWS_J, JUMP_J = (_call[n] for n in ("terminal_quadratic", "end_rows_jacobian", "jump_jacobian"))
LAGRANGIAN, DYNAMICS_H, END_LAGRANGIAN = (_call[n] for n in ("lagrangian", "dynamics_hessian", "end_lagrangian"))
LANES_DYNAMICS, LANES_COST, LANES_EQUALITY, LANES_ROWS = (
    _call[f"lanes.{n}"] for n in ("dynamics", "cost", "equality", "rows")
)
LANES_DYNAMICS_J, LANES_COST_Q, LANES_EQUALITY_J, LANES_ROWS_J = (
    _call[f"lanes.{n}"] for n in ("dynamics_jacobian", "cost_quadratic", "equality_jacobian", "rows_jacobian")
)
RICCATI, STEP, CURVATURE, CHAIN_FIRST, CHAIN_NEXT, PACK = (
    _call[n]
    for n in (
        "riccati_node",
        "step_node",
        "curvature_node",
        "chain_first",
        "chain_next",
        "pack",
    )
)
BOX_VALUES, BOX_CHANGES, ADD_BOXES = (_call[n] for n in ("box_values", "box_changes", "add_boxes"))
ADD_ROWS, ADD_ROW_GRADIENT, ROW_PRODUCTS, NODE_ROWS, PULLED_ROWS = (
    _call[n] for n in ("add_rows", "add_row_gradient", "row_products", "node_rows", "pulled_rows")
)
UNPACK_AB, UNPACK_MATRIX, UNPACK_EQUALITIES, UNPACK_ROWS = (
    _call[f"unpack_{n}"] for n in ("ab", "matrix", "equalities", "rows")
)
ARG, RES, INDEX = _w.POINTERS, _w.POINTERS + 8, _w.INDICES
