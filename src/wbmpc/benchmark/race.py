"""The whole race in one run on one core: who, on what, and how far from the goals."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from wbmpc.benchmark.peers import PEERS, Measure, peer, prepare, to_equal_residual
from wbmpc.benchmark.problems import Problem, race_problems, suite_bench
from wbmpc.benchmark.program import compiler
from wbmpc.kernel import dense
from wbmpc.kernel.codegen_target import compile_module, load_object, vector_budget
from wbmpc.kernel.ir import Floats, PointerCall
from wbmpc.kernel.library import Library
from wbmpc.kernel.products import matrix_product
from wbmpc.report import versions
from wbmpc.solver import SQP, InteriorPoint, Solver
from wbmpc.solver.workspace import aligned

#: Real time, but never a second iteration in one call.
ONE_ITERATION = SQP.real_time(interior_point=InteriorPoint("real_time", max_extra_iterations=0))


def milliseconds(call: Callable[[], Any], repeat: int) -> np.ndarray:
    """Processor time (repeat,) [ms] of calls after one that does not count: others may use the machine."""
    call()
    times = np.empty(repeat)
    for i in range(repeat):
        start = time.process_time()
        call()
        times[i] = 1e3 * (time.process_time() - start)
    return times


def single_iteration(solver: Solver, x: np.ndarray, u: np.ndarray, settings: SQP | None = None) -> Solver:
    """A solver of the same problem with one iteration and one trial point per call, at the trajectory (x, u)."""
    one_trial = replace(ONE_ITERATION, min_step=0.9)
    single = Solver(solver.ocp, settings or one_trial)
    for name, reference in solver.references.items():
        single.set_reference(name, reference)
    single.set_schedule(solver.schedule)
    single.warm_start(x, u)
    return single


def several_iterations(problem: Problem, iterations: int, repeat: int = 5) -> tuple[float, np.ndarray, np.ndarray]:
    """Least processor time [ms] of ``repeat`` solves of at most so many iterations from the common guess, and where they end."""
    solver = problem.solver
    start = solver.trajectory(copy=False)
    few = single_iteration(solver, start.x, start.u, replace(solver.settings, iterations=iterations))

    def solve() -> None:
        few.warm_start(problem.x0, problem.u0)
        few.reset()
        few.iterate(problem.x0)

    times = milliseconds(solve, repeat)
    found = few.trajectory()
    return float(times.min()), found.x, found.u


def ours(problem: Problem, repeat: int) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Solution (x, u) from the common guess and figures: least time of an iteration (warm, trial point included) and of
    five solves to convergence, with the certificate's residuals."""
    solver, total = problem.solver, np.inf
    for _ in range(6):  # the first does not count
        solver.warm_start(problem.x0, problem.u0)
        solver.reset()
        start = time.process_time()
        solver.iterate(problem.x0)
        total = min(total, time.process_time() - start)
    solver.warm_start(problem.x0, problem.u0)
    solver.reset()
    solution = solver.solve(problem.x0)
    single = single_iteration(solver, solution.x, solution.u)
    times = milliseconds(lambda: single.iterate(problem.x0), repeat)
    return solution.x, solution.u, {
        "success": solution.status.name == "CONVERGED",
        "iterations": solution.iterations,
        "total_ms": 1e3 * total,
        "iteration_ms": float(np.min(times)),
        "iteration_ms_median": float(np.median(times)),
        "kkt": solution.kkt,
        "violation": solution.violation,
    }  # fmt: skip


def size_race(repeat: int, note: Callable[[str], None]) -> list[dict[str, Any]]:
    rows = []
    for name, (make, published, goal) in race_problems().sizes.items():
        note(name)
        problem = suite_bench(make())
        t, figures = problem.solver.problem, ours(problem, repeat)[2]
        best = figures["iteration_ms"]
        rows.append(
            {
                "problem": problem.name, "nx": t.nx, "nu": t.nu, "intervals": t.ocp.intervals,
                "rows": t.equality.shape[0], "success": figures["success"], "iteration_ms": best, "ocs2_ms": published,
                "ratio": published / best, "goal": goal,
            }
        )  # fmt: skip
    return rows


