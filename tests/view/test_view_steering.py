"""Requests of a user, applied to robots in physics. Truth: where MuJoCo says end effector, legs and base are afterwards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from driving import CONFIGURATIONS
from effort import thorough
from wbmpc import lie
from wbmpc.model.robot import load_robot
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import Reference
from wbmpc.simulation.lockstep import Ending, Running, Watch, run_lockstep
from wbmpc.view.session import system_of
from wbmpc.view.user_commands import MAX_WEIGHTS, UserCommands, no_requests

NOWHERE = np.array([0.0, 0, 0, 1, 0, 0, 0])


class Requests:
    """A watcher that gives orders at times: ``(t, {name: value})``."""

    def __init__(self, plan: list[tuple[float, dict[str, Any]]], look: Callable[[float, Running], None]) -> None:
        self.plan, self.look, self.requests = plan, look, no_requests()

    def begin(self, running: Running) -> None:
        self.running = running
        lift = getattr(running.plant.description.base, "ball_radius", 0.0)
        self.steering = UserCommands(running, np.array([0.0, 0.0, lift]))

    def tick(self, t: float, command: Any, plans: PolicyQueue) -> None:
        while self.plan and t >= self.plan[0][0]:
            for name, value in self.plan.pop(0)[1].items():
                self.requests[name][...] = value
        self.steering.apply(t, self.requests, NOWHERE)
        self.look(t, self.running)

    def end(self, ending: Ending) -> None:
        assert ending.reason == ""


def made(robot: Any, seed: int) -> tuple[Any, ...]:
    return system_of(robot, seed).parts


def drive(make: Any, name: str, seconds: float, plan: list[tuple[float, dict[str, Any]]], look: Any = None) -> Running:
    robot = load_robot(name)
    plant, controller, mpc, timing = make(robot, 1)
    watcher = Requests(plan, look or (lambda t, running: None))
    ending = run_lockstep(plant, controller, mpc, timing, seconds, lambda *_: None, Watch(None, (watcher,)))
    assert ending.reason == ""
    return watcher.running


def test_the_hand_goes_where_its_goal_is_dragged() -> None:
    robot = load_robot("swerve-ur10")
    position, orientation = robot.pose(robot.home)
    goal = position + [0.7, -0.25, 0.15]  # beyond the arm's reach: the base must come along
    running = drive(made, "swerve-ur10", 4.5, [(0.1, {"goals": 1, "goal": [*goal, *orientation]})])
    truth = running.plant.truth()
    assert np.linalg.norm(truth.tool - goal) < 0.08  # the odometry drifts on the way
    assert np.linalg.norm(truth.pose[:2] - [0.7, -0.25]) < 0.3


def test_a_goal_is_given_in_the_world() -> None:
    """With a drift the goal that the MPC gets is the one that the user sees, in the estimate's frame."""
    running = drive(made, "swerve-ur10", 0.01, [])
    drift = np.array([0.5, -0.2, 0.0, *lie.quaternion_about((0, 0, 1), 0.3)])
    steering, requests = UserCommands(running, np.zeros(3)), no_requests()
    seen = np.array([1.0, 0.5, 0.8, *lie.quaternion_about((0, 1, 0), 0.2)])
    requests["goals"][...], requests["goal"][...] = 1, seen
    steering.apply(0.0, requests, drift)
    given = running.mpc.reference["end_effector"].at(0.0)
    np.testing.assert_allclose(lie.pose_compose(drift, given), seen, atol=1e-12)


def test_the_base_goes_to_its_goal() -> None:
    robot = load_robot("swerve-ur10")
    running = drive(made, "swerve-ur10", 3.0, [(0.1, {"base_goals": 1, "base_goal": [0.25, -0.1, 0.3]})])
    truth = running.plant.truth()
    assert np.linalg.norm(truth.tool - robot.pose(robot.home)[0]) < 0.05  # the end effector stays
    assert truth.pose[2] > 0.1 and truth.pose[0] > 0.05


