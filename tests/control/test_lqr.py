"""The ball robot's regulators. Truth: the robot's dynamics and poses by finite differences, Lyapunov's equation for the cost of a
gain, equilibria under a force by Newton's method, turning the world."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov

from wbmpc import lie
from wbmpc.bases.ball.messages import BallMeasurement
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.studies.minniti2019.lqr import LqrController, LqrWeights, RegulatorGains

PERIOD = 0.0025
HAND, TWIST = np.array([30.0, 20.0, 10.0, 4.0, 3.0, 2.0]), np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("rezero")


@pytest.fixture(scope="module")
def gains(robot: RobotModel) -> RegulatorGains:
    state = np.concatenate([[2.0, 1.0, 1.5, 0.0, 0.0, 0.3, 0.2, 0.1], [1.0, 1.0, 0.5, 2.0, 2.0, 0.2, 0.2, 0.2]])
    return RegulatorGains(robot, LqrWeights(HAND, TWIST, state, np.array([0.1] * 3 + [0.02] * 3)), PERIOD)


def slopes(function, x: np.ndarray, step: float = 1e-5) -> np.ndarray:  # type: ignore[no-untyped-def]
    """By central differences."""
    columns = [(function(x + step * e) - function(x - step * e)) / (2.0 * step) for e in np.eye(x.size)]
    return np.array(columns).T


def place_and_turn(robot: RobotModel, q: np.ndarray) -> np.ndarray:
    """Of the end effector against that at home (6): position, rotation vector in the world."""
    x = np.concatenate([q, np.zeros(q.size)])
    position, quaternion = robot.pose(x)
    turn = lie.quaternion_multiply(quaternion, lie.quaternion_conjugate(robot.pose(robot.home)[1]))
    return np.concatenate([position, lie.quaternion_log(turn)])


def test_no_other_gain_costs_less(robot: RobotModel, gains: RegulatorGains) -> None:
    """Mean cost from random states near rest, of the gain and of gains near it."""
    arm = robot.home[robot.state["arm"]]
    x, u = robot.base.numeric.equilibrium(arm)
    n = robot.base.nq
    s, v = ca.SX.sym("s", x.size), ca.SX.sym("v", u.size)
    rates = ca.Function("rates", [s, v], [robot.dynamics()(s, v, ca.SX.zeros(robot.parameters.size), ca.SX(0, 1))])
    rate = lambda z: np.array(rates(z[: x.size], z[x.size :])).ravel()
    both = slopes(rate, np.concatenate([x, u]))
    ab = expm(PERIOD * np.vstack([both, np.zeros((u.size, x.size + u.size))]))
    a, b = ab[: x.size, : x.size], ab[: x.size, x.size :]
    end_effector, w = slopes(lambda q: place_and_turn(robot, q), x[:n]), gains.weights
    q = np.diag(w.state).copy()
    q[:n, :n] += end_effector.T @ np.diag(w.end_effector) @ end_effector
    q[n:, n:] += end_effector.T @ np.diag(w.twist) @ end_effector

    def cost(k: np.ndarray) -> float:
        loop = a - b @ k
        assert np.abs(np.linalg.eigvals(loop)).max() < 1.0
        return float(np.trace(solve_discrete_lyapunov(loop.T, PERIOD * (q + k.T @ np.diag(w.torque) @ k))))

    found, rng = gains.at(arm), np.random.default_rng(0)
    least = cost(found)
    for _ in range(10):
        near = 1e-3 * np.abs(found) * rng.normal(size=found.shape)
        assert min(cost(found + near), cost(found - near)) > least


def test_rest_under_a_force_to_first_command(robot: RobotModel, gains: RegulatorGains) -> None:
    arm, force = robot.home[robot.state["arm"]], np.array([0.2, -0.3, -0.5])
    (x0, u0), (x1, u1) = robot.base.numeric.equilibrium(arm), robot.base.numeric.equilibrium(arm, force=force)
    generalized = slopes(lambda q: robot.pose(np.concatenate([q, np.zeros(q.size)]))[0], x0[: robot.base.nq]).T @ force
    shift = gains.at_rest(arm) @ generalized
    away = np.concatenate([x1[3:5] - x0[3:5], u1 - u0])
    assert np.linalg.norm(away) > 0.01
    assert np.linalg.norm(shift - away) < 0.03 * np.linalg.norm(away)


def controller(
    robot: RobotModel, gains: RegulatorGains, scheduled: bool, target: np.ndarray, maximum: float
) -> LqrController:
    u = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])[1]
    out = LqrController(robot, None, u, PERIOD, DriveSettings(0.02), observer=False)  # type: ignore[arg-type]
    out.regulate(gains, lambda t: target, scheduled, maximum)
    return out


def asked(controller: LqrController, x: np.ndarray) -> np.ndarray:
    """Torques that the law asks for at x, before they are cut."""
    controller.measure(BallMeasurement(0.0, x, 0.0))
    controller.command(0.0, PolicyQueue())
    return controller.target


def test_scheduled_gains_turn_with_the_heading(robot: RobotModel, gains: RegulatorGains) -> None:
    """The same displacement seen from the robot asks for the same torques, whatever its heading."""
    home = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])[0]
    n, yaw = robot.base.nq, 0.7
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    x = home + 0.01 * np.random.default_rng(1).normal(size=home.size)
    turned = x.copy()
    turned[2] += yaw
    for pair in (slice(0, 2), slice(n, n + 2)):
        turned[pair] = turn @ x[pair]
    there = home.copy()
    there[2] = yaw
    here = asked(controller(robot, gains, True, home, 1.0), x)
    assert np.abs(here).max() > 0.1
    assert asked(controller(robot, gains, True, there, 1.0), turned) == pytest.approx(here, abs=1e-9)
    plain = asked(controller(robot, gains, False, there, 1.0), turned)
    assert np.abs(plain - here).max() > 0.05


def test_far_away_pulls_no_harder(robot: RobotModel, gains: RegulatorGains) -> None:
    home = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])[0]
    at = lambda far: asked(controller(robot, gains, False, home, 0.1), home + far * np.eye(home.size)[0])
    assert at(0.1) == pytest.approx(at(0.5))
    assert np.abs(at(0.05) - at(0.1)).max() > 1e-3
