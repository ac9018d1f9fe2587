"""`wbmpc bench`: the solver against IPOPT and Fatrop on the same discretised problems, in one run.

IPOPT and Fatrop come in CasADi's wheel and run through ``nlpsol`` with exact Hessians in CasADi's interpreter: that is
what a user of the wheel gets, not what those solvers could do with compiled functions.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from queue import Empty
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.experiments.paths import SinePath
from wbmpc.experiments.rezero_problem import RezeroCost, rezero_problem
from wbmpc.experiments.settings import MpcSettings
from wbmpc.experiments.swerve_problem import SwerveCost, swerve_problem
from wbmpc.model import load_robot
from wbmpc.ocp import Mode, ModeSchedule, Reference, RelaxedBarrier
from wbmpc.ocp.transcription import BoxRow
from wbmpc.report import versions
from wbmpc.solver import SQP, Solver

#: A peer that has not answered after this time [s] is stopped and reported so.
PEER_SECONDS = 40.0


@dataclass(frozen=True)
class Problem:
    """A solver with its references set, its start, and the guess that every solver gets."""

    name: str
    solver: Solver
    x0: np.ndarray
    u0: np.ndarray


def swerve_bench(intervals: int = 100, settings: SQP | None = None, brakes: str = "closed") -> Problem:
    """Swerve base with arm on the way along a gentle sine: nx 21, nu 21, 10 s.

    With closed brakes the twelve rows of rolling and brakes depend on each other; with open ones eight rows remain.
    """
    robot = load_robot("swerve-ur10")
    ocp = swerve_problem(robot, MpcSettings(intervals=intervals, first_interval=0.0), SwerveCost())
    if brakes == "open":
        del ocp.terms["brakes"]
    solver = Solver(ocp, settings or SQP(iterations=300))
    if brakes == "open":
        solver.set_schedule(ModeSchedule((Mode("open", {"brake": [1.0] * 4}),)))
    path = SinePath(0.15, 2.66, 1, 0.255, start=0.5, ramp=2.0)
    t = np.arange(0.0, 12.0, 0.05)
    along, across = path.point(t)
    position, orientation = robot.pose(robot.home)
    hand = position + np.stack([along, across, 0.0 * along], axis=1)
    solver.set_reference("hand", Reference.poses(t, hand, orientation))
    states, inputs = np.tile(robot.home, (t.size, 1)), np.zeros((t.size, robot.input.size))
    arc, rate = path.arc(t)
    states[:, 0], inputs[:, 0] = arc * path.length / path.arc_length, rate * path.length / path.arc_length
    solver.set_reference("state", Reference(t, states))
    solver.set_reference("input", Reference(t, inputs))
    return Problem(
        f"swerve base with arm, brakes {brakes}, N = {intervals}", solver, robot.home, np.zeros(robot.input.size)
    )


def rezero_bench(intervals: int = 65, settings: SQP | None = None, step: float = 0.1) -> Problem:
    """Ball robot with arm and a hand force as an input, a step of the hand: nx 16, nu 9, 1.3 s."""
    robot = load_robot("rezero", contact="force")
    horizon = 0.02 * intervals if intervals > 40 else 1.3
    mpc = MpcSettings(horizon=horizon, intervals=intervals, first_interval=0.0, barrier_mu=1e-2)
    solver = Solver(rezero_problem(robot, mpc, RezeroCost()), settings or SQP(iterations=300))
    home, torque = robot.equilibrium(robot.home[robot.state["arm"]])
    u0 = np.concatenate([torque, np.zeros(3)])
    position, orientation = robot.pose(home)
    solver.set_reference("hand", Reference.poses([0.0], [position + [step, 0.0, 0.0]], orientation))
    solver.set_reference("body", Reference.constant(home))
    solver.set_reference("twist", Reference.constant(np.zeros(6)))
    solver.set_reference("torque", Reference.constant(u0))
    return Problem(f"ball robot with arm, N = {intervals}", solver, home, u0)


# ---------------------------------------------------------------------- the same problem for other solvers
def _barrier(rows: list[BoxRow], z: ca.SX) -> ca.SX:
    terms = [RelaxedBarrier(mu, delta).value(sign * z[i] + offset) for i, sign, offset, mu, delta in rows]
    return sum(terms, ca.SX(0))


def _step(f: ca.Function, x: ca.SX, u: ca.SX, p: np.ndarray, w: np.ndarray, h: float, rk4: bool) -> ca.SX:
    k1 = f(x, u, p, w)
    k2 = f(x + h / 2 * k1, u, p, w)
    if not rk4:
        return x + h * k2
    k3 = f(x + h / 2 * k2, u, p, w)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3, u, p, w))


def nonlinear_program(solver: Solver, x0: np.ndarray) -> tuple[dict[str, ca.SX], list[int]]:
    """The discretised problem as CasADi's ``nlpsol`` takes it, stage by stage (x_k, u_k), and the rows of each stage.

    The parameters are sampled for a horizon that starts at time 0.
    """
    from wbmpc.solver.receding import sample

    t, ws = solver.problem, solver.ws
    n, width = t.ocp.intervals, ws.p.shape[1]
    flat = np.zeros((n + 1) * width)
    for k in range(n + 1):
        sample(*solver.tables(), float(ws.grid[k]), flat, k * width)
    p, w, h = flat.reshape(n + 1, width)[:, : t.node.size], ws.w[: t.constant.size], np.diff(ws.grid)
    x = [ca.SX.sym(f"x{k}", t.nx) for k in range(n + 1)]
    u = [ca.SX.sym(f"u{k}", t.nu) for k in range(n)]
    cost, rows, variables = ca.SX(0), [], []
    values = t.values
    for k in range(n):
        end = _step(values["dynamics"], x[k], u[k], p[k], w, float(h[k]), t.ocp.integrator == "rk4")
        start = [x[0] - x0] if k == 0 else []
        rows.append([x[k + 1] - end, *start, values["equality"](x[k], u[k], p[k], w)])
        cost += h[k] * (values["cost"](x[k], u[k], p[k], w) + _barrier(t.path_boxes, ca.vertcat(x[k], u[k])))
        variables += [x[k], u[k]]
    cost += values["terminal"](x[n], p[n], w) + _barrier(t.terminal_boxes, x[n])
    g = [ca.vertcat(*r) for r in rows]
    program = {"x": ca.vertcat(*variables, x[n]), "f": cost, "g": ca.vertcat(*g)}
    return program, [r.shape[0] for r in g]


def solve_with(
    name: str, program: dict[str, ca.SX], shape: tuple[int, int, int], x: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Solve by IPOPT or Fatrop from a guess x (N + 1, nx), u (N, nu): states, inputs, figures. ``shape``: N, nx, nu."""
    n, nx, nu = shape
    options: dict[str, Any] = {"print_time": False}
    if name == "fatrop":
        options |= {"structure_detection": "auto", "equality": [True] * program["g"].shape[0]}
        options |= {"fatrop.print_level": 0, "fatrop.tolerance": 1e-8, "fatrop.max_iter": 300}
    else:
        options |= {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-8, "ipopt.max_iter": 300}
    solver = ca.nlpsol("peer", name, program, options)
    guess = np.concatenate([np.hstack([x[:-1], u]).ravel(), x[-1]])
    start = time.perf_counter()
    found = np.array(solver(x0=guess, lbg=0.0, ubg=0.0)["x"]).ravel()
    elapsed = time.perf_counter() - start
    stats = solver.stats()
    steps = max(int(stats["iter_count"]), 1)
    table = found[: n * (nx + nu)].reshape(n, nx + nu)
    states = np.vstack([table[:, :nx], found[-nx:]])
    figures = {
        "success": bool(stats["success"]),
        "iterations": steps,
        "total_ms": 1e3 * elapsed,
        "iteration_ms": 1e3 * elapsed / steps,
    }
    return states, table[:, nx:], figures


