"""HPIPM (acados' build where it is found, else that of CasADi's wheel) and OSQP on the quadratic problem of one step, against our
Riccati kernel."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse

from wbmpc.benchmark.peers import within
from wbmpc.benchmark.problems import Problem
from wbmpc.benchmark.program import Program
from wbmpc.benchmark.race import milliseconds
from whole_race.acados_peer import Acados, AcadosProblem, NoAcados, Settings, build_description
from whole_race.acados_race import search
from whole_race.lq import LQProblem, Packed, eliminate, linearize, our_step, pack, substitute

#: A step is right when it differs from ours by no more than this.
RIGHT = 1e-6
#: HPIPM's tests of its interior point say little where there are no inequalities, so it is stopped after as few iterations as
#: make the step right. OSQP's first-order method gets the polish of its solution.
ITERATIONS = (1, 2, 3, 4, 6, 8, 12, 20, 30)
_HPIPM = {"mode": "speed", "res_g_max": 1e-8, "res_b_max": 1e-8}
_OSQP = {"verbose": False, "eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 20000, "polish": True}
PEERS = ("hpipm", "osqp")


def matrices(lq: LQProblem) -> tuple[sparse.csc_matrix, np.ndarray, sparse.csc_matrix, np.ndarray]:
    """H, g, A, c of minimize ½ zᵀ H z + gᵀ z, A z = c; z = (u_0, x_1, u_1, …, x_N), rows [gap; equality] per stage.

    The start is known, so it is no unknown: HPIPM would take it as a constraint for its interior point. The gap is
    A δx + B δu − δx⁺ = −b, the sign that CasADi's interface to HPIPM asks for.
    """
    n, nx, nz = lq.ab.shape
    ng = lq.cd.shape[1]
    h = sparse.block_diag([*lq.h, lq.h_end], format="csc")
    a = sparse.lil_matrix((n * (nx + ng), n * nz + nx))
    right = np.zeros(a.shape[0])
    for k in range(n):
        z, row = slice(k * nz, (k + 1) * nz), k * (nx + ng)
        a[row : row + nx, z] = lq.ab[k]
        a[row : row + nx, (k + 1) * nz : (k + 1) * nz + nx] = -np.eye(nx)
        right[row : row + nx] = -lq.b[k]
        a[row + nx : row + nx + ng, z] = lq.cd[k]
        right[row + nx : row + nx + ng] = -lq.e[k]
    a, g = a.tocsc(), np.concatenate([lq.g.ravel(), lq.g_end])
    return h[nx:, nx:], g[nx:] + h[nx:, :nx] @ lq.dx0, a[:, nx:], right - a[:, :nx] @ lq.dx0


def _matrix(m: sparse.csc_matrix) -> ca.DM:
    m = m.sorted_indices()
    pattern = ca.Sparsity(int(m.shape[0]), int(m.shape[1]), m.indptr.tolist(), m.indices.tolist())
    return ca.DM(pattern, m.data)


def _options(name: str, lq: LQProblem, iterations: int) -> dict[str, Any]:
    quiet: dict[str, Any] = {"print_time": False, "error_on_fail": False}
    if name == "osqp":
        return {**quiet, "osqp": _OSQP}
    n, nx, nz = lq.ab.shape
    # CasADi detects nothing when the rows are dependent, so all is given
    sizes = {"N": n, "nx": [0] + [nx] * n, "nu": [nz - nx] * n + [0], "ng": [lq.cd.shape[1]] * n + [0]}
    return {**quiet, **sizes, "hpipm": {**_HPIPM, "iter_max": iterations}}


def _solve(name: str, lq: LQProblem, ours: np.ndarray, repeat: int) -> dict[str, Any]:
    h, g, a, right = matrices(lq)
    big, rows = _matrix(h), _matrix(a)
    figures: dict[str, Any] = {}
    for iterations in ITERATIONS if name == "hpipm" else (None,):
        solver = ca.conic(
            "step", name, {"h": big.sparsity(), "a": rows.sparsity()}, _options(name, lq, iterations or 0)
        )
        call = lambda solver=solver: solver(h=big, g=g, a=rows, lba=right, uba=right)
        difference = float(np.abs(np.concatenate([lq.dx0, np.array(call()["x"]).ravel()]) - ours).max())
        figures = {"success": difference <= RIGHT, "iterations": iterations, "difference": difference}
        if figures["success"]:
            break
    own, times = [], np.empty(repeat)
    for i in range(repeat):
        start = time.process_time()
        call()
        times[i] = 1e3 * (time.process_time() - start)
        own.append(1e3 * float(solver.stats().get("t_proc_solver", 0.0)))
    inside = min((t for t in own if t > 0.0), default=None)
    return {**figures, "call_ms": float(times.min()), "step_ms": float(times.min()) if inside is None else inside}


def _with_acados(problem: Problem, ours: np.ndarray, repeat: int) -> dict[str, Any]:
    """HPIPM of acados' build with acados' condensing, the fastest right settings; its own clock, without linearization."""
    shared, x0, u0 = AcadosProblem(Program(problem.solver)), problem.x0, problem.u0
    n = shared.program.n
    x, u = np.tile(x0, (n + 1, 1)), np.tile(u0, (n, 1))
    flat = lambda x, u: np.concatenate([np.hstack([x[:-1], u]).ravel(), x[-1]])

    def figures(settings: Settings, repeat: int) -> dict[str, Any]:
        solver, times = Acados(shared, settings, real_time=True), []
        for _ in range(repeat):
            solver.reset()
            solver.warm_start(x, u)
            solver.solve(x0)
            times.append(1e3 * solver.number("time_qp_sol"))
        difference = float(np.abs(flat(*solver.trajectory()) - flat(x, u) - ours).max())
        row = {"success": difference <= RIGHT, "difference": difference, "step_ms": min(times)}
        return {**row, "iterations": solver.count("qp_iter"), "settings": str(settings)}

    def score(settings: Settings) -> float:
        row = figures(settings, 5)
        return float(row["step_ms"]) if row["success"] else np.inf

    settings, _ = search(score, n, ("blocks", "mode", "mu0", "tolerance"))
    return {**figures(settings, repeat), "build": f"acados {build_description()['commit']}"}


def step_problem(problem: Problem) -> tuple[LQProblem, Packed]:
    """The quadratic problem of the first iteration from the common guess, packed for the kernel.

    There the equality rows agree with each other even where they depend on each other.
    """
    solver, program = problem.solver, Program(problem.solver)
    assert solver.kernel is not None
    x, u = np.tile(problem.x0, (program.n + 1, 1)), np.tile(problem.u0, (program.n, 1))
    lq = linearize(program, x, u, problem.x0)
    return lq, pack(solver.kernel, lq, solver.problem.softness)


def _hpipm(problem: Problem, lq: LQProblem, ours: np.ndarray, repeat: int) -> dict[str, Any]:
    try:
        return _with_acados(problem, ours, repeat)
    except NoAcados:
        return {**_solve("hpipm", lq, ours, repeat), "build": "CasADi's wheel"}


def quadratic_race(
    problem: Problem, repeat: int = 20, seconds: float = 300.0, peers: Sequence[str] = PEERS
) -> list[dict[str, Any]]:
    """Rows with milliseconds of one step, without linearization, and the largest difference from our step.

    ``step_ms`` is the solver's own time where CasADi measures it, else that of the whole call.
    """
    lq, packed = step_problem(problem)
    z = our_step(packed)

    def step() -> None:
        eliminate(packed)
        substitute(packed)

    times = milliseconds(step, 10 * repeat)
    common = {"problem": problem.name}
    rows = [{**common, "solver": "wbmpc Riccati", "success": True, "step_ms": float(times.min()), "difference": 0.0}]
    for name in peers:
        arguments = (_hpipm, problem, lq, z, repeat) if name == "hpipm" else (_solve, name, lq, z, repeat)
        found = within(seconds, *arguments)
        rows.append(
            {**common, "solver": name, **({"success": False, "error": found} if isinstance(found, str) else found)}
        )
    return rows