@pytest.mark.parametrize("name", ["swerve-ur10", "differential-ur10"])
@pytest.mark.parametrize("turned", [3.0, -3.3, 9.0, -40.0])
def test_a_base_turns_to_its_goal_by_the_shorter_way_however_often_it_has_turned(name: str, turned: float) -> None:
    """A page's goal is a quaternion, and says no turns. Truth: the goal's direction as it was sent, and the turn from the state."""
    running = drive(made, name, 0.01, [])
    steering, requests, drift = UserCommands(running, np.zeros(3)), no_requests(), NOWHERE.copy()
    x = running.controller.state().copy()
    x[running.mpc.dynamics.state["base"]] = [0.3, -0.2, turned]
    running.controller.state = lambda: x
    drift[3:] = lie.quaternion_about((0.0, 0.0, 1.0), 0.4)
    for k, way in enumerate((0.3, -0.3, 3.0)):
        direction = turned + way + 0.4
        goal = np.arctan2(np.sin(direction), np.cos(direction))
        requests["base_goals"][...], requests["base_goal"][...] = k + 1, [0.2, 0.0, goal]
        steering.apply(0.1 * k, requests, drift)
        found = running.mpc.reference["state"].at(0.1 * k)[running.mpc.dynamics.state["base"]]
        assert found[2] - turned == pytest.approx(way, abs=1e-9)
        np.testing.assert_allclose(found[:2], [0.2 * np.cos(0.4), -0.2 * np.sin(0.4)], atol=1e-9)


def test_a_base_that_stands_turns_its_wheels_first() -> None:
    """Straight wheels, a base that is to turn on the spot: their rows see nothing at standstill (it stays at 0 without)."""
    running = drive(made, "swerve-ur10", 2.5, [(0.1, {"base_goals": 1, "base_goal": [0.0, 0.0, 0.3]})])
    assert running.plant.truth().pose[2] == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize("name", ["H", pytest.param("A", marks=thorough)])
def test_legs_move_and_are_braked_again(name: str) -> None:
    modes: list[str] = []

    def look(t: float, running: Running) -> None:
        schedule = running.mpc.solver.schedule
        modes.append(schedule.modes[schedule.index(t)].name)

    order = {"configurations": 1, "configuration": list(CONFIGURATIONS).index(name)}
    running = drive(made, "swerve-ur10", 7.0, [(0.1, order)], look)
    legs = [running.plant.truth().joints[f"leg_{leg}"] for leg in ("LF", "RF", "LB", "RB")]
    np.testing.assert_allclose(legs, CONFIGURATIONS[name], atol=0.02)
    assert list(dict.fromkeys(modes)) == ["default", "brakes open", "brakes closed"]
    np.testing.assert_array_equal(running.controller.brakes(0.0), 0.0)


SPEED, STARTS = 0.15, 0.5


def on_its_way(robot: Any, seed: int) -> tuple[Any, ...]:
    """A run whose base goes ahead, while it turns a little, with its end effector beside it: references that move."""
    plant, controller, mpc, timing = made(robot, seed)
    t = np.arange(0.0, 12.0, 0.02)
    gone, moving = SPEED * np.maximum(t - STARTS, 0.0), t >= STARTS
    states, inputs = np.tile(robot.home, (t.size, 1)), np.zeros((t.size, robot.input.size))
    states[:, robot.state["base"].start] += gone
    inputs[:, robot.input["base"].start] = SPEED * moving
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.poses(t, position + gone[:, None] * [1.0, 0.0, 0.0], orientation)
    mpc.reference["state"], mpc.reference["input"] = Reference(t, states), Reference(t, inputs)
    return plant, controller, mpc, timing


