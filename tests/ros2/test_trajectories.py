"""Trajectories for a joint_trajectory_controller. Truth: its rules as documented (an end at rest, rising times, all joints, not in
the past), limits of the robot's file, and braking by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from wbmpc.bases import base_type
from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.mpc.policy import Policy
from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.control import ControlNode
from wbmpc.ros2.convert import error_message, seconds
from wbmpc.ros2.settings import Controller, drive_groups, settings_of
from wbmpc.ros2.trajectory_client import AHEAD, Trajectories, TrajectorySender

ROBOT = load_robot("swerve-ur10")
ARM = list(ROBOT.input.groups["arm"])
LIMITS = ROBOT.description.limits


def plain(values: dict[str, Any]) -> Any:
    """A message as it comes out of the bus."""
    empty: dict[str, Any] = {"accelerations": (), "effort": ()}
    points = [
        SimpleNamespace(**{**empty, **p, "time_from_start": SimpleNamespace(**p["time_from_start"])})
        for p in values["points"]
    ]
    head = SimpleNamespace(stamp=SimpleNamespace(**values["header"]["stamp"]))
    return SimpleNamespace(header=head, joint_names=values["joint_names"], points=points)


def plan(rate: np.ndarray, start: np.ndarray | None = None) -> Policy:
    """Of an arm that moves at a constant rate [rad/s] for 2 s."""
    times = np.linspace(0.0, 2.0, 41)
    x = np.tile(ROBOT.home, (41, 1))
    x[:, ROBOT.state["arm"]] = (ROBOT.home[ROBOT.state["arm"]] if start is None else start) + times[:, None] * rate
    u = np.zeros((40, ROBOT.input.size))
    u[:, ROBOT.input["arm"]] = rate
    return Policy(times, x, u, np.zeros((40, ROBOT.input.size, ROBOT.state.size)))


def leading(rate: np.ndarray, start: np.ndarray | None = None, joints: Any = ARM) -> tuple[TrajectorySender, Any]:
    """Who leads the arm along such a plan since 7 s, and all that is sent."""
    said: list[dict[str, Any]] = []
    node: Any = SimpleNamespace(publisher=lambda *given: SimpleNamespace(publish=said.append))
    controller = Controller(topic="/arm", joints=tuple(joints), takes="trajectory")
    sender = TrajectorySender(node, ROBOT, SwerveRosSettings(), controller)
    sender.send(plan(rate, start), 0.01, 7.0)
    return sender, said


def sent(rate: np.ndarray, start: np.ndarray | None = None) -> Any:
    """What is sent for an arm that moves at a constant rate [rad/s] as long as anybody plans; now is 7 s."""
    return plain(leading(rate, start)[1][0])


def test_a_moving_arms_trajectory_ends_at_rest() -> None:
    """Two joints at 1 and -0.5 rad/s: constant deceleration below the limits, over half the way of the speed."""
    rate = np.array([1.0, 0.0, -0.5, 0.0, 0.0, 0.0])
    message = sent(rate)
    last, end = message.points[-2:]
    assert seconds(last.time_from_start) < AHEAD and np.array_equal(last.velocities, rate)
    np.testing.assert_array_equal(end.velocities, np.zeros(6))
    takes = seconds(end.time_from_start) - seconds(last.time_from_start)
    acceleration = np.array([LIMITS.acceleration[n] for n in ARM])
    assert np.all(np.abs(rate) / takes <= acceleration) and takes < 2.0 * np.max(np.abs(rate) / acceleration)
    np.testing.assert_allclose(np.array(end.positions) - last.positions, 0.5 * takes * rate, atol=1e-9)
    led = base_type("swerve").ros_plant(ROBOT, None, 0).lead(ARM, [("arm", i) for i in range(6)], message, 7.0)
    np.testing.assert_array_equal(led.at(led.times[-1])[1], np.zeros(6))


def test_no_joint_is_sent_beyond_its_range() -> None:
    upper = ROBOT.limits.state_upper[ROBOT.state["arm"]]
    start = ROBOT.home[ROBOT.state["arm"]].copy()
    start[2] = upper[2] - 0.52
    message = sent(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), start)
    assert message.points[-2].positions[2] < upper[2] == message.points[-1].positions[2]


RULES = [
    (lambda m: m.points.clear(), "no points"),
    (lambda m: m.joint_names.pop(), "joints .* are needed"),
    (lambda m: m.joint_names.__setitem__(0, "elbow"), "joints .* are needed"),
    (lambda m: setattr(m.points[-1], "velocities", np.full(6, 0.01)), "must be at rest"),
    (lambda m: setattr(m.points[2], "time_from_start", m.points[1].time_from_start), "must rise"),
    (lambda m: setattr(m.header.stamp, "sec", 5), "it ended"),
    (lambda m: setattr(m.points[1], "positions", np.zeros(5)), "needs 6 positions"),
    (lambda m: setattr(m.points[1], "velocities", np.zeros(7)), "needs 6 velocities"),
    (lambda m: setattr(m.points[1], "positions", np.full(6, np.nan)), "positions: a number is not finite"),
    (lambda m: setattr(m.points[1], "velocities", np.full(6, np.inf)), "velocities: a number is not finite"),
    (lambda m: setattr(m.points[1], "positions", np.full(6, 1e300)), "positions: a number is too large"),
    (lambda m: setattr(m.points[1], "accelerations", np.zeros(5)), "needs 6 accelerations"),
    (lambda m: setattr(m.points[1], "effort", np.zeros(6)), "efforts are not supported"),
    (lambda m: setattr(m.points[0].time_from_start, "sec", -1), "must rise"),
    (lambda m: m.joint_names.extend(["x" * 1000] * 1000), "got 1006"),
]


@pytest.mark.parametrize(("change", "says"), RULES)
def test_the_follower_rejects_what_the_real_controller_does(change: Any, says: str) -> None:
    side, places = base_type("swerve").ros_plant(ROBOT, None, 0), [("arm", i) for i in range(6)]
    message = sent(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    side.lead(ARM, places, message, 7.0)
    change(message)
    with pytest.raises(InputError, match=says):
        side.lead(ARM, places, message, 7.0)


def test_what_is_wrong_with_a_long_trajectory_is_said_in_a_line() -> None:
    """However many points, rows and names it has."""
    side, places = base_type("swerve").ros_plant(ROBOT, None, 0), [("arm", i) for i in range(6)]
    changes: tuple[Any, ...] = (
        lambda m: m.points.extend(m.points[-1:] * 10_000),
        lambda m: [setattr(p, "positions", np.zeros(3)) for p in m.points * 1000],
        lambda m: m.joint_names.__setitem__(slice(None), ["x" * 100_000] * 6),
    )
    for change in changes:
        message = sent(np.zeros(6))
        change(message)
        with pytest.raises(InputError) as error:
            side.lead(ARM, places, message, 7.0)
        assert len(error_message(error.value)) < 400


@pytest.mark.parametrize(("stamp", "after"), [(0, 100), (107, 0), (107, 50)])
def test_the_way_to_the_first_point_takes_its_time(stamp: int, after: int) -> None:
    """As a joint_trajectory_controller interpolates from where the joints are: 0.3 rad in 100 s and more are 3 mrad in the first second."""
    side, places = base_type("swerve").ros_plant(ROBOT, None, 0), [("arm", i) for i in range(6)]
    here = side.read().joints["arm"]
    point = {"positions": here + 0.3, "velocities": np.zeros(6), "time_from_start": {"sec": after, "nanosec": 0}}
    head = {"stamp": {"sec": stamp, "nanosec": 0}}
    side.led["arm"] = side.lead(ARM, places, plain({"header": head, "joint_names": list(ARM), "points": [point]}), 7.0)
    for now in (7.0, 8.0, 57.0):
        assert np.all(np.abs(side.led["arm"].at(now)[0] - here) <= 0.3 * (now - 7.0) / 100.0 + 1e-12)
    rates = {"arm": np.zeros(6)}
    side.track(rates, 8.0)
    assert np.all(np.abs(rates["arm"]) < 0.05)
    np.testing.assert_allclose(side.led["arm"].at(300.0)[0], here + 0.3)


def test_a_new_trajectory_goes_on_at_the_speed_of_the_old_one() -> None:
    side, places = base_type("swerve").ros_plant(ROBOT, None, 0), [("arm", i) for i in range(6)]
    side.read()
    rate = np.array([1.0, 0.0, -0.5, 0.0, 0.0, 0.0])
    side.led["arm"] = side.lead(ARM, places, sent(rate), 7.0)
    later = sent(rate)
    later.header.stamp.nanosec = 300_000_000
    side.led["arm"] = side.lead(ARM, places, later, 7.1)
    np.testing.assert_allclose(side.led["arm"].at(7.1)[1], rate, atol=1e-9)


def test_a_stop_brakes_on_and_does_not_turn_back() -> None:
    """Truth: constant deceleration from the speed to rest within the ramp by hand, and the cubic between two points of a
    joint_trajectory_controller: with another end than that a joint would come back, and brake harder."""
    rate, ramp = np.array([1.0, -2.0, 0.5, 0.0, 0.3, -0.1]), 0.2
    sender, said = leading(rate, joints=tuple(reversed(ARM)))
    sender.stop(ROBOT.home, ramp, 7.0)
    (point,) = plain(said[1]).points
    start, end = ROBOT.home[ROBOT.state["arm"]], np.array(point.positions)[::-1]
    takes = seconds(point.time_from_start)
    assert takes == ramp and not np.any(point.velocities)
    share = np.linspace(0.0, 1.0, 101)[:, None]
    speeds = 6.0 * share * (1.0 - share) * (end - start) / takes + (1.0 - share) * (1.0 - 3.0 * share) * rate
    np.testing.assert_allclose(speeds, (1.0 - share) * rate, atol=1e-9)
    sender.stop(ROBOT.home, 0.0, 7.0)  # time has to pass
    assert 0.0 < seconds(plain(said[2]).points[0].time_from_start) < ramp


@pytest.mark.parametrize("age", [0.0, 2.0])
def test_a_stop_sets_no_arm_going_that_rests(age: float) -> None:
    """The node was held up for 2 s, in which the arm followed its last trajectory to its end. Truth: that end, whether joint states say
    so by now or are as old as the trajectory; and there it stays after a second stop."""
    rate = np.array([1.0, -0.4, 0.5, 0.0, 0.3, -0.1])
    sender, said = leading(rate)
    end, x = np.array(plain(said[0]).points[-1].positions), ROBOT.home.copy()
    x[ROBOT.state["arm"]] = end if age == 0.0 else ROBOT.home[ROBOT.state["arm"]] + 0.01 * rate  # as it was at 7 s
    for _ in range(2):
        sender.stop(x, 0.2, 9.0, age)
        np.testing.assert_allclose(plain(said[-1]).points[-1].positions, end, atol=1e-9)
        x[ROBOT.state["arm"]], age = end, 0.0


@pytest.mark.parametrize(("age", "counts"), [(0.1, 0.1), (-0.5, 0.0), (9.0, AHEAD)])
def test_a_stop_after_silence_brakes_from_where_the_arm_has_gone_since(age: float, counts: float) -> None:
    """Joint states ended 0.1 s before the stop: the arm has followed its trajectory since. Truth: the same constant deceleration, from
    there. A clock that went back counts for none; beyond its trajectory's end the arm has not gone."""
    said: list[dict[str, Any]] = []
    node: Any = SimpleNamespace(publisher=lambda *given: SimpleNamespace(publish=said.append))
    controllers = {
        group: Controller(topic=f"/{group}", joints=tuple(names), takes="trajectory" if group == "arm" else "numbers")
        for group, names in drive_groups(ROBOT).items()
        if names and group != "brake"
    }
    settings = SwerveRosSettings(controllers=controllers)
    trajectories = Trajectories(node, ROBOT, settings)
    rate, place = np.array([0.3, -0.4, 0.2, 0.0, 0.3, -0.1]), ROBOT.state["arm"]
    trajectories.send(plan(rate), 0.01, lambda: 7.0)
    state = SimpleNamespace(
        trajectories=trajectories, adapter=SimpleNamespace(snapshot=lambda: (3.0, ROBOT.home)), now=lambda: 7.0,
        settings=settings, clock=SimpleNamespace(now=lambda: 3.0 + age),
    )  # fmt: skip
    ControlNode._stop_trajectories(state)  # type: ignore[arg-type]
    (point,) = plain(said[1]).points
    takes = seconds(point.time_from_start)
    np.testing.assert_allclose(np.array(point.positions) - ROBOT.home[place], (counts + 0.5 * takes) * rate, atol=1e-9)


