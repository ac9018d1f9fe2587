"""Base and arm controlled by themselves. Truth: the whole robot's dynamics with the arm torques that make its arm move so; forward
kinematics; a double integrator that is integrated by itself."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from effort import thorough
from toys import robot
from wbmpc import lie
from wbmpc.registry import REGISTRY
from wbmpc.studies.minniti2019.held_arm import ServoedArm
from wbmpc.studies.minniti2019.push_settings import RezeroPushHandSettings
from wbmpc.studies.minniti2019.separate import ArmLoop, EndEffectorInverse

BALL = robot("rezero")
N = BALL.base.nq


def base_alone() -> ca.Function:
    dynamics = ServoedArm(BALL)
    x, u, w = (ca.SX.sym(n, k) for n, k in (("x", 2 * N), ("u", 3), ("w", dynamics.parameters.size)))
    f, slope = dynamics.jacobian(x, u, w, ca.SX(0, 1))
    return ca.Function("f", [x, u, w], [f, slope, ca.jacobian(dynamics(x, u, w, ca.SX(0, 1)), ca.vertcat(x, u))])


ALONE = base_alone()


def parameters(goal: np.ndarray, pace: float, disturbance: np.ndarray) -> np.ndarray:
    return np.concatenate([disturbance, goal, [pace]])


def some_state(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return BALL.home + np.concatenate([0.2 * rng.normal(size=N), 0.5 * rng.normal(size=N)])


@pytest.mark.parametrize("seed", [0, 1])
def test_base_accelerates_as_the_whole_robot_with_that_arm(seed: int) -> None:
    rng, x = np.random.default_rng(10 + seed), some_state(seed)
    wheels, goal, pace, force = rng.normal(size=3), rng.normal(size=N - 5), 6.0, rng.normal(size=5)
    rate, slope, differentiated = (np.array(v) for v in ALONE(x, wheels, parameters(goal, pace, force)))
    np.testing.assert_allclose(slope, differentiated, atol=1e-8)
    np.testing.assert_allclose(rate[:N].ravel(), x[N:])
    a = rate[N:].ravel()
    np.testing.assert_allclose(a[5:], pace**2 * (goal - x[5:N]) - 2.0 * pace * x[N + 5 :])
    # the whole robot: whatever arm torques that takes, the disturbance as its parameter
    needed = BALL.base.numeric.inverse_dynamics(x[:N], x[N:], a)
    q, u = ca.SX.sym("q", N), ca.SX.sym("u", N - 2)
    given = BALL.base.generalized_force(q, u, ca.SX.zeros(BALL.parameters.size))
    force_of = ca.Function("force", [q, u], [given])
    arm = needed[5:] - np.array(force_of(x[:N], np.concatenate([wheels, np.zeros(N - 5)]))).ravel()[5:]
    acts = np.array(force_of(x[:N], np.concatenate([wheels, arm]))).ravel() + np.concatenate([force, np.zeros(N - 5)])
    np.testing.assert_allclose(acts, needed, atol=1e-9)


def test_an_arm_at_its_goal_stays_there() -> None:
    x = BALL.home.copy()
    rate = np.array(ALONE(x, np.zeros(3), parameters(x[5:N], 9.0, np.zeros(5)))[0]).ravel()
    np.testing.assert_allclose(rate[[5, 6, 7]], 0.0)
    np.testing.assert_allclose(rate[N:], 0.0, atol=1e-9)  # and at home all of it rests


def test_inverse_kinematics_takes_the_hand_there() -> None:
    inverse, rng = (
        EndEffectorInverse(BALL, np.array([300.0, 300.0, 300.0, 0.0, 0.0, 0.0]), 1e-6),
        np.random.default_rng(0),
    )
    for _ in range(5):
        there = BALL.home.copy()
        there[:5] += 0.1 * rng.normal(size=5)
        there[5:N] += 0.4 * rng.normal(size=N - 5)
        pose = np.concatenate(BALL.pose(there))
        found = inverse(there, pose, BALL.home[5:N], BALL.home[5:N], steps=200)
        there[5:N] = found
        assert np.linalg.norm(BALL.pose(there)[0] - pose[:3]) < 1e-4


def test_a_hand_out_of_reach_points_there() -> None:
    """The nearest point of the sphere of 0.6 m about the shoulder, 0.5 m up in the base."""
    inverse = EndEffectorInverse(BALL, np.array([300.0] * 3 + [0.0] * 3), 1e-3)
    place, quaternion = BALL.pose(BALL.home)
    far, found = place + [1.5, 0.3, 0.0], BALL.home[5:N]
    for _ in range(100):
        previous, found = found, inverse(BALL.home, np.concatenate([far, quaternion]), BALL.home[5:N], found)
    np.testing.assert_allclose(found, previous, atol=1e-3)  # and it stays there
    arm, state = BALL.state["arm"], BALL.home.copy()
    assert np.all(found >= BALL.limits.state_lower[arm]) and np.all(found <= BALL.limits.state_upper[arm])
    state[arm] = found
    shoulder = lie.euler_zyx_to_rotation(*state[2:5]) @ [0.0, 0.0, 0.5]
    assert np.linalg.norm(BALL.pose(state)[0] - far) == pytest.approx(np.linalg.norm(far - shoulder) - 0.6, abs=5e-3)


@pytest.mark.parametrize(("integral", "left"), [(0.0, True), (3.0, False)])
def test_integral_removes_what_a_constant_torque_leaves(integral: float, left: bool) -> None:
    """A unit inertia with a torque of 2 N m that is not modeled: a PD stops 2 / ω² short."""
    loop, q, v, h = ArmLoop(pace=8.0, integral=integral), np.zeros(1), np.zeros(1), 1e-3
    for _ in range(8000):
        torque = loop.torque(np.eye(1), np.zeros(1), 0.2 - q, v, h)
        v = v + h * (torque - 2.0)
        q = q + h * v
    assert 0.2 - q[0] == pytest.approx(2.0 / 64.0 if left else 0.0, abs=2e-4)


@pytest.mark.parametrize("name", [pytest.param("separate", marks=thorough), "separate-aware"])
def test_separate_control_stands_a_small_push(name: str) -> None:
    settings = RezeroPushHandSettings(forces=(30.0,), settle_time=0.5, pause=2.0, controller=name)
    result = REGISTRY["rezero-push-hand"].run(settings, 0, None)
    assert result.completed, result.reason
    torque = result.log.array("torque")
    assert np.abs(torque[:, :3]).max() <= 4.0 + 1e-9 and np.abs(torque[:, 3:]).max() <= 20.0 + 1e-9
    assert 0.01 < result.metrics["hand_error_max"].value < 0.3
    assert result.mpc is not None and result.mpc.solves > 0
    found = np.abs(result.log.array("disturbance")).max()
    assert (found == 0.0) == (name == "separate")
