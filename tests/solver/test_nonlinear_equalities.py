"""Equalities that are curved in the inputs, with Gauss-Newton. Truth: IPOPT on the same discretization; circles, by hand."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import ipopt
import numpy as np
import pytest

from toys import Rows, ToyDynamics
from wbmpc.ocp import AugmentedLagrangian, Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import ILQR, SQP, Solver, Status

ROWS: dict[str, tuple[Callable[..., ca.SX], tuple[float, float], float]] = {
    "circle": (lambda s: ca.sumsqr(s.u) - 1.0, (10.0, 1.0), 0.1),
    "circle, cheap": (lambda s: ca.sumsqr(s.u) - 1.0, (3.0, 1.0), 0.01),
    "circle that grows": (lambda s: ca.sumsqr(s.u) - 1.0 - 0.3 * s.x[0] ** 2, (10.0, 1.0), 0.1),
    "hyperbola": (lambda s: s.u[0] * s.u[1] - 0.5, (1.0, -0.7), 0.1),
    "sine": (lambda s: s.u[1] - ca.sin(3.0 * s.u[0]), (1.0, -0.7), 0.1),
    "cubic": (lambda s: s.u[1] - s.u[0] ** 3 - 0.2, (1.0, -0.7), 0.1),
}


def made(name: str, settings: SQP, **more: object) -> Solver:
    """A point that is driven by its velocity to a goal; the velocity has to be on a curve."""
    row, goal, weight = ROWS[name]
    ocp = OptimalControlProblem(ToyDynamics(2, 2, lambda x, u, w, m: u), 2.0, 20)
    ocp.add(Cost("state", Rows(2, lambda s: s.x - np.array(goal)), 1.0, at="path+terminal"))
    ocp.add(Cost("input", Rows(2, lambda s: s.u - np.array([0.3, 0.4])), weight))
    ocp.add(Constraint("curve", Rows(1, row), **more))  # type: ignore[arg-type]
    solver = Solver(ocp, settings)
    solver.warm_start(np.zeros(2), np.array([0.5, 0.2]))
    return solver


@pytest.mark.parametrize("algorithm", [SQP(), ILQR()], ids=["sqp", "ilqr"])
@pytest.mark.parametrize("name", ROWS)
def test_optimum_in_few_iterations(name: str, algorithm: SQP) -> None:
    solver = made(name, algorithm)
    found = solver.solve(np.zeros(2))
    assert found.status is Status.CONVERGED and found.iterations <= 25, found
    solver.warm_start(found.x + 1e-3, found.u + 1e-3)
    x, u, cost = ipopt.solve(solver, np.zeros(2))
    np.testing.assert_allclose(found.x, x, atol=1e-5)
    np.testing.assert_allclose(found.u, u, atol=1e-5)
    assert found.cost == pytest.approx(cost, abs=1e-6)


def test_the_kkt_residual_is_that_of_the_true_problem() -> None:
    """What keeps the subproblem convex vanishes at the solution: there the velocity points to the goal's side, on the circle."""
    found = made("circle", SQP()).solve(np.zeros(2))
    np.testing.assert_allclose(np.linalg.norm(found.u, axis=1), 1.0, atol=1e-8)
    assert found.kkt < 1e-8 and found.u[:, 0].min() > 0.9


@pytest.mark.parametrize("algorithm", [SQP(), ILQR()], ids=["sqp", "ilqr"])
def test_multipliers_of_a_curved_inequality(algorithm: SQP) -> None:
    """|u| ≤ 1 by an augmented Lagrangian: the interior point's optimum."""
    ocps = []
    for how in ({"penalty": AugmentedLagrangian(10.0)}, {"hard": True}):
        ocp = OptimalControlProblem(ToyDynamics(2, 2, lambda x, u, w, m: u), 2.0, 20)
        ocp.add(Cost("state", Rows(2, lambda s: s.x - np.array([1.0, -0.7])), 1.0, at="path+terminal"))
        ocp.add(Cost("input", Rows(2, lambda s: s.u - np.array([3.0, 2.0])), 0.1))
        ocp.add(Constraint("disc", Rows(1, lambda s: 1.0 - ca.sumsqr(s.u)), sets.NonNegative(), **how))  # type: ignore[arg-type]
        ocps.append(ocp)
    multiplier, hard = (Solver(ocp, algorithm).solve(np.zeros(2)) for ocp in ocps)
    assert multiplier.status is hard.status is Status.CONVERGED
    assert multiplier.iterations <= 40, multiplier
    np.testing.assert_allclose(multiplier.u, hard.u, atol=2e-4)


