"""Inputs with one source and more than one publisher. Truth: messages with what nobody else has said; the stand-in's wheels."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, wait_until

from wbmpc.ros2.sources import AMBIGUOUS, SILENT, OneSource

pytestmark = needs_dds
if not MISSING:
    from standin import NETWORK, PERIOD, ROBOT, drive

    from wbmpc.ros2.convert import header, stamp
    from wbmpc.ros2.opening import open_node


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The wall's clock [s], which is the test's."""
    now = [5.0]
    monkeypatch.setattr("wbmpc.ros2.sources.time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


@pytest.fixture
def second(pair: Callable[..., Any]) -> Any:
    """Makes a publisher of another process: a node of its own."""
    opened: list[Any] = []

    def make(p: Any, topic: str, kind: str) -> Any:
        opened.append(open_node(f"second_{len(opened)}", "dds", NETWORK))
        publisher = opened[-1].publisher(topic, kind)
        heard = publisher._writer.get_matched_subscriptions
        assert wait_until(lambda: p.run(PERIOD) or len(heard()) >= 1)
        return publisher

    yield make
    for node in opened:
        node.close()


def test_the_first_one_counts_until_it_is_silent_and_another_one_speaks(wall: list[float]) -> None:
    switched: list[float] = []
    one = OneSource("/imu", lambda: switched.append(wall[0]))
    assert one.takes("a") and not one.conflict
    wall[0] += SILENT - 0.01
    assert not one.takes("b") and one.takes("a")
    assert (
        one.conflict
        == "2 publishers on /imu, which has one source: only the first one counts, until it is silent for 1 s"
    )
    wall[0] += 10.0
    assert one.takes("a") and not one.conflict and not switched  # a pause alone replaces nobody
    wall[0] += SILENT + 0.01
    assert one.takes("b") and switched == [wall[0]] and not one.conflict
    assert one.replaced == "the publisher of /imu was replaced by another one"
    assert not one.takes("a") and one.takes("b")  # who comes back is the second one
    one.settle()
    assert not one.replaced


def test_a_flood_of_publishers_is_bounded(wall: list[float]) -> None:
    one = OneSource("/imu")
    one.takes(0)
    assert not any(one.takes(k) for k in range(1, 10_000))
    assert one.conflict.startswith("101 publishers on /imu")


@pytest.mark.parametrize("kept", [False, True])
def test_messages_whose_publisher_is_unknown_count_for_who_would_fall(wall: list[float], kept: bool) -> None:
    one = OneSource("/imu", take_ambiguous=kept)
    assert one.takes("a") and one.takes(AMBIGUOUS) is kept
    assert one.conflict == "more than one publisher on /imu, which has one source"
    wall[0] += 3.0
    assert one.takes("a") and not one.conflict and not one.replaced


def test_a_second_inertial_unit_does_not_turn_the_odometry(
    pair: Callable[..., Any], second: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """5 rad/s in 400 messages a second beside a unit at rest, while the base drives ahead: the robot stops, and has not turned."""
    p = pair()
    own = p.standin.node.publisher("/imu", "sensor_msgs/msg/Imu")
    other: list[Any] = []

    def change(message: dict[str, Any]) -> dict[str, Any]:
        own.publish({"header": message["header"]})
        for publisher in other:
            publisher.publish({"header": message["header"], "angular_velocity": {"z": 5.0}})
        return message

    p.standin.change = change
    drive(p)
    other.append(second(p, "/imu", "sensor_msgs/msg/Imu"))
    runner = p.control.runner
    assert p.until(lambda: runner.stopped)
    assert "2 publishers on /imu, which has one source" in p.control.state
    p.run(0.2)
    assert abs(p.control.adapter.snapshot()[1][2]) < 2e-3
    assert p.control.waiting_reason().startswith("waiting: 2 publishers on /imu")


def test_a_second_time_and_second_states_do_not_count(pair: Callable[..., Any], second: Any) -> None:
    """A time far ahead, and joints elsewhere: nothing of it is believed, and the robot stops."""
    p = pair()
    drive(p)
    clock, joints = p.control.clock, p.control.robot_io
    publisher = second(p, "/clock", "rosgraph_msgs/msg/Clock")
    publisher.publish({"clock": stamp(1e6)})
    assert p.until(lambda: "2 publishers on /clock" in p.control.state) and clock.stamp() < 1e3
    names = [n for part in p.standin.names.values() for n in part]
    publisher = second(p, "/joint_states", "sensor_msgs/msg/JointState")
    publisher.publish({"header": header(p.standin.time, ""), "name": names, "position": np.full(len(names), 0.5)})
    assert p.until(lambda: "2 publishers on /joint_states" in joints.conflict)
    assert not joints.fault and np.all(p.control.adapter.snapshot()[1][ROBOT.state["leg"]] != 0.5)


def test_a_second_localization_does_not_drag_the_robot_away(pair: Callable[..., Any]) -> None:
    """Each of its poses is 5 cm from the one before, nearer than a jump. Truth: the first one's."""
    control = pair(topics={"pose": "/pose"}, use_sim_time=False).control
    pose = SimpleNamespace(
        position=SimpleNamespace(x=0.0, y=0.0, z=0.0), orientation=SimpleNamespace(x=0, y=0, z=0, w=1)
    )
    head = SimpleNamespace(frame_id="odom", stamp=SimpleNamespace(sec=0, nanosec=0))
    for k in range(20):
        for source, x in (("first", 0.0), ("second", 0.05 * k)):
            pose.position.x = x
            control.source._take(
                SimpleNamespace(header=head, pose=SimpleNamespace(pose=pose, covariance=[0.0] * 36)), source
            )
            fix = control.source.newest()
            assert (fix is not None and fix[1][0] == 0.0) if source == "first" else fix is None
    assert "2 publishers on /pose, which has one source" in control.waiting_reason()


def test_the_joints_of_a_gripper_may_have_a_publisher_of_their_own(pair: Callable[..., Any]) -> None:
    """It is heard first, and goes on for ever. Truth: the positions of our joints."""
    body = pair(use_sim_time=False).control.robot_io
    names = [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]]
    at = lambda k: SimpleNamespace(stamp=SimpleNamespace(sec=5, nanosec=1000 * k))
    gripper = lambda k: body._take_joints(SimpleNamespace(header=at(k), name=["gripper"], position=[0.1]), "gripper")
    gripper(0)
    assert "joint 'leg_LF' is missing; it has 'gripper'" in body.fault  # as long as there is nothing else
    for k in range(3):
        body._take_joints(SimpleNamespace(header=at(k), name=names, position=ROBOT.home[3:]), "robot")
        gripper(k)
        assert not body.fault and not body.conflict and body.waiting_reason() == ""
    assert body._joints[0].groups["arm"] is not None
    body._take_joints(SimpleNamespace(header=at(3), name=["leg_LF"], position=[0.1]), "somebody")
    assert not body.fault and "2 publishers on /joint_states" in body.conflict


def test_a_simulator_that_is_killed_and_started_anew_needs_a_goal(
    pair: Callable[..., Any], second: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its publishers are still on the bus (a lease has not ended), and the new one begins 0.01 rad from where it was, with its time
    ahead: not heard at first, then the robot stops, says why, and takes a goal."""
    monkeypatch.setattr("wbmpc.ros2.sources.SILENT", 0.3)
    p = pair()
    drive(p)
    p.run(0.1)
    old = p.standin
    p.control.clock.source._heard = time.monotonic()
    new = [
        second(p, t, k)
        for t, k in (("/joint_states", "sensor_msgs/msg/JointState"), ("/clock", "rosgraph_msgs/msg/Clock"))
    ]
    old._joints, old._clock = new
    old.time, old.answers = 100.0, 0.01
    for group in old.joints:
        old.joints[group] = old.joints[group] + 0.01
    began, runner = time.monotonic(), p.control.runner
    before = p.control.clock.stamp()
    p.run(4 * PERIOD)
    assert p.control.clock.stamp() == before and "2 publishers on /" in p.control._other_publisher
    assert p.until(lambda: runner.stopped and not p.control._other_publisher, 20.0)
    assert time.monotonic() - began < 10.0
    assert p.until(lambda: p.standin.speed == 0.0)
    p.run(0.1)
    assert p.standin.speed == 0.0 and p.control.runner is runner
    p.control.step()
    old.answers = 5.0
    p.go(2.0, frame="base_link")
    assert p.until(lambda: p.standin.speed > 0.5), (p.control.state, p.control.request_queue.rejected)
