"""What hard limits cost: one iteration with them and without any limits, on the problems of ``wbmpc bench``."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from wbmpc.benchmark.problems import Problem, race_problems
from wbmpc.solver import SQP, InteriorPoint, Solver


def _milliseconds(solver: Solver, x0: np.ndarray) -> float:
    """Least of eight medians of an iteration's time, each of 25."""
    solver.solve(x0)
    medians = []
    for _ in range(8):
        times = []
        for _ in range(25):
            start = time.process_time()
            solver._run(x0)
            times.append(time.process_time() - start)
        medians.append(float(np.median(times)))
    return 1e3 * min(medians)


def _without_limits(problem: Problem, settings: SQP) -> Solver:
    """The same problem and references with its inequalities taken out."""
    solver_of_problem = problem.solver
    for term in solver_of_problem.ocp.inequalities:
        del solver_of_problem.ocp.terms[term.name]
    solver = Solver(solver_of_problem.ocp, settings)
    solver.references, solver.schedule = solver_of_problem.references, solver_of_problem.schedule
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
