"""ViewScene derivatives of the experiments' problems. Truth: finite differences of the values, and JᵀWJ of the residuals."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toys import Rows, ToyDynamics, pendulum, random_stage, rezero_solver, robot, swerve_solver
from wbmpc.bases.ball.residuals import BallSpin
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, RelaxedBarrier, SmoothL1, Transcription, residuals, sets
from wbmpc.ocp.parameters import default_weights, mode_tables

MAKERS = {
    "swerve": lambda: swerve_solver(backend="interpreted"),
    "rezero": lambda: rezero_solver(backend="interpreted"),
    "pendulum": lambda: pendulum("interpreted"),
}


@pytest.fixture(scope="module", params=MAKERS)
def solver(request):  # type: ignore[no-untyped-def]
    return MAKERS[request.param]()


def differences(function, z: np.ndarray, h: float = 1e-5) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Jacobian by central differences of fourth order."""
    steps = [
        (function(z - 2 * d) - 8 * function(z - d) + 8 * function(z + d) - function(z + 2 * d))
        for d in h * np.eye(z.size)
    ]
    return np.array(steps).T / (12 * h)


def points(solver, count: int = 3):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(8)
    return [random_stage(solver, rng) for _ in range(count)]


def of_z(solver, function, p, w):  # type: ignore[no-untyped-def]
    nx = solver.problem.nx
    return lambda z: np.array(function(z[:nx], z[nx:], p, w)).ravel()


@pytest.mark.parametrize(
    ("value", "derivative"), [("dynamics", "dynamics_jacobian"), ("equality", "equality_jacobian")]
)
def test_jacobians(solver, value: str, derivative: str) -> None:  # type: ignore[no-untyped-def]
    for x, u, p, w in points(solver):
        f, jacobian = solver.problem.derivatives[derivative](x, u, p, w)
        np.testing.assert_allclose(
            np.array(f), np.array(solver.problem.values[value](x, u, p, w)), rtol=1e-10, atol=1e-10
        )
        want = differences(of_z(solver, solver.problem.values[value], p, w), np.concatenate([x, u]))
        if want.size:
            np.testing.assert_allclose(np.array(jacobian), want, atol=1e-6 * (1.0 + np.abs(want).max()))


def test_cost_gradient(solver) -> None:  # type: ignore[no-untyped-def]
    problem, h = solver.problem, 0.07
    for x, u, p, w in points(solver):
        value, gradient, _ = problem.derivatives["cost_quadratic"](x, u, p, w, h)
        assert float(value) == pytest.approx(h * float(problem.values["cost"](x, u, p, w)), rel=1e-12)
        want = h * differences(of_z(solver, problem.values["cost"], p, w), np.concatenate([x, u]))[0]
        np.testing.assert_allclose(np.array(gradient).ravel(), want, atol=1e-7 * (1.0 + np.abs(want).max()))
        value, gradient, _ = problem.derivatives["terminal_quadratic"](x, p, w)
        want = differences(lambda z, p=p, w=w: np.array(problem.values["terminal"](z, p, w)).ravel(), x)[0]
        np.testing.assert_allclose(np.array(gradient).ravel(), want, atol=1e-7 * (1.0 + np.abs(want).max()))