@thorough
def test_a_driving_base_goes_on_while_its_legs_move() -> None:
    """Truth: MuJoCo. It neither turns back towards where its reference began nor stops."""
    seen: list[tuple[float, float]] = []
    look = lambda t, running: seen.append((t, running.plant.truth().pose[0]))
    order = {"configurations": 1, "configuration": list(CONFIGURATIONS).index("A")}
    running = drive(on_its_way, "swerve-ur10", 6.0, [(3.0, order)], look)
    t, x = np.array(seen).T
    assert np.diff(x[t > 2.0]).min() > -1e-3
    assert np.abs(x - SPEED * np.maximum(t - STARTS, 0.0))[t > 2.0].max() < 0.08
    angles = [running.plant.truth().joints[f"leg_{leg}"] for leg in ("LF", "RF", "LB", "RB")]
    assert np.abs(angles - CONFIGURATIONS["A"]).max() < np.abs(CONFIGURATIONS["X"] - CONFIGURATIONS["A"]).max() - 0.3


def test_orders_take_the_reference_of_their_moment() -> None:
    """Legs and yaw of a reference that has moved on are kept when the base's goal is dragged, the base's path when legs are."""
    robot = load_robot("swerve-ur10")
    plant, controller, mpc, _ = on_its_way(robot, 1)
    controller.measure(plant.measure())
    base, leg = robot.state["base"], robot.state["leg"]
    previous = mpc.reference["state"]
    previous.values[:, base.start + 2] = 0.1 * previous.times
    previous.values[:, leg] += 0.05 * previous.times[:, None]
    running: Any = Running(plant, controller, mpc, None, np.inf)  # type: ignore[arg-type]
    steering, requests = UserCommands(running, np.zeros(3)), no_requests()
    position, orientation = robot.pose(robot.home)
    requests["goals"][...], requests["goal"][...] = 1, [*position, *orientation]
    steering.apply(4.0, requests, NOWHERE)
    held = mpc.reference["state"].at(4.0)
    assert held[base.start + 2] == pytest.approx(0.4)
    np.testing.assert_allclose(held[leg], robot.home[leg] + 0.2)
    mpc.reference["state"] = previous
    requests["configurations"][...], requests["configuration"][...] = 1, list(CONFIGURATIONS).index("H")
    steering.apply(4.0, requests, NOWHERE)
    for t in (4.0, 7.0):
        np.testing.assert_allclose(mpc.reference["state"].at(t)[base], previous.at(t)[base])
        np.testing.assert_allclose(mpc.reference["state"].at(t)[leg], 0.0)


def test_brakes_open_at_once() -> None:
    running = drive(made, "swerve-ur10", 0.5, [(0.1, {"brake_clicks": 1, "brakes_open": 1})])
    np.testing.assert_array_equal(running.controller.brakes(0.0), 1.0)


