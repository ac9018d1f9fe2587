"""Inputs with one source and more than one publisher. Truth: messages with what nobody else has said; the stand-in's wheels."""

from __future__ import annotations

import itertools
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, wait_until

from wbmpc.ros2.sources import AMBIGUOUS, OneSource

pytestmark = needs_dds
if not MISSING:
    from standin import AHEAD, ENVIRONMENT, NETWORK, PERIOD, ROBOT, drive

    from wbmpc.ros2.convert import header, stamp
    from wbmpc.ros2.network import LEASE
    from wbmpc.ros2.opening import open_node


@dataclass(unsafe_hash=True)
class Publisher:
    """A source by its name."""

    name: object
    left: bool = field(default=False, compare=False)
    preferred: int = field(default=0, compare=False)

    def gone(self) -> bool:
        return self.left

    def prefer(self) -> None:
        self.preferred += 1


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The wall clock [s], which is the test's."""
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


def test_the_first_one_counts_until_it_is_gone_and_another_one_speaks(wall: list[float]) -> None:
    """However long it is silent: a flood may be what keeps it from being heard."""
    switched: list[float] = []
    one = OneSource("/imu", lambda: switched.append(wall[0]))
    a, b = Publisher("a"), Publisher("b")
    assert one.takes(a) and not one.conflict and a.preferred == 1
    for _ in range(100):
        wall[0] += 10.0
        assert not one.takes(b)
    assert one.conflict == "2 publishers on /imu, which has one source: only the first one counts"
    assert one.takes(a) and not one.replaced and not b.preferred
    wall[0] += 3.0
    assert one.takes(a) and not one.conflict and not switched
    a.left = True
    assert one.takes(b) and switched == [wall[0]] and not one.conflict and b.preferred == 1
    assert one.replaced == "the publisher of /imu was replaced by another one"
    a.left = False
    assert not one.takes(a) and one.takes(b)  # who comes back is the second one
    one.settle()
    assert not one.replaced


def test_a_flood_of_publishers_is_bounded(wall: list[float]) -> None:
    one = OneSource("/imu")
    one.takes(Publisher(0))
    assert not any(one.takes(Publisher(k)) for k in range(1, 10_000))
    assert one.conflict.startswith("101 publishers on /imu")


@pytest.mark.parametrize("kept", [False, True])
def test_messages_whose_publisher_is_unknown_count_for_who_would_fall(wall: list[float], kept: bool) -> None:
    one = OneSource("/imu", take_ambiguous=kept)
    a = Publisher("a")
    assert one.takes(a) and one.takes(AMBIGUOUS) is kept
    assert one.conflict == "more than one publisher on /imu, which has one source"
    wall[0] += 3.0
    assert one.takes(a) and not one.conflict and not one.replaced


@pytest.fixture
def nodes() -> Any:
    """Opens nodes."""
    opened: list[Any] = []

    def make(name: str) -> Any:
        opened.append(open_node(name, "dds", NETWORK))
        return opened[-1]

    yield make
    for node in opened:
        node.close()


def test_a_flood_does_not_keep_the_first_ones_messages_from_arriving(nodes: Callable[[str], Any]) -> None:
    """20 000 messages of another one, between those of the first one, which are not lost though nobody waits for anything, and
    which all bring a callback. Of the others few do. Truth: what was sent; the first one's last message, sent again until it is there."""
    from wbmpc.ros2.bus import SENSOR

    node, own, other = nodes("reader"), nodes("own"), nodes("other")
    one, heard, counted, asked = OneSource("/flooded"), [], [], []

    def take(message: Any, source: Any) -> None:
        heard.append(message.data)
        asked.append(source)
        if one.takes(source):
            counted.append(message.data)

    node.subscribe("/flooded", "std_msgs/msg/String", take, SENSOR, sourced=True)
    first, second = (n.publisher("/flooded", "std_msgs/msg/String") for n in (own, other))
    assert wait_until(lambda: first.publish({"data": "first"}) or bool(counted))
    assert wait_until(lambda: second.publish({"data": "second"}) or bool(one.conflict))
    assert not asked[0].gone()
    before = len(heard)
    for k in range(200):
        for _ in range(100):
            second.publish({"data": "second"})
        first.publish({"data": str(k)})
    assert wait_until(lambda: first.publish({"data": "end"}) or counted[-1] == "end")
    assert set(counted) == {"first", *map(str, range(200)), "end"} and not one.replaced
    assert len([m for m in heard[before:] if m == "second"]) < 4000
    own.close()
    assert wait_until(lambda: second.publish({"data": "second"}) or bool(one.replaced))
    assert asked[0].gone() and counted[-1] == "second"
    second.publish({"data": "all pass now"})
    assert wait_until(lambda: counted[-1] == "all pass now")


