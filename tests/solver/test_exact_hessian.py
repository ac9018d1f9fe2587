"""The exact Hessian. Truth: CasADi's Hessian of the discrete Lagrangian; the optimum of Gauss-Newton; quadratic convergence."""

from __future__ import annotations

import casadi as ca
import ipopt
import numpy as np
import pytest

from effort import thorough
from toys import Rows, ToyDynamics, hardened_pendulum, pendulum, rezero_solver, robot
from wbmpc.errors import InputError
from wbmpc.kernel.second_derivatives import SECOND
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import ILQR, SQP, Solver, Status
from wbmpc.solver.inequalities import start_rows
from wbmpc.solver.memory_layout import EXACT, STATE, H, StateField
from wbmpc.solver.riccati import backward

START = np.array([0.2, 0.5, 0.3, -0.4])


def hessians(solver: Solver) -> list[np.ndarray]:
    """[x; u] blocks of all nodes at the present iterate, from the solver's memory."""
    m, o, s = solver.ws.memory, solver.ws.table, solver.kernel.sizes
    m[o[STATE] + StateField.BARRIER], m[o[STATE] + StateField.SECOND_ORDER_SHARE] = 0.1, 1.0
    start_rows(m, o, 0.01, False, False)
    backward(m, o, True)
    keep = [i for i in range(s.nz) if i != s.nx]
    blocks = []
    for k in range(solver.problem.ocp.intervals):
        start = o[H] + k * s.nz * s.lz
        block = m[start : start + s.nz * s.lz].reshape(s.nz, s.lz)[:, : s.nz].T
        blocks.append(np.triu(block[np.ix_(keep, keep)]))
    return blocks


@pytest.mark.parametrize("integrator", ["rk2", "rk4"])
def test_it_is_the_hessian_of_the_lagrangian(integrator: str) -> None:
    """Without rows of their own; costates and multipliers by least squares, rewritten."""
    rng = np.random.default_rng(3)
    base = pendulum(n=5, integrator=integrator)
    for name in ("speed", "force", "tip_range"):
        del base.ocp.terms[name]
    solver = Solver(base.ocp, SQP(hessian="exact"), use_cache=False)
    solver.set_reference("state", base.references["state"])
    x, u = 0.5 * rng.normal(size=(6, 4)), rng.normal(size=(5, 2))
    solver.warm_start(x, u)
    solver.iterate(START)  # samples the references; the iterate is put back
    solver.warm_start(x, u)
    blocks = hessians(solver)
    t, p, w = solver.problem, solver.ws.p, solver.ws.w
    s, z, lam, nu = t.x, t.z, ca.SX.sym("l", 4), ca.SX.sym("n", 1)
    grid = np.diff(solver.ws.grid)
    costate = np.array(ca.Function("g", [s], [ca.gradient(t.values["terminal"](s, p[5], w), s)])(x[5])).ravel()
    for k in range(4, -1, -1):
        h = grid[k]
        cost = h * t.values["cost"](t.x, t.u, p[k], w)
        step = ipopt._step(solver, t.x, t.u, p[k], h)
        rows = t.values["equality"](t.x, t.u, p[k], w)
        whole = cost + ca.dot(lam, step)
        gradient = ca.Function("g", [z, lam], [ca.gradient(whole, z), ca.jacobian(rows, z)])
        at = np.concatenate([x[k], u[k]])
        g, j = (np.array(v) for v in gradient(at, costate))
        multiplier = np.linalg.lstsq(j[:, 4:].T, -g[4:].ravel(), rcond=None)[0]
        lagrangian = whole + ca.dot(nu, rows)
        hessian = ca.Function("h", [z, lam, nu], [ca.hessian(lagrangian, z)[0]])
        want = np.triu(np.array(ca.DM(ca.densify(hessian(at, costate, multiplier)))))
        np.testing.assert_allclose(blocks[k], want, atol=1e-6 * (1 + np.abs(want).max()))
        costate = (g.ravel() + j.T @ multiplier)[:4]


