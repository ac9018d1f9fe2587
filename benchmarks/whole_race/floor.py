"""What an iteration must cost: its floating-point operations against this core's peak, and where the rest goes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.benchmark.problems import Problem
from wbmpc.benchmark.program import Program
from wbmpc.benchmark.race import milliseconds, peak_gflops, single_iteration
from wbmpc.kernel.compiled import equality_inputs, step_pattern
from wbmpc.kernel.ir import LANES
from wbmpc.kernel.sizes import Sizes
from wbmpc.solver.workspace import aligned
from whole_race import loops
from whole_race.lq import eliminate, linearize, pack, substitute

_FREE = {ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_ASSIGN, ca.OP_NEG}
_CALLS = {ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_ATAN2, ca.OP_ACOS, ca.OP_ASIN, ca.OP_ATAN, ca.OP_EXP, ca.OP_LOG}


def operations(function: ca.Function) -> tuple[int, int]:
    """(arithmetic operations, calls of elementary functions) of one evaluation; a call counts as one operation too."""
    codes = [function.instruction_id(k) for k in range(function.n_instructions())]
    return sum(c not in _FREE for c in codes), sum(c in _CALLS for c in codes)


def riccati_operations(s: Sizes, entries: np.ndarray, touched: int) -> int:
    """Operations of one Riccati step, without the padding: products, factorizations, substitutions; of symmetric matrices one half.

    ``entries`` (nz,): how many every column of [A b B; 0 1 0] has; ``touched``: how many inputs are in equalities."""
    x, z, u, g, d = s.nx + 1, s.nz, s.nu, s.ng, touched
    cholesky = sum((2 * (u - 1 - j) + 1) * (s.first + j + 1) for j in range(u))
    total = int(2 * x * entries.sum() + 2 * entries @ np.arange(1, z + 1)) + u * x * (x + 1) + cholesky + u * u * x
    if g:  # U⁻¹Dᵀ, Schur complement and its factor, value function, multipliers, gains; then all once more for what is left
        total += g * d * d + 2 * x * g * d + 2 * g * g * d + g**3 // 3 + g * g * x + x * (x + 1) * g
        total += g * g * x + 2 * x * d * g
        total += 2 * x * g * d + 2 * x * g + 2 * g * g * x + 2 * x * d * g + u * u * x
    return total


def iteration_operations(program: Program, sizes: Sizes) -> dict[str, int]:
    """Floating-point operations of the parts of one iteration, all nodes."""
    t, n = program.t, program.n
    functions, stages = {**t.values, **t.derivatives}, 4 if program.stages.rk4 else 2
    count = {name: operations(f)[0] for name, f in functions.items()}
    pattern = functions["dynamics_jacobian"].sparsity_out(1)
    states = sum(c < t.nx for c in pattern.get_col())
    chain = (stages - 1) * (2 * states * sizes.nz + 2 * t.nx * sizes.nz)
    linear = 2 * (t.nu * sizes.nx + t.nx * sizes.nz)
    entries = step_pattern(t, pattern, sizes).sum(axis=0)
    held = equality_inputs(functions["equality_jacobian"].sparsity_out(1), sizes)
    touched = max((j + 1 for inputs in held for j in inputs), default=0)
    return {
        "dynamics with Jacobian": n * stages * count["dynamics_jacobian"],
        "chain rule": n * chain,
        "cost with Hessian": n * count["cost_quadratic"] + count["terminal_quadratic"],
        "equalities with Jacobian": n * count["equality_jacobian"],
        "Riccati": n * riccati_operations(sizes, entries, touched),
        "step": n * linear,
        "trial: dynamics": n * stages * count["dynamics"],
        "trial: cost": n * count["cost"] + count["terminal"],
        "trial: equalities": n * count["equality"],
    }


def _net(call: Callable[[int], Any], count: int, repeat: int) -> float:
    """Milliseconds of a loop over ``count`` nodes or blocks, less those of the call of an empty loop."""
    return float(milliseconds(lambda: call(count), repeat).min() - milliseconds(lambda: call(0), repeat).min())


def _chain_time(problem: Problem, blocks: int, repeat: int) -> float:
    """Milliseconds of the chain rule of one Runge-Kutta stage at all nodes."""
    kernel = problem.solver.kernel
    assert kernel is not None
    size = LANES * kernel.sizes.nx * kernel.sizes.lz
    room, weights = aligned(4 * size), aligned(2 * LANES)
    weights[:] = 0.01
    address = kernel.address("chain_first")
    return _net(lambda count: loops.chain_all(address, room, size, count, weights), blocks, repeat)


def side_by_side(rows: np.ndarray) -> np.ndarray:
    """Numbers (N, width) of nodes as blocks (blocks, width, 8) of eight nodes; the last node fills the last block."""
    blocks = -(-len(rows) // LANES)
    nodes = np.minimum(np.arange(blocks * LANES), len(rows) - 1)
    full = rows[nodes].reshape(blocks, LANES, rows.shape[1])
    out = aligned(full.size).reshape(len(full), rows.shape[1], LANES)
    out[:] = full.transpose(0, 2, 1)
    return out


def _stage_times(problem: Problem, x: np.ndarray, u: np.ndarray, program: Program, repeat: int) -> dict[str, float]:
    """Milliseconds of every stage function at all nodes once."""
    kernel, s = problem.solver.kernel, program.samples
    assert kernel is not None
    w = np.append(s.w, 0.0)
    given = [side_by_side(np.asarray(a, float)) for a in (x[: program.n], u, s.p[: program.n], s.h[: program.n, None])]
    rows = [[a[k].ctypes.data for a in given] for k in range(len(given[0]))]
    pointers = np.array([[*row[:3], w.ctypes.data, row[3]] for row in rows], dtype=np.int64)
    room = aligned(LANES * (kernel.sizes.nz + 8) * (kernel.sizes.lz + kernel.sizes.lg + 8))
    results = np.full(3, room.ctypes.data, dtype=np.int64)
    names = ("dynamics_jacobian", "cost_quadratic", "equality_jacobian", "dynamics", "cost", "equality")
    time = lambda name: _net(
        lambda count: loops.sweep(kernel.address(f"lanes.{name}"), pointers, 5, count, results), len(rows), repeat
    )
    none = () if kernel.sizes.ng else ("equality", "equality_jacobian")  # not called where there are no rows
    return {name: 0.0 if name in none else time(name) for name in names}


def profile(problem: Problem, repeat: int = 100) -> dict[str, Any]:
    """Operations, time and rate of the parts of one iteration; what is left over is called "rest"."""
    solver, program = problem.solver, Program(problem.solver)
    assert solver.kernel is not None
    solver.warm_start(problem.x0, problem.u0)
    solution = solver.solve(problem.x0)
    single = single_iteration(solver, solution.x, solution.u)
    whole = float(milliseconds(lambda: single.iterate(problem.x0), repeat).min())
    stage = _stage_times(problem, solution.x, solution.u, program, repeat)
    packed = pack(solver.kernel, linearize(program, solution.x, solution.u, problem.x0), solver.problem.softness)
    slopes = 4 if program.stages.rk4 else 2
    short = {n: packed._replace(sizes=np.array([n, *packed.sizes[1:]], dtype=np.int64)) for n in (0, program.n)}
    times = {
        "chain rule": (slopes - 1) * _chain_time(problem, -(-program.n // LANES), repeat),
        "dynamics with Jacobian": slopes * stage["dynamics_jacobian"],
        "cost with Hessian": stage["cost_quadratic"],
        "equalities with Jacobian": stage["equality_jacobian"],
        "Riccati": _net(lambda count: eliminate(short[count]), program.n, repeat),
        "step": _net(lambda count: substitute(short[count]), program.n, repeat),
        "trial: dynamics": slopes * stage["dynamics"],
        "trial: cost": stage["cost"],
        "trial: equalities": stage["equality"],
    }
    counts = iteration_operations(program, solver.kernel.sizes)
    total, peak = sum(counts.values()), peak_gflops()
    parts = {n: {"operations": c, "ms": times[n]} for n, c in counts.items()}
    rest = whole - sum(times.values())
    return {
        "problem": problem.name,
        "parts": {**parts, "rest: limits, copies": {"operations": 0, "ms": rest}},
        "operations": total,
        "iteration_ms": whole,
        "peak_gflops": peak,
        "floor_ms": total / peak / 1e6,
        "ratio": whole / (total / peak / 1e6),
    }
