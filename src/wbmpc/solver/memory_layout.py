"""Where things are in the table ``o`` of :mod:`wbmpc.solver.workspace`: constants for the compiled code.

The letters are those of docs/explanation/solver.md. Every compiled function works on the memory ``m`` (doubles) and the table ``o``
(integers) and allocates nothing; arguments named after a block or an array are offsets into the memory.
"""

from __future__ import annotations

from wbmpc.solver import workspace as _w

(N, NX, NU, NG, LX, LZ, LG, NP, RK4, PATH_BOXES, END_BOXES, QUATERNIONS, BASE) = range(13)
(ROW_BOXES, ROW_GENERAL, END_ROW_BOXES, END_ROW_GENERAL, ROWS, ROW_END, ROW_TOTAL) = range(13, 20)
(JUMPS, ALIGN, EXACT, POLICY, CURVED, BENT, WISHES, MULTIPLIERS) = range(20, len(_w.DIMENSIONS))

_place = {name: _w.OFFSETS + i for i, name in enumerate(_w.BLOCKS)}
GRID, X, U, XT, UT, BEST, DU_LAST = (_place[n] for n in ("grid", "x", "u", "x_trial", "u_trial", "u_best", "du_last"))
DX, DU, P, W, AB, H, E, EPS, K = (_place[n] for n in ("dx", "du", "p", "w", "ab", "h", "e", "eps", "k"))
VALUE, TERMINAL, SCRATCH, G = (_place[n] for n in ("value", "terminal", "scratch", "gradient"))
J1, J2, S1, S2, SLOPES, SMALL, BOXES = (_place[n] for n in ("j1", "j2", "s1", "s2", "f", "small", "boxes"))
ROW_H, ROW_T, ROW_L, ROW_S = (_place[n] for n in ("rows_h", "rows_t", "rows_l", "rows_s"))
ROW_C, ROW_E, ROW_D, ROW_N = (_place[n] for n in ("rows_c", "rows_e", "rows_d", "rows_n"))
ROW_DT, ROW_DS, ROW_Y = (_place[n] for n in ("rows_dt", "rows_ds", "rows_y"))
ROW_TABLE, ROW_J, ROW_SCALED, END_J = (_place[n] for n in ("row_table", "row_jacobian", "row_scaled", "end_jacobian"))
WISH_R, WISH_STEP = (_place[n] for n in ("wish", "wish_step"))
ADJOINT, NU_ROWS, SIGNED = (_place[n] for n in ("adjoint", "multiplier", "signed"))
PULLED, ROW_TRIAL, LANES_OUT = (_place[n] for n in ("pulled", "row_trial", "lanes"))
NORMAL, SECOND, CHAINED = (_place[n] for n in ("normal", "second", "chained"))
LANE_X, LANE_NEXT, LANE_U, LANE_P, LANE_SMALL = (_place[f"lane_{n}"] for n in ("x", "next", "u", "p", "small"))
LANE_F, LANE_J1, LANE_J2, LANE_S1, LANE_S2 = (_place[f"lane_{n}"] for n in ("f", "j1", "j2", "s1", "s2"))
LANE_BARRIER = _place["lane_barrier"]
LANE_AB, LANE_MATRIX, LANE_E, LANE_ROWS, LANE_VALUES = (
    _place[f"lane_{n}"] for n in ("ab", "matrix", "equalities", "rows", "values")
)
GRID_BASE, GRID_OLD, STATE, FILTER = (_place[n] for n in ("grid_base", "grid_old", "state", "filter"))

#: Columns of the row table: h = sign z + offset (rows of one variable); ν or ρ; kind; whether the row counts at the first
#: node and at the others (1 or 0).
SIGN, OFFSET, PENALTY, KIND, COUNTS_FIRST, COUNTS = range(6)
#: Places in the block ``state``: μ of the interior point, shift of the Hessian, entries in the filter; then what the rows'
#: step found: largest primal and dual step length, slope of the rows' cost, largest complementarity product, largest primal
#: residual, the violation that the full step leaves (of multiplier rows), and what the rows add to the cost;
#: the factor of the multiplier rows' ρ, and how much of the exact Hessian's second derivatives counts; last whether trial
#: points are held within the true rows of the inputs, by how much they are outside all the same (rows of inputs alone, rows
#: with states) and where most (node times ``ROWS`` plus row), cost and violation of the iterate, and without a certificate the
#: last step length and the longest one to try (0: not known, 1), which outlives a solve; whether rows of the inputs are watched at
#: trial points (in real time), by what share of a row's size the first input of a plan misses an equality, and which row;
#: by how much the violation without wishes is less than the 1-norm with all equalities; by how much planned states are outside
#: hard rows (0 up to the tolerance), where most (as above), and the same of the rows whose L1 slack is not what gives way there;
#: for how many solves in a row equalities with multipliers have contradicted each other, by what share they are missed since limits
#: of the inputs are in their way (0: they are not), for how long [s], and which limit holds them most (−1: none).
MU, SHIFT, FILTERED, PRIMAL, DUAL, ROW_SLOPE, PRODUCT, RESIDUAL, LEFT, ROW_COST, RHO, THETA = range(12)
HOLD, MISSED, GIVEN_WAY, MOST_AT, COST, VIOLATION, LAST_ALPHA, LONGEST = range(12, 20)
WATCHED, UNEQUAL, UNEQUAL_ROW, WISHED, PASSED, PASSED_AT, UNDUE, CONTRADICTED = range(20, 28)
HELD_SHARE, HELD_FOR, HELD_BY = range(28, 31)
#: By how much planned inputs and states may be outside a hard row [its range].
LIMIT_TOLERANCE = 1e-3

#: Settings of a solve, one array of numbers: see :mod:`wbmpc.solver.settings`.
SETTINGS = (
    "iterations",
    "tolerance",
    "feasibility",
    "min_step",
    "compute_kkt",
    "accept_min_step",
    "single_shooting",
    "use_filter",
    "mu_start",
    "mu_end",
    "keep_multipliers",
    "min_slack",
    "tau",
    "max_extra_iterations",
    "max_regularization",
    "keep_slacks",
    "mu_floor",
    "equality_bound",
    "rollout_restart",
)
(
    ITERATIONS, TOLERANCE, FEASIBILITY, SMALLEST, CERTIFY, FORCE, SINGLE, USE_FILTER, MU_START, MU_END, KEEP, LEAST_SLACK, TAU,
    EXTRA, LARGEST_SHIFT, KEEP_SLACKS, MU_FLOOR, EQUALITY_BOUND, START_ANEW,
) = range(len(SETTINGS))  # fmt: skip

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
RICCATI, CHAIN, ADD_ROWS, PACK = (_call[n] for n in ("riccati_node", "chain_lanes", "add_rows", "pack"))
UNPACK_AB, UNPACK_MATRIX, UNPACK_EQUALITIES, UNPACK_ROWS = (
    _call[f"unpack_{n}"] for n in ("ab", "matrix", "equalities", "rows")
)
ARG, RES, INDEX = _w.POINTERS, _w.POINTERS + 8, _w.INDICES
