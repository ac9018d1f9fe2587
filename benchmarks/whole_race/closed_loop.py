"""Cost of a closed loop when every solver has the same processor time per period.

The ball robot on its model (no noise; kicks of its speed from a seed), soft limits, one node of the horizon per period. A
solver does as many iterations as its time, measured before in the same loop, lets it; one that cannot finish a single
iteration gets it done over several periods, in which its last plan goes on. PolicyQueue are applied without feedback, by all.
The peers' time is that of their iterations alone, without what CasADi needs to set a solve up; ours is the whole call.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.benchmark.peers import TOLERANCE, Prepared, nlp_solver, prepare, within
from wbmpc.benchmark.problems import Problem
from wbmpc.benchmark.program import Program
from wbmpc.benchmark.race import ONE_ITERATION, single_iteration
from wbmpc.studies.race.robots import rezero_bench

BUDGETS_MS = (0.4, 1.0, 3.0, 10.0)
PERIODS, EVERY, KICK, MAXIMUM = 150, 25, 0.15, 20
SECONDS = 300.0
Plan = tuple[np.ndarray, np.ndarray]
#: (state, guess, iterations) to a plan.
Planner = Callable[[np.ndarray, Plan, int], Plan]


def shifted(plan: Plan) -> Plan:
    """The plan from its second node on; the last values hold."""
    x, u = plan
    return np.vstack([x[1:], x[-1:]]), np.vstack([u[1:], u[-1:]])


def our_planner(problem: Problem, counts: list[int]) -> Planner:
    """Real-time iterations of this library."""
    single = single_iteration(problem.solver, problem.x0, problem.u0, ONE_ITERATION)

    def plan(x0: np.ndarray, guess: Plan, iterations: int) -> Plan:
        single.warm_start(*guess)
        for _ in range(iterations):
            single.iterate(x0)
        counts.append(iterations)
        found = single.trajectory()
        return found.x, found.u

    return plan


def peer_planner(name: str, prepared: Prepared, counts: list[int]) -> Planner:
    """A solver of CasADi's wheel, stopped after some iterations."""
    program, solvers = prepared.program, {}
    above = np.where(program.equality(), 0.0, np.inf)

    def plan(x0: np.ndarray, guess: Plan, iterations: int) -> Plan:
        if iterations not in solvers:
            # Fatrop does none or at least two, one more than it is reported: it gets the second one for nothing
            maximum = max(iterations - 1, 1) if name == "fatrop" else iterations
            solvers[iterations] = nlp_solver(name, prepared, maximum, TOLERANCE)
        start = np.concatenate([np.hstack([guess[0][:-1], guess[1]]).ravel(), guess[0][-1]])
        found = solvers[iterations](x0=start, p=x0, lbg=0.0, ubg=above)
        counts.append(int(solvers[iterations].stats()["iter_count"]))
        return program.trajectory(np.array(found["x"]).ravel())

    return plan


def drive(
    problem: Problem,
    planner: Planner,
    iterations: int,
    late: int,
    seed: int,
    periods: int = PERIODS,
    kicked: slice = slice(0),
) -> float:
    """Cost per second of the closed loop; plans come into force ``late`` periods after the state they start from.

    ``kicked``: states that change by ±``KICK`` every ``EVERY`` periods.
    """
    program = Program(problem.solver)
    s, h, rng = program.samples, float(program.samples.h[0]), np.random.default_rng(seed)
    stage = program.stages.cost()
    x, total = np.array(problem.x0, float), 0.0
    current = (np.tile(problem.x0, (program.n + 1, 1)), np.tile(problem.u0, (program.n, 1)))
    pending, ready = current, 0
    for k in range(periods):
        if k and k % EVERY == 0:
            x[kicked] += KICK * rng.choice([-1.0, 1.0], x[kicked].size)
        if k >= ready:
            if k:
                current = pending
            pending, ready = planner(x, current, iterations), k + max(late, 1)
            if late:
                for _ in range(late):
                    pending = shifted(pending)
            else:
                current = pending
        u = current[1][0]
        total += float(ca.DM(stage(x, u, s.p[0], s.w, h)))
        x = problem.solver.simulate(x, u, h)
        current = shifted(current)
        if late == 0:
            pending = current
        if not np.isfinite(x).all() or np.abs(x).max() > 1e3:
            return math.inf
    return total / (periods * h)


def pace(problem: Problem, planner: Planner, counts: list[int]) -> tuple[float, float]:
    """Milliseconds of a plan of one iteration (median over a closed loop) and of every further one (mean).

    ``counts``: where the planner writes how many iterations a plan took: a warm solve may end before it is stopped.
    """
    spent: list[np.ndarray] = []
    steps: list[int] = []
    for iterations in (1, 3, 5):
        times: list[float] = []

        def timed(x0: np.ndarray, guess: Plan, count: int, times: list[float] = times) -> Plan:
            start = time.process_time()
            plan = planner(x0, guess, count)
            times.append(1e3 * (time.process_time() - start))
            return plan

        counts.clear()
        drive(problem, timed, iterations, 0, 0, 60)
        spent.append(np.array(times))
        steps.append(sum(counts))
    # between stops at three and at five, so that what a solve needs to start drops out
    further = (float(np.median(spent[2])) - float(np.median(spent[1]))) * len(spent[1]) / max(steps[2] - steps[1], 1)
    return float(np.median(spent[0])), max(further, 1e-3)


def _means(
    problem: Problem, planner: Planner, counts: list[int], budgets: Sequence[float], seeds: Sequence[int], alone: bool
) -> list[dict[str, Any]]:
    rates = problem.solver.ocp.dynamics.state["base_velocity"]
    kicked = slice(rates.start, rates.start + 2)
    first, further = pace(problem, planner, counts)
    first = further if alone else first
    out = []
    for budget in budgets:
        iterations = min(1 + max(int((budget - first) / further), 0), MAXIMUM)
        late = 0 if first <= budget else math.ceil(first / budget)
        costs = [drive(problem, planner, iterations, late, seed, kicked=kicked) for seed in seeds]
        fell = sum(not math.isfinite(c) for c in costs)
        row = {
            "budget_ms": budget,
            "iterations": iterations,
            "late": late,
            "plan_ms": first + (iterations - 1) * further,
        }
        out.append({**row, "cost": float(np.mean(costs)) if fell == 0 else None, "fell": fell, "success": fell == 0})
    return out


def closed_loop_race(
    names: Sequence[str], note: Callable[[str], None], seeds: Sequence[int] = (200, 201, 202)
) -> list[dict[str, Any]]:
    """Rows: solver, budget [ms], iterations per plan, periods of delay, cost per second (None: the robot fell)."""
    problem = rezero_bench(limits="soft")
    prepared = prepare(problem)
    rows = []
    for name in names:
        note(f"closed loop: {name}")
        own = name.startswith("wbmpc")
        counts: list[int] = []
        planner = our_planner(problem, counts) if own else peer_planner(name, prepared, counts)
        found = within(SECONDS, _means, problem, planner, counts, BUDGETS_MS, seeds, not own)
        given = [{"success": False, "error": found}] if isinstance(found, str) else found
        rows += [{"problem": problem.name, "solver": name, **row} for row in given]
    return rows
