"""HPIPM and OSQP of CasADi's wheel on the quadratic problem of one step, against our Riccati kernel."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse

from wbmpc.benchmark.child import within
from wbmpc.benchmark.lq import LQProblem, Packed, eliminate, linearise, our_step, pack, substitute
from wbmpc.benchmark.ours import milliseconds
from wbmpc.benchmark.problems import Problem
from wbmpc.benchmark.program import Program

#: OSQP's tolerance: its first-order method is not made for more.
OSQP_TOLERANCE = 1e-6
SOLVERS: dict[str, dict[str, Any]] = {
    "hpipm": {"hpipm": {"mode": "speed", "iter_max": 30, "res_g_max": 1e-6, "res_b_max": 1e-8}},
    "osqp": {"osqp": {"verbose": False, "eps_abs": OSQP_TOLERANCE, "eps_rel": OSQP_TOLERANCE, "max_iter": 20000}},
}


def matrices(lq: LQProblem) -> tuple[sparse.csc_matrix, np.ndarray, sparse.csc_matrix, np.ndarray]:
    """H, g, A, c of minimise ½ zᵀ H z + gᵀ z, A z = c; z = (x_0, u_0, …, x_N), rows [gap; start; equality] per stage.

    The gap is A δx + B δu − δx⁺ = −b, the sign that CasADi's interface to HPIPM asks for.
    """
    n, nx, nz = lq.ab.shape
    ng, size = lq.cd.shape[1], n * nz + nx
    h = sparse.block_diag([*lq.h, lq.h_end], format="csc")
    a = sparse.lil_matrix((n * (nx + ng) + nx, size))
    right, row = np.zeros(a.shape[0]), 0
    for k in range(n):
        z = slice(k * nz, (k + 1) * nz)
        a[row : row + nx, z] = lq.ab[k]
        a[row : row + nx, (k + 1) * nz : (k + 1) * nz + nx] = -np.eye(nx)
        right[row : row + nx] = -lq.b[k]
        row += nx
        if k == 0:
            a[row : row + nx, :nx] = np.eye(nx)
            right[row : row + nx] = lq.dx0
            row += nx
        if ng:
            a[row : row + ng, z] = lq.cd[k]
            right[row : row + ng] = -lq.e[k]
            row += ng
    return h, np.concatenate([lq.g.ravel(), lq.g_end]), a.tocsc(), right


def _matrix(m: sparse.csc_matrix) -> ca.DM:
    m = m.sorted_indices()
    pattern = ca.Sparsity(*m.shape, m.indptr.tolist(), m.indices.tolist())
    return ca.DM(pattern, m.data)


def _solve(name: str, lq: LQProblem, repeat: int) -> tuple[np.ndarray, dict[str, Any]]:
    h, g, a, right = matrices(lq)
    big, rows = _matrix(h), _matrix(a)
    options = {**SOLVERS[name], "print_time": False, "error_on_fail": False}
    if name == "hpipm":
        n, nx, nz = lq.ab.shape
        ng = lq.cd.shape[1]
        # the start is a constraint of node 0; CasADi detects nothing when the rows are dependent, so all is given
        options |= {"N": n, "nx": [nx] * (n + 1), "nu": [nz - nx] * n + [0], "ng": [nx + ng, *[ng] * (n - 1), 0]}
    solver = ca.conic("step", name, {"h": big.sparsity(), "a": rows.sparsity()}, options)
    call = lambda: solver(h=big, g=g, a=rows, lba=right, uba=right)
    times = milliseconds(call, repeat)
    z, stats = np.array(call()["x"]).ravel(), solver.stats()
    own = stats.get("t_wall_solver")
    return z, {
        "success": bool(stats["success"]),
        "iterations": max(int(stats.get("iter_count", 0)), 0) or None,
        "step_ms": float(times.min()),
        "solver_ms": None if own is None else 1e3 * float(own),
    }


def step_problem(problem: Problem, noise: float = 1e-2) -> tuple[LQProblem, Packed, int]:
    """The quadratic problem at the solution plus ``noise``, packed, and the Riccati kernel's address."""
    solver, program = problem.solver, Program(problem.solver)
    assert solver.kernel is not None
    solver.guess(problem.x0, problem.u0)
    solution, rng = solver.solve(problem.x0), np.random.default_rng(0)
    x = solution.x + noise * rng.normal(size=solution.x.shape)
    u = solution.u + noise * rng.normal(size=solution.u.shape)
    lq = linearise(program, x, u, problem.x0)
    return lq, pack(solver.kernel, lq, solver.problem.compliance), solver.kernel.address("riccati_node")


def quadratic_race(
    problem: Problem, repeat: int = 20, seconds: float = 20.0, names: tuple[str, ...] = tuple(SOLVERS)
) -> list[dict[str, Any]]:
    """Rows with milliseconds of one step, without linearisation, and the largest difference from our step."""
    lq, packed, address = step_problem(problem)
    z = our_step(packed, address)
    times = milliseconds(lambda: (eliminate(packed, address), substitute(packed)), 5 * repeat)
    common = {"problem": problem.name}
    rows = [{**common, "solver": "wbmpc Riccati", "success": True, "step_ms": float(times.min()), "difference": 0.0}]
    for name in names:
        found = within(seconds, _solve, name, lq, repeat)
        if isinstance(found, str):
            rows.append({**common, "solver": name, "success": False, "error": found})
        else:
            rows.append({**common, "solver": name, **found[1], "difference": float(np.abs(found[0] - z).max())})
    return rows
