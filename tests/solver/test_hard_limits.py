"""Hard limits, multiplier rows and certificates. Truth: OSQP, IPOPT, the interpreted twin, problems solved by hand."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import ipopt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import wbmpc as wb
from effort import draws, thorough
from toys import LinearQuadratic, Rows, ToyDynamics, hardened_pendulum, pendulum
from wbmpc.errors import InputError, SolveFailed
from wbmpc.ocp import AugmentedLagrangian, Constraint, Cost, Mode, ModeSchedule, OptimalControlProblem, sets
from wbmpc.solver import ILQR, SLQ, SQP, InteriorPoint, Solver, Status

START = np.array([0.2, 0.5, 0.3, -0.4])


def double_integrator(*constraints: Constraint, n: int = 20, horizon: float = 2.0) -> OptimalControlProblem:
    """Position and speed, force as input; the cost pulls to the origin."""
    dynamics = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0]))
    ocp = OptimalControlProblem(dynamics, horizon, n)
    ocp.add(Cost("x", Rows(2, lambda s: s.x), [10, 1], at="path+terminal", terminal_weight=[100, 10]))
    ocp.add(Cost("u", Rows(1, lambda s: s.u), 0.1))
    for c in constraints:
        ocp.add(c)
    return ocp


def box(name: str, of: str, bound: float, at: str = "path", **more: object) -> Constraint:
    """|u| or |speed| at most ``bound``."""
    rows = Rows(1, (lambda s: s.u) if of == "u" else (lambda s: s.x[1]))
    return Constraint(name, rows, sets.Box(-bound, bound), at=at, **{"hard": True, **more})


def quadratic_program(solver: Solver, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same linear quadratic problem by OSQP, polished: x, u."""
    t = solver.problem
    n, nx, nu, p, w = t.ocp.intervals, t.nx, t.nu, solver.ws.p, solver.ws.w
    x, u = [ca.SX.sym("x", nx) for _ in range(n + 1)], [ca.SX.sym("u", nu) for _ in range(n)]
    cost, rows, upper = t.values["terminal"](x[n], p[n], w), [x[0] - x0], [np.zeros(nx)]
    for k, h in enumerate(np.diff(t.ocp.grid)):
        cost += h * t.values["cost"](x[k], u[k], p[k], w)
        rows.append(ipopt._step(solver, x[k], u[k], p[k], h) - x[k + 1])
        upper.append(np.zeros(nx))
        own, bounds = ipopt._own_rows(t.path, ca.vertcat(x[k], u[k]), t.values["rows"](x[k], u[k], p[k], w), k == 0)
        rows += own
        upper.append(np.array(bounds))
    own, bounds = ipopt._own_rows(t.end, x[n], t.values["end_rows"](x[n], p[n], w), False)
    program = {"x": ca.vertcat(*x, *u), "f": cost, "g": ca.vertcat(*rows, *own)}
    options = {"osqp": {"eps_abs": 1e-9, "eps_rel": 1e-9, "polish": True, "max_iter": 200000, "verbose": False}}
    found = ca.qpsol("q", "osqp", program, options)(lbg=0, ubg=np.concatenate([*upper, bounds]))
    z, size = np.array(found["x"]).ravel(), (n + 1) * nx
    return z[:size].reshape(n + 1, nx), z[size:].reshape(n, nu)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_double_integrator_against_osqp(backend: str) -> None:
    ocp = double_integrator(box("force", "u", 1.0), box("speed", "x", 0.6, at="path+terminal"))
    solver = Solver(ocp, SQP(backend=backend), use_cache=False)
    found = solver.solve(np.array([1.0, 0.2]))
    x, u = quadratic_program(solver, np.array([1.0, 0.2]))
    assert found.status is Status.CONVERGED, found
    np.testing.assert_allclose(found.x, x, atol=1e-6)
    np.testing.assert_allclose(found.u, u, atol=1e-5)
    assert (np.abs(u) > 0.999).sum() > 5  # both limits are met on the way
    assert (x[:, 1] < -0.599).sum() > 3


