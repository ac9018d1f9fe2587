"""Hard rows that are curved in the inputs. Truth: IPOPT on the same discretization; the projection onto a disc, by hand; the
constraints evaluated again; the interpreted twin."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import ipopt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toys import Rows, ToyDynamics
from wbmpc.errors import RunAborted
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import ILQR, SQP, Solver, Status
from wbmpc.types import Observation

RANGE = 1e-3  # of a limit's range: what a command may be outside


def masses(nu: int, weight: float, n: int = 15, horizon: float = 2.0) -> OptimalControlProblem:
    """``nu`` points pushed by a force each, drawn to the origin; ``weight`` of the forces."""
    dynamics = ToyDynamics(2 * nu, nu, lambda x, u, w, m: ca.vertcat(x[nu:], u))
    ocp = OptimalControlProblem(dynamics, horizon, n)
    pull = [10.0] * nu + [1.0] * nu
    ocp.add(Cost("x", Rows(2 * nu, lambda s: s.x), pull, at="path+terminal", terminal_weight=[10.0 * p for p in pull]))
    ocp.add(Cost("u", Rows(nu, lambda s: s.u), weight))
    return ocp


def hard(name: str, f: Callable[..., ca.SX], **more: object) -> Constraint:
    return Constraint(name, Rows(1, f), sets.NonNegative(), hard=True, **more)  # type: ignore[arg-type]


def disc(radius: float = np.sqrt(10.0)) -> Constraint:
    """|u|² ≤ radius², in units of the radius squared."""
    return hard("disc", lambda s: 1.0 - ca.sumsqr(s.u) / radius**2)


def cone() -> Constraint:
    """Friction: the last force is the normal one."""
    return hard("cone", lambda s: 0.7 * (s.u[-1] + 5.0) - ca.sqrt(ca.sumsqr(s.u[:-1]) + 0.01))


def made(limit: Constraint, chosen: SQP, weight: float, nu: int = 2, **more: object) -> Solver:
    ocp = masses(nu, weight, **more)  # type: ignore[arg-type]
    ocp.add(limit)
    return Solver(ocp, chosen)


START = np.array([5.0, 0.3, 1.0, -2.0])


@pytest.mark.parametrize("limit", [disc, cone])
@pytest.mark.parametrize("weight", [1e-4, 0.01, 1.0])
@pytest.mark.parametrize("hessian", ["gauss_newton", "exact"])
def test_optimum_against_ipopt(limit: Callable[[], Constraint], weight: float, hessian: str) -> None:
    """From an input at rest, where a disc's linearization says nothing."""
    solver = made(limit(), SQP(hessian=hessian), weight)
    found = solver.solve(START)
    assert found.status is Status.CONVERGED, found
    assert found.iterations < 50
    solver.warm_start(found.x + 0.01, found.u + 0.01)
    x, u, cost = ipopt.solve(solver, START)
    np.testing.assert_allclose(found.x, x, atol=1e-5)
    np.testing.assert_allclose(found.u, u, atol=1e-4)
    assert found.cost == pytest.approx(cost, abs=1e-5)


def plan_is_within(solver: Solver, x: np.ndarray, *, of: tuple[str, ...]) -> None:
    """Every node's inputs, by the constraints evaluated again."""
    found = solver.solve(x)
    assert found.status is Status.ITERATION_LIMIT and not found.detail, found
    violations = solver.checks.violations(found.x, found.u, solver.ws.p, solver.ws.w)
    for name in of:
        assert violations[name].value <= RANGE, violations[name]


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.floats(-4.0, 1.0), st.floats(-1.0, 1.0), st.sampled_from([SQP, ILQR]), st.integers(0, 99))
def test_every_real_time_plan_is_within_the_disc(weight: float, radius: float, algorithm: type[SQP], seed: int) -> None:
    """Weights 1e-4 to 10, radii 0.1 to 10, one iteration per solve, pushes of the state: no plan is outside."""
    rng = np.random.default_rng(seed)
    solver = made(disc(10.0**radius), algorithm.real_time(), 10.0**weight)
    x = 3.0 * rng.normal(size=4)
    for _ in range(12):
        plan_is_within(solver, x, of=("disc",))
        x = solver.simulate(x, solver.ws.u[0], 0.05) + 0.3 * rng.normal(size=4)


def test_real_time_settles_at_the_optimum() -> None:
    best = made(disc(), SQP(), 0.01).solve(START)
    solver = made(disc(), SQP.real_time(), 0.01)
    for _ in range(12):
        found = solver.solve(START)
    assert found.cost == pytest.approx(best.cost, rel=1e-4)
    np.testing.assert_allclose(found.u[0], best.u[0], atol=1e-2)


def test_plans_stay_within_several_rows_together() -> None:
    """A cone, a bound, a plane and a row that moves with the state; a plan that starts outside of all of them."""
    ocp = masses(3, 1e-3)
    ocp.add(cone())
    ocp.add(Constraint("box", Rows(3, lambda s: s.u), sets.Box(-4.0, 6.0), hard=True))
    ocp.add(hard("plane", lambda s: 3.0 - s.u[0] - s.u[1]))
    ocp.add(hard("moving", lambda s: 9.0 + ca.cos(s.x[0]) - (s.u[0] + ca.sin(s.x[3])) ** 2 - s.u[1] ** 2))
    solver = Solver(ocp, SQP.real_time())
    x = np.array([4.0, -3.0, 2.0, 1.0, 5.0, -6.0])
    solver.warm_start(x, np.full(3, 50.0))
    for _ in range(10):
        plan_is_within(solver, x, of=("cone", "box", "plane", "moving"))
        x = solver.simulate(x, solver.ws.u[0], 0.05)