def _child(queue: Any, arguments: tuple[Any, ...]) -> None:
    try:
        queue.put(solve_with(*arguments))
    except Exception as error:  # the parent reports it
        queue.put(str(error).splitlines()[0][:200])


def solve_within(seconds: float, *arguments: Any) -> tuple[np.ndarray, np.ndarray, dict[str, Any]] | str:
    """:func:`solve_with` in a child process; a sentence when it fails or takes too long."""
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_child, args=(queue, arguments), daemon=True)
    child.start()
    try:
        return queue.get(timeout=seconds)  # type: ignore[no-any-return]
    except Empty:
        return f"no answer in {seconds:.0f} s"
    finally:
        child.kill()
        child.join()


# ---------------------------------------------------------------------- the run
def _ours(problem: Problem, repeat: int) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    solver = problem.solver
    solver.guess(problem.x0, problem.u0)
    solver.solve(problem.x0)
    solver.guess(problem.x0, problem.u0)
    solution = solver.solve(problem.x0)
    single = Solver(solver.ocp, SQP(iterations=1, certify=False, force_step=True))
    for name, reference in solver.references.items():
        single.set_reference(name, reference)
    single.guess(solution.x, solution.u)
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        single.run(problem.x0)
        times.append(1e3 * (time.perf_counter() - start))
    return solution.x, solution.u, {
        "success": solution.status.name == "CONVERGED",
        "iterations": solution.iterations,
        "total_ms": 1e3 * solution.solve_time,
        "iteration_ms": float(np.median(times)),
        "iteration_ms_min": float(np.min(times)),
        "kkt": solution.kkt,
        "violation": solution.violation,
    }  # fmt: skip