@settings(max_examples=draws(8, 12), deadline=None, derandomize=True)
@given(st.integers(1, 6), st.integers(1, 5), st.integers(1, 6), st.data())
def test_random_limits_against_osqp(nx: int, nu: int, n: int, data: st.DataObject) -> None:
    """Boxes on inputs, a general row of state and input, a row at the end; more rows than can be active."""
    seed = data.draw(st.integers(0, 999))
    rng = np.random.default_rng(seed)
    lq = LinearQuadratic(nx, nu, 0, n=n, seed=seed)
    ocp = lq.problem()
    mixed, last = rng.normal(size=(2, nx + nu)), rng.normal(size=(1, nx))
    ocp.add(Constraint("box", Rows(nu, lambda s: s.u), sets.Box(-0.3, 0.4), hard=True))
    row = Rows(2, lambda s: ca.DM(mixed) @ ca.vertcat(s.x, s.u))
    ocp.add(Constraint("mixed", row, sets.Box(-np.inf, 3.0 + 2.0 * np.abs(lq.x0).sum()), hard=True))
    ocp.add(Constraint("last", Rows(1, lambda s: ca.DM(last) @ s.x), sets.Box(-50.0, 50.0), at="terminal", hard=True))
    solver = Solver(ocp, SQP(iterations=200), use_cache=False)
    found = solver.solve(lq.x0)
    x, u = quadratic_program(solver, lq.x0)
    assert found.status is Status.CONVERGED, found
    scale = 1.0 + np.abs(x).max()
    assert np.abs(found.x - x).max() < 2e-5 * scale
    assert np.abs(found.u - u).max() < 2e-5 * scale
    assert np.abs(found.u - 0.05).max() < 0.35 + 1e-9


@pytest.mark.parametrize("algorithm", [SQP, ILQR])
@pytest.mark.parametrize("line_search", ["merit", "filter"])
def test_nonlinear_problem_against_ipopt(algorithm: type[SQP], line_search: str) -> None:
    solver = hardened_pendulum(algorithm(iterations=300, line_search=line_search))
    found = solver.solve(START)
    assert found.status is Status.CONVERGED, found
    solver.warm_start(START)
    x, u, cost = ipopt.solve(solver, START)
    np.testing.assert_allclose(found.x, x, atol=1e-6)
    np.testing.assert_allclose(found.u, u, atol=1e-5)
    assert found.cost == pytest.approx(cost, abs=1e-6)
    force = 2.0 * u[:, 0] - 1.0
    assert force.max() > 13.9 or force.min() < -14.9  # a limit is met


def test_slq_is_the_same_problem_on_a_finer_grid() -> None:
    fine = hardened_pendulum(SLQ(iterations=300, step=0.02))
    found = fine.solve(START)
    assert found.status is Status.CONVERGED
    assert np.diff(found.times).max() <= 0.02 + 1e-12
    assert set(np.round(hardened_pendulum(SQP()).ws.grid, 9)) <= set(np.round(found.times, 9))
    x, u, _ = ipopt.solve(fine, START)
    np.testing.assert_allclose(found.x, x, atol=1e-6)
    np.testing.assert_allclose(found.u, u, atol=1e-5)


@pytest.mark.parametrize("algorithm", [SQP, ILQR])
@pytest.mark.parametrize("mode", ["converge", "real_time"])
def test_same_iterates_as_the_twin(mode: str, algorithm: type[SQP]) -> None:
    interior = InteriorPoint(mode)
    a, b = (
        hardened_pendulum(algorithm(iterations=9, backend=k, interior_point=interior, max_regularization=0.0))
        for k in ("compiled", "interpreted")
    )
    for s in (a, b):
        s.iterate(START, 0.1)
    np.testing.assert_allclose(a.ws.x, b.ws.x, atol=1e-6)
    np.testing.assert_allclose(a.ws.u, b.ws.u, atol=1e-5)
    np.testing.assert_allclose(
        a.log[:9, [0, 1, 2, 3, 4, 7, 8, 9]], b.log[:9, [0, 1, 2, 3, 4, 7, 8, 9]], rtol=1e-4, atol=1e-6
    )
    count = len(a.problem.path.rows)
    twin = np.array([r.l for r in b._backend.twin.own[1:-1]])
    np.testing.assert_allclose(a.ws.rows_l[1:-1, :count], twin, rtol=1e-3, atol=1e-6)


def test_every_iterate_of_single_shooting_is_a_motion_of_the_model() -> None:
    solver = hardened_pendulum(ILQR(iterations=3, compute_kkt=False))
    solver.iterate(START)
    x = START
    np.testing.assert_array_equal(solver.ws.x[0], START)
    for k, h in enumerate(np.diff(solver.ws.grid)):
        x = solver.simulate(x, solver.ws.u[k], h)
        np.testing.assert_allclose(solver.ws.x[k + 1], x, atol=1e-9)


