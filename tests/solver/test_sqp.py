"""The SQP iteration. Truth: the interpreted twin; statuses and speeds as promised."""

from __future__ import annotations

import time
from dataclasses import replace

import casadi as ca
import ipopt
import numpy as np
import pytest

from toys import LinearQuadratic, Rows, ToyDynamics, hardened_pendulum, pendulum, rezero_solver, robot, swerve_solver
from wbmpc.errors import InputError, NotFinite
from wbmpc.ocp import Cost, Mode, ModeSchedule, OptimalControlProblem
from wbmpc.solver import ILQR, SLQ, SQP, Solver, Status
from wbmpc.solver.solution import COLUMNS
from wbmpc.solver.workspace import LOG

START = np.array([0.2, 0.5, 0.3, -0.4])


@pytest.mark.parametrize("equality", [True, False])
@pytest.mark.parametrize("integrator", ["rk2", "rk4"])
def test_same_iterates_as_the_twin(integrator: str, equality: bool) -> None:
    """Rows, boxes with |scale| ≠ 1, a general barrier, a smooth L1 norm, modes, parameters, a geometric grid."""
    solvers = [pendulum(b, integrator, equality=equality, iterations=1) for b in ("compiled", "interpreted")]
    schedule = ModeSchedule((Mode("a", {"m": [0.0]}), Mode("b", {"m": [0.7]})), (0.5,))
    for s in solvers:
        s.set_schedule(schedule)
        s.set_parameters({"w": np.array([0.4])})
    for _ in range(12):
        for s in solvers:
            s.iterate(START, 0.1)
        a, b = solvers
        np.testing.assert_allclose(a.ws.x, b.ws.x, rtol=0, atol=1e-7)
        np.testing.assert_allclose(a.ws.u, b.ws.u, rtol=0, atol=1e-6)
        np.testing.assert_allclose(a.ws.k[:, :, :4], b.ws.k, rtol=1e-5, atol=1e-5)
        shared = [LOG.index(n) for n in ("cost", "violation", "kkt", "step", "alpha")]
        np.testing.assert_allclose(a.log[0, shared], b.log[0, shared], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("make", [swerve_solver, rezero_solver])
def test_robots_iterate_like_the_twin(make) -> None:  # type: ignore[no-untyped-def]
    a, b = make(n=4, iterations=3, compute_kkt=False), make(n=4, iterations=3, compute_kkt=False, backend="interpreted")
    x0 = robot("swerve-ur10" if make is swerve_solver else "rezero").home
    za, zb = a.solve(x0), b.solve(x0)
    # the swerve's side-slip rows are dependent: the last digits go into which of them carries the load
    np.testing.assert_allclose(za.x, zb.x, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(za.u, zb.u, rtol=1e-4, atol=1e-3)


def test_whole_solves_agree_and_the_certificate_holds() -> None:
    a, b = (pendulum(backend, iterations=200).solve(START) for backend in ("compiled", "interpreted"))
    assert a.status is b.status is Status.CONVERGED
    assert a.kkt <= 1e-8 and a.violation <= 1e-6
    np.testing.assert_allclose(a.x, b.x, atol=1e-8)
    assert a.cost == pytest.approx(b.cost, rel=1e-9)
    assert "converged" in str(a) and a.usable


def test_same_call_same_bits() -> None:
    a, b = (pendulum(iterations=40).solve(START) for _ in range(2))
    np.testing.assert_array_equal(a.x, b.x)
    np.testing.assert_array_equal(a.log, b.log)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_not_finite_start(backend: str) -> None:
    for bad in (np.nan, np.inf, 1e200):
        solver = pendulum(backend)
        solver.ws.x[:] = bad  # as a solve may leave it; a guess has to be finite
        with np.errstate(all="ignore"):
            found = solver.solve(START)
        assert found.status is Status.NOT_FINITE, bad
        assert found.iterations == 1
        assert not found.usable


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_nan_in_one_late_node_is_seen(backend: str) -> None:
    solver = pendulum(backend)
    solver.warm_start(np.zeros(4))
    solver.ws.x[-1, 3] = np.nan
    with np.errstate(all="ignore"):
        assert solver.solve(START).status is Status.NOT_FINITE


def test_iteration_limit() -> None:
    found = pendulum(iterations=2).solve(START)
    assert found.status is Status.ITERATION_LIMIT
    assert found.iterations == 2
    assert len(found.log) == 2


def cliff(backend: str, **sqp: object) -> Solver:
    """A cost whose Gauss-Newton step always leaves the domain of the logarithm."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u), 1.0, 2)

    def f(s):  # type: ignore[no-untyped-def]
        import casadi as ca

        return ca.sqrt(1e-6 - s.u * s.u) * 1e3 + 1e4 * s.u

    ocp.add(Cost("cliff", Rows(1, f), 1.0))
    return Solver(ocp, SQP(backend=backend, **sqp))


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("force", [True, False])
def test_a_step_to_nowhere_is_not_taken(backend: str, force: bool) -> None:
    solver = cliff(backend, iterations=5, min_step=0.2, accept_min_step=force, compute_kkt=False)
    with np.errstate(all="ignore"):
        found = solver.solve(np.array([0.0]))
    assert found.status in (Status.LINE_SEARCH_FAILED, Status.ITERATION_LIMIT)
    assert np.isfinite(found.u).all()
    assert np.isfinite(found.x).all()


def test_merit_decreases_on_the_way() -> None:
    """From an infeasible start the violation goes to zero and no accepted iterate is worse in both."""
    found = pendulum(iterations=100).solve(START)
    cost, violation = found.log[:, 0], found.log[:, 1]
    assert violation[-1] < 1e-6 < violation[0]
    worse = (np.diff(cost) > 1e-6) & (np.diff(violation) > 1e-6)
    assert not worse.any()


def test_linear_quadratic_problem_converges() -> None:
    lq = LinearQuadratic(4, 3, 1, n=8, seed=11)
    solver = Solver(lq.problem(), SQP(iterations=50), use_cache=False)
    found = solver.solve(lq.x0)
    x, u = lq.kkt(lq.x0)
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.x, x, atol=1e-6)
    np.testing.assert_allclose(found.u, u, atol=1e-5)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_short_horizons(n: int) -> None:
    lq = LinearQuadratic(3, 2, 1, n=n, seed=3)
    found = Solver(lq.problem(), SQP(iterations=60), use_cache=False).solve(lq.x0)
    np.testing.assert_allclose(found.u, lq.kkt(lq.x0)[1], atol=1e-5)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_simulate_takes_whole_states_and_inputs_alone(backend: str) -> None:
    """Compiled code knows addresses and no lengths: it would read on beyond the end."""
    lq = LinearQuadratic(3, 2, 0)
    solver = Solver(lq.problem(), SQP(backend=backend))
    x, u = np.zeros(3), np.zeros(2)
    for bad in (
        (0.0, u),
        (np.zeros(0), u),
        (np.zeros(4), u),
        (np.zeros((1, 3)), u),
        (x, 0.0),
        (x, np.zeros(1)),
        (x, np.zeros((2, 1))),
    ):
        with pytest.raises(InputError, match="simulate: 3 states and 2 inputs are needed, got shapes"):
            solver.simulate(*bad, 0.1)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_simulate_takes_finite_numbers_alone(backend: str) -> None:
    """What is not finite would come back as a state, and a step that is no number as a TypeError of ctypes."""
    lq = LinearQuadratic(3, 2, 0)
    solver = Solver(lq.problem(), SQP(backend=backend))
    x, u, many = np.ones(3), np.ones(2), np.ones((70, 2))
    for bad in (np.nan, np.inf, -np.inf):
        for i in range(3):
            with pytest.raises(NotFinite, match=f"simulate: '{solver.ocp.dynamics.state.names[i]}' must be finite"):
                solver.simulate(np.where(np.arange(3) == i, bad, x), u, 0.1)
        for inputs in (u, many):
            with pytest.raises(NotFinite, match=rf"simulate: '{solver.ocp.dynamics.input.names[1]}' must be finite"):
                solver.simulate(x, np.where(np.arange(2) == 1, bad, inputs), 0.1)
        with pytest.raises(NotFinite, match="simulate: the step must be finite"):
            solver.simulate(x, u, bad)
    for step in (None, "0.1", True, [0.1], np.ones(2), 1j, -0.1, object()):
        with pytest.raises(InputError, match="simulate"):
            solver.simulate(x, u, step)
    for step in (np.float32(0.25), np.float64(0.25), np.array(0.25)):
        np.testing.assert_array_equal(solver.simulate(x, u, step), solver.simulate(x, u, 0.25))
    np.testing.assert_array_equal(solver.simulate(x, u, 0), x)


@pytest.mark.parametrize("integrator", ["rk2", "rk4"])
def test_simulate_is_the_twins_step_and_the_truth(integrator: str) -> None:
    """rk4 with small steps against SciPy's integrator; both backends alike."""
    from scipy.integrate import solve_ivp

    a, b = pendulum("compiled", integrator), pendulum("interpreted", integrator)
    u = np.array([1.5, -0.5])
    a.iterate(START), b.iterate(START)
    np.testing.assert_allclose(a.simulate(START, u, 0.03), b.simulate(START, u, 0.03), atol=1e-13)
    f = a.problem.values["dynamics"]
    rhs = lambda t, x: np.array(f(x, u, a.ws.p[0], a.ws.w)).ravel()
    truth = solve_ivp(rhs, (0.0, 0.5), START, rtol=1e-11, atol=1e-12).y[:, -1]
    x = START
    for _ in range(100):
        x = a.simulate(x, u, 0.005)
    np.testing.assert_allclose(x, truth, atol=1e-4 if integrator == "rk2" else 1e-9)


def fastest(function, count: int) -> float:  # type: ignore[no-untyped-def]
    times = []
    for _ in range(count):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def test_compiled_iterations_are_much_faster_than_interpreted() -> None:
    model = robot("swerve-ur10")
    quick = {"iterations": 1, "compute_kkt": False, "accept_min_step": True, "min_step": 0.2}
    a, b, c = (
        swerve_solver(**quick),
        swerve_solver(backend="interpreted", **quick),
        swerve_solver(**{**quick, "compute_kkt": True}),
    )
    compiled, interpreted = fastest(lambda: a.iterate(model.home), 100), fastest(lambda: b.iterate(model.home), 2)
    assert interpreted > 20.0 * compiled
    assert fastest(lambda: c.iterate(model.home), 100) < 3.0 * compiled


@pytest.mark.parametrize("algorithm", [SQP, ILQR])
@pytest.mark.parametrize("line_search", ["merit", "filter"])
def test_a_step_that_fails_is_damped(algorithm: type[SQP], line_search: str) -> None:
    """Gauss-Newton overshoots where the arc tangent is flat; with full steps only, the Levenberg-Marquardt shift must help."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u), 1.0, 4)
    ocp.add(Cost("turn", Rows(1, lambda s: ca.atan(5.0 * (s.u - 1.0))), 1.0))
    ocp.add(Cost("still", Rows(1, lambda s: s.x), 1e-3, at="path+terminal"))
    found = []
    for shift in (0.0, 1e6):
        settings = algorithm(iterations=200, line_search=line_search, min_step=0.9, max_regularization=shift)
        solver = Solver(ocp, settings)
        solver.warm_start(np.zeros((5, 1)), np.full((4, 1), 5.0))
        found.append(solver.solve(np.zeros(1)))
    undamped, damped = found
    assert (
        undamped.status in (Status.LINE_SEARCH_FAILED, Status.INFEASIBLE)
        and undamped.log[:, COLUMNS["shift"]].max() == 0.0
    )
    assert damped.status is Status.CONVERGED, damped
    np.testing.assert_allclose(damped.u, 1.0, atol=1e-4)  # as far as the small pull to 0 lets it
    assert damped.log[:, COLUMNS["shift"]].max() > 0.1 and damped.log[-1, COLUMNS["shift"]] < 1e-4


def test_slq_takes_a_guess_on_the_grid_of_the_problem() -> None:
    """A ramp and a staircase: linear states and held inputs, read off between the nodes that were given."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u), 1.0, 2, grid=[0.0, 0.4, 1.0])
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 1.0))
    solver = Solver(ocp, SLQ(step=0.2))
    solver.warm_start(np.array([[0.0], [4.0], [10.0]]), np.array([[1.0], [2.0]]))
    np.testing.assert_allclose(solver.ws.x.ravel(), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0])
    np.testing.assert_allclose(solver.ws.u.ravel(), [1.0, 1.0, 2.0, 2.0, 2.0])
    with pytest.raises(InputError, match=r"warm start, x: .* are needed, got"):
        solver.warm_start(np.zeros((4, 1)))


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("made", [pendulum, hardened_pendulum], ids=["soft", "hard"])
@pytest.mark.parametrize(
    "settings", [SQP(iterations=3), SQP.real_time(2), ILQR(iterations=3)], ids=lambda s: type(s).__name__
)
def test_cost_and_violation_are_those_of_the_returned_trajectory(settings: SQP, made, backend: str) -> None:  # type: ignore[no-untyped-def]
    """Truth: costs and relaxed barriers added up again, without what the interior point adds; the gaps likewise."""
    base = made()
    solver = Solver(base.ocp, replace(settings, backend=backend))
    solver.set_reference("state", base.references["state"])
    found = solver.solve(START)
    assert found.status is Status.ITERATION_LIMIT
    t, p, w, n = solver.problem, solver.ws.p, solver.ws.w, len(found.u)
    path, end = ipopt._boxes(t.path.barriers, t.nx + t.nu), ipopt._boxes(t.end.barriers, t.nx)
    cost, gaps = float(t.values["terminal"](found.x[n], p[n], w) + end(found.x[n])), 0.0
    for k, h in enumerate(np.diff(found.times)):
        z = np.concatenate([found.x[k], found.u[k]])
        cost += h * float(t.values["cost"](found.x[k], found.u[k], p[k], w) + path(z))
        gaps += float(np.abs(solver_step(solver, found.x[k], found.u[k], p[k], h) - found.x[k + 1]).sum())
    assert found.cost == pytest.approx(cost, rel=1e-9)
    assert abs(found.log[-1, COLUMNS["cost"]] - cost) > 1e-6  # the iterate before the last step has another
    equalities = [np.abs(np.array(t.values["equality"](found.x[k], found.u[k], p[k], w))).sum() for k in range(n)]
    least = gaps + sum(equalities) + np.abs(found.x[0] - START).sum()
    if made is pendulum:
        assert found.violation == pytest.approx(least, rel=1e-6, abs=1e-12)
    else:
        assert found.violation >= least - 1e-9  # the rows' own residuals come on top


def solver_step(solver: Solver, x: np.ndarray, u: np.ndarray, p: np.ndarray, h: float) -> np.ndarray:
    """One step of the integrator, rewritten."""
    return np.array(ca.evalf(ipopt._step(solver, ca.SX(x), ca.SX(u), p, h))).ravel()
