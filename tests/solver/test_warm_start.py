"""Slacks and multipliers of a solution that the next solve starts from. Truth: what a solve without them finds."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from toys import Rows
from wbmpc.model.ode import Ode
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import SQP, Solver, Status


def swing() -> OptimalControlProblem:
    """A pendulum with limits of torque and speed that are active, and a circle to stay out of at the end."""
    dynamics = Ode({"x": ["q", "v"]}, {"u": ["t"]}, lambda x, u: ca.vertcat(x[1], u - 4.0 * ca.sin(x[0])))
    ocp = OptimalControlProblem(dynamics, 1.0, 12)
    ocp.add(Cost("goal", Rows(2, lambda s: ca.vertcat(s.x[0] - 1.5, s.x[1])), 10.0, at="path+terminal"))
    ocp.add(Cost("torque", Rows(1, lambda s: s.u), 0.01))
    ocp.add(Constraint("bounds", Rows(1, lambda s: s.u), sets.Box(-6.0, 6.0), hard=True))
    ocp.add(Constraint("speed", Rows(1, lambda s: s.x[1:]), sets.Box(-1.5, 1.5), hard=True, at="path+terminal"))
    away = Rows(1, lambda s: ca.sumsqr(s.x - ca.DM([1.5, 0.0])) - 0.01)
    ocp.add(Constraint("away", away, sets.NonNegative(), hard=True, at="terminal"))
    return ocp


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_a_warm_start_takes_fewer_iterations_and_finds_the_same(backend: str) -> None:
    rng, solver = np.random.default_rng(4), Solver(swing(), SQP(backend=backend))  # type: ignore[arg-type]
    counts = []
    for _ in range(8 if backend == "compiled" else 1):
        x0 = rng.normal(size=2) * [0.3, 0.5]
        solver.reset()
        solver.warm_start(x0)
        first = solver.solve(x0)
        moved = x0 + 1e-3 * rng.normal(size=2)
        warm = solver.solve(moved)
        solver.reset()
        solver.warm_start(x0)
        cold = solver.solve(moved)
        assert first.status is warm.status is cold.status is Status.CONVERGED
        assert warm.iterations < cold.iterations
        np.testing.assert_allclose(warm.u, cold.u, atol=1e-4)
        counts.append((warm.iterations, cold.iterations))
    warm_total, cold_total = np.sum(counts, axis=0)
    assert 1.5 * warm_total < cold_total, counts


def test_both_back_ends_start_alike() -> None:
    found = []
    for backend in ("compiled", "interpreted"):
        solver = Solver(swing(), SQP(backend=backend))  # type: ignore[arg-type]
        solver.warm_start(np.zeros(2))
        solver.solve(np.zeros(2))
        found.append(solver.solve(np.array([1e-3, -1e-3])))
    ours, twin = found
    assert ours.iterations == twin.iterations
    np.testing.assert_allclose(ours.log[:, :4], twin.log[:, :4], rtol=1e-4, atol=1e-6)


def test_another_guess_starts_cold() -> None:
    """Slacks that do not fit count for nothing: the same solve to the last bit as of a solver that knows no other."""
    solver, other = Solver(swing()), Solver(swing())
    solver.warm_start(np.zeros(2))
    solver.solve(np.zeros(2))
    guess = np.array([0.5, -0.5])
    for s in (solver, other):
        s.warm_start(guess)
    np.testing.assert_array_equal(solver.solve(guess).log, other.solve(guess).log)


def test_no_solve_costs_more_than_the_settings_say() -> None:
    """Pushes and jumps of the state, one after the other: every count is within the bound, and some need more than one iteration."""
    settings = SQP.real_time()
    solver, rng = Solver(swing(), settings), np.random.default_rng(5)
    solver.warm_start(np.zeros(2))
    costs = []
    for _ in range(100):
        solver.iterate(rng.normal(size=2) * [1.0, 2.0], delta=0.02)
        costs.append(solver.effort)
    worst = np.max(costs, axis=0)
    assert np.all(worst <= settings.max_effort) and worst[0] > 1
    assert settings.max_effort == (13, 56)
