"""Goals and speeds as they come from the bus, the bad ones too. Truth: what was sent, the wheels' radius."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds

from effort import some
from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.ros2.convert import planar, planar_path, read_pose, read_poses
from wbmpc.ros2.goals import Planner
from wbmpc.ros2.hold_ups import HoldUps
from wbmpc.ros2.opening import open_node
from wbmpc.ros2.publishers import rejections
from wbmpc.ros2.request_queue import RequestQueue
from wbmpc.ros2.settings import settings_of

pytestmark = needs_dds
if not MISSING:
    from standin import NETWORK, drive


BAD_GOALS: tuple[tuple[str, str, dict[str, float], str], ...] = (
    ("/goal_pose", "map", {}, "unknown frame 'map'; valid: odom, base_link"),
    ("/goal_pose", "odom", {"x": float("nan")}, "a number is not finite"),
    ("/goal_pose", "odom", {"x": 1.0, "z": 5.0}, "has z = 5.00 m in 'odom'; valid: -0.50 to "),
    ("/goal_pose", "base_link", {"x": 1.0, "z": -2.0}, "has z = -2.00 m in 'base_link'; valid: -"),
    ("/end_effector_goal", "odom", {"x": 1.0, "z": -0.4}, "out of reach: height -0.40 m, possible 0.00 to 2.39 m"),
    ("/end_effector_goal", "odom", {"x": 1.0, "z": 3.0}, "out of reach: height 3.00 m, possible 0.00 to 2.39 m"),
)


def test_bad_goals_change_nothing(pair: Callable[..., Any]) -> None:
    """One after the other, while the robot drives."""
    p = pair(rates={"diagnostics": 0.01})  # what is new is reported at once
    drive(p)
    task = p.control.active_task
    said = lambda: [v.value for m in p.said for s in m.status for v in s.values if v.key == "rejected"]
    for topic, frame, position, says in BAD_GOALS:
        p.send(topic, "geometry_msgs/msg/PoseStamped", {"header": {"frame_id": frame}, "pose": {"position": position}})
        assert p.until(lambda: says in p.control.request_queue.rejected)  # noqa: B023 - asked within the turn
        assert p.control.active_task is task and p.control.running
        assert p.until(lambda: any(says in text for text in said()))  # noqa: B023


def test_whatever_a_goal_does_what_runs_goes_on(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Too far away, and a planner that fails as nobody foresaw: the robot drives on, one log line each, diagnostics say so;
    the next goal that is taken ends it."""
    p = pair()
    drive(p)
    task = p.control.active_task
    for _ in range(2):
        p.go(1e6)
        assert p.until(lambda: "the base's goal is 1e+06 m away" in p.control.request_queue.rejected)
    assert p.control.active_task is task
    assert sum("1e+06 m away" in r.getMessage() for r in caplog.records) == 1

    def fails(*_: Any) -> None:
        raise MemoryError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(p.control.adapter.planner, "to_base", fails)
        says = "a goal is rejected: MemoryError: no room"
        for _ in range(2):
            p.go(1.5)
            assert p.until(lambda: p.control.request_queue.rejected == says)
    assert p.control.active_task is task and p.control.running and p.standin.speed > 0.5
    assert sum(says in r.getMessage() for r in caplog.records) == 1
    said = lambda: [v.value for m in p.said for s in m.status for v in s.values if v.key == "rejected"]
    assert p.until(lambda: says in said())
    p.go(1.5)
    assert p.until(lambda: p.control.active_task is not task)
    assert p.control.request_queue.rejected == ""