# ---------------------------------------------------------------------- limits that cannot be held
@pytest.mark.parametrize("slack", [20.0, 1e3])
def test_an_unreachable_state_limit_is_relaxed_exactly_and_named(slack: float) -> None:
    """Speed 2 where 0.6 is allowed and the force is limited: the L1 penalty, written with slack variables for IPOPT."""
    ocp = double_integrator(box("force", "u", 1.0), box("speed", "x", 0.6, at="path", slack=slack))
    solver = Solver(ocp, SQP(iterations=300), use_cache=False)
    x0 = np.array([1.0, 2.0])
    found = solver.solve(x0)
    assert found.status is Status.RELAXED, found
    assert found.worst is not None and found.worst.row == "speed.all[0]"
    assert found.worst.node == 1 and found.worst.value == pytest.approx(1.3, abs=1e-3)
    assert "speed.all[0]" in str(found)
    n, h = 20, 0.1
    x, u = ca.SX.sym("x", 2, n + 1), ca.SX.sym("u", n)
    over, under = ca.SX.sym("o", n), ca.SX.sym("o", n)
    cost, rows = 50.0 * x[0, n] ** 2 + 5.0 * x[1, n] ** 2, [x[:, 0] - x0]
    for k in range(n):
        cost += h * (5.0 * x[0, k] ** 2 + 0.5 * x[1, k] ** 2 + 0.05 * u[k] ** 2)
        cost += (h * slack / 1.2 * (over[k] + under[k])) if k else 0.0
        rows.append(x[:, k + 1] - ca.vertcat(x[0, k] + h * (x[1, k] + 0.5 * h * u[k]), x[1, k] + h * u[k]))
    program = {"x": ca.vertcat(ca.vec(x), u, over, under), "f": cost}
    free = [x[1, k] - over[k] for k in range(1, n)], [-x[1, k] - under[k] for k in range(1, n)]
    program["g"] = ca.vertcat(*rows, *free[0], *free[1])
    equal, soft = 2 * (n + 1), 2 * (n - 1)
    lower = np.concatenate([np.full(equal, -np.inf), -np.ones(n), np.zeros(2 * n)])
    upper = np.concatenate([np.full(equal, np.inf), np.ones(n), np.full(2 * n, np.inf)])
    options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.tol": 1e-10, "ipopt.sb": "yes"}
    bounds = {"lbg": np.concatenate([np.zeros(equal), np.full(soft, -np.inf)])}
    bounds["ubg"] = np.concatenate([np.zeros(equal), np.full(soft, 0.6)])
    answer = np.array(ca.nlpsol("s", "ipopt", program, options)(lbx=lower, ubx=upper, **bounds)["x"]).ravel()
    np.testing.assert_allclose(found.x, answer[:equal].reshape(n + 1, 2), atol=1e-5)


def test_contradicting_hard_inputs_are_infeasible_and_named() -> None:
    high = Constraint("high", Rows(1, lambda s: s.u - 2.0), sets.NonNegative(), hard=True)
    low = Constraint("low", Rows(1, lambda s: 1.0 - s.u), sets.NonNegative(), hard=True)
    found = Solver(double_integrator(high, low), SQP(), use_cache=False).solve(np.array([1.0, 0.5]))
    assert found.status is Status.INFEASIBLE
    assert "high" in found.detail or "low" in found.detail


def test_contradicting_equalities_are_infeasible_and_named() -> None:
    two = [Constraint(n, Rows(1, lambda s, v=v: s.u - v)) for n, v in (("one", 1.0), ("two", 2.0))]
    solver = Solver(double_integrator(*two), SQP(), use_cache=False)
    found = solver.solve(np.array([1.0, 0.5]))
    assert found.status is Status.INFEASIBLE
    assert found.worst is not None and found.worst.value == pytest.approx(0.5, abs=0.1)
    with pytest.raises(SolveFailed, match="cannot all be met"):
        solver.solve(np.array([1.0, 0.5]), throw=True)


def test_a_term_that_is_not_finite_is_named() -> None:
    ocp = double_integrator()
    ocp.add(Cost("bad", Rows(1, lambda s: ca.sqrt(s.x[0] - 5.0)), 1.0))
    found = Solver(ocp, SQP(), use_cache=False).solve(np.array([1.0, 0.5]))
    assert found.status is Status.NOT_FINITE
    assert "'bad' at node 0" in found.detail and "'bad'" in str(found)