def _peer(
    name: str, program: dict[str, ca.SX], shape: tuple[int, int, int], problem: Problem, x: np.ndarray, u: np.ndarray
) -> dict[str, Any]:
    """Figures from the common guess; and from our solution with 1e-3 of noise, for the difference of the solutions."""
    n = shape[0]
    common = solve_within(
        PEER_SECONDS, name, program, shape, np.tile(problem.x0, (n + 1, 1)), np.tile(problem.u0, (n, 1))
    )
    figures: dict[str, Any] = {"success": False, "error": common} if isinstance(common, str) else dict(common[2])
    rng = np.random.default_rng(0)
    near_x, near_u = x + 1e-3 * rng.normal(size=x.shape), u + 1e-3 * rng.normal(size=u.shape)
    near = solve_within(PEER_SECONDS, name, program, shape, near_x, near_u)
    if isinstance(near, str) or not near[2]["success"]:
        return {**figures, "difference": None}
    figures.setdefault("iteration_ms", near[2]["iteration_ms"])
    difference = max(float(np.abs(near[0] - x).max()), float(np.abs(near[1] - u).max()))
    return {**figures, "from_nearby": near[2], "difference": difference}


def run_benchmark(repeat: int = 200, progress: Callable[[float, str], None] | None = None) -> dict[str, Any]:
    """All problems by all solvers: rows with milliseconds per iteration, to convergence, and the largest difference."""
    rows: list[dict[str, Any]] = []
    makers: tuple[Any, ...] = (swerve_bench, partial(swerve_bench, brakes="open"), rezero_bench)
    for k, make in enumerate(makers):
        problem = make()
        t = problem.solver.problem
        shape = (t.ocp.intervals, t.nx, t.nu)
        if progress is not None:
            progress(k / len(makers), problem.name)
        x, u, figures = _ours(problem, repeat)
        common = {"problem": problem.name, "nx": t.nx, "nu": t.nu, "rows": t.equality.shape[0], "intervals": shape[0]}
        rows.append({**common, "solver": "wbmpc SQP", **figures, "difference": 0.0})
        program, _ = nonlinear_program(problem.solver, problem.x0)
        for peer in ("ipopt", "fatrop"):
            if progress is not None:
                progress((k + 0.4) / len(makers), f"{problem.name}: {peer}")
            rows.append({**common, "solver": peer, **_peer(peer, program, shape, problem, x, u)})
    return {"rows": rows, "reference_kernel_gflops": matrix_product_speed(), "versions": versions()}


def matrix_product_speed() -> float:
    """GFLOP/s of one core on products of 512 x 512 matrices (NumPy's BLAS): a yardstick of the machine."""
    a = np.random.default_rng(0).normal(size=(512, 512))
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        a @ a
        best = min(best, time.perf_counter() - start)
    return float(2 * 512**3 / best / 1e9)


def print_table(figures: dict[str, Any]) -> None:
    """The figures as a table."""
    from rich.console import Console
    from rich.table import Table

    console = Console(width=max(Console().width, 118))
    table = Table(title="Same discretised problem, one thread")
    left = ("problem", "solver")
    for column in (*left, "ms / iteration", "iterations", "ms to convergence", "largest difference"):
        table.add_column(column, justify="left" if column in left else "right")
    last = ""
    for row in figures["rows"]:
        title = row["problem"] if row["problem"] != last else ""
        last = row["problem"]
        step = f"{row['iteration_ms']:.3f}" if "iteration_ms" in row else "-"
        ending = f"{row['total_ms']:.1f}" if row["success"] else row.get("error", "not converged")
        difference = "-" if row["difference"] is None else f"{row['difference']:.1e}"
        table.add_row(title, row["solver"], step, str(row.get("iterations", "-")), ending, difference)
    console.print(table)
    console.print(
        "wbmpc: median of warm single iterations, trial point included. IPOPT and Fatrop: through CasADi's interpreter, exact "
        "Hessians, from the same constant guess; the difference is to their solution from a guess 1e-3 beside ours."
    )
    console.print(
        f"{figures['versions']['cpu']}; {figures['reference_kernel_gflops']:.0f} GFLOP/s on 512 x 512 products"
    )