LIBRARY = Library("machine speed")
call4 = PointerCall(4)


compiled = LIBRARY.compiled


@compiled
def repeat_product(address: int, a: Floats, b: Floats, c: Floats, count: int) -> None:
    """One matrix product many times."""
    for _ in range(count):
        call4(address, a.ctypes.data, b.ctypes.data, c.ctypes.data, c.ctypes.data)


@cache
def peak_gflops() -> float:
    """GFLOP/s of one core on products (24 × 48)(48 × 48) in the first-level cache, by our own kernel."""
    ir = dense.FMA + "\n" + matrix_product("peak", 3, 48, 48, 24, 48, 1, 24, None, False, vector_budget())
    engine = load_object(compile_module(ir))
    a, b, c = aligned(24 * 48), aligned(48 * 48), aligned(24 * 48)
    a[:], b[:], count = 1.0, 1.0, 1000
    address = engine.get_function_address("peak")
    times = milliseconds(lambda: repeat_product(address, a, b, c, count), 20)
    return float(2 * 24 * 48 * 48 * count / times.min() / 1e6)


def matrix_product_speed() -> float:
    """GFLOP/s of one core on products of 512 x 512 matrices by NumPy's BLAS."""
    a = np.random.default_rng(0).normal(size=(512, 512))
    return float(2 * 512**3 / milliseconds(lambda: a @ a, 5).min() / 1e6)


def _milliseconds(solver: Solver, x0: np.ndarray) -> float:
    """Least of eight medians of an iteration's time, each of 25."""
    solver.solve(x0)
    medians = []
    for _ in range(8):
        times = []
        for _ in range(25):
            start = time.process_time()
            solver.iterate(x0)
            times.append(time.process_time() - start)
        medians.append(float(np.median(times)))
    return 1e3 * min(medians)


def _without_limits(problem: Problem, settings: SQP) -> Solver:
    """The same problem and references with its inequalities taken out."""
    solver_of_problem = problem.solver
    for term in solver_of_problem.ocp.inequalities:
        del solver_of_problem.ocp.terms[term.name]
    solver = Solver(solver_of_problem.ocp, settings)
    solver.data.references, solver.data.schedule = solver_of_problem.data.references, solver_of_problem.schedule
    start = solver_of_problem.trajectory(copy=False)
    solver.warm_start(start.x, start.u)
    return solver


def iteration_times() -> dict[str, dict[str, float]]:
    """Of each robot: an iteration [ms] with hard limits, without limits, and the ratio."""
    settings = SQP.real_time(interior_point=InteriorPoint("real_time", max_extra_iterations=0))
    settings = replace(settings, min_step=0.9)  # one trial point in both
    out = {}
    for name, make in race_problems().limited.items():
        problem = make(settings)
        hard = _milliseconds(problem.solver, problem.x0)
        free = _milliseconds(_without_limits(make(settings), settings), problem.x0)
        out[name] = {"hard_ms": hard, "unlimited_ms": free, "ratio": hard / free}
    return out


#: Least factor by which we want to be faster to the common residual than the fastest full solver, and in a step than the
#: fastest QP solver; most that hard limits may cost; most against C.
FULL, QUADRATIC, HARD, C = 5.0, 2.0, 1.3, 1.2
Progress = Callable[[float, str], None]


@contextmanager
def one_core() -> Iterator[int | None]:
    """Run on one processor core, children too, where the system allows it; yields its number."""
    try:
        previous = os.sched_getaffinity(0)
        core = max(previous)
        os.sched_setaffinity(0, {core})
    except (AttributeError, OSError):
        yield None
        return
    try:
        yield core
    finally:
        os.sched_setaffinity(0, previous)


