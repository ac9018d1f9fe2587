"""Figures of this library's solver on a problem."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from wbmpc.benchmark.problems import Problem
from wbmpc.solver import SQP, InteriorPoint, Solver

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
        few._run(problem.x0)

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
        solver._run(problem.x0)
        total = min(total, time.process_time() - start)
    solver.warm_start(problem.x0, problem.u0)
    solver.reset()
    solution = solver.solve(problem.x0)
    single = single_iteration(solver, solution.x, solution.u)
    times = milliseconds(lambda: single._run(problem.x0), repeat)
    return solution.x, solution.u, {
        "success": solution.status.name == "CONVERGED",
        "iterations": solution.iterations,
        "total_ms": 1e3 * total,
        "iteration_ms": float(np.min(times)),
        "iteration_ms_median": float(np.median(times)),
        "kkt": solution.kkt,
        "violation": solution.violation,
    }  # fmt: skip