def gauss_newton(solver, place: str, stage) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Σ Jᵀ W J over the costs, J by finite differences of each residual, W from the terms as they were given."""
    problem, (x, u, p, w) = solver.problem, stage
    z = np.concatenate([x, u]) if place == "path" else x
    total, nx = np.zeros((z.size, z.size)), problem.nx
    for cost in solver.ocp.costs:
        if cost.at not in (place, "path+terminal"):
            continue
        residual = ca.Function(
            "r", [problem.x, problem.u, problem.p, problem.w], [cost.residual(problem.symbols(cost.name))]
        )
        r = lambda z, f=residual: np.array(f(z[:nx], z[nx:] if z.size > nx else u, p, w)).ravel()
        weight = cost.weight if place == "path" or cost.terminal_weight is None else cost.terminal_weight
        curve = np.array(ca.DM(cost.norm.curvature(ca.DM(r(z))))).ravel() if isinstance(cost.norm, SmoothL1) else 1.0
        j = differences(r, z)
        total += j.T @ np.diag(cost.expand(weight) * curve) @ j
    return total


def test_hessian_is_gauss_newton(solver) -> None:  # type: ignore[no-untyped-def]
    h = 0.07
    for stage in points(solver, 2):
        x, u, p, w = stage
        upper = np.array(solver.problem.derivatives["cost_quadratic"](x, u, p, w, h)[2])
        want = h * gauss_newton(solver, "path", stage)
        for constraint, row in solver.problem.path.general_barriers:
            z = solver.problem.z
            j = np.array(ca.DM(ca.Function("j", [z], [ca.densify(ca.jacobian(row, z))])(np.concatenate([x, u]))))
            value = ca.Function("h", [z], [row])(np.concatenate([x, u]))
            safe = np.maximum(np.array(value).ravel(), constraint.penalty.delta)
            want += h * j.T @ np.diag(constraint.penalty.mu / safe**2) @ j
        np.testing.assert_allclose(np.triu(want), upper, atol=1e-6 * (1.0 + np.abs(want).max()))
        upper = np.array(solver.problem.derivatives["terminal_quadratic"](x, p, w)[2])
        want = gauss_newton(solver, "terminal", stage)
        if not solver.problem.path.general_barriers:
            np.testing.assert_allclose(np.triu(want), upper, atol=1e-6 * (1.0 + np.abs(want).max()))


def test_switched_terms_count_in_their_modes_only() -> None:
    from wbmpc.ocp import Mode, ModeSchedule

    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u, mode=1), 1.0, 2)
    ocp.add(Cost("always", Rows(1, lambda s: s.x), 2.0))
    ocp.add(Cost("sometimes", Rows(1, lambda s: s.u), 2.0, modes=("b",)))
    ocp.add(Constraint("tied", Rows(1, lambda s: s.u - 3.0), modes=("a",)))
    ocp.add(
        Constraint("soft", Rows(1, lambda s: s.x), sets.NonNegative(), modes=("b",), penalty=RelaxedBarrier(1.0, 0.1))
    )
    problem = Transcription(ocp)
    schedule = ModeSchedule((Mode("a", {"m": [7.0]}), Mode("b"), Mode("c")), (0.1, 0.2))
    tables = mode_tables(problem, schedule)
    np.testing.assert_array_equal(tables, [[7, 0, 1, 0], [0, 1, 0, 1], [0, 0, 0, 0]])
    w = default_weights(problem)
    cost = [float(problem.values["cost"](2.0, 5.0, row, w)) for row in tables]
    np.testing.assert_allclose(cost, [4.0, 4.0 + 25.0 - np.log(2.0), 4.0], rtol=1e-12)
    rows = [float(problem.values["equality"](2.0, 5.0, row, w)) for row in tables]
    assert rows == [2.0, 0.0, 0.0]


def test_spin_of_the_ball_is_the_vertical_part_of_the_wheels_torque() -> None:
    """By statics: each wheel's friction acts at its contact, horizontally along a circle of radius r sin z; with the
    force τ / r_w its torque about the vertical is (r / r_w) sin z τ, and all three add up. Under a base that leans the circles lean too:
    what these forces do about the vertical is their moment about the ball's center."""
    ball = robot("rezero")
    x, u = ca.SX.sym("x", ball.state.size), ca.SX.sym("u", ball.input.size)
    empty = ca.SX(0, 1)
    spin = ca.Function("spin", [x, u], [BallSpin(ball)(residuals.Symbols(x, u, empty, empty, empty, x, u))])
    torque = np.array([1.0, 2.5, -0.5, 7.0, 8.0, 9.0])
    upright, tilted = np.zeros(ball.state.size), np.zeros(ball.state.size)
    tilted[2:5] = 0.4, 0.3, -0.2
    radius, wheel, zenith = 0.125, 0.064, np.pi / 4
    assert float(spin(upright, torque)) == pytest.approx(radius / wheel * np.sin(zenith) * 3.0)
    turned, moment = Rotation.from_euler("ZYX", tilted[2:5]).as_matrix(), np.zeros(3)
    for azimuth, own in zip(ball.description.base.wheels.azimuths, torque[:3], strict=True):
        place = radius * np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
        around = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        moment += np.cross(turned @ place, turned @ (own / wheel * around))
    assert float(spin(tilted, torque)) == pytest.approx(moment[2])