def robot_race(problem: Problem, repeat: int, note: Callable[[str], None]) -> list[dict[str, Any]]:
    """One problem by all full solvers: milliseconds to the common residual and per iteration, largest difference from ours."""
    t = problem.solver.problem
    size = {
        "nx": t.nx, "nu": t.nu, "rows": t.equality.shape[0], "limits": len(t.path.rows), "intervals": t.ocp.intervals,
    }  # fmt: skip
    common = {"problem": problem.name, **size}
    x, u, figures = ours(problem, repeat)
    rows = [{**common, "solver": "wbmpc SQP", **figures, "difference": 0.0}]
    note(f"{problem.name}: compiling for the peers")
    prepared = prepare(problem)
    measure = Measure(prepared.program)
    attempt = lambda iterations: several_iterations(problem, iterations)
    rows[0]["residual"] = measure(x, u, problem.x0).figure
    maximum = problem.solver.settings.iterations  # a solve goes on with the exact Hessian, these iterations do not
    rows[0] |= to_equal_residual(attempt, maximum, lambda x, u: measure(x, u, problem.x0))
    for name in PEERS:
        note(f"{problem.name}: {name}")
        rows.append({**common, "solver": name, **peer(name, prepared, problem, x, u, measure)})
    return rows


def _fastest(rows: list[dict[str, Any]], key: str) -> dict[str, Any] | None:
    """The fastest peer: it has a time, and a right answer where that was checked."""
    peers = [r for r in rows if not r["solver"].startswith("wbmpc") and r.get(key)]
    return min(peers, key=lambda r: r[key], default=None)


def _against(rows: list[dict[str, Any]], key: str, goal: float) -> list[dict[str, Any]]:
    """How many times faster than the fastest peer, per problem, in the figure ``key``."""
    out = []
    for name in dict.fromkeys(r["problem"] for r in rows):
        group = [r for r in rows if r["problem"] == name]
        own, best = next(r for r in group if r["solver"].startswith("wbmpc")), _fastest(group, key)
        value = best[key] / own[key] if best and own.get(key) else None
        what = f"{name}: times faster than {best['solver'] if best else 'peers'}"
        out.append({"what": what, "value": value, "goal": goal, "met": None if value is None else value >= goal})
    return out


def goals(figures: dict[str, Any]) -> list[dict[str, Any]]:
    """The goal, what was measured, and whether that is enough (None: not measured)."""
    out = _against(figures["rows"], "equal_ms", FULL)
    out += _against(figures.get("quadratic", []), "step_ms", QUADRATIC)
    for r in figures["sizes"]:
        what = f"{r['problem']}: times faster than OCS2's constant"
        out.append({"what": what, "value": r["ratio"], "goal": r["goal"], "met": r["ratio"] >= r["goal"]})
    at_most = [(f"{n}: hard-limited over unlimited", v["ratio"], HARD) for n, v in figures["limits"].items()]
    at_most += [(f"{r['problem']}: over C", r.get("ratio"), C) for r in figures.get("yardstick", [])]
    for what, value, goal in at_most:
        out.append({"what": what, "value": value, "goal": goal, "met": None if value is None else value <= goal})
    return out


def run_benchmark(repeat: int = 200, progress: Progress | None = None) -> dict[str, Any]:
    """The solver against IPOPT and Fatrop on both robots, its time beside OCS2's on problems of the same sizes, and what hard
    limits cost: all figures as one object. ``repeat``: timed iterations per problem."""
    done = 0

    def note(text: str) -> None:
        if progress is not None:
            progress(done / 3, text)

    figures: dict[str, Any] = {"versions": versions(), "compiler": compiler()}
    with one_core() as core:
        figures["core"] = core
        figures["reference_kernel_gflops"], figures["peak_gflops"] = matrix_product_speed(), peak_gflops()
        figures["rows"] = []
        for make in race_problems().robots:
            for limits in ("soft", "hard"):
                figures["rows"] += robot_race(make(limits=limits), repeat, note)
        done = 1
        figures["sizes"] = size_race(repeat, note)
        done = 2
        note("hard limits")
        figures["limits"] = iteration_times()
    figures["goals"] = goals(figures)
    return figures