def test_a_goal_that_is_long_in_planning_keeps_nobody_waiting(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot drives on and says so meanwhile; and once it has stopped, the plan does not start it again."""
    p = pair(rates={"diagnostics": 20.0})
    drive(p)
    task, begun, go_on = p.control.active_task, threading.Event(), threading.Event()
    plan = p.control.adapter.planner.to_base

    def slow(*given: Any) -> Any:
        begun.set()
        assert go_on.wait(60.0)
        return plan(*given)

    monkeypatch.setattr(p.control.adapter.planner, "to_base", slow)
    p.go(1.5)
    assert p.until(begun.is_set)
    p.said.clear()
    assert p.until(lambda: len(p.said) > 2) and p.control.state == "running: base to a goal"
    assert p.control.active_task is task and p.standin.speed > 0.5
    go_on.set()
    assert p.until(lambda: p.control.active_task is not task) and p.control.request_queue.rejected == ""
    begun.clear()
    go_on.clear()
    p.go(2.5)
    assert p.until(begun.is_set)
    broken = iter([lambda m: {**m, "position": m["position"] * np.nan}])
    p.standin.change = lambda m: next(broken, lambda same: same)(m)
    assert p.until(lambda: p.control.runner.stopped and p.standin.speed == 0.0)
    go_on.set()
    assert p.until(lambda: p.control.request_queue.rejected == "a goal is rejected: the robot has stopped meanwhile")
    p.run(0.2)
    assert p.control.runner.stopped and p.standin.speed == 0.0


@pytest.mark.parametrize("where", ["planning", "waiting behind another one", "beginning"])
def test_a_goal_from_before_the_process_was_held_up_does_not_start(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    """A robot that stands; the process is held up for 3 s while a goal is planned, or while the run of it begins, and so are a second goal and
    a command for legs that wait meanwhile. By hand: a clock that is set. What is sent again starts."""
    p, begun, go_on, now = pair(), threading.Event(), threading.Event(), [10.0]
    adapter, hold_ups = p.control.adapter, p.control.hold_ups
    monkeypatch.setattr(hold_ups, "wall", lambda: now[0])
    plan, begin = adapter.planner.to_base, adapter.begin
    p.ready()
    hold_ups.look()

    def slow(*given: Any) -> Any:
        begun.set()
        assert go_on.wait(60.0)
        return plan(*given)

    def held(x: Any) -> None:
        begin(x)
        now[0] += 3.0

    says = "a goal is rejected: it is from before the node was held up"
    if where == "beginning":
        monkeypatch.setattr(adapter, "begin", held)
        p.go(1.5)
    else:
        monkeypatch.setattr(adapter.planner, "to_base", slow)
        p.go(1.5)
        assert p.until(begun.is_set)
        if where != "planning":
            p.go(2.5)
            p.send("/leg_configuration", "std_msgs/msg/String", {"data": "X"})
        p.run(0.1)
        now[0] += 3.0
        go_on.set()
    assert p.until(lambda: p.control.request_queue.rejected == says)
    p.run(0.2)
    assert p.control.runner is None and p.control.request_queue.running is None and p.standin.speed == 0.0
    legs = p.control.base_commands.commands
    assert ("from before" in legs.rejected) is (where == "waiting behind another one") and not legs.waiting
    monkeypatch.setattr(adapter, "begin", begin)
    for _ in range(45):  # as the thread of the node does, for four seconds
        hold_ups.look()
        now[0] += 0.09
    p.go(1.5)
    assert p.until(lambda: p.control.running) and p.control.request_queue.rejected == ""


def test_who_ends_brings_the_robot_to_rest_before_it_waits_for_a_plan(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Truth: the order of what happens."""
    p = pair()
    seen: list[str] = []
    monkeypatch.setattr(p.control.robot_io, "rest", lambda: seen.append("at rest"))
    monkeypatch.setattr(p.control, "runner", SimpleNamespace(stopped=True))
    monkeypatch.setattr(p.control, "_end_runner", lambda: seen.append("no more ticks"))
    monkeypatch.setattr(p.control.planning, "close", lambda: seen.append("no more plans"))
    p.control.close()
    assert seen == ["no more ticks", "at rest", "no more plans"]
    monkeypatch.undo()


@pytest.mark.parametrize("stamped", some([False, True], [0]))
def test_speeds_of_either_type_drive_the_base_and_run_out(pair: Callable[..., Any], stamped: bool) -> None:
    p = pair(safety={"cmd_vel": 0.3})
    p.ready()
    twist = {"linear": {"x": 0.4}}
    kind = "geometry_msgs/msg/TwistStamped" if stamped else "geometry_msgs/msg/Twist"
    publisher = p.standin.node.publisher("/cmd_vel", kind)
    assert p.until(lambda: publisher._writer.get_matched_subscriptions())
    for _ in range(12):
        publisher.publish({"twist": twist} if stamped else twist)
        p.run(0.1)
    assert p.control.adapter.snapshot()[1][0] > 0.1
    np.testing.assert_allclose(np.abs(p.standin.commands["wheel"]), 4.0, rtol=0.1)  # 0.4 m/s on wheels of 0.1 m
    assert p.until(lambda: np.abs(p.standin.commands["wheel"]).max() < 0.2)  # 20 mm/s
    assert p.control.state == "running: base to rest"
    assert p.control.running


def test_stamped_speeds_drive_the_base_beside_somebody_who_could_send_plain_ones(pair: Callable[..., Any]) -> None:
    """A teleoperator who is silent, then a navigator: both types of one topic, and no mismatch is reported."""
    p = pair()
    p.ready()
    silent = p.standin.node.publisher("/cmd_vel", "geometry_msgs/msg/Twist")
    assert p.until(lambda: silent._writer.get_matched_subscriptions())
    other = open_node("navigator", "dds", NETWORK)
    try:
        publisher = other.publisher("/cmd_vel", "geometry_msgs/msg/TwistStamped")
        assert p.until(lambda: publisher._writer.get_matched_subscriptions())
        for _ in range(4):
            publisher.publish({"twist": {"linear": {"x": 0.4}}})
            p.run(0.1)
        assert p.control.state == "running: base at a speed" and p.standin.speed > 1.0
        assert p.node.faults == []
    finally:
        other.close()


class Speeds:
    """Somebody who sends speeds to a pair's controller, 20 times a second."""

    def __init__(self, p: Any, kind: str = "Twist") -> None:
        self.pair, self.kind = p, kind
        p.ready()
        self._publisher = p.standin.node.publisher("/cmd_vel", f"geometry_msgs/msg/{kind}")
        assert p.until(lambda: self._publisher._writer.get_matched_subscriptions())

    def send(self, seconds: float, frame: str = "", **linear: float) -> np.ndarray:
        """For so long; the base's poses (n, 3) after every message."""
        poses = []
        for _ in range(round(seconds / 0.05)):
            twist = {"linear": linear}
            self._publisher.publish(twist if self.kind == "Twist" else {"header": {"frame_id": frame}, "twist": twist})
            self.pair.run(0.05)
            poses.append(self.pair.control.adapter.snapshot()[1][:3])
        return np.array(poses)


def said(p: Any, key: str) -> list[str]:
    """Values of a key of the diagnostics."""
    return [v.value for m in p.said for s in m.status for v in s.values if v.key == key]


def test_speeds_of_another_frame_are_rejected(pair: Callable[..., Any]) -> None:
    p = pair()
    speeds = Speeds(p, "TwistStamped")
    speeds.send(0.2, "map", x=0.4)
    assert p.control.request_queue.rejected == "/cmd_vel: the speed is in the frame 'map'; valid: base_link, or none"
    assert p.control.runner is None and p.until(lambda: p.control.request_queue.rejected in said(p, "rejected"))
    speeds.send(0.2, "base_link", x=0.4)
    assert p.until(lambda: p.control.state == "running: base at a speed") and p.control.request_queue.rejected == ""


def test_a_speed_beyond_the_limits_is_scaled_and_that_is_said(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    p = pair(cmd_vel={"base": 0.3}, safety={"cmd_vel": 2.0})
    speeds = Speeds(p)
    speeds.send(1.0, x=1e6)
    says = "/cmd_vel: 1e+06, 0 m/s, 0 rad/s is faster than 0.3, 0.3 m/s, 1 rad/s (key 'cmd_vel'): scaled down to that"
    assert p.until(lambda: says in said(p, "limited speed"))
    assert sum(r.getMessage() == says for r in caplog.records) == 1
    np.testing.assert_allclose(np.abs(p.standin.commands["wheel"]), 3.0, rtol=0.1)  # 0.3 m/s on wheels of 0.1 m
    speeds.send(0.1, x=0.2)
    assert p.control.request_queue.limited == "" and rejections(p.control) == {}


def test_a_path_of_another_clock_or_with_poses_in_another_frame_is_rejected(pair: Callable[..., Any]) -> None:
    p = pair()
    drive(p)
    task = p.control.active_task
    pose = lambda i, frame="": {
        "header": {"stamp": {"sec": i}, "frame_id": frame},
        "pose": {"position": {"x": 0.2 * (i % 10)}},
    }
    for poses, says in (
        ([pose(1_700_000_000), pose(1_700_000_001)], "s from now; valid: at most 60 s (are its stamps of this clock?)"),
        ([pose(0, "odom"), pose(0, "map")], "pose 1 of the path is in the frame 'map', the path in 'odom'"),
    ):
        p.send("/base_path", "nav_msgs/msg/Path", {"header": {"frame_id": "odom"}, "poses": poses})
        assert p.until(lambda t=says: t in p.control.request_queue.rejected), p.control.request_queue.rejected
        assert p.control.active_task is task and p.control.running


def test_a_long_path_is_read_at_once() -> None:
    """The node's own thread reads it, and publishes nothing meanwhile: one by one, 20 000 poses took two seconds. Truth: poses one by one, on
    a way that turns; the time of the processor that this takes. What is wrong with one says which it is."""
    rng = np.random.default_rng(3)
    n, numbers = 3000, lambda names, row: SimpleNamespace(**dict(zip(names, map(float, row), strict=True)))
    turned = rng.normal(size=(n, 4))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    rows = zip(rng.normal(size=(n, 3)), turned, strict=True)
    poses: list[Any] = [SimpleNamespace(position=numbers("xyz", p), orientation=numbers("wxyz", q)) for p, q in rows]
    begin = time.process_time()
    pairs = [read_pose(p, "a pose") for p in poses]
    planar_poses = [planar(*pair) for pair in pairs]
    middle = time.process_time()
    positions, orientations = read_poses(poses, "pose {} of the path")
    found = planar_path(positions, orientations)
    end = time.process_time()
    np.testing.assert_allclose(positions, [p for p, _ in pairs], atol=1e-15)
    np.testing.assert_allclose(orientations, [q for _, q in pairs], atol=1e-15)
    np.testing.assert_allclose(found, planar_poses, atol=1e-12)
    assert end - middle < 0.4 * (middle - begin)
    for k, wrong, says in ((7, np.nan, "not finite"), (8, 1e8, "too large"), (9, None, "quaternion has length 0")):
        if wrong is None:
            poses[k].orientation = numbers("wxyz", np.zeros(4))
        else:
            poses[k].position.y = wrong
        with pytest.raises(InputError, match=f"pose {k} of the path.*{says}"):
            read_poses(poses, "pose {} of the path")
        poses[k] = poses[0]


def test_a_path_in_the_bases_frame_is_moved_as_its_poses_are() -> None:
    """Truth: the base's rotation about the vertical, as a matrix."""
    robot = load_robot("differential-ur10")
    settings = settings_of(robot)()
    node: Any = SimpleNamespace(subscribe=lambda *given, **also: None)
    planner = Planner(robot, settings.speeds, settings.goals)
    queue = RequestQueue(HoldUps(), node, planner, settings, lambda: 0.0, time.monotonic, time.monotonic)
    rng, x = np.random.default_rng(4), robot.home.copy()
    x[robot.state["base"]] = [1.0, -2.0, 0.7]
    positions, turned = rng.normal(size=(9, 3)), rng.normal(size=(9, 4))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    c, s = np.cos(0.7), np.sin(0.7)
    turn, height = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), queue.planner.base_height
    down = np.array([0.0, 0.0, queue.planner.lift])
    moved, orientations = queue._in_world("base_link", x, positions, turned)
    np.testing.assert_allclose(moved, [np.array([1.0, -2.0, height]) + turn @ p - down for p in positions], atol=1e-12)
    rotation = lie.quaternion_to_rotation
    for q, was in zip(orientations, turned, strict=True):
        np.testing.assert_allclose(rotation(q), turn @ rotation(was), atol=1e-12)
    np.testing.assert_allclose(queue._in_world("odom", x, positions, turned)[0], positions - down, atol=1e-15)


def test_a_flood_of_goals_is_a_few_log_lines(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    """Goals of two kinds in turn, each of which is taken: five lines in 10 s, as of every cause."""
    p = pair()
    drive(p)
    position, turned = p.control.robot.pose(p.control.adapter.snapshot()[1])
    there = {"position": dict(zip("xyz", position, strict=True)), "orientation": dict(zip("wxyz", turned, strict=True))}
    taken = set()
    for _ in range(10):
        p.go(2.0)
        assert p.until(lambda: "base" in p.control.task)
        p.send("/end_effector_goal", "geometry_msgs/msg/PoseStamped", {"header": {"frame_id": "odom"}, "pose": there})
        assert p.until(lambda: "end effector" in p.control.task)
        taken.add(p.control.task)
    assert taken == {"end effector to a goal"}
    lines = [r.getMessage() for r in caplog.records if r.getMessage().startswith("running: ")]
    assert 0 < len(lines) <= 5 * (1 + int((caplog.records[-1].created - caplog.records[0].created) // 10.0)), lines