def test_a_plan_that_starts_outside_goes_to_the_nearest_inputs() -> None:
    """One interval, nothing but the input to decide, and it hardly weighs: inputs at (6, 8) in a disc of radius 5 go to (3, 4)."""
    ocp = OptimalControlProblem(ToyDynamics(2, 2, lambda x, u, w, m: u), 0.1, 1)
    ocp.add(Cost("stay", Rows(2, lambda s: s.u - ca.DM([6.0, 8.0])), 1.0))
    ocp.add(disc(5.0))
    solver = Solver(ocp, SQP.real_time())
    solver.warm_start(np.zeros(2), np.array([6.0, 8.0]))
    found = solver.solve(np.zeros(2))
    np.testing.assert_allclose(found.u[0], [3.0, 4.0], atol=5e-3)
    assert np.hypot(*found.u[0]) <= 5.0


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_inputs_that_no_plan_can_hold_are_reported_by_name(backend: str) -> None:
    """Two discs that do not meet. The twin, which is slow, has fewer nodes."""
    ocp = masses(1, 0.1, n=15 if backend == "compiled" else 3)
    ocp.add(hard("right", lambda s: 1.0 - (s.u[0] - 3.0) ** 2))
    ocp.add(hard("left", lambda s: 1.0 - (s.u[0] + 3.0) ** 2))
    found = Solver(ocp, SQP.real_time(backend=backend)).solve(START[:2])
    assert found.status is Status.INPUT_INFEASIBLE and not found.usable
    assert "right" in found.detail or "left" in found.detail
    assert "planned inputs miss a hard limit" in str(found)
    with pytest.raises(RunAborted, match=r"hard limit .*(right|left)"):
        MPC(ocp, SQP.real_time(backend=backend), first_iterations=1, plan_only_limits=True).update(
            Observation(0.0, START[:2])
        )


def test_a_limit_that_moves_with_the_state_gives_way_by_name() -> None:
    """The measured speed leaves no admissible force: the exact slack is used, and the plan says so."""
    ocp = masses(1, 0.1)
    ocp.add(hard("power", lambda s: 2.0 - 0.1 * s.u[0] ** 2 - s.x[1] ** 2))
    solver = Solver(ocp, SQP.real_time())
    found = solver.solve(np.array([1.0, 3.0]))
    worst = solver.checks.violations(found.x, found.u, solver.ws.p, solver.ws.w)["power"]
    assert worst.value >= 7.0  # 2 − 3² at the measured state
    assert found.usable and f"power.all[0] by {worst.value:.3g} at node {worst.node}" in found.detail


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_rows_with_a_slack_give_way_to_bounds_of_inputs(backend: str) -> None:
    """At 5 m, 100 (1 − x) − (2 + x) u − u² / 100 ≥ 0 takes a force of −63, and bounds end at −4. The twin, which is slow, has fewer nodes."""
    ocp = masses(1, 0.1, n=15 if backend == "compiled" else 3)
    ocp.add(Constraint("box", Rows(1, lambda s: s.u), sets.Box(-4.0, 6.0), hard=True))
    ocp.add(hard("far", lambda s: 100.0 * (1.0 - s.x[0]) - (2.0 + s.x[0]) * s.u[0] - 0.01 * s.u[0] ** 2))
    solver = Solver(ocp, SQP.real_time(backend=backend))
    found = solver.solve(np.array([5.0, 0.0]))
    assert found.usable and -4.0 - RANGE <= found.u.min() <= found.u.max() <= 6.0 + RANGE, found
    assert "far.all[0]" in found.detail


@pytest.mark.parametrize("algorithm", [SQP, ILQR])
@pytest.mark.parametrize("real_time", [True, False])
def test_same_iterates_as_the_twin(algorithm: type[SQP], real_time: bool) -> None:
    results = []
    for backend in ("compiled", "interpreted"):
        chosen = algorithm.real_time(4, backend=backend) if real_time else algorithm(iterations=6, backend=backend)
        ocp = masses(3, 0.01, n=6)
        for limit in (cone(), disc(4.0), hard("moving", lambda s: 9.0 - (s.u[0] + 0.1 * s.x[0]) ** 2)):
            ocp.add(limit)
        solver = Solver(ocp, chosen)
        found = solver.solve(np.array([4.0, -3.0, 2.0, 1.0, 0.5, -0.6]))
        results.append((found.x, found.u, found.cost, found.violation, found.log[:, 4]))
    for a, b in zip(*results, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7)


def test_linear_rows_have_no_second_derivatives_and_curved_ones_have() -> None:
    """What decides about the cost of an iteration."""
    linear, state, curved, mixed = masses(2, 1.0), masses(2, 1.0), masses(2, 1.0), masses(2, 1.0)
    linear.add(hard("plane", lambda s: 3.0 - s.u[0] - s.u[1] + ca.sin(s.x[0])))
    state.add(hard("round", lambda s: 3.0 - ca.sumsqr(s.x)))
    curved.add(disc())
    mixed.add(hard("bilinear", lambda s: 3.0 - s.x[0] * s.u[1]))
    found = [Solver(p, SQP()).problem.nonlinear_input_rows for p in (linear, state, curved, mixed)]
    assert found == [False, False, True, False]