def test_brakes_of_legs_that_hold_nothing_stay_closed(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """In H open legs would let the base go sideways (all four are parallel); the same click in X opens them."""
    running = drive(made, "swerve-ur10", 0.01, [])
    x, controller = running.controller.state(), running.controller
    monkeypatch.setattr(controller, "state", lambda: x)
    requests, drift = no_requests(), np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    requests["brake_clicks"][...], requests["brakes_open"][...] = 1, 1
    inside, x[controller.robot.state["leg"]] = x[controller.robot.state["leg"]].copy(), 0.0
    UserCommands(running, np.zeros(3)).apply(0.0, requests, drift)
    np.testing.assert_array_equal(controller.brakes(0.0), 0.0)
    assert "nothing would hold the base against sideways" in caplog.text
    x[controller.robot.state["leg"]] = inside
    UserCommands(running, np.zeros(3)).apply(0.0, requests, drift)
    np.testing.assert_array_equal(controller.brakes(0.0), 1.0)


def test_a_push_ends_by_itself() -> None:
    forces: dict[float, float] = {}

    def look(t: float, running: Running) -> None:
        forces[t] = float(running.plant.data.xfrc_applied[running.plant.world.body, 1])

    drive(made, "rezero", 0.5, [(0.1, {"pushes": 1, "push": [0, 15.0, 0], "push_time": 0.2})], look)
    pushed = [t for t, f in forces.items() if f > 0.0]
    assert max(forces.values()) == 15.0
    assert pushed[0] == pytest.approx(0.1, abs=0.01) and pushed[-1] == pytest.approx(0.3, abs=0.01)


def test_the_ball_robot_follows_its_goal() -> None:
    robot = load_robot("rezero")
    position, orientation = robot.pose(robot.home)
    seen = position + [0.3, 0.2, robot.description.base.ball_radius]  # in the world the floor is at 0
    running = drive(made, "rezero", 3.5, [(0.1, {"goals": 1, "goal": [*seen, *orientation]})])
    assert np.linalg.norm(running.plant.truth().tool - position - [0.3, 0.2, 0]) < 0.03


def test_weights_act_without_compiling() -> None:
    """An end effector that costs a thousandth gives way to the base's goal; back at its weight it is held again."""
    base = {"base_goals": 1, "base_goal": [2.5, 0.0, 0.0]}
    robot = load_robot("swerve-ur10")
    home = robot.pose(robot.home)[0]
    firm = drive(made, "swerve-ur10", 1.2, [(0.1, base)])
    steering = UserCommands(firm, np.zeros(3))
    factors = np.ones(16)
    factors[[c.name for c in steering.costs].index("end_effector")] = 1e-3
    soft = drive(made, "swerve-ur10", 1.2, [(0.05, {"weights": factors}), (0.1, base)])
    assert firm.mpc.solver.kernel is not None
    far = [np.linalg.norm(r.plant.truth().tool - home) for r in (firm, soft)]
    assert far[1] > 1.5 * far[0]
    again = soft.mpc.solver.constants.copy()
    steering = UserCommands(soft, np.zeros(3))
    steering._weights = steering._seen_weights = factors
    steering.apply(0.0, no_requests(), NOWHERE)
    assert not np.array_equal(soft.mpc.solver.constants, again)
    np.testing.assert_array_equal(soft.mpc.solver.constants, firm.mpc.solver.constants)


def test_orders_before_a_run_are_not_for_it() -> None:
    running = drive(made, "rezero", 0.01, [])
    steering, requests = UserCommands(running, np.zeros(3)), no_requests()
    requests["pushes"][...], requests["push"][...], requests["push_time"][...] = 3, [9, 0, 0], 1.0
    steering.skip(requests)
    steering.apply(0.0, requests, NOWHERE)
    assert not running.plant.data.xfrc_applied.any()
    assert steering.braked is None


@pytest.mark.parametrize("name", ["swerve-ur10", "rezero"])
def test_orders_that_cannot_be_done_change_nothing(name: str) -> None:
    """Not finite, no quaternion, far away: the references stay, the reason is given, and the loop goes on to its end."""
    running = drive(made, name, 0.01, [])
    rejected: list[str] = []
    steering = UserCommands(running, np.zeros(3), rejected.append)
    position, turn = running.controller.robot.pose(running.controller.robot.home)
    previous = running.mpc.reference["end_effector"]
    bad: list[dict[str, Any]] = [
        {"goals": 1, "goal": [np.nan, *position[1:], *turn]}, {"goals": 2, "goal": [*position, 0.0, 0, 0, 0]},
        {"goals": 3, "goal": [1e9, 0.0, 1.0, *turn]}, {"pushes": 1, "push": [np.nan, 0.0, 0.0], "push_time": 1.0},
        {"pushes": 2, "push": [10.0, 0.0, 0.0], "push_time": np.inf}, {"base_goals": 1, "base_goal": [np.nan, 0.0, 0.0]},
        {"weights": np.full(MAX_WEIGHTS, np.nan)}, {"weights": np.zeros(MAX_WEIGHTS)},
    ]  # fmt: skip
    if steering.braked is not None:
        bad += [{"configurations": 1, "configuration": 99.0}, {"brake_clicks": 1, "brakes_open": np.nan}]
    requests = no_requests()
    weights = running.mpc.solver.constants.copy()
    for k, wrong in enumerate(bad):
        for key, value in wrong.items():
            requests[key][...] = value
        steering.apply(0.1 * k, requests, NOWHERE)
        steering.apply(0.1 * k + 0.05, requests, NOWHERE)  # said once, not at every tick
        assert len(rejected) == k + 1, wrong
    assert running.mpc.reference["end_effector"] is previous
    np.testing.assert_array_equal(running.mpc.solver.constants, weights)
