"""What somebody hostile can do on the bus. Truth: limits as they are written, what was sent."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, private, wait_until

from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.ros2.bus import Qos
from wbmpc.ros2.convert import LONGEST, error_message, read_pose, read_vector, stamp
from wbmpc.ros2.deferred import MAX_MESSAGES, Deferred
from wbmpc.ros2.joints import read_imu
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node
from wbmpc.ros2.settings import settings_of

pytestmark = needs_dds
if not MISSING:
    from cyclonedds.internal import load_cyclonedds

    from wbmpc.ros2.messages import types

NETWORK = Network.of({**private(), "ROS_DOMAIN_ID": "57"})
STRING = "std_msgs/msg/String"


@pytest.fixture
def nodes() -> Iterator[tuple[Any, Any]]:
    pair = open_node("one", "dds", NETWORK), open_node("other", "dds", NETWORK)
    yield pair
    for node in pair:
        node.close()


def connected(one: Any, topic: str) -> Any:
    """A publisher whom somebody hears."""
    publisher = one.publisher(topic, STRING, Qos(depth=1000))
    assert wait_until(lambda: publisher._writer.get_matched_subscriptions())
    return publisher


def test_what_is_too_large_is_dropped_before_it_is_decoded(
    nodes: tuple[Any, Any], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = nodes
    got: list[str] = []
    decoded, decode = [], other.types.decode
    monkeypatch.setattr(other.types, "decode", lambda kind, data: decoded.append(len(data)) or decode(kind, data))
    other.subscribe("/large", STRING, lambda m: got.append(m.data), Qos(depth=1000), largest=100)
    publisher = connected(one, "/large")
    for _ in range(30):
        publisher.publish({"data": "x" * 1003})
    publisher.publish({"data": "small"})
    assert wait_until(lambda: got == ["small"])
    assert max(decoded) <= 100
    lines = [r.getMessage() for r in caplog.records if "/large" in r.getMessage()]
    assert 1 <= len(lines) <= 5 and lines[0] == "/large: a message of 1012 bytes is dropped; valid: at most 100"


def test_messages_that_wait_are_bounded_in_bytes(nodes: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = nodes
    monkeypatch.setattr("wbmpc.ros2.deferred.MAX_BYTES", 2500)
    got: list[str] = []
    other.subscribe("/wait", STRING, lambda m: got.append(m.data[:2]), Qos(depth=1000), deferred=True)
    publisher = connected(one, "/wait")
    for k in range(20):
        publisher.publish({"data": f"{k}" + "x" * 1000})
    assert wait_until(lambda: other._deferred._number == 20)
    other.work()
    assert got == ["18", "19"]


def test_a_flood_on_one_topic_leaves_the_other_ones_their_messages_and_the_node_its_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Truth: order and number of what was put in; each message of the flood brings another one, forever."""
    deferred, got = Deferred(), []
    deferred.put("/goal", got.append, "goal")

    def flood(k: int) -> None:
        got.append(k)
        deferred.put("/flood", flood, k + 1000)

    for k in range(1000):
        deferred.put("/flood", flood, k)
    deferred.put("/legs", got.append, "legs")
    deferred.work()
    assert got == ["goal", *range(1000 - MAX_MESSAGES, 1000), "legs"]
    monkeypatch.setattr("wbmpc.ros2.deferred.BUDGET", 0.0)
    deferred.work()
    assert len(got) == MAX_MESSAGES + 3  # one more, and the node goes on with what else it has to do


@pytest.mark.parametrize(("level", "written"), [(4, False), (2, True)])
def test_the_middleware_has_no_line_for_each_malformed_message(
    nodes: tuple[Any, Any], capfd: pytest.CaptureFixture[str], level: int, written: bool
) -> None:
    """It warns (4) of each on stderr, however many there are; errors (2) are still said."""
    log = load_cyclonedds().dds_log
    log(level, b"a.c", 1, b"here", b"deserialization failed\n")
    assert ("deserialization failed" in capfd.readouterr().err) is written