def test_an_unbounded_problem_ends() -> None:
    ocp = OptimalControlProblem(ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0])), 2.0, 10)

    class Linear:
        """r itself: unbounded below."""

        value = staticmethod(lambda r: r)
        gradient = staticmethod(lambda r: ca.SX.ones(r.shape))
        curvature = staticmethod(lambda r: 1e-9 * ca.SX.ones(r.shape))

    ocp.add(Cost("down", Rows(1, lambda s: s.u), 1.0, norm=Linear()))
    found = Solver(ocp, SQP(iterations=500), use_cache=False).solve(np.array([1.0, 0.5]))
    assert found.status is Status.DIVERGED
    assert not found.usable and "largest" in found.detail


# ---------------------------------------------------------------------- multiplier rows
END = Constraint("end", Rows(2, lambda s: s.x - ca.DM([0.3, 0.0])), at="terminal")


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("penalty", [None, AugmentedLagrangian(10.0)])
def test_terminal_equality(backend: str, penalty: AugmentedLagrangian | None) -> None:
    """Relative degree two: the last input cannot do it alone."""
    term = END if penalty is None else replace(END, penalty=penalty)
    solver = Solver(double_integrator(term), SQP(backend=backend), use_cache=False)
    found = solver.solve(np.array([1.0, 0.5]))
    assert found.status is Status.CONVERGED, found
    np.testing.assert_allclose(found.x[-1], [0.3, 0.0], atol=1e-6)
    x, u, _ = ipopt.solve(solver, np.array([1.0, 0.5]))
    np.testing.assert_allclose(found.x, x, atol=2e-6)
    np.testing.assert_allclose(found.u, u, atol=2e-5)


def test_dense_terminal_equality_of_a_nonlinear_problem() -> None:
    base = pendulum()
    base.ocp.add(
        Constraint(
            "there", Rows(2, lambda s: ca.vertcat(s.x[0] + ca.sin(s.x[1]) - 0.5, s.x[2] * s.x[0])), at="terminal"
        )
    )
    solver = Solver(base.ocp, SQP(iterations=200))
    solver.set_reference("state", base.references["state"])
    found = solver.solve(START)
    assert found.status is Status.CONVERGED, found
    assert found.violations["there"].value < 1e-6
    x, u, _ = ipopt.solve(solver, START)
    np.testing.assert_allclose(found.x, x, atol=2e-6)
    np.testing.assert_allclose(found.u, u, atol=2e-5)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_state_equality_along_the_path(backend: str) -> None:
    line = Constraint("line", Rows(1, lambda s: s.x[0] + s.x[1] - 1.5), at="path+terminal")
    solver = Solver(double_integrator(line), SQP(backend=backend), use_cache=False)
    found = solver.solve(np.array([1.0, 0.5]))
    assert found.status is Status.CONVERGED, found
    np.testing.assert_allclose(found.x.sum(axis=1), 1.5, atol=1e-6)
    x, _, _ = ipopt.solve(solver, np.array([1.0, 0.5]))
    np.testing.assert_allclose(found.x, x, atol=1e-5)


@pytest.mark.parametrize("backend", ["compiled", pytest.param("interpreted", marks=thorough)])
def test_augmented_lagrangian_has_the_optimum_of_the_interior_point(backend: str) -> None:
    soft = box("force", "u", 0.5, hard=False, penalty=AugmentedLagrangian(10.0))
    a = Solver(double_integrator(soft), SQP(backend=backend), use_cache=False).solve(np.array([1.0, 0.5]))
    b = Solver(double_integrator(box("force", "u", 0.5)), SQP(), use_cache=False).solve(np.array([1.0, 0.5]))
    assert a.status is b.status is Status.CONVERGED
    np.testing.assert_allclose(a.u, b.u, atol=2e-5)
    assert (np.abs(b.u) > 0.499).any()


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_hard_rows_count_in_their_modes_only(backend: str) -> None:
    slow = box("slow", "u", 0.2, modes=("careful",))
    solver = Solver(double_integrator(slow), SQP(backend=backend), use_cache=False)
    solver.set_schedule(ModeSchedule((Mode("quick"), Mode("careful")), (1.0,)))
    found = solver.solve(np.array([1.0, 0.5]))
    assert found.status is Status.CONVERGED
    later = found.times[:-1] >= 1.0 - 1e-9
    assert np.abs(found.u[later]).max() <= 0.2 + 1e-7
    assert np.abs(found.u[~later]).max() > 1.0