SOFT_GOALS: dict[str, Callable[..., ca.SX]] = {
    "sine of a state": lambda s: ca.sin(3.0 * s.x[0]) - s.u[1],
    "stretched": lambda s: s.u[0] * (1.0 + s.x[1] ** 2) - 1.0,
    "wheel": lambda s: s.u[0] * ca.sin(s.x[1]) - s.u[1] * ca.cos(s.x[1]),
    "exponential": lambda s: ca.exp(s.u[0]) + s.u[1] - 1.0,
}


@pytest.mark.parametrize(
    ("name", "softness", "backend"),
    [*((name, c, "compiled") for name in SOFT_GOALS for c in (1e-3, 1e-2, 1.0)), ("wheel", 1e-2, "interpreted")],
)
def test_a_nonlinear_soft_goal(name: str, softness: float, backend: str) -> None:
    """A row g with softness c is a cost of ½ g² / c per interval, which IPOPT minimizes."""
    solvers = []
    for term in (
        Constraint("goal", Rows(1, SOFT_GOALS[name]), softness=softness),
        Cost("goal", Rows(1, SOFT_GOALS[name]), 10.0 / softness),
    ):
        ocp = OptimalControlProblem(ToyDynamics(2, 2, lambda x, u, w, m: u), 2.0, 20)
        ocp.add(Cost("state", Rows(2, lambda s: s.x - np.array([3.0, 1.0])), 1.0, at="path+terminal"))
        ocp.add(Cost("input", Rows(2, lambda s: s.u), 0.1))
        ocp.add(term)
        solvers.append(Solver(ocp, SQP(backend=backend)))  # type: ignore[arg-type]
        solvers[-1].warm_start(np.zeros(2), np.array([0.5, 0.2]))
    found = solvers[0].solve(np.zeros(2))
    assert found.status is Status.CONVERGED and found.iterations <= 60, found
    solvers[1].warm_start(found.x + 1e-3, found.u + 1e-3)
    np.testing.assert_allclose(found.u, ipopt.solve(solvers[1], np.zeros(2))[1], atol=1e-5)


@pytest.mark.parametrize("hessian", ["gauss_newton", "exact"])
def test_what_can_be_met_is_never_called_infeasible(hessian: str) -> None:
    """A point on a circle of velocities that has come to its goal has nowhere to go: no quick convergence."""
    ROWS["rest"] = (ROWS["circle"][0], (1.0, -0.7), 0.1)
    found = made("rest", SQP(hessian=hessian, iterations=60)).solve(np.zeros(2))  # type: ignore[arg-type]
    assert found.status in (Status.CONVERGED, Status.ITERATION_LIMIT, Status.LINE_SEARCH_FAILED), found
    if found.status is not Status.CONVERGED:
        assert (
            found.detail.startswith("largest violation: curve.all[0] by")
            and "nonlinear in the inputs: try" in found.detail
        )
        assert np.isnan(found.kkt) or found.kkt > 0.0


def test_what_cannot_be_met_is() -> None:
    """|u|² = −1, with second derivatives."""
    ROWS["empty"] = (lambda s: ca.sumsqr(s.u) + 1.0, (1.0, 1.0), 0.1)
    found = made("empty", SQP(hessian="exact")).solve(np.zeros(2))
    assert found.status is Status.INFEASIBLE and "curve.all[0]" in found.detail, found
