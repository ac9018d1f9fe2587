"""What hard rows that touch some of the states add to an iteration: time beside the same problem without them.

Usage: python benchmarks/sparse_rows.py [--rows 10 30 100] [--touched 10] [--intervals 100]

21 states, 21 inputs; each row is a distance of the first states, as rows of obstacles are. Processor times, the quickest of many.
"""

from __future__ import annotations

import argparse
import time

import casadi as ca
import numpy as np

from wbmpc.model.ode import Ode
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, residuals, sets
from wbmpc.solver import SQP, InteriorPoint, Solver

Rows = residuals.Expression
STATES, INPUTS, SOLVES = 21, 21, 200


def problem(rows: int, touched: int, intervals: int) -> OptimalControlProblem:
    """Coupled first-order drives with costs, and ``rows`` curved rows of the first ``touched`` states at every node."""
    r = np.random.default_rng(0)
    drive, slopes = np.eye(STATES, INPUTS) + 0.2 * r.normal(size=(STATES, INPUTS)), r.normal(size=(rows, touched))
    names = {"x": [str(i) for i in range(STATES)]}, {"u": [str(i) for i in range(INPUTS)]}
    ocp = OptimalControlProblem(Ode(*names, lambda x, u: ca.DM(drive) @ u - 0.1 * ca.sin(x)), 2.0, intervals)
    ocp.add(Cost("state", Rows(STATES, lambda s: s.x - 0.5), 10.0, at="path+terminal"))
    ocp.add(Cost("input", Rows(INPUTS, lambda s: s.u), 0.1))
    if rows:
        away = Rows(rows, lambda s: 3.0 + ca.DM(slopes) @ s.x[:touched] + 0.1 * s.x[0] ** 2)
        ocp.add(Constraint("clearance", away, sets.NonNegative(), hard=True, slack=1e4))
    return ocp


def iteration(ocp: OptimalControlProblem) -> float:
    """The quickest real-time iteration [s]."""
    settings = SQP.real_time(interior_point=InteriorPoint("real_time", max_extra_iterations=0))
    solver, start = Solver(ocp, settings, use_cache=False), np.full(STATES, 0.1)
    solver.warm_start(start)
    times = []
    for _ in range(SOLVES):
        before = time.process_time()
        solver.iterate(start)
        times.append(time.process_time() - before)
    return min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, nargs="*", default=[10, 30, 100])
    parser.add_argument("--touched", type=int, default=10, help="states that each row touches")
    parser.add_argument("--intervals", type=int, default=100)
    given = parser.parse_args()
    without = iteration(problem(0, given.touched, given.intervals))
    print(f"no rows: {1e3 * without:.3f} ms")
    for rows in given.rows:
        found = iteration(problem(rows, given.touched, given.intervals))
        print(f"{rows:4d} rows: {1e3 * found:.3f} ms, {found / without:.2f} of that", flush=True)


if __name__ == "__main__":
    main()
