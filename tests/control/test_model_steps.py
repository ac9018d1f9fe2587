"""The ball robot's compiled calls of its model. Truth: the same made of the solver's integrator, CasADi's mass matrix and weight, and the
observer's and the payload's own steps, one by one; and the same source as ordinary Python."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from toys import made, robot
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import RezeroCost, rezero_mpc
from wbmpc.bases.ball.disturbance import DisturbanceObserver
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.learned_forces import GATE
from wbmpc.bases.ball.messages import BallMeasurement
from wbmpc.bases.ball.model_steps import Learning, ModelSteps
from wbmpc.bases.ball.payload import PayloadEstimator
from wbmpc.bases.ball.push import PushEstimator
from wbmpc.bases.ball.sent_torques import DriveSettings, SentTorques
from wbmpc.bases.ball.settings import mpc_settings
from wbmpc.bases.ball.torque_limits import TorqueLimits
from wbmpc.errors import InputError, NotFinite
from wbmpc.kernel.step import Backend
from wbmpc.model.robot import load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue

ROBOT, PERIOD = load_robot("rezero", payload=True), 0.0025
HOME, TORQUE = ROBOT.base.numeric.equilibrium(robot("rezero").home[ROBOT.state["arm"]])
#: By what digits of machine code differ: order of sums, products added in one rounding.
SAME: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-11}


def new_mpc() -> MPC:
    return rezero_mpc(ROBOT, mpc_settings(barrier_mu=3e-2), RezeroCost())


@pytest.fixture(scope="module")
def mpc() -> MPC:
    return new_mpc()


def parts(mpc: MPC, mass: float = 0.0) -> tuple[DisturbanceObserver, PayloadEstimator]:
    numeric = ROBOT.base.numeric
    observer = DisturbanceObserver(mpc.solver.simulate, numeric.mass_matrix, ROBOT.base.nq, np.array(GATE))
    return observer, PayloadEstimator(numeric.tool_weight, mass=mass)


def steps_of(mpc: MPC, learning: Learning, backend: Backend, period: float = PERIOD) -> tuple[ModelSteps, SentTorques]:
    """Of drives without a lag."""
    sent = SentTorques(TORQUE, period, DriveSettings())
    limits = TorqueLimits(ROBOT, TORQUE.size)
    return made(backend, ModelSteps, ROBOT, mpc.solver, limits, sent, period, learning), sent


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


def policy(seed: int, n: int = 5) -> Policy:
    """Of n intervals of 10 ms near the equilibrium; torques beyond what the drives can."""
    rng, size = np.random.default_rng(seed), HOME.size
    states = HOME + 0.01 * rng.normal(size=(n + 1, size))
    inputs, gains = TORQUE + 3.0 * rng.normal(size=(n, TORQUE.size)), 5.0 * rng.normal(size=(n, TORQUE.size, size))
    return Policy(0.01 * np.arange(n + 1), states, inputs, gains)


def make(kind: type[BallController], mpc: MPC, observer: bool = True) -> BallController:
    """With all that a new state is asked for."""
    arm = HOME[ROBOT.state["arm"]]
    made = kind(ROBOT, mpc, TORQUE, PERIOD, DriveSettings(0.02, 0.01), observer, None, FallPredictor(ROBOT, arm))
    learned = made.learned
    learned.lean_control, learned.push_estimator = LeanControl(ROBOT, arm, 0.6, 2.0), PushEstimator(ROBOT, arm, 0.2)
    learned.payload = parts(mpc, 0.2)[1] if observer else None
    return made


def test_a_controller_with_a_model_of_its_own_does_the_same() -> None:
    """What is learned, what the solver gets of it, the lean, predictions and torques; for more ticks than torques are remembered."""
    (ours, own), plans, cut = (make(kind, new_mpc()) for kind in (BallController, OwnModel)), PolicyQueue(), 0
    assert ours._steps is not None and own._steps is None
    for k, (t, x, _) in enumerate(motion(200, 5)):
        if k % 5 == 0:
            plans.current = policy(k, 5 if k % 10 else 1)
        found = []
        for controller in (ours, own):
            controller.measure(BallMeasurement(t, x, 2.0 * PERIOD))
            given = ROBOT.parameters.vector(controller.parameters())
            np.testing.assert_allclose(controller.mpc.solver.parameters, given, rtol=1e-12, atol=1e-15)
            predicted = controller.predict(0.002 * (k % 5), 0.002 * (k % 5) + 4.0 * PERIOD, plans).x
            command = controller.command(0.002 * (k % 5), plans).torque
            leans = controller.learned.leans(controller.measured)
            what = (controller.learned.disturbance, leans[:4], controller.state(), predicted, command)
            found.append([*what, controller.target, controller.feedforward, controller.sent.last])
        for one, other in zip(*found, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9)
        component = ours.fall_predictor._maximum(  # type: ignore[union-attr]
            x[None], ours.learned.carried, np.zeros((1, 2)), ours.learned.shift(ours.measured)
        )
        assert np.hypot(*ours.learned.leans(ours.measured)[4:]) == pytest.approx(component, rel=1e-9)
        cut += int(ours.clamped)
    assert np.abs(own.learned.disturbance).max() > 0.01 and cut > 10
    assert ours.sent.count == own.sent.count == 200 > len(ours.sent.rows)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_a_policy_is_followed_as_by_its_parts(mpc: MPC, backend: Backend) -> None:
    """Truth: the policy's own law, limits and drives, and the solver's integrator, one by one."""
    limits, plan, late = TorqueLimits(ROBOT, TORQUE.size), policy(1), 3
    sent, twin = (SentTorques(TORQUE, PERIOD, DriveSettings(0.02, 0.005)) for _ in range(2))
    steps = made(backend, ModelSteps, ROBOT, mpc.solver, limits, sent, PERIOD, Learning())
    for k, (t, x, u) in enumerate(motion(6, 2)):
        sent.send(u), twin.send(u)
        acts = mpc.solver.simulate(x, twin.rows[twin.since(late + twin.dead, 0)], PERIOD)
        wanted = plan.feedforward(t), plan.law(t, acts)
        torque = limits.limited(wanted[1], acts)
        for one, other in zip(steps.act(plan, t, x, late) or (), (*wanted, torque), strict=True):
            np.testing.assert_allclose(one, other, **SAME)
        twin.send(torque)
        np.testing.assert_allclose(sent.last, twin.last, **SAME)
        goes = twin.follow(limits.limited(plan.law(t, x), x), u)
        for one, other in zip(
            steps.foresee(plan, t, x, u) or (), (mpc.solver.simulate(x, goes, PERIOD), goes), strict=True
        ):
            np.testing.assert_allclose(one, other, **SAME)
        assert sent.count == 2 * k + 2


def test_what_cannot_be_followed_is_said_by_the_parts(mpc: MPC) -> None:
    controller, plans, plan = make(BallController, mpc, observer=False), PolicyQueue(), policy(1)
    controller.fall_predictor, wide = None, Policy(plan.times, np.zeros((6, 17)), plan.u, np.zeros((5, 6, 17)))
    inputs = Policy(plan.times, plan.x, plan.u[:, :5], plan.gain[:, :5])
    cases = (
        (plan, 0.0, np.full(16, np.nan), NotFinite, "simulate: 'base.x' must be finite"),
        (plan, np.nan, HOME, NotFinite, "policy: time and state must be finite"),
        (plan, np.inf, HOME, NotFinite, "policy: time and state must be finite"),
        (plan, 0.0, HOME[:15], InputError, "16 states and 6 inputs are needed, got shapes"),
        (wide, 0.0, HOME, InputError, "a state of 17 numbers is needed"),
        (inputs, 0.0, HOME, ValueError, "broadcast"),
    )
    for plans.current, t, x, error, said in cases:
        controller.measured = BallMeasurement(0.0, x, 0.0)
        with pytest.raises(error, match=said):
            controller.command(t, plans)
    assert controller.sent.count == 0
