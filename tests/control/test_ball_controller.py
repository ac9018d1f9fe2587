"""The ball robot's controller between MPC and drives. Truth: a linear plant that is stepped on and compared with what was predicted for
it, a linear program."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog

from toys import robot
from wbmpc.bases.ball.balance import Balance
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.messages import BallMeasurement
from wbmpc.bases.ball.push import DEAD, PushEstimator
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.errors import InputError, NotFinite
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue

PERIOD = 0.0025
BALL = robot("rezero")
N, TORQUES = 8, 6
_RNG = np.random.default_rng(7)
#: A stable linear stand-in for the robot: ẋ = A x + B u.
A = np.block([[np.zeros((N, N)), np.eye(N)], [-2.0 * np.eye(N), -0.5 * np.eye(N)]])
B = np.vstack([np.zeros((N, TORQUES)), _RNG.normal(size=(N, TORQUES))])


def linear_step(x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
    if u.ndim == 2:
        for row in u:
            x = linear_step(x, row, h)
        return x
    whole = expm(h * np.block([[A, B], [np.zeros((TORQUES, 2 * N + TORQUES))]]))
    return (whole @ np.concatenate([x, u]))[: 2 * N]


class LinearMpc:
    """What the controller uses of an MPC."""

    def __init__(self) -> None:
        self.parameters: list[dict[str, np.ndarray]] = []
        self.solver = SimpleNamespace(simulate=linear_step, set_parameters=self.parameters.append)


def feedback_policy(seed: int) -> Policy:
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, 1.0, 51)
    gain = rng.normal(size=(50, TORQUES, 2 * N))
    return Policy(times, rng.normal(size=(51, 2 * N)) * 0.1, rng.normal(size=(50, TORQUES)), gain)


def ball_controller(lag: float = 0.0, observer: bool = False, dead: int = 0) -> BallController:
    drives = DriveSettings(lag, dead * PERIOD)
    return BallController(BALL, LinearMpc(), np.zeros(TORQUES), PERIOD, drives, observer)  # type: ignore[arg-type]


def run_ball(
    controller: BallController, late: int, lag: float, ticks: int = 40, dead: int = 0
) -> tuple[list[np.ndarray], list]:  # type: ignore[type-arg]
    """A plant with drives of a first-order lag (held over a tick), and ``dead`` ticks before it, under the controller: its states, and
    what was predicted.

    Predictions are (tick they are for, state); a new policy comes into force every tenth tick, four ticks late.
    """
    x, torque, states, predictions, plans = 0.1 * np.ones(2 * N), np.zeros(TORQUES), [], [], PolicyQueue()
    blend = 1.0 - np.exp(-PERIOD / lag) if lag else 1.0
    way = [np.zeros(TORQUES)] * dead
    for k in range(ticks):
        states.append(x)
        age = min(late, k)
        controller.measure(BallMeasurement(k * PERIOD, states[k - age], age * PERIOD))
        t = k * PERIOD
        plans.activate(t)
        if k % 10 == 0:
            if plans.current is not None:
                predictions.append((k + 4, controller.predict(t, t + 4 * PERIOD, plans)))
            plans.add(t + 4 * PERIOD, feedback_policy(k))
        np.testing.assert_allclose(controller.state(), x, atol=1e-10)
        command = controller.command(t, plans).torque
        way.append(command)
        torque = torque + blend * (way.pop(0) - torque)
        x = linear_step(x, torque, PERIOD)
    return states, predictions


@pytest.mark.parametrize("lag", [0.0, 0.02])
@pytest.mark.parametrize(("late", "dead"), [(0, 0), (2, 0), (5, 0), (2, 3)])
def test_ball_robot_prediction_is_what_happens(late: int, dead: int, lag: float) -> None:
    """A late message is brought up to now (checked at every tick), and the state for the plan's start comes true: with a dead
    time, that in which the plan's first torques will act."""
    states, predictions = run_ball(ball_controller(lag, dead=dead), late, lag, dead=dead)
    assert len(predictions) == 3
    for tick, observation in predictions:
        assert observation.t == pytest.approx((tick + dead) * PERIOD)
        np.testing.assert_allclose(observation.x, states[tick + dead], atol=1e-10)
        assert np.abs(states[tick] - states[tick - 4]).max() > 1e-3  # the delay mattered


def test_a_dead_time_of_many_ticks_is_predicted_over() -> None:
    """More of them than are remembered for late messages alone, and such a message. Truth: the same torques, step by step."""
    dead, late, x = 100, 5, 0.1 * np.ones(2 * N)
    controller, sent = ball_controller(dead=dead), np.random.default_rng(3).normal(size=(120, TORQUES))
    for torque in sent:
        controller._drive(torque)
    controller.measure(BallMeasurement(1.0, x, late * PERIOD))
    for torque in sent[-dead - late :]:
        x = linear_step(x, torque, PERIOD)
    np.testing.assert_allclose(controller.ahead(), x, atol=1e-10)