@pytest.mark.parametrize(("time", "sec"), [(2.0**31 + 3.3, 2**31 - 1), (-3e9, -(2**31))])
def test_a_time_that_no_stamp_can_say_is_the_nearest_one(time: float, sec: int) -> None:
    """A /clock of 2³¹ − 1 s and 2³² − 1 ns, as its fields can say it, ended the node by the stamp of its log line."""
    kind, t = "rosgraph_msgs/msg/Clock", types("jazzy")
    assert t.decode(kind, t.encode(kind, {"clock": stamp(time)})).clock.sec == sec


@pytest.mark.parametrize("error", [InputError("frame '{}'; valid: odom"), ValueError("frame '{}'; valid: odom")])
def test_what_is_quoted_is_one_short_line(error: Exception) -> None:
    """Nobody writes lines into our log, or megabytes."""
    quoted = type(error)(str(error).format("map\n\x1b[31mERROR" + "x" * 1_000_000))
    said = error_message(quoted)
    assert len(said) < LONGEST + 40 and said.isprintable()
    assert "frame 'map\\n\\x1b[31mERROR" in said and said.endswith("'; valid: odom")
    assert error_message(InputError("short")) == "short"


VECTOR = SimpleNamespace(x=0.0, y=0.0, z=0.0)
TOO_LARGE = SimpleNamespace(x=0.0, y=-1e300, z=0.0)


@pytest.mark.parametrize(
    "read",
    [
        lambda: read_vector(TOO_LARGE, "the force"),
        lambda: read_pose(SimpleNamespace(position=TOO_LARGE, orientation=SimpleNamespace(x=0, y=0, z=0, w=1)), "goal"),
        lambda: read_imu(SimpleNamespace(angular_velocity=VECTOR, linear_acceleration=TOO_LARGE)),
    ],
)
def test_numbers_that_would_overflow_are_rejected_where_they_come_in(read: Callable[[], Any]) -> None:
    with pytest.raises(InputError, match=r"a number is too large; valid: -1e\+07 to 1e\+07"):
        read()


def test_joints_that_are_nowhere_and_wrenches_that_nobody_exerts(pair: Callable[..., Any]) -> None:
    """The first joint states may be anywhere, but not there."""
    control = pair(use_sim_time=False).control
    body = control.robot_io
    names, at = body._reader.names, SimpleNamespace(stamp=SimpleNamespace(sec=5, nanosec=0))
    body._take_joints(SimpleNamespace(header=at, name=names, position=[-1e300] * len(names)))
    assert "joint states: a number is too large" in body.fault and body._joints is None
    force = SimpleNamespace(force=TOO_LARGE, torque=VECTOR)
    control.request_queue._try(
        "/wrench", control.request_queue._take_wrench,
        SimpleNamespace(header=SimpleNamespace(frame_id="odom"), wrench=force),
    )  # fmt: skip
    assert "/wrench: the force: a number is too large" in control.request_queue.rejected
    assert not control.request_queue.wrench().any()


