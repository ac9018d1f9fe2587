"""The ball robot's compiled calls of its model. Truth: the same made of the solver's integrator, CasADi's mass matrix and weight, and the
observer's and the payload's own steps, one by one; and the same source as ordinary Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.controller import GATE, BallController
from wbmpc.bases.ball.defaults import RezeroCost, rezero_mpc
from wbmpc.bases.ball.disturbance import DisturbanceObserver
from wbmpc.bases.ball.model_steps import Learning, ModelSteps
from wbmpc.bases.ball.payload import PayloadEstimator
from wbmpc.bases.ball.sent_torques import DriveSettings, SentTorques
from wbmpc.bases.ball.settings import mpc_settings
from wbmpc.bases.ball.torque_limits import TorqueLimits
from wbmpc.kernel.step import Backend
from wbmpc.model.robot import load_robot
from wbmpc.mpc.mpc import MPC

ROBOT, PERIOD = load_robot("rezero", payload=True), 0.0025
HOME, TORQUE = ROBOT.base.numeric.equilibrium(robot("rezero").home[ROBOT.state["arm"]])
#: By what digits of machine code differ: order of sums, products added in one rounding.
SAME: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-11}


@pytest.fixture(scope="module")
def mpc() -> MPC:
    return rezero_mpc(ROBOT, mpc_settings(barrier_mu=3e-2), RezeroCost())


def parts(mpc: MPC, mass: float = 0.0) -> tuple[DisturbanceObserver, PayloadEstimator]:
    numeric = ROBOT.base.numeric
    observer = DisturbanceObserver(mpc.solver.simulate, numeric.mass_matrix, ROBOT.base.nq, np.array(GATE))
    return observer, PayloadEstimator(numeric.tool_weight, mass=mass)


def steps_of(mpc: MPC, learning: Learning, backend: Backend, period: float = PERIOD) -> tuple[ModelSteps, SentTorques]:
    """Of drives without a lag."""
    sent = SentTorques(TORQUE, period, DriveSettings())
    return ModelSteps(ROBOT, mpc.solver, TorqueLimits(ROBOT, TORQUE.size), sent, period, learning, backend), sent


def motion(count: int, seed: int) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Times, states and torques: a lean that swings, an arm that sags at once after half of them, as under a load that comes."""
    rng, found = np.random.default_rng(seed), []
    for k in range(count):
        x, t = HOME.copy(), k * PERIOD
        x[3] += 0.02 * np.sin(3.0 * t)
        x[ROBOT.base.nq + 3] = 0.06 * np.cos(3.0 * t)
        x[ROBOT.state["arm_velocity"]] = 0.02 * rng.normal(size=len(ROBOT.state.groups["arm"]))
        if k > count // 2:
            x[ROBOT.state["arm_velocity"]] += 0.3 * (t - PERIOD * (count // 2))
        found.append((t, x, TORQUE + 0.2 * rng.normal(size=TORQUE.size)))
    return found


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_what_is_learned_is_that_of_the_parts(mpc: MPC, backend: Backend) -> None:
    observer, payload = parts(mpc, 0.2)
    learned, weighed = parts(mpc, 0.2)
    steps, sent = steps_of(mpc, Learning(learned, weighed), backend)
    for t, x, u in motion(320, 3):  # more than the observer needs to start
        sent.send(u)
        observer.update(t, x, u, PERIOD)
        payload.observe(x[: ROBOT.base.nq], observer.arrays, observer.learning, PERIOD)
        steps.learn(t, x, sent.at(0), PERIOD)
        np.testing.assert_allclose(learned.force, observer.force, **SAME)
        assert weighed.mass == pytest.approx(payload.mass, rel=1e-9, abs=1e-11)
        assert learned.learning == pytest.approx(observer.learning, rel=1e-9)
    assert abs(payload.mass - 0.2) > 1e-3 and np.abs(observer.force).max() > 0.05  # there was something to learn


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_where_it_gets_is_by_the_equations_of_motion(mpc: MPC, backend: Backend) -> None:
    """Truth: the equations of motion, M v̇ + h = τ, solved by NumPy, over a step so short that they are constant."""
    base, n, (x, u) = ROBOT.base, ROBOT.base.nq, (HOME.copy(), TORQUE.copy())
    u[-1] += 0.5
    x[n + 5 :] = 0.1, -0.2, 0.3
    q, given = ca.SX.sym("q", n), ca.SX.sym("u", u.size)
    force = ca.Function("force", [q, given], [base.generalized_force(q, given, ca.SX.zeros(ROBOT.parameters.size))])
    torque = np.array(force(x[:n], u)).ravel() - base.numeric.inverse_dynamics(x[:n], x[n:], np.zeros(n))
    truth = np.linalg.solve(base.numeric.mass_matrix(x[:n]), torque)[5:]
    steps, sent = steps_of(mpc, Learning(), backend, 1e-6)
    sent.send(u)
    found = (steps.through(x, slice(sent.at(0), sent.at(0) + 1)) - x) / 1e-6  # type: ignore[operator]
    np.testing.assert_allclose(found[ROBOT.state["arm_velocity"]], truth, rtol=1e-4, atol=1e-4)
    assert np.abs(truth).max() > 1.0


class OwnModel(BallController):
    """Its model is the same, but its own: every part asks it by itself."""

    def _step(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        return self.mpc.solver.simulate(x, u, h)


def test_a_controller_with_a_model_of_its_own_learns_the_same(mpc: MPC) -> None:
    make: Callable[[type[BallController]], BallController]
    make = lambda kind: kind(ROBOT, mpc, TORQUE, PERIOD, DriveSettings(0.02, 0.01))
    ours, own = make(BallController), make(OwnModel)
    assert ours._steps is not None and own._steps is None
    for t, x, u in motion(20, 5):
        for controller in (ours, own):
            controller.sent.send(u)
            controller.measured = type("Measured", (), {"state": x, "age": 0.0})()  # type: ignore[assignment]
            controller._learn(t, x, PERIOD)
        np.testing.assert_allclose(ours.disturbance, own.disturbance, **SAME)
    assert np.abs(own.disturbance).max() > 0.01