def curved(hessian: str) -> Solver:
    """Residuals that do not vanish at the optimum, and a curved hard row: Gauss-Newton is slow here."""
    dynamics = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1] + 0.3 * x[0] ** 2, u[0] - ca.sin(x[0])))
    ocp = OptimalControlProblem(dynamics, 1.0, 8)
    ocp.add(
        Cost(
            "far",
            Rows(2, lambda s: ca.vertcat(s.x[0] ** 2 + s.x[1] - 2.0, ca.exp(0.5 * s.x[1]) - 3.0)),
            5.0,
            at="path+terminal",
        )
    )
    ocp.add(Cost("u", Rows(1, lambda s: s.u), 0.1))
    circle = Rows(1, lambda s: 1.2 - s.x[0] ** 2 - 0.1 * s.u[0] ** 2)
    ocp.add(Constraint("circle", circle, sets.NonNegative(), hard=True))
    ocp.add(Constraint("end", Rows(1, lambda s: 1.0 - s.x[0] * s.x[1]), sets.NonNegative(), at="terminal", hard=True))
    return Solver(ocp, SQP(iterations=200, hessian=hessian), use_cache=False)


def test_same_optimum_with_curved_rows_and_no_more_iterations() -> None:
    x0 = np.array([0.2, 0.1])
    plain, exact = curved("gauss_newton"), curved("exact")
    a, b = plain.solve(x0), exact.solve(x0)
    assert b.status is Status.CONVERGED, b
    x, u, _ = ipopt.solve(curved_at(exact, x0), x0)
    np.testing.assert_allclose(b.x, x, atol=1e-6)
    np.testing.assert_allclose(b.u, u, atol=1e-5)
    assert b.iterations <= a.iterations


def curved_at(solver: Solver, x0: np.ndarray) -> Solver:
    solver.warm_start(x0)
    return solver


def test_convergence_is_quadratic_where_gauss_newtons_is_linear() -> None:
    tails = {}
    for hessian in ("gauss_newton", "exact"):
        base = pendulum()
        solver = Solver(base.ocp, SQP(iterations=200, hessian=hessian))
        solver.set_reference("state", base.references["state"])
        found = solver.solve(START)
        assert found.status is Status.CONVERGED
        tails[hessian] = found.log[-3:, 2]
    slow, fast = tails["gauss_newton"], tails["exact"]
    assert fast[2] < 1e-3 * fast[1] < 1e-4 * fast[0]
    assert slow[2] > 1e-2 * slow[1]


@thorough
@pytest.mark.parametrize("algorithm", [SQP, ILQR])
def test_robot_and_hard_rows(algorithm: type[SQP]) -> None:
    a, b = (hardened_pendulum(algorithm(iterations=300, hessian=h)).solve(START) for h in ("gauss_newton", "exact"))
    assert a.status is b.status is Status.CONVERGED
    np.testing.assert_allclose(a.u, b.u, atol=1e-5)
    model = robot("rezero")
    plain = rezero_solver(8)
    exact = Solver(plain.ocp, SQP(iterations=200, hessian="exact"))
    for name, reference in plain.references.items():
        exact.set_reference(name, reference)
    exact.warm_start(plain.ws.x, plain.ws.u)
    np.testing.assert_allclose(exact.solve(model.home).u, plain.solve(model.home).u, atol=1e-5)


def test_what_it_does_not_go_with() -> None:
    with pytest.raises(InputError, match="interpreted"):
        Solver(pendulum().ocp, SQP(hessian="exact", backend="interpreted"))
    with pytest.raises(InputError, match=r"unknown hessian 'exakt'.*did you mean 'exact'"):
        SQP(hessian="exakt")  # type: ignore[arg-type]