def test_what_fails_beside_the_control_does_not_end_the_run(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """A message that cannot be made, again and again: the node goes on, and says so a few times."""
    p = pair()
    p.ready()

    def fails() -> None:
        raise InputError("wrench: numbers of 1e+09 at most are needed")

    p.control.publishers.publish = p.control.rosout.send = fails
    for _ in range(20):
        p.control.step()
    del p.control.rosout.send
    assert 1 <= sum("wrench: numbers of 1e+09" in r.getMessage() for r in caplog.records) <= 5


def test_a_description_of_nothing_but_beginnings_takes_a_check_no_time() -> None:
    """Truth: the process's clock; with each beginning followed to the text's end 60 kB took seconds, 300 kB minutes."""
    from wbmpc.ros2.check import _which_robot

    ear, robot = SimpleNamespace(times=[], fault=""), load_robot("panda")
    begin = time.process_time()
    assert not _which_robot(robot, ear, ["<robot" * 10_000])  # type: ignore[arg-type]
    assert not _which_robot(robot, ear, ["<robot" + " name" * 12_000])  # type: ignore[arg-type]
    assert time.process_time() - begin < 1.0
    (found,) = _which_robot(robot, ear, ['<robot version="1"\n name = "panda">'])  # type: ignore[arg-type]
    assert found.text == "the robot on the bus is 'panda'"


def test_nobody_writes_findings_of_a_check(nodes: tuple[Any, Any]) -> None:
    """Names of robots, frames and nodes are what others call them. Truth: a finding is one short line that a terminal shows as it is."""
    from wbmpc.ros2.check import check

    evil, looker = nodes
    said = "x\nok      /imu   all is well\x1b[31m" + "x" * 500
    described = evil.publisher("/robot_description", STRING, Qos(latched=True))
    described.publish({"data": f"<robot name='{said}'/>"})
    evil.publisher("/odom", "nav_msgs/msg/Odometry")
    evil.name = said[:200]
    evil._announce()
    assert wait_until(lambda: looker.publishers("/robot_description") and looker.publishers("/odom"))
    robot = load_robot("panda")
    found = check(looker, robot, settings_of(robot)(), 1.0)
    assert {"robot", "/odom"} <= {f.topic for f in found}
    assert all(f.text.isprintable() and len(f.text) < LONGEST + 40 for f in found), found


def test_an_announcement_that_cannot_be_read_names_nobody(nodes: tuple[Any, Any]) -> None:
    """Truth: the name that is announced next."""
    evil, looker = nodes
    evil.publisher("/odom", "nav_msgs/msg/Odometry")
    assert wait_until(lambda: looker.publishers("/odom"))
    (endpoint,) = looker.publishers("/odom")
    encode, evil.types = evil.types.encode, SimpleNamespace(hash=evil.types.hash)
    evil.types.encode = lambda kind, values: encode(kind, values).replace(b"one\0", b"\xff\xfe\xff\0")
    evil._announce()
    assert looker.owner(endpoint) == ""
    evil.types.encode = encode
    evil._announce()
    assert wait_until(lambda: looker.owner(endpoint) == "one")


def test_who_comes_and_goes_in_other_types_makes_no_threads_and_no_long_lists(
    nodes: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Truth: threads of the process; what is reported of an endpoint is one short line, the newest one."""
    from wbmpc.ros2.bus import DEFAULT, Endpoint
    from wbmpc.ros2.mismatch import Mismatches, OwnEndpoint

    monkeypatch.setattr("wbmpc.ros2.mismatch._UNSEEN", 0.3)
    there: list[Endpoint] = []
    mismatches = Mismatches(SimpleNamespace(publishers=lambda topic: there))  # type: ignore[arg-type]
    ours, before = OwnEndpoint("subscription", "/scan", STRING, DEFAULT), threading.active_count()
    for k in range(300):
        there.append(Endpoint("/scan", f"evil/msg/T{k:03d}\n\x1b[31m", DEFAULT, False))
        mismatches.notice(ours, "type")
    assert threading.active_count() <= before + 1
    assert wait_until(mismatches.messages)
    there.append(Endpoint("/scan", "another/msg/Type", DEFAULT, False))
    mismatches.notice(ours, "type")
    assert wait_until(lambda: "another/msg/Type" in mismatches.messages()[0])
    (message,) = mismatches.messages()
    assert message.isprintable() and len(message) < LONGEST + 40
    assert len(caplog.records) == 2
    there.clear()
    assert not mismatches.messages()


def test_a_cloud_of_signaling_nans_writes_no_warning_on_the_terminal() -> None:
    """Truth: warnings are errors here; the one point that is a measurement counts."""
    from wbmpc.ros2.obstacle_messages import read_points

    signaling = np.full((3, 3), 0x7F800001, np.uint32)
    signaling[1] = np.ones(3, np.float32).view(np.uint32)
    fields = [SimpleNamespace(name=n, offset=4 * k, datatype=7) for k, n in enumerate("xyz")]
    cloud = SimpleNamespace(
        height=1, width=3, point_step=12, row_step=36, is_bigendian=False, fields=fields, data=signaling.tobytes()
    )
    assert read_points(cloud).tolist() == [[1.0, 1.0, 1.0]]