#: Hears numbers and watches the graph; says how many there were after its pause, whether a source was replaced and how many it had.
HEARS = """
import time
from wbmpc.ros2 import open_node
from wbmpc.ros2.bus import SENSOR
from wbmpc.ros2.sources import OneSource
node, one, counted, known = open_node("hears", "dds"), OneSource("/stopped"), [], set()

def take(message, source):
    known.add(source)
    if one.takes(source):
        counted.append(message.data)

node.subscribe("/stopped", "std_msgs/msg/Int64", take, SENSOR, sourced=True)
last, before = time.monotonic(), 0
while len(counted) < before + 300 or not before:
    time.sleep(0.05)
    node.publishers("/stopped")
    if time.monotonic() - last > 2.0:
        before = len(counted)
    last = time.monotonic()
    print(len(counted), flush=True)
print(one.replaced or "not replaced", len(known), flush=True)
node.close()
"""


def test_who_is_heard_again_after_a_lease_is_the_same_one(nodes: Callable[[str], Any]) -> None:
    """For a process that was stopped for longer, as for one that was off the network. All messages pass as before."""
    node, environment = nodes("speaks"), {**os.environ, **ENVIRONMENT}
    publisher, k = node.publisher("/stopped", "std_msgs/msg/Int64"), itertools.count()
    speak = lambda: publisher.publish({"data": next(k)})
    program = [sys.executable, "-c", HEARS]
    with subprocess.Popen(program, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as hears:
        out: Any = hears.stdout
        said = iter(lambda: speak() or (out.read1() if select.select([out], [], [], 0.005)[0] else b""), None)
        try:
            assert wait_until(lambda: int((next(said).split() or [b"0"])[-1]) > 100)
            hears.send_signal(signal.SIGSTOP)
            end = time.monotonic() + 1.5 * LEASE
            while time.monotonic() < end:
                time.sleep(0.01)
                speak()
            hears.send_signal(signal.SIGCONT)
            words: list[bytes] = []
            assert wait_until(lambda: words.append(next(said)) or hears.poll() is not None)
            assert (b"".join(words) + out.read()).splitlines()[-1] == b"not replaced 1"
        finally:
            hears.kill()


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
            message = SimpleNamespace(header=head, pose=SimpleNamespace(pose=pose, covariance=[0.0] * 36))
            control.source._take(message, Publisher(source))
            fix = control.source.newest()
            assert (fix is not None and fix[1][0] == 0.0) if source == "first" else fix is None
    assert "2 publishers on /pose, which has one source" in control.waiting_reason()


def test_a_localization_in_place_of_the_first_one_stops_the_robot(pair: Callable[..., Any]) -> None:
    """The first one leaves; another one says the same, so that nothing jumps. The robot stands until the next goal."""
    p, source = pair(topics={"pose": "/pose"}), [Publisher("first")]
    control, upright = p.control, SimpleNamespace(x=0, y=0, z=0, w=1)

    def say(message: Any) -> Any:
        seen = control.adapter.snapshot()
        x, y = (0.0, 0.0) if seen is None else seen[1][:2]
        pose = SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=0.0), orientation=upright)
        head = SimpleNamespace(frame_id="odom", stamp=SimpleNamespace(sec=0, nanosec=0))
        given = SimpleNamespace(header=head, pose=SimpleNamespace(pose=pose, covariance=np.eye(6).ravel()))
        control.source._take(given, source[0])
        return message

    p.standin.change = say
    drive(p)
    source[0].left, source[0] = True, Publisher("second")
    runner = control.runner
    assert p.until(lambda: runner.stopped, 30.0), control.state
    assert "the publisher of /pose was replaced by another one" in control.state
    assert p.until(lambda: p.standin.speed == 0.0)
    p.run(0.1)
    assert p.standin.speed == 0.0 and control.runner is runner
    p.go(2.0, frame="base_link")
    assert p.until(lambda: p.standin.speed > 0.5), (control.state, control.request_queue.rejected)
    p.run(0.5)
    assert control.running