def double_well() -> OptimalControlProblem:
    """ẋ = u, cost (x² − 1)² / 2 + 0.005 u²: from 0, staying there is stationary, and either well is better."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u), 4.0, 40)
    ocp.add(Cost("well", Rows(1, lambda s: s.x**2 - 1.0), 1.0, at="path+terminal"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.01))
    ocp.add(Constraint("speed", Rows(1, lambda s: s.u), sets.Box(-5.0, 5.0), hard=True))
    return ocp


def test_a_saddle_is_reported() -> None:
    """Truth: the cost of a motion into a well, which is lower."""
    solver = Solver(double_well(), SQP(hessian="exact"))
    solver.warm_start(np.zeros(1))
    saddle = solver.solve(np.zeros(1))
    assert saddle.status is Status.CONVERGED and np.abs(saddle.x).max() < 1e-9
    assert saddle.detail == (
        "the curvature is not positive in every direction: a saddle or a maximum, no minimum; try another guess"
    )
    assert np.isfinite(solver.ws.k).all()
    gains = saddle.gain
    np.testing.assert_array_equal(solver.ws.k[:, :, :1], gains)  # looking has changed nothing
    ramp = np.minimum(solver.ocp.grid, 1.0)
    solver.warm_start(ramp[:, None], np.where(solver.ocp.grid[:-1] < 1.0, 1.0, 0.0)[:, None])
    well = solver.solve(np.zeros(1))
    assert well.status is Status.CONVERGED and well.detail == "" and well.cost < 0.5 * saddle.cost
    assert abs(well.x[-1, 0]) == pytest.approx(1.0, abs=1e-2)


def test_a_last_subproblem_that_is_not_convex_is_named() -> None:
    """The largest step was said to be "nan"."""
    found = Solver(double_well(), SQP(iterations=1, hessian="exact")).solve(np.zeros(1))
    assert found.status is Status.ITERATION_LIMIT and found.detail == "the last subproblem is not convex"


def slow(hessian: str, share: float = 0.99) -> Solver:
    """½ (u + 1)² + ½ (λ u² + u − 1)²: Gauss-Newton contracts the distance from the minimum u = 0 by λ with each step."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u), 1.0, 4)
    ocp.add(Cost("far", Rows(2, lambda s: ca.vertcat(s.u + 1.0, share * s.u**2 + s.u - 1.0)), 1.0))
    ocp.add(Cost("state", Rows(1, lambda s: s.x), 1e-9, at="path+terminal"))
    solver = Solver(ocp, SQP(hessian=hessian), use_cache=False)  # type: ignore[arg-type]
    solver.warm_start(np.zeros(1), np.full(1, 0.5))
    return solver


def test_a_solve_that_gauss_newton_would_not_finish_goes_on_with_the_exact_hessian() -> None:
    """Truth: u = 0; 0.99^300 of the distance is left where nothing takes over."""
    assert slow("gauss_newton").solve(np.zeros(1)).status is Status.ITERATION_LIMIT
    solver = slow("auto")
    first = solver.solve(np.zeros(1))
    assert first.status is Status.CONVERGED and first.iterations < 100
    np.testing.assert_allclose(first.u, 0.0, atol=1e-6)
    # what comes after does not depend on it: Gauss-Newton again, and none but `solve` compiles
    assert solver.ws.table[EXACT] == 0
    solver.warm_start(np.zeros(1), np.full(1, 0.5))
    assert solver.solve(np.zeros(1)).iterations == first.iterations
    solver.warm_start(np.zeros(1), np.full(1, 0.5))
    assert solver.status(solver.iterate(np.zeros(1))[0]) is Status.ITERATION_LIMIT


@pytest.mark.parametrize("rows", [False, True])
def test_nothing_of_it_stays_behind(rows: bool) -> None:
    """Iterations of Gauss-Newton after those of the exact Hessian are those of a solver that never had one, bit by bit: sums of cubes of
    distant states have second derivatives where a diagonal cost has none."""
    n = 18
    curved = lambda x, u, w, m: ca.vertcat(x[1:] + 0.1 * x[0] * x[-1] * u, u)
    ocp = OptimalControlProblem(ToyDynamics(n, 1, curved), 1.0, 9)
    ocp.add(Cost("all", Rows(n + 1, lambda s: ca.vertcat(s.x - 0.3, s.u)), 1.0, at="path"))
    if rows:
        ocp.add(Constraint("near", Rows(1, lambda s: 2.0 - s.x[0] ** 2), sets.NonNegative(), hard=True))
    solver = Solver(ocp, SQP(iterations=2), use_cache=False)

    def gains() -> np.ndarray:
        solver.reset()
        solver.warm_start(np.full(n, 0.2), np.zeros(1))
        solver.iterate(np.full(n, 0.1))
        return solver.ws.k.copy()

    first = gains()
    exact = solver.hessian._compile()
    assert exact is not None
    solver.hessian._use(exact.addresses, True)
    assert np.abs(gains() - first).max() > 1e-6
    assert solver.kernel is not None
    solver.hessian._use([solver.kernel.address(name) for name in SECOND], False)
    np.testing.assert_array_equal(gains(), first)


def test_a_solve_that_finishes_in_time_stays_with_gauss_newton() -> None:
    """Contraction by 0.9: a hundred iterations and more, and the same ones to the last bit."""
    ours, plain = (slow(hessian, 0.9).solve(np.zeros(1)) for hessian in ("auto", "gauss_newton"))
    assert ours.iterations > 100 and ours.status is Status.CONVERGED
    np.testing.assert_array_equal(ours.log, plain.log)
