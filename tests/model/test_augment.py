"""Wrapped inputs. Independent truth: the exponential of a first-order lag, the integral of a rate, finite differences."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import scipy.linalg

from effort import some
from toys import Rows, ToyDynamics
from wbmpc.errors import InputError
from wbmpc.model.augment import DriveLag, FrequencyShaping, InputFilter, InputRate
from wbmpc.model.robot import load_robot
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, Reference, RelaxedBarrier, residuals, sets
from wbmpc.solver import SQP, Solver, Status


def arm_problem(dynamics, robot) -> OptimalControlProblem:
    ocp = OptimalControlProblem(dynamics, 2.0, 40)
    ocp.add(Cost("posture", residuals.State(robot), {"arm": 10.0, "base": 1.0}, at="path+terminal"))
    ocp.add(
        Cost(
            "speed",
            residuals.Input(robot, reference=None),
            {"base": 1.0, "leg": 1.0, "steer": 1.0, "wheel": 0.01, "arm": 0.1},
        )
    )
    ocp.add(Constraint("rolling", residuals.Rolling(robot)))
    return ocp


def goal_of(robot) -> np.ndarray:
    goal = robot.home.copy()
    goal[robot.state["arm"]] += 0.4
    return goal


def test_acceleration_limits_hold_and_the_arm_arrives() -> None:
    robot = load_robot("swerve-ur10")
    dynamics = InputRate(robot.dynamics(), ["arm"])
    ocp = arm_problem(dynamics, robot)
    rate = residuals.ProblemInput(dynamics, ["arm_rate"])
    ocp.add(Cost("acceleration", rate, 1e-3))
    ocp.add(Constraint("accelerations", rate, sets.Box(-2.0, 2.0), penalty=RelaxedBarrier(1e-3, 1e-2)))
    solver = Solver(ocp, SQP(iterations=100))
    solver.set_reference("posture", Reference.constant(goal_of(robot)))
    start = np.concatenate([robot.home, np.zeros(6)])
    solver.warm_start(start)
    solution = solver.solve(start)
    assert solution.status is Status.CONVERGED
    acceleration = solution.u[:, dynamics.input["arm_rate"]]
    assert np.abs(acceleration).max() <= 2.02
    assert np.abs(acceleration).max() > 1.0
    # the speeds in the state are the integral of the accelerations
    speeds = solution.x[:, dynamics.state["arm_input"]]
    np.testing.assert_allclose(np.diff(speeds, axis=0), acceleration * 0.05, atol=1e-9)
    np.testing.assert_allclose(solution.x[-1, robot.state["arm"]], goal_of(robot)[robot.state["arm"]], atol=0.02)


def test_drive_lag_follows_the_exponential() -> None:
    robot = load_robot("swerve-ur10")
    dynamics = DriveLag(robot.dynamics(), {"arm": 0.1})
    solver = Solver(arm_problem(dynamics, robot))
    x = np.concatenate([robot.home, np.zeros(6)])
    u = np.zeros(21)
    u[robot.input["arm"]] = 0.5
    for _ in range(200):
        x = solver.simulate(x, u, 1e-3)
    np.testing.assert_allclose(x[dynamics.state["arm_actual"]], 0.5 * (1.0 - np.exp(-2.0)), rtol=1e-5)
    traveled = 0.5 * (0.2 - 0.1 * (1.0 - np.exp(-2.0)))
    np.testing.assert_allclose(x[robot.state["arm"]] - robot.home[robot.state["arm"]], traveled, rtol=1e-4)


@pytest.mark.parametrize(
    "wrap",
    [
        lambda d: InputRate(d, ["wheel"]),
        lambda d: DriveLag(d, {"wheel": 0.02, "arm": 0.05}),
        lambda d: FrequencyShaping(d, {"wheel": InputFilter(30.0, 200.0), "arm": InputFilter(5.0, 40.0, 2.0)}),
    ],
)
def test_jacobian_against_finite_differences(wrap) -> None:
    dynamics = wrap(load_robot("rezero").dynamics())
    nx, nu = dynamics.state.size, dynamics.input.size
    x, u, w = ca.SX.sym("x", nx), ca.SX.sym("u", nu), ca.SX.sym("w", dynamics.parameters.size)
    f, j = dynamics.jacobian(x, u, w, ca.SX(0, 1))
    both = ca.Function("f", [ca.vertcat(x, u), w], [f, j])
    plain = ca.Function("g", [ca.vertcat(x, u), w], [dynamics(x, u, w, ca.SX(0, 1))])
    rng = np.random.default_rng(0)
    z, parameters = 0.2 * rng.normal(size=nx + nu), np.zeros(dynamics.parameters.size)
    value, jacobian = (np.array(v) for v in both(z, parameters))
    np.testing.assert_allclose(value, np.array(plain(z, parameters)), atol=1e-10)
    h = 1e-6
    difference = [
        np.array(plain(z + h * e, parameters) - plain(z - h * e, parameters)).ravel() / (2 * h) for e in np.eye(nx + nu)
    ]
    np.testing.assert_allclose(jacobian, np.array(difference).T, atol=1e-5)


@pytest.mark.parametrize("frequency", some([2.0, 20.0, 150.0], [1]))
def test_filter_has_its_frequency_response(frequency: float) -> None:
    """Truth: the transfer function; a long simulation with a sine as ν gives u with amplitude 1 / |weight|."""
    toy = ToyDynamics(1, 1, lambda x, u, w, m: u[0])
    f = InputFilter(10.0, 60.0)
    dynamics = FrequencyShaping(toy, {"u": f})
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 1)
    empty = ca.SX(0, 1)
    derivative = ca.Function("f", [x, u], [dynamics(x, u, empty, empty), dynamics.view(x, u)[1]])
    h, state, seen = 4e-4, np.zeros(2), []
    for k in range(int(3.0 / h) + int(2 * np.pi / frequency / h)):
        half = state + 0.5 * h * np.array(derivative(state, np.sin(frequency * h * k))[0]).ravel()
        slope, acting = derivative(half, np.sin(frequency * h * (k + 0.5)))
        state = state + h * np.array(slope).ravel()
        seen.append(float(acting))
    last = np.array(seen[int(3.0 / h) :])
    assert np.abs(last).max() == pytest.approx(1.0 / float(f.weight(frequency)), rel=2e-3)


def test_filters_start_at_rest() -> None:
    robot = load_robot("rezero")
    dynamics = FrequencyShaping(
        robot.dynamics(), {"wheel": InputFilter(30.0, 200.0), "arm": InputFilter(5.0, 40.0, 2.0)}
    )
    u = np.random.default_rng(0).normal(size=robot.input.size)
    x, wrapped = dynamics.equilibrium(robot.home, u)
    sx, su, w = ca.SX.sym("x", x.size), ca.SX.sym("u", wrapped.size), ca.SX.sym("w", dynamics.parameters.size)
    both = ca.Function("f", [sx, su, w], [dynamics(sx, su, w, ca.SX(0, 1)), dynamics.view(sx, su)[1]])
    derivative, acting = (np.array(v).ravel() for v in both(x, wrapped, np.zeros(w.shape[0])))
    np.testing.assert_allclose(acting, u, atol=1e-12)
    np.testing.assert_allclose(derivative[robot.state.size :], 0.0, atol=1e-12)


def test_shaped_regulator_against_scipy() -> None:
    """A double integrator over a long horizon: gain at the start against the algebraic Riccati equation of the wrapped system."""
    toy = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0]))
    f = InputFilter(3.0, 20.0)
    dynamics = FrequencyShaping(toy, {"u": f})
    ocp = OptimalControlProblem(dynamics, 8.0, 800, integrator="rk4")
    ocp.add(Cost("state", Rows(2, lambda s: s.x[:2]), [10.0, 1.0]))
    ocp.add(Cost("shaped", residuals.ProblemInput(dynamics, ["u_shaped"]), 0.5))
    solution = Solver(ocp, SQP()).solve(np.array([1.0, 0.0, 0.0]))
    a = np.array([[0, 1, 0], [0, 0, (f.pole - f.zero) / f.high], [0, 0, -f.zero]])
    b = np.array([[0.0], [1.0 / f.high], [1.0]])
    value = scipy.linalg.solve_continuous_are(a, b, np.diag([10.0, 1.0, 0.0]), np.array([[0.5]]))
    np.testing.assert_allclose(solution.gain[0], -(b.T @ value) / 0.5, rtol=0.03)


def test_bad_filters() -> None:
    with pytest.raises(InputError, match="'pole' must be positive"):
        InputFilter(1.0, 0.0)
    with pytest.raises(InputError, match="did you mean 'wheel'"):
        FrequencyShaping(load_robot("rezero").dynamics(), {"wheels": InputFilter(1.0, 2.0)})


def test_bad_groups_and_time_constants() -> None:
    dynamics = load_robot("rezero").dynamics()
    with pytest.raises(InputError, match="did you mean 'wheel'"):
        InputRate(dynamics, ["wheels"])
    with pytest.raises(InputError, match="must be positive"):
        DriveLag(dynamics, {"wheel": 0.0})