def test_the_joints_of_a_gripper_may_have_a_publisher_of_their_own(pair: Callable[..., Any]) -> None:
    """It is heard first, and goes on forever. Truth: the positions of our joints."""
    body = pair(use_sim_time=False).control.robot_io
    names = [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]]
    at = lambda k: SimpleNamespace(stamp=SimpleNamespace(sec=5, nanosec=1000 * k))
    gripper = lambda k: body._take_joints(
        SimpleNamespace(header=at(k), name=["gripper"], position=[0.1]), Publisher("gripper")
    )
    gripper(0)
    assert "joint 'leg_LF' is missing; it has 'gripper'" in body.fault  # as long as there is nothing else
    for k in range(3):
        body._take_joints(SimpleNamespace(header=at(k), name=names, position=ROBOT.home[3:]), Publisher("robot"))
        gripper(k)
        assert not body.fault and not body.conflict and body.waiting_reason() == ""
    assert body._joints[0].groups["arm"] is not None
    body._take_joints(SimpleNamespace(header=at(3), name=["leg_LF"], position=[0.1]), Publisher("somebody"))
    assert not body.fault and "2 publishers on /joint_states" in body.conflict


def test_a_simulator_that_is_restarted_needs_a_goal(pair: Callable[..., Any], nodes: Callable[[str], Any]) -> None:
    """The new one begins 0.01 rad from where the killed one was, with its time ahead, while that one's publishers are still on the
    bus, as long as a lease has not ended: not heard at first. Then the robot stands, says why, and takes a goal."""
    p, killed = pair(), nodes("killed")
    robot, control = p.standin, p.control
    new = robot._joints, robot._clock
    robot._joints = killed.publisher("/joint_states", "sensor_msgs/msg/JointState")
    robot._clock = killed.publisher("/clock", "rosgraph_msgs/msg/Clock")
    assert wait_until(lambda: all(s._writer.get_matched_subscriptions() for s in (robot._joints, robot._clock)))
    drive(p)
    robot._joints, robot._clock = new
    robot.time, robot.answers = 100.0, 0.01
    for group in robot.joints:
        robot.joints[group] = robot.joints[group] + 0.01
    robot.joints["wheel"] = robot.joints["wheel"] + 30.0 * AHEAD
    driven = control.adapter.snapshot()[1][:2]
    runner, before = control.runner, control.clock.stamp()
    assert p.until(lambda: runner.stopped and "2 publishers on /" in control._other_publisher)
    assert before <= control.clock.stamp() < 100.0 and control.waiting_reason()
    killed.close()  # the lease has ended
    replaced = lambda: control.robot_io._joint_source.replaced and control.clock.source.replaced
    assert p.until(lambda: replaced() and not control._other_publisher)
    assert p.until(lambda: robot.speed == 0.0)
    p.run(0.1)
    assert robot.speed == 0.0 and control.runner is runner
    control.step()
    # how far it went while its second publisher was not heard is not known to the node
    np.testing.assert_allclose(control.adapter.snapshot()[1][:2], driven, atol=0.25)
    estimate = control.adapter.estimate()
    assert np.all(np.sqrt(np.diag(estimate.covariance)[:2]) > 0.09)
    robot.answers = 5.0
    p.go(2.0, frame="base_link")
    assert p.until(lambda: robot.speed > 0.5), (control.state, control.request_queue.rejected)