# ---------------------------------------------------------------------- precision of the Riccati rows
def test_equalities_hold_beside_saturated_inputs() -> None:
    """Curvatures up to 1e8 on single inputs make the rows' Schur complement ill-conditioned: still 1e-6."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        nx, nu, ng = 4, 6, 4
        curvature = 10.0 ** rng.uniform(0, 8, size=nu) * (rng.random(nu) < 0.6) + 1.0
        c, d, e = rng.normal(size=(ng, nx)), rng.normal(size=(ng, nu)), rng.normal(size=ng)
        a, b = rng.normal(size=(nx, nx)), rng.normal(size=(nx, nu))
        dynamics = ToyDynamics(nx, nu, lambda x, u, w, m, a=a, b=b: ca.DM(a) @ x + ca.DM(b) @ u)
        ocp = OptimalControlProblem(dynamics, 1.0, 4)
        ocp.add(Cost("x", Rows(nx, lambda s: s.x), at="path+terminal"))
        ocp.add(Cost("u", Rows(nu, lambda s: s.u), list(curvature)))
        ocp.add(Constraint("rows", Rows(ng, lambda s, c=c, d=d, e=e: ca.DM(c) @ s.x + ca.DM(d) @ s.u + ca.DM(e))))
        solver = Solver(ocp, SQP(iterations=1, compute_kkt=False, accept_min_step=True), use_cache=False)
        solver.iterate(rng.normal(size=nx))
        left = solver.ws.x[:-1] @ c.T + solver.ws.u @ d.T + e
        assert np.abs(left).max() < 1e-6, seed


def test_bad_settings() -> None:
    for make, message in (
        (lambda: InteriorPoint("fast"), "interior point mode"),  # type: ignore[arg-type]
        (lambda: InteriorPoint(barrier=0.0), "barrier must be positive"),
        (lambda: InteriorPoint(fraction_to_boundary=1.0), "fraction_to_boundary"),
        (lambda: SQP(line_search="none"), "line search"),  # type: ignore[arg-type]
        (lambda: SLQ(step=0.0), "step must be positive"),
        (lambda: ILQR(iterations=0), "ILQR: iterations"),
        (lambda: SQP(tolerance=0.0), "tolerance"),
        (lambda: SQP(tolerance=np.inf), "tolerance must be positive and finite"),
        (lambda: InteriorPoint(barrier=np.inf), "barrier must be positive and finite"),
    ):
        with pytest.raises(InputError, match=message):
            make()


@pytest.mark.parametrize("n", [100, 400])
@pytest.mark.parametrize("speed", [0.75, 1.5])
@pytest.mark.parametrize("slack", [1e3, 1e5])
def test_a_start_far_outside_a_limit_with_many_nodes(n: int, speed: float, slack: float) -> None:
    """Truth: nothing brakes harder than −1, so that after t seconds the speed is at least ``speed`` − t: that, and no more.

    From a guess that is inside this took up to 439 iterations, beyond the default.
    """
    ocp = OptimalControlProblem(ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0])), 1.0, n)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), [10.0, 1.0], at="path+terminal"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.1))
    ocp.add(Constraint("force", Rows(1, lambda s: s.u), sets.Box(-1.0, 1.0), hard=True))
    ocp.add(Constraint("speed", Rows(1, lambda s: s.x[1]), sets.Box(-0.5, 0.5), hard=True, slack=slack))
    found = Solver(ocp).solve(np.array([0.0, speed]))
    assert found.status is Status.RELAXED and found.iterations < 80, str(found)
    outside = found.times[:-1] < speed - 0.5 - 1.5 / n
    np.testing.assert_allclose(found.u[outside], -1.0, atol=1e-5)
    np.testing.assert_allclose(found.x[:-1][outside, 1], speed - found.times[:-1][outside], atol=1e-5)


def test_the_log_has_a_row_for_every_iteration() -> None:
    """A restart and extra iterations after cut steps come together; a last one with held inputs would have the last row."""
    real_time = SQP.real_time(interior_point=InteriorPoint("real_time", 3e-2))
    solver = hardened_pendulum(real_time, n=8, equality=False)
    rng = np.random.default_rng(0)
    counts = [solver.iterate(rng.normal(size=4) * rng.choice([3.0, 10.0]), 0.0)[1] for _ in range(300)]
    assert len(solver.log) - 1 <= max(counts) <= len(solver.log)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_after_a_jump_few_real_time_solves_come_to_the_quadratic_programs_plan(backend: str) -> None:
    """A mass in the plane at rest whose goal jumps by 1.7 m: its force is at limits, then its speed. Multipliers of the rest do not feel
    the limits, and with their barrier parameter slacks cut every step to a hundredth: the plan was still 1.4 off after six solves."""
    dynamics = ToyDynamics(4, 2, lambda x, u, w, m: ca.vertcat(x[2:], u))
    ocp = OptimalControlProblem(dynamics, 4.0, 40)
    ocp.add(Cost("place", Rows(2, lambda s: s.x[:2]), 4e3, at="path+terminal"))
    ocp.add(Cost("input", Rows(2, lambda s: s.u), 0.1))
    ocp.add(Constraint("force", Rows(2, lambda s: s.u), sets.Box(-1.0, 1.0), hard=True))
    ocp.add(Constraint("speed", Rows(2, lambda s: s.x[2:]), sets.Box(-0.5, 0.5), hard=True, slack=1e6))
    solver, jumped = Solver(ocp, SQP.real_time(backend=backend)), np.array([1.5, -0.7, 0.0, 0.0])
    for _ in range(3):
        solver.iterate(np.zeros(4), 0.0)
    _, truth = quadratic_program(solver, jumped)
    for _ in range(3):
        solver.iterate(jumped, 0.0)
    assert np.abs(solver.ws.u - truth).max() < 0.06
    assert np.abs(solver.ws.u[0] - truth[0]).max() < 1e-3
    _, count = solver.iterate(jumped, 0.0)
    assert count == 1  # the barrier parameter is as small as ever


def test_a_limit_of_a_few_micrometers_that_gives_way_is_reported() -> None:
    """A box of ±3 µm, entered at 9 µm/s with a drive of 3 µm/s²: whatever it does, it stops 13.5 µm further."""
    unit = 3e-6
    ocp = OptimalControlProblem(ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0])), 2.0, 20)
    ocp.add(Cost("state", Rows(2, lambda s: s.x / unit), at="path+terminal"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u / unit), 0.1))
    ocp.add(Constraint("place", Rows(1, lambda s: s.x[:1]), sets.Box(-unit, unit), hard=True, at="path+terminal"))
    ocp.add(Constraint("force", Rows(1, lambda s: s.u), sets.Box(-unit, unit), hard=True))
    found = Solver(ocp).solve(np.array([0.0, 3.0 * unit]))
    assert found.violations["place"].value > unit
    assert found.status is Status.RELAXED and "place" in found.detail


@pytest.mark.parametrize("at", ["path", "path+terminal"])
def test_a_constraint_without_rows_changes_nothing(at: str) -> None:
    nothing = Constraint("nothing", Rows(0, lambda s: ca.SX(0, 1)), sets.NonNegative(), hard=True, at=at)  # type: ignore[arg-type]
    with_it, without = (
        Solver(double_integrator(*c), SQP(backend="interpreted")).solve(np.array([1.0, 0.0])) for c in ([nothing], [])
    )
    assert with_it.status is Status.CONVERGED and "nothing" not in with_it.violations
    np.testing.assert_allclose(with_it.u, without.u, atol=1e-8)


@pytest.mark.parametrize("unit", [1e-9, 1e-12])
def test_a_box_in_a_tiny_unit_is_no_equality(unit: float) -> None:
    """|unit u| ≤ 2 unit is |u| ≤ 2, the truth: its bounds are near each other as numbers, not as what inputs may do."""
    dynamics = wb.Ode({"x": ["p", "v"]}, {"u": ["a"]}, lambda x, u: ca.vertcat(x[1], u[0]))

    def solved(scale: float) -> wb.Solution:
        ocp = wb.OptimalControlProblem(dynamics, horizon=1.0, intervals=20)
        ocp.add(wb.Cost("state", wb.residuals.State(dynamics), [30.0, 1.0], at="path+terminal"))
        ocp.add(wb.Cost("effort", wb.residuals.Expression(1, lambda s: s.u), 0.01))
        bound = wb.sets.Box(-2.0 * scale, 2.0 * scale)
        ocp.add(wb.Constraint("limit", wb.residuals.Expression(1, lambda s: scale * s.u), bound, hard=True))
        return wb.Solver(ocp).solve(np.array([1.0, 0.0]))

    truth, found = solved(1.0), solved(unit)
    assert truth.status is found.status is wb.Status.CONVERGED and np.abs(truth.u).max() > 1.9
    np.testing.assert_allclose(found.u, truth.u, atol=1e-6)
