"""Every solver on every test problem. Truth: IPOPT, and Fatrop where it converges, on the same discretization."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "solver"))
sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import ipopt
from whole_race.torque_arm import torque_arm

from effort import thorough
from small_problems import cartpole, double_integrator
from toys import rezero_solver, robot
from wbmpc.benchmark.problems import SampleProblem
from wbmpc.ocp import Constraint, Reference
from wbmpc.solver import ILQR, SLQ, SQP, Solver, Status
from wbmpc.studies.race.ballbot import ballbot
from wbmpc.studies.race.differential import differential_manipulator
from wbmpc.studies.race.swerve import swerve

SOLVERS = {
    "sqp-merit": SQP(iterations=400),
    "sqp-filter": SQP(iterations=400, line_search="filter"),
    "sqp-exact": SQP(iterations=400, hessian="exact"),
    "sqp-shift": SQP(iterations=400, min_step=0.9),  # full steps, or a Levenberg-Marquardt shift
    "ilqr": ILQR(iterations=400),
    "ilqr-filter": ILQR(iterations=400, line_search="filter"),
    "slq": SLQ(iterations=400, step=0.04),
}


def hardened(problem: SampleProblem) -> SampleProblem:
    """All inequalities hard."""
    for name, term in problem.ocp.terms.items():
        if isinstance(term, Constraint) and not term.equality:
            problem.ocp.terms[name] = replace(term, hard=True)
    return problem


def rezero_with_a_force() -> SampleProblem:
    """The ball robot pushes with 5 N while its end effector stays."""
    base = rezero_solver(6)
    model = robot("rezero", contact="force")
    from wbmpc.bases.ball.defaults import RezeroCost, rezero_problem
    from wbmpc.settings import MpcSettings

    settings = MpcSettings(horizon=0.3, intervals=6, first_interval=0.0, barrier_mu=1e-2)
    home, torque = model.base.numeric.equilibrium(model.home[model.state["arm"]])
    u = np.concatenate([torque, np.zeros(3)])
    references = {
        **base.references, "body": Reference.constant(home),
        "torque": Reference.constant(u + np.concatenate([0 * torque, [5.0, 0.0, 0.0]])),
    }  # fmt: skip
    return SampleProblem(
        "ball robot with a force", rezero_problem(model, settings, RezeroCost()), home, home, u, references
    )


#: Problem, and whether IPOPT needs a start near the solution (dependent rows, indefinite Hessians far from it).
PROBLEMS = {
    "double-integrator": (partial(double_integrator, hard=True), False),
    "cartpole": (partial(cartpole, intervals=30, hard=True), False),
    "ballbot": (partial(ballbot, intervals=20, goal=(0.3, 0.15, 0.2)), False),
    "differential-manipulator": (lambda: hardened(differential_manipulator(intervals=12)), False),
    "torque-arm": (partial(torque_arm, intervals=10), False),
    "swerve-base": (lambda: hardened(swerve(arm=False, intervals=8)), True),
    "swerve-brakes": (lambda: hardened(swerve(arm=True, brakes="events", intervals=10)), True),
    "ball-robot-force": (rezero_with_a_force, False),
}


def goes_with(name: str, solver: str) -> bool:
    """The exact Hessian is for rk2 without quaternions; SLQ where IPOPT on the finer grid takes no minutes."""
    if solver == "sqp-exact":
        return name != "cartpole" and not name.startswith("swerve")
    return solver != "slq" or name in ("double-integrator", "cartpole", "ballbot", "torque-arm")


def slow(name: str, solver: str) -> bool:
    """Whether a pair runs with all tests only: line searches and shifts are tried on the small problems."""
    if solver in ("sqp-filter", "sqp-shift", "ilqr-filter", "slq"):
        return name not in ("double-integrator", "cartpole", "ballbot")
    return solver == "sqp-exact" and name in ("ball-robot-force", "torque-arm")


@cache
def truth(name: str, refined: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """IPOPT's answer; ``refined``: on the grid of SLQ."""
    maker, near = PROBLEMS[name]
    problem = maker()
    solver = problem.solver(SOLVERS["slq"] if refined else SQP(iterations=400))
    solver.iterate(problem.x0)  # samples the references
    if near:
        noise = np.random.default_rng(0)
        solver.warm_start(
            *(v + 0.01 * noise.normal(size=v.shape) for v in (solver.trajectory().x, solver.trajectory().u))
        )
    else:
        solver.warm_start(problem.x, problem.u)
    return ipopt.solve(solver, problem.x0)[:2]


@pytest.mark.parametrize(
    ("name", "solver"),
    [pytest.param(n, s, marks=thorough if slow(n, s) else ()) for n in PROBLEMS for s in SOLVERS if goes_with(n, s)],
    ids=lambda v: str(v),
)
def test_optimum(name: str, solver: str) -> None:
    problem = PROBLEMS[name][0]()
    made = problem.solver(SOLVERS[solver])
    found = made.solve(problem.x0)
    assert found.status is Status.CONVERGED, found
    assert found.iterations > 2  # the guess is not the optimum
    x, u = truth(name, solver == "slq")
    assert len(found.u) == made.ocp.intervals and (solver != "slq" or np.diff(found.times).max() <= 0.04 + 1e-9)
    assert np.abs(found.x - x).max() < 1e-6, name
    assert np.abs(found.u - u).max() < 1e-6 * (1.0 + np.abs(u).max()), name
    check_certificate(made, found.x, found.u, problem)


def check_certificate(made: Solver, x: np.ndarray, u: np.ndarray, problem: SampleProblem) -> None:
    """Gaps, start and hard limits, evaluated again."""
    np.testing.assert_allclose(x[0], problem.x0, atol=1e-9)
    for k, h in enumerate(np.diff(made.trajectory().grid)):
        step = ipopt._step(made, made.problem.x, made.problem.u, made.node_parameters[k], h)
        end = evaluate(step, made, x[k], u[k])
        np.testing.assert_allclose(end, x[k + 1], atol=1e-6)
    for row in made.problem.path.boxes:
        values = np.hstack([x[:-1], u])[1:, row.variable]
        assert np.min(row.sign * values + row.offset) > -1e-7, row.name


def evaluate(expression, made: Solver, x: np.ndarray, u: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    import casadi as ca

    return np.array(ca.Function("f", [made.problem.x, made.problem.u], [expression])(x, u)).ravel()


@pytest.mark.parametrize("name", ["double-integrator", "cartpole", "ballbot", "differential-manipulator", "torque-arm"])
def test_fatrop_agrees(name: str) -> None:
    problem = PROBLEMS[name][0]()
    made = problem.solver(SOLVERS["sqp-merit"])
    found = made.solve(problem.x0)
    made.warm_start(problem.x, problem.u)
    x, u, _ = ipopt.solve(made, problem.x0, "fatrop")
    assert np.abs(found.x - x).max() < 5e-6 * (1.0 + np.abs(x).max())
    assert np.abs(found.u - u).max() < 5e-5 * (1.0 + np.abs(u).max())  # Fatrop stops at 1e-9