def test_a_stop_leaves_no_joint_beyond_its_range() -> None:
    sender, said = leading(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    x, place = ROBOT.home.copy(), ROBOT.state["arm"]
    upper = ROBOT.limits.state_upper[place][2]
    x[place.start + 2] = upper - 0.01
    sender.stop(x, 0.2, 7.0)
    assert plain(said[1]).points[0].positions[2] == upper


@pytest.mark.parametrize("back", [False, True])
def test_an_arm_whose_simulator_has_restarted_is_led_nowhere(back: bool) -> None:
    """A stop leads an arm to rest at where it was, within 0.2 s; that of a new simulation is far from there. By hand: times of /clock."""
    clock, led = BusClock(), list[Any]()
    for t in (10.0, 10.5, *([1.0] * back)):
        clock.set(t)
    control = SimpleNamespace(
        clock=clock, now=clock.stamp, settings=settings_of(ROBOT)(),
        trajectories=SimpleNamespace(restart=lambda: None, stop=lambda *given: led.append(given)),
        adapter=SimpleNamespace(snapshot=lambda: (10.4, ROBOT.home)),
    )  # fmt: skip
    ControlNode._stop_trajectories(control)  # type: ignore[arg-type]
    assert bool(led) is not back


def test_a_trajectory_of_a_time_that_went_back_says_nothing_of_now() -> None:
    """A run of the new time that ends before its first trajectory: the arm stands where it is. By hand: 1 rad/s at 1000 s, a stop at 1 s."""
    said = list[Any]()
    node: Any = SimpleNamespace(publisher=lambda *_: SimpleNamespace(publish=said.append))
    arm = Controller(topic="/arm", joints=tuple(ARM), takes="trajectory")
    sender = TrajectorySender(node, ROBOT, settings_of(ROBOT)(), arm)
    sender.send(plan(np.ones(6)), 0.0, 1000.0)
    sender.stop(ROBOT.home, 0.2, 1.0)
    np.testing.assert_array_equal(said[-1]["points"][-1]["positions"], ROBOT.home[ROBOT.state["arm"]])