@pytest.mark.parametrize(
    ("dead", "said"),
    [
        (0.0012, r"0\.0012 s is not a whole number of controller periods of 2\.5 ms; valid: e\.g\. 0 or 0\.0025 s"),
        (0.0137, r"valid: e\.g\. 0\.0125 or 0\.015 s"),
        (-0.01, r"valid: e\.g\. 0 s"),
        (1.0, "must be at most 0.5 s"),
        (np.nan, "must be finite"),
    ],
)
def test_a_dead_time_that_cannot_be_predicted_over_is_rejected(dead: float, said: str) -> None:
    with pytest.raises(InputError, match=f"actuator_dead_time: .*{said}"):
        BallController(BALL, LinearMpc(), np.zeros(TORQUES), PERIOD, DriveSettings(0.02, dead))  # type: ignore[arg-type]


def test_ball_robot_clips_torques_and_stops_without() -> None:
    controller, plans = ball_controller(), PolicyQueue()
    controller.measure(BallMeasurement(0.0, np.zeros(2 * N), 0.0))
    wild = feedback_policy(0)
    plans.add(0.0, Policy(wild.times, wild.x, 1e3 * np.sign(wild.u), wild.gain))
    torque = controller.command(0.0, plans).torque
    np.testing.assert_allclose(np.abs(torque[3:]), [20, 20, 20])
    assert np.abs(torque[:3]).max() < 4.0 + 1e-9
    np.testing.assert_array_equal(controller.stop().torque, np.zeros(TORQUES))


#: Torque about the vertical that wheel torques (3) do to the ball [N m] and its limit, by hand.
SPIN, MAXIMUM = 0.125 / 0.064 * np.sin(np.pi / 4) * np.ones(3), 2.0


def largest_share(lean: np.ndarray) -> float:
    """By linear programming: the most of ``lean`` that the wheels can do, with whatever spin the floor allows."""
    rows = np.column_stack([np.vstack([lean, -lean]).reshape(2, 3).ravel(), np.repeat([1.0, -1.0], 3)])
    reach = MAXIMUM / SPIN.sum()
    return float(linprog([-1.0, 0.0], A_ub=rows, b_ub=np.full(6, 4.0), bounds=[(0.0, 1.0), (-reach, reach)]).x[0])


@pytest.mark.parametrize("size", [1.0, 3.0, 8.0, 100.0])
def test_balance_comes_before_yaw(size: float) -> None:
    """What tilts keeps its direction and as much of its size as some spin allows; what is possible is not touched."""
    controller, plans = ball_controller(), PolicyQueue()
    controller.measure(BallMeasurement(0.0, np.zeros(2 * N), 0.0))
    wild, rng, untouched = feedback_policy(0), np.random.default_rng(0), 0
    for _ in range(50):
        asked = size * rng.normal(size=3)
        u = np.tile(np.concatenate([asked, np.zeros(TORQUES - 3)]), (len(wild.u), 1))
        plans.current = Policy(wild.times, wild.x, u, 0.0 * wild.gain)
        given = controller.command(0.0, plans).torque[:3]
        assert np.abs(given).max() <= 4.0 + 1e-9 and abs(SPIN @ given) <= MAXIMUM + 1e-9
        lean, left = asked - asked.mean(), given - given.mean()
        np.testing.assert_allclose(left, largest_share(lean) * lean, atol=1e-6)
        if np.abs(asked).max() <= 4.0 and abs(SPIN @ asked) <= MAXIMUM:
            untouched += 1
            np.testing.assert_allclose(given, asked, atol=1e-12)
        assert controller.clamped == bool(np.abs(given - asked).max() > 1e-6)  # rounding is no clamp
    assert untouched > 5 or size > 3.0


def test_ball_robot_hands_its_disturbance_to_the_model() -> None:
    controller = ball_controller(observer=True)
    state = np.zeros(2 * N)
    for k in range(3):
        state[N] = 0.01 * k  # it moves without a torque
        controller.measure(BallMeasurement(k * PERIOD, state.copy(), 0.0))
    given = controller.mpc.parameters[-1]["disturbance"]  # type: ignore[attr-defined]
    assert given is controller.learned.disturbance and given[0] > 0.0
    with pytest.raises(NotFinite, match="disturbance observer: 'state'"):
        controller.measure(BallMeasurement(0.01, np.full(2 * N, np.nan), 0.0))


