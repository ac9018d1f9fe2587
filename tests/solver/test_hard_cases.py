"""Problems at the edge: bounds that fix a variable, an unstable model, a limit that is far away. Truth: the
interpreted twin; problems without the variable or the limit."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from wbmpc.model.ode import Ode
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, residuals, sets
from wbmpc.ocp.input_rows import input_bounds
from wbmpc.solver import ILQR, SQP, Solver, Status
from wbmpc.solver.barrier_update import adaptive_mu, start_adaptive
from wbmpc.solver.memory_layout import StateField
from wbmpc.solver.settings import THRESHOLDS

Rows = residuals.Expression


def pushed(stiffness: float = 0.0, helper: bool = True, n: int = 20, goal: float = 1.0) -> OptimalControlProblem:
    """x'' = stiffness x + a + b / 10 (without ``helper``: b = 0.3) on its way to 1."""
    f = lambda x, u: ca.vertcat(x[1], stiffness * x[0] + u[0] + 0.1 * (u[1] if helper else 0.3))
    ocp = OptimalControlProblem(Ode({"x": ["p", "v"]}, {"u": ["a", "b"] if helper else ["a"]}, f), 2.0, n)
    ocp.add(Cost("state", Rows(2, lambda s: s.x - ca.DM([goal, 0.0])), 10.0, at="path+terminal"))
    ocp.add(Cost("input", Rows(ocp.dynamics.input.size, lambda s: s.u), 0.1))
    return ocp


@pytest.mark.parametrize("gap", [0.0, 1e-14, 1e-12, 1e-9])
@pytest.mark.parametrize(
    "settings", [SQP(), ILQR(), SQP(backend="interpreted", iterations=20)], ids=["sqp", "ilqr", "twin"]
)
def test_an_input_that_its_bounds_fix_is_a_constant(settings: SQP, gap: float) -> None:
    ocp, without = pushed(n=6), pushed(n=6, helper=False)
    ocp.add(Constraint("fixed", Rows(2, lambda s: s.u), sets.Box([-3.0, 0.3], [3.0, 0.3 + gap]), hard=True))
    without.add(Constraint("bound", Rows(1, lambda s: s.u), sets.Box(-3.0, 3.0), hard=True))
    found, other = (Solver(p, settings).solve(np.zeros(2)) for p in (ocp, without))
    assert found.status is other.status is Status.CONVERGED, found
    np.testing.assert_allclose(found.u, np.column_stack([other.u, np.full(6, 0.3)]), atol=1e-7)


def test_a_policy_holds_an_input_that_its_bounds_fix() -> None:
    ocp = pushed()
    ocp.add(Constraint("fixed", Rows(2, lambda s: s.u), sets.Box([-3.0, 0.3], [3.0, 0.3]), hard=True))
    lower, upper = input_bounds(Solver(ocp, SQP.real_time()).problem)
    np.testing.assert_allclose(lower, [-3.0, 0.3])
    np.testing.assert_allclose(upper, [3.0, 0.3])


def test_a_state_that_is_fixed_at_the_end_is_there() -> None:
    ocp, equal = pushed(), pushed()
    stop = Rows(1, lambda s: s.x[1:])
    ocp.add(Constraint("stop", stop, sets.Box(0.2, 0.2), hard=True, at="terminal"))
    equal.add(Constraint("stop", Rows(1, lambda s: s.x[1:] - 0.2), at="terminal"))
    found, other = (Solver(p, SQP()).solve(np.zeros(2)) for p in (ocp, equal))
    assert found.status is Status.CONVERGED and found.x[-1, 1] == pytest.approx(0.2, abs=1e-6)
    np.testing.assert_allclose(found.u, other.u, atol=1e-6)


@pytest.mark.parametrize("stiffness", [100.0, 400.0, 1600.0])
def test_an_unstable_model_rounds_no_worse_than_a_stable_one(stiffness: float) -> None:
    """Motions grow up to 13 times within an interval, 10²² times within the horizon."""
    solver, twin = (Solver(pushed(stiffness), SQP(iterations=3, backend=b)) for b in ("compiled", "interpreted"))
    found, other = (s.solve(np.array([0.5, 0.0])) for s in (solver, twin))
    assert found.status is Status.CONVERGED and found.iterations <= 3, found
    np.testing.assert_allclose(found.u, other.u, rtol=1e-9, atol=1e-9 * np.abs(other.u).max())


@pytest.mark.parametrize("far", [1e4, 1e6])
def test_a_limit_that_is_far_away_gives_way(far: float) -> None:
    """A relaxed limit pulls by the weight of its slack, 1000 for a range of 2: as a goal that is 500 / 10 further away does."""
    ocp = pushed()
    position = Rows(1, lambda s: s.x[:1])
    ocp.add(Constraint("limit", position, sets.Box(-1.0, 1.0), hard=True, slack=1e3, at="path+terminal"))
    solver = Solver(ocp, SQP())
    solver.warm_start(np.array([far, 0.0]))
    found = solver.solve(np.array([far, 0.0]))
    assert found.status is Status.RELAXED, found
    pulled = Solver(pushed(goal=1.0 - 500.0 / 10.0), SQP()).solve(np.array([far, 0.0]))
    np.testing.assert_allclose(found.x, pulled.x, rtol=1e-8, atol=1e-8 * far)
    np.testing.assert_allclose(found.u, pulled.u, rtol=1e-8, atol=1e-8 * far)


def test_the_barrier_follows_products_while_the_error_falls() -> None:
    """Truth: the rule of LOQO by hand; the fallback keeps four fifths of the mean product."""
    m = np.zeros(40)
    start_adaptive.python(m, 0)
    m[StateField.BARRIER] = 0.01
    rule = lambda error, products, step=1.0, of_barrier=1.0: adaptive_mu.python(
        m, 0, 7e-3, (error, of_barrier), products, step, 1e-12
    )
    assert rule(1.0, (1e-2, 1e-2)) == pytest.approx(THRESHOLDS.steepest * 1e-3)  # even products: as fast as it may
    assert rule(0.8, (1e-2, 1e-4)) == pytest.approx(0.1 * 2.0**3 * 1e-2)  # uneven ones: back to the central path
    for _ in range(THRESHOLDS.error_memory):
        following = rule(0.7, (1e-2, 5e-3))
    assert following == pytest.approx(THRESHOLDS.steepest * 1e-3)
    assert rule(0.69, (1e-2, 5e-3)) == pytest.approx(8e-3)  # 1.5 % in four iterations
    assert rule(0.68, (1e-2, 5e-3)) == pytest.approx(7e-3)  # the monotone rule from then on
    assert rule(0.1, (1e-2, 5e-3), step=0.05, of_barrier=0.05) == pytest.approx(7e-3)  # slacks are in the way
    assert rule(0.1, (1e-2, 5e-3), of_barrier=0.05) == pytest.approx(THRESHOLDS.steepest * 1e-3)  # solved: free again
