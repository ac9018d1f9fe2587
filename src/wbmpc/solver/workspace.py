"""The solver's memory: one block of doubles, 64-byte aligned, and one table of integers that says where things are.

Two flat arrays keep the compiled driver small (it compiles in seconds, once per machine, for problems of any size).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wbmpc.kernel import Kernel
from wbmpc.kernel.compiled import ADDRESSES as FUNCTIONS
from wbmpc.kernel.dense import pad
from wbmpc.kernel.ir import LANES
from wbmpc.kernel.sizes import Sizes
from wbmpc.ocp import Transcription
from wbmpc.ocp.constraint_classification import BoxRow, Kind, Row
from wbmpc.ocp.parameters import default_weights

#: Columns of the iteration log.
LOG = (
    "cost",
    "violation",
    "kkt",
    "step",
    "alpha",
    "defect",
    "equality",
    "inequality",
    "complementarity",
    "mu",
    "shift",
    "dual_alpha",
)

#: Entries of the integer table before the function addresses: dimensions, then offsets [doubles] into the memory.
DIMENSIONS = (
    "n",
    "nx",
    "nu",
    "ng",
    "lx",
    "lz",
    "lg",
    "np",
    "rk4",
    "path_boxes",
    "terminal_boxes",
    "quaternions",
    "base",
    "row_boxes",  # rows with a state of their own: of single variables, general; along the path, at the end
    "row_general",
    "row_entries",  # of their Jacobian, as it is kept
    "end_boxes",
    "end_general",
    "rows",  # entries for them per node, a multiple of eight
    "row_end",  # first of the end's rows in the row table
    "row_total",  # length of a column of the row table
    "jumps",
    "align",
    "exact",  # whether the Hessian is the exact one
    "policy",  # whether the gains belong to the present trajectory
    "nonlinear_input_rows",  # whether hard rows are nonlinear in the inputs
    "nonlinear_equalities",  # whether equalities or rows with multipliers are
    "soft_equalities",  # whether any equality is soft (:data:`wbmpc.ocp.transcription.MIN_SOFTNESS`)
    "multipliers",  # whether rows have multipliers of an augmented Lagrangian
)
BLOCKS = (
    "grid",  # (N + 1,) s
    "x",  # (N + 1, nx)
    "u",  # (N, nu)
    "x_trial",
    "u_trial",
    "du_last",  # (N, nu): the direction before
    "u_best",  # (nu,): of one node, nearest to its rows
    "dx",  # (N + 1, lx), entry nx is 1
    "du",  # (N, nu)
    "p",  # (N + 1, np)
    "w",
    "ab",  # (N, nx + 1, lz): [A b B] of each node, last row unit
    "h",  # (N or 8, nz, lz): Hessian with the gradient in row and column nx
    "e",  # equality rows of eight nodes
    "eps",  # (lg,)
    "k",  # (N, nu, lx): gains, feed-forward in entry nx
    "value",  # (nx + 1, lx): value function
    "terminal",  # (nx + 1, lx)
    "scratch",
    "gradient",  # (N + 1, lz), of the cost without the rows
    "j1",  # (nx, lz)
    "j2",
    "s1",
    "s2",
    "f",  # (6, lx)
    "small",  # (16 + largest number of equalities or general rows,)
    "boxes",  # (relaxed barriers, 4): sign, offset, μ, δ; path first
    "rows_h",  # (N + 1, rows): value, slack, multiplier, L1 slack, σ, e, J δz, next multiplier, steps of the slacks
    "rows_t",
    "rows_l",
    "rows_s",
    "rows_c",
    "rows_e",
    "rows_d",
    "rows_n",
    "rows_dt",
    "rows_ds",
    "rows_y",  # ν − l, kept apart: it is tiny where the L1 slack is large
    "row_table",  # (7, path rows, then end rows, each up to a multiple of eight): see memory_layout.py
    "row_jacobian",  # (blocks of eight nodes, entries, 8): see wbmpc.kernel.sparse_rows
    "row_matrix",  # (nr, lz): of one node
    "end_jacobian",  # (ne, lz)
    "grid_base",  # (N + 1,) the problem's own; ``grid`` may have nodes moved onto events
    "grid_old",
    "state",  # (STATE_SIZE,): μ, shift of the Hessian, … (see memory_layout.py)
    "filter",  # (64, 2): cost, violation
    "soft_residual",  # (N, equalities): residuals of soft equalities as variables, and their step
    "soft_residual_step",
    "adjoint",  # (4, lx): costate, its two multiples, spare
    "pulled",  # (lz + 24,): Jᵀ σ J δz of one node; scratch of the forward pass
    "row_trial",  # (8, rows): values at a trial point of one node, or of eight
    "multiplier",  # (equalities,)
    "signed",  # (general rows,): their multipliers with the sign of the Lagrangian; scratch of the KKT residual
    "normal",  # (equalities, equalities)
    "second",  # (nz, lz): second derivatives
    "chained",  # (nz, lz)
    "lane_x",  # eight nodes side by side, here and below: (nx, 8), the next states, inputs and parameters
    "lane_next",
    "lane_u",
    "lane_p",
    "lane_small",  # (6, 8): interval, 1 for lanes that count, weights of a Runge-Kutta stage, cost, barriers
    "lane_f",  # (6, nx, 8): slopes, middle, end
    "lane_j1",  # (nx, lz, 8)
    "lane_j2",
    "lane_j3",  # of the third and fourth stage
    "lane_j4",
    "lane_s1",
    "lane_s2",
    "lane_s3",
    "lane_ab",
    "lane_matrix",  # (nz, lz, 8), only the groups with entries
    "lane_equalities",
    "lane_rows",  # (entries, 8): the Jacobian of rows at trial points
    "lane_weights",  # (2, general rows, 8): their σ and e
    "lane_pulled",  # (nz, 8): Jᵀ w σ e
    "lane_barrier",  # (nz, 2, 8): slope and curvature of the relaxed barriers by variable
    "lane_values",  # (equalities or general rows, 8)
)
#: Entries of the block ``state``.
STATE_SIZE = 48

#: First index of the function addresses, of the pointer tables and of the rows' indices in the integer table.
OFFSETS = len(DIMENSIONS)
ADDRESSES = OFFSETS + len(BLOCKS)
POINTERS = ADDRESSES + len(FUNCTIONS)
INDICES = POINTERS + 16

_ROWS = ("rows_h", "rows_t", "rows_l", "rows_s", "rows_c", "rows_e", "rows_d", "rows_n", "rows_dt", "rows_ds", "rows_y")
_VIEWS = (
    "grid",
    "x",
    "u",
    "x_trial",
    "u_trial",
    "p",
    "w",
    "k",
    "value",
    "dx",
    "du",
    "rows_h",
    "rows_t",
    "rows_l",
    "rows_s",
    "state",
)


def aligned(count: int) -> np.ndarray:
    """Zeros whose first element is at a multiple of 64 bytes."""
    raw = np.zeros(count + 8)
    start = (-raw.ctypes.data % 64) // 8
    return raw[start : start + count]


class BoxTable(NamedTuple):
    """Relaxed barriers on h = sign z[variable] + offset, z = [x; u]."""

    variable: np.ndarray
    sign: np.ndarray
    offset: np.ndarray
    mu: np.ndarray
    delta: np.ndarray


def box_table(rows: list[BoxRow]) -> BoxTable:
    """Rows of a transcription as arrays."""
    table = np.array(rows, float).reshape(-1, 5)
    return BoxTable(table[:, 0].astype(np.int64), *(np.ascontiguousarray(table[:, i]) for i in range(1, 5)))


@dataclass(frozen=True)
class Workspace:
    """``memory`` and ``table`` go to the compiled code; the other fields are views into the memory."""

    memory: np.ndarray
    table: np.ndarray
    grid: np.ndarray
    x: np.ndarray
    u: np.ndarray
    x_trial: np.ndarray
    u_trial: np.ndarray
    p: np.ndarray
    w: np.ndarray
    k: np.ndarray
    value: np.ndarray
    dx: np.ndarray
    du: np.ndarray
    rows_h: np.ndarray
    rows_t: np.ndarray
    rows_l: np.ndarray
    rows_s: np.ndarray
    state: np.ndarray


def _lane_shapes(s: Sizes, parameters: int, rk4: bool) -> dict[str, tuple[int, ...]]:
    """Of the blocks with eight nodes side by side."""
    sizes = {
        "lane_x": pad(s.nx),
        "lane_next": pad(s.nx),
        "lane_u": pad(s.nu),
        "lane_p": pad(parameters),
        "lane_small": 6,
        "lane_f": 6 * s.nx,
        **{f"lane_{name}": s.nx * s.lz for name in ("j1", "j2", "s1", "s2", "ab")},
        **{f"lane_{name}": s.nx * s.lz * rk4 for name in ("j3", "j4", "s3")},
        "lane_matrix": s.nz * s.lz,
        "lane_equalities": pad(s.equality_buffer()),
        "lane_rows": s.row_entries,
        "lane_weights": 2 * pad(s.nr),
        "lane_pulled": s.nz,
        "lane_barrier": 2 * s.nz,
        "lane_values": max(s.ng, s.nr),
    }
    return {name: (max(size, 1), LANES) for name, size in sizes.items()}


def _shapes(kernel: Kernel, problem: Transcription) -> dict[str, tuple[int, ...]]:
    s, n = kernel.sizes, problem.ocp.intervals
    barriers = len(problem.path.barriers) + len(problem.end.barriers)
    jacobian = (s.nx, s.lz)
    path, end = pad(len(problem.path.rows)), pad(len(problem.end.rows))
    rows = max(path, end, 1)
    shapes: dict[str, tuple[int, ...]] = {
        "grid": (n + 1,),
        "x": (n + 1, s.nx),
        "u": (n, s.nu),
        "x_trial": (n + 1, s.nx),
        "u_trial": (n, s.nu),
        "du_last": (n, s.nu),
        "u_best": (s.nu,),
        "dx": (n + 1, s.lx),
        "du": (n, s.nu),
        "p": (n + 1, max(problem.node.size, 1)),
        "w": (max(problem.constant.size, 1),),
        "ab": (n, s.nx + 1, s.lz),
        "h": (max(n, LANES), s.nz, s.lz),
        "e": (LANES, pad(s.equality_buffer())) if s.ng else (1,),
        "eps": (s.lg,),
        "k": (n, s.nu, s.lx),
        "value": (s.nx + 1, s.lx),
        "terminal": (s.nx + 1, s.lx),
        "scratch": (s.scratch()["total"],),
        "gradient": (n + 1, s.lz),
        "j1": jacobian,
        "j2": jacobian,
        "s1": jacobian,
        "s2": jacobian,
        "f": (6, s.lx),
        "small": (16 + max(s.ng, s.nr, s.ne),),
        "boxes": (max(barriers, 1), 4),
        "row_table": (7, max(path + end, 1)),
        "row_jacobian": (-(-n // LANES), max(s.row_entries, 1), LANES),
        "row_matrix": (max(s.nr, 1), s.lz),
        "end_jacobian": (max(s.ne, 1), s.lz),
        "grid_base": (n + 1,),
        "grid_old": (n + 1,),
        "state": (STATE_SIZE,),
        "filter": (64, 2),
        "soft_residual": (n, max(s.ng, 1)) if problem.soft_equalities else (1,),
        "soft_residual_step": (n, max(s.ng, 1)) if problem.soft_equalities else (1,),
        "adjoint": (4, s.lx),
        "pulled": (s.lz + 3 * LANES,),
        "row_trial": (LANES, rows),
        "multiplier": (max(s.ng, 1),),
        "signed": (max(s.nr, s.ne, 1),),
        "normal": (max(s.ng, 1), max(s.ng, 1)),
        "second": (s.nz, s.lz),
        "chained": (s.nz, s.lz),
    }
    shapes |= _lane_shapes(s, shapes["p"][1], problem.ocp.integrator == "rk4")
    return shapes | {name: (n + 1, rows) for name in _ROWS}


def _extended(variables: list[int] | np.ndarray, nx: int) -> np.ndarray:
    """Indices in [x; u] as indices in [x, 1, u]."""
    index = np.asarray(variables, dtype=np.int64)
    return np.where(index >= nx, index + 1, index)


#: What fills a group of rows up to a multiple of eight: it never counts.
_NO_ROW = Row("", Kind.HARD, 0, 0.0, 1.0, np.inf, 1.0, False)


def _filled(rows: list[Row]) -> list[Row]:
    return [*rows, *[_NO_ROW] * (pad(len(rows)) - len(rows))]


def _row_table(rows: list[Row]) -> np.ndarray:
    """The columns of the row table (see memory_layout.py)."""
    used = [r is not _NO_ROW for r in rows]
    columns = [
        (r.sign, r.offset, r.penalty, r.kind, y and not r.state_only, y, not r.from_now)
        for r, y in zip(rows, used, strict=True)
    ]
    return np.array(columns, float).reshape(-1, 7).T


def make_workspace(kernel: Kernel, problem: Transcription) -> Workspace:
    """Memory for ``problem`` with its default weights, zero trajectories and no references."""
    s, shapes = kernel.sizes, _shapes(kernel, problem)
    offsets, total = {}, 0
    for name in BLOCKS:
        offsets[name] = total
        total += pad(int(np.prod(shapes[name])))
    memory = aligned(total)
    view = {n: memory[offsets[n] : offsets[n] + int(np.prod(shapes[n]))].reshape(shapes[n]) for n in BLOCKS}
    for grid in ("grid", "grid_base", "grid_old"):
        view[grid][:] = problem.ocp.grid
    view["ab"][:, s.nx, s.nx] = 1.0
    view["dx"][:, s.nx] = 1.0
    view["eps"][: s.ng] = problem.softness + 1e-14
    weights = default_weights(problem)
    view["w"][: weights.size] = weights
    boxes = box_table([*problem.path.barriers, *problem.end.barriers])
    if boxes.variable.size:
        view["boxes"][:] = np.stack(boxes[1:], axis=1)
    rows = [*_filled(problem.path.rows), *_filled(problem.end.rows)]
    view["row_table"][:, : len(rows)] = _row_table(rows)
    quaternions = list(problem.ocp.dynamics.unit_quaternions)
    dimensions = [
        problem.ocp.intervals, s.nx, s.nu, s.ng, s.lx, s.lz, s.lg, shapes["p"][1], problem.ocp.integrator == "rk4",
        len(problem.path.barriers), len(problem.end.barriers), len(quaternions), memory.ctypes.data,
        len(problem.path.boxes), len(problem.path.general), s.row_entries, len(problem.end.boxes), len(problem.end.general),
        shapes["rows_h"][1], pad(len(problem.path.rows)), len(rows), problem.jumps, problem.ocp.align_events, problem.exact, 0,
        problem.nonlinear_input_rows, problem.nonlinear_equalities, problem.soft_equalities, any(r.kind != Kind.HARD for r in rows),
    ]  # fmt: skip
    indices = [
        *_extended(boxes.variable, s.nx), *quaternions, *_extended([r.variable for r in rows], s.nx),
        *([0] * problem.ocp.intervals),
    ]  # fmt: skip
    table = np.array(
        [*dimensions, *(offsets[n] for n in BLOCKS), *kernel.addresses, *([0] * 16), *indices], dtype=np.int64
    )
    return Workspace(memory, table, **{n: view[n] for n in _VIEWS})