def test_what_makes_the_disturbance_infinite_is_reported() -> None:
    """A joint that turns at 17 rad/s (its limit is 4) in a state that the model has no answer to."""
    controller, state = ball_controller(observer=True), np.zeros(2 * N)
    controller.learned.observer.step = lambda x, u, h: np.full(2 * N, np.nan)  # type: ignore[union-attr]
    state[-1] = -17.0
    why = "the estimated disturbance is not finite: arm_elbow is believed to turn at 17 rad/s, and its limit is 4 rad/s"
    controller.measure(
        BallMeasurement(0.0, state, 0.0)
    )  # what the model makes of this state is compared with the next message
    with pytest.raises(NotFinite, match=why):
        controller.measure(BallMeasurement(0.0025, state, 0.0))


def test_ball_robot_leans_about_where_it_stands_under_what_it_has_learned() -> None:
    """The shift of the limit is that of the disturbance just learned (tests/control/test_lean_control.py), beside a push's room."""
    controller = ball_controller(observer=True)
    controller.learned.lean_control = LeanControl(BALL, np.zeros(3), 0.6, 2.0)
    state = np.zeros(2 * N)
    for k in range(200):  # half of what 20 N along x would do: 26 kg
        state[N] = 0.9 * k * PERIOD
        controller.measure(BallMeasurement(k * PERIOD, state.copy(), 0.0))
    given = controller.mpc.parameters[-1]  # type: ignore[attr-defined]
    leans = controller.learned.lean_control.leans(controller.learned.disturbance, 0.0)
    np.testing.assert_allclose(given["push"], controller.learned.lean_control.center(leans, 0.0))
    assert given["push"][0] > 0.01


#: Height [m] of the center of mass over the ball's center, arm straight up: by hand, from masses and places in the robot's file.
HEIGHT = (18.66 * 0.1956 + 1.2 * 0.48 + 1.4 * 0.63 + 1.1 * 0.94) / (18.66 + 1.2 + 1.4 + 1.1)


def test_ball_robot_hands_a_push_that_it_feels_to_the_model() -> None:
    """What the model does not explain tilts it forward, ever faster: room is kept in front, for 0.2 s of that drift."""
    controller, state = ball_controller(), np.zeros(2 * N)
    controller.learned.push_estimator = PushEstimator(BALL, np.zeros(3), 0.2)
    for k in range(40):
        controller.measure(BallMeasurement(k * PERIOD, state.copy(), 0.0))
        state = linear_step(state, np.zeros(TORQUES), PERIOD)
        state[N + 3] += 8.0 * PERIOD  # rad/s of pitch
    given = controller.mpc.parameters[-1]["push"]  # type: ignore[attr-defined]
    drift = 8.0 * HEIGHT / Balance.of(BALL, np.zeros(3)).pole
    assert given == pytest.approx([0.2 * (drift - DEAD), 0.0], rel=0.02, abs=2e-3)
    with pytest.raises(NotFinite, match="push estimator: 'state' needs 16 finite numbers"):
        controller.measure(BallMeasurement(0.1, np.full(2 * N, np.nan), 0.0))


class Fixed:
    """An estimator that always says the same."""

    def update(self, time, wheel, arm, gyro, accel, turning):  # type: ignore[no-untyped-def]
        self.given, self.turning = (time, *wheel, *arm, *gyro, *accel), turning
        return np.arange(2.0 * N)


def test_with_an_estimator_the_simulators_state_is_not_used() -> None:
    controller, fixed = ball_controller(), Fixed()
    controller.estimator = fixed  # type: ignore[assignment]
    readings = (np.ones(3), 2.0 * np.ones(3), 3.0 * np.ones(3), 4.0 * np.ones(3))
    acted = np.array([0.3, -0.1, 0.5, 9.0, 9.0, 9.0])  # two ticks ago, as old as the readings are
    for torque in (acted, np.zeros(6), np.zeros(6)):
        controller.sent.send(torque)
    controller.measure(BallMeasurement(0.5, np.full(2 * N, np.nan), 2.0 * PERIOD, *readings))
    assert fixed.turning == pytest.approx(controller.robot.base.wheel_torque_map()[2] @ acted[:3])
    controller.measure(BallMeasurement(0.5, np.full(2 * N, np.nan), 0.0, *readings))
    np.testing.assert_array_equal(controller.state(), np.arange(2.0 * N))
    assert fixed.given == (0.5, *[1.0] * 3, *[2.0] * 3, *[3.0] * 3, *[4.0] * 3)


def test_a_measurement_later_than_all_known_torques_counts_as_from_the_first() -> None:
    """A machine that stalls hands over what is 0.2 s old at 400 Hz: 64 torques are known. Truth: the torques at the start."""
    controller = ball_controller(observer=True)
    controller.measure(BallMeasurement(0.0, 0.1 * np.ones(2 * N), 0.0))
    x = 0.2 * np.ones(2 * N)
    controller.measure(BallMeasurement(1.0, x, 1000 * PERIOD))
    expected = x
    for _ in range(63):
        expected = linear_step(expected, np.zeros(TORQUES), PERIOD)
    np.testing.assert_allclose(controller.state(), expected)
