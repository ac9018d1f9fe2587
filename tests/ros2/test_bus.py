"""A node without ROS. Truth: rosbags reads what was on the wire, hand-written CDR, the names and hashes of REP 2016."""

from __future__ import annotations

import re
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, everything, needs_dds, private, wait_until

from wbmpc.errors import InputError, RunAborted
from wbmpc.ros2.bus import DEFAULT, LATCHED, SENSOR, Qos, full_name
from wbmpc.ros2.multi_type_subscriber import MultiTypeSubscriber
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node

pytestmark = needs_dds
if not MISSING:
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from rosbags.interfaces import Nodetype
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    from wbmpc.ros2 import dds
    from wbmpc.ros2.cdr_types import message_class
    from wbmpc.ros2.messages import types

NETWORK = Network.of({**private(), "ROS_DOMAIN_ID": "44"})
STRING, JOINTS = "std_msgs/msg/String", "sensor_msgs/msg/JointState"


@pytest.fixture
def nodes() -> Iterator[tuple[Any, Any]]:
    pair = open_node("one", "dds", NETWORK), open_node("other", "dds", NETWORK)
    yield pair
    for node in pair:
        node.close()


# ---------------------------------------------------------------------- messages
def test_a_message_is_the_cdr_that_the_specification_says() -> None:
    """Little endian, four bytes of header, strings with their zero, numbers at multiples of their size."""
    t = types("jazzy")
    data = t.encode(JOINTS, {"header": {"stamp": {"sec": 7, "nanosec": 9}}, "name": ["ab"], "position": [0.5]})
    body = struct.pack("<iI", 7, 9) + struct.pack("<I", 1) + b"\0" + b"\0" * 3  # stamp, frame "", alignment
    body += struct.pack("<I", 1) + struct.pack("<I", 3) + b"ab\0" + b"\0"  # one name
    body += struct.pack("<I", 1) + b"\0" * (-(len(body) + 4) % 8) + struct.pack("<d", 0.5)
    body += struct.pack("<II", 0, 0)  # no velocities, no efforts
    assert data[:4] == b"\x00\x01\x00\x00"
    assert data[4:] == body


def every_type() -> set[str]:
    """All message types that the bridge's sources name."""
    sources = (Path(__file__).parents[2] / "src/wbmpc/ros2").glob("*.py")
    return {kind for f in sources for kind in re.findall(r"\w+/msg/[A-Z]\w+", f.read_text())}


def by_chance(rng: np.random.Generator, form: Any) -> Any:
    """A value of a field: of whole messages as nested mappings, of sequences up to three parts."""
    node, detail = form
    if node == Nodetype.NAME:
        return {
            n: by_chance(rng, f)
            for n, f in types("jazzy").store.fielddefs[detail][1]
            if n != "structure_needs_at_least_one_member"
        }
    if node == Nodetype.BASE:
        if detail[0] == "string":
            return "ab c"[: rng.integers(0, 5)]
        low, high = (0, 2) if detail[0] == "bool" else (0, 120)
        return float(rng.normal()) if "float" in detail[0] else int(rng.integers(low, high))
    part, size = detail
    return [by_chance(rng, part) for _ in range(size if node == Nodetype.ARRAY else rng.integers(0, 4))]


@pytest.mark.parametrize("kind", sorted(every_type()) if not MISSING else [])
def test_every_types_bytes_are_what_rosbags_writes(kind: str) -> None:
    """Whatever is in a message: rosbags reads our bytes, and writes the same ones of what it has read."""
    t, rng = types("jazzy"), np.random.default_rng(0)
    for _ in range(10):
        data = t.encode(kind, by_chance(rng, (Nodetype.NAME, kind)))
        assert bytes(t.store.serialize_cdr(t.store.deserialize_cdr(data, kind), kind)) == data


def test_what_is_not_given_is_zero_and_what_is_not_known_is_named() -> None:
    t = types("jazzy")
    kind = "geometry_msgs/msg/PoseWithCovariance"
    pose = t.decode(kind, t.encode(kind, {"pose": {"position": {"x": 1}}}))
    assert (pose.pose.position.x, pose.pose.orientation.w) == (1.0, 1.0)
    assert pose.covariance.shape == (36,)
    with pytest.raises(InputError, match=r"unknown field of geometry_msgs/msg/Point 'u'.*valid: x, y, z"):
        t.encode("geometry_msgs/msg/PoseStamped", {"pose": {"position": {"u": 1.0}}})
    with pytest.raises(InputError, match="covariance needs 36 values, got 1"):
        t.encode(kind, {"covariance": [1.0]})
    with pytest.raises(
        InputError, match=r"unknown message type 'std_msgs/msg/Strin'.*did you mean 'std_msgs/msg/String'"
    ):
        t.check("std_msgs/msg/Strin")


def test_what_is_on_the_wire_goes_into_a_bag_and_comes_out_of_it(nodes: tuple[Any, Any], tmp_path: Path) -> None:
    """Bytes off the bus, recorded untouched, read by rosbags' own reader: every field of every kind of message."""
    one, _ = nodes
    sent = {
        JOINTS: {"header": {"frame_id": "b"}, "name": ["a", "b"], "position": np.array([1.0, -2.0])},
        "std_msgs/msg/Float64MultiArray": {"data": np.linspace(0, 1, 14)},
        "nav_msgs/msg/Odometry": {"child_frame_id": "c", "pose": {"covariance": np.arange(36.0)}},
        "tf2_msgs/msg/TFMessage": {"transforms": [{"child_frame_id": "x", "transform": {"rotation": {"w": 0.5, "z": 0.25}}}]},
        "nav_msgs/msg/Path": {"poses": [{"pose": {"position": {"x": float(i)}}} for i in range(3)]},
        "diagnostic_msgs/msg/DiagnosticArray": {"status": [{"level": 2, "name": "n", "values": [{"key": "k", "value": "v"}]}]},
        "visualization_msgs/msg/MarkerArray": {"markers": [{"type": 4, "points": [{"x": 1.0}], "color": {"a": 1.0}}]},
    }  # fmt: skip
    raw: dict[str, list[bytes]] = {kind: [] for kind in sent}
    listening = DomainParticipant(44)
    readers = {
        kind: DataReader(listening, Topic(listening, f"rt/t{i}", message_class(types("jazzy"), kind)))
        for i, kind in enumerate(sent)
    }
    for i, (kind, values) in enumerate(sent.items()):
        publisher = one.publisher(f"/t{i}", kind)
        assert wait_until(lambda p=publisher: p._writer.get_matched_subscriptions())  # type: ignore[misc]
        publisher.publish(values)
        assert wait_until(lambda k=kind: raw[k].extend(s.data for s in readers[k].take(N=9)) or raw[k])  # type: ignore[misc]
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        for i, kind in enumerate(sent):
            bag.write(bag.add_connection(f"/t{i}", kind, typestore=store), 1, raw[kind][0])
    with Reader(tmp_path / "bag") as bag:
        read = {c.msgtype: store.deserialize_cdr(data, c.msgtype) for c, _, data in bag.messages()}
    assert read.keys() == sent.keys()
    assert list(read[JOINTS].name) == ["a", "b"] and list(read[JOINTS].position) == [1.0, -2.0]
    np.testing.assert_array_equal(read["std_msgs/msg/Float64MultiArray"].data, np.linspace(0, 1, 14))
    assert read["nav_msgs/msg/Odometry"].pose.covariance[35] == 35.0
    assert read["tf2_msgs/msg/TFMessage"].transforms[0].transform.rotation.z == 0.25
    assert [p.pose.position.x for p in read["nav_msgs/msg/Path"].poses] == [0.0, 1.0, 2.0]
    assert read["diagnostic_msgs/msg/DiagnosticArray"].status[0].values[0].value == "v"
    assert read["visualization_msgs/msg/MarkerArray"].markers[0].points[0].x == 1.0


# ---------------------------------------------------------------------- topics
def test_all_messages_come_in_order(nodes: tuple[Any, Any]) -> None:
    one, other = nodes
    got: list[float] = []
    other.subscribe("/count", "std_msgs/msg/Float64", lambda m: got.append(m.data), Qos(depth=1000))
    publisher = one.publisher("/count", "std_msgs/msg/Float64", Qos(depth=1000))
    assert wait_until(lambda: [e for e in other.publishers("/count") if not e.own])
    assert wait_until(lambda: publisher._writer.get_matched_subscriptions())
    for i in range(500):
        publisher.publish({"data": i})
    assert wait_until(lambda: len(got) == 500)
    assert got == list(range(500))


TWO_THREADS = """
import threading
from wbmpc.ros2 import Qos, open_node
one, other, got = open_node("one", "dds"), open_node("other", "dds"), []
other.subscribe("/count", "std_msgs/msg/Float64", lambda m: got.append(m.data), Qos(depth=1000))
publisher = one.publisher("/count", "std_msgs/msg/Float64", Qos(depth=1000))
while not publisher._writer.get_matched_subscriptions():
    pass
threads = [threading.Thread(target=lambda: [publisher.publish({"data": i}) for i in range(1000)]) for _ in range(2)]
for t in threads:
    t.start()
for t in threads:
    t.join()
print(len(got))
"""


def test_two_threads_may_send_on_one_topic_that_is_heard_in_their_process() -> None:
    """In a process of its own: where they wait for each other, all of Python does."""
    run = subprocess.run(
        [sys.executable, "-c", TWO_THREADS], env=everything(), timeout=60.0, capture_output=True, text=True
    )
    assert run.stdout.strip() == "2000", run.stderr


MANY_TOPICS = """
from wbmpc.ros2 import Network, open_node
node = open_node("one", "dds", Network.of())
for k in range(40):
    node.publisher(f"/joint_{k}", "std_msgs/msg/Float64")
print(len(node.publishers("/joint_39")))
"""


def test_a_robot_may_have_more_topics_of_a_type_than_a_bucket_of_the_middlewares_table() -> None:
    """In a process of its own: a table whose entries share a hash grows forever (Cyclone DDS holds 32 of them)."""
    run = subprocess.run(
        [sys.executable, "-c", MANY_TOPICS], env=everything(), timeout=60.0, capture_output=True, text=True
    )
    assert run.stdout.strip() == "1", run.stderr


FORGOTTEN = """
import gc, time
from wbmpc.ros2 import Network, open_node
one, got = open_node("one", "dds", Network.of()), []
open_node("other", "dds", Network.of()).subscribe("/count", "std_msgs/msg/Float64", lambda m: got.append(m.data))
publisher = one.publisher("/count", "std_msgs/msg/Float64")
while not publisher._writer.get_matched_subscriptions():
    time.sleep(0.01)
for i in range(10):
    gc.collect()
    publisher.publish({"data": i})
print(len(got))
"""


def test_a_node_that_nobody_holds_hears_until_it_is_closed() -> None:
    """In a process of its own: DDS would call what Python has thrown away."""
    run = subprocess.run(
        [sys.executable, "-c", FORGOTTEN], env=everything(), timeout=60.0, capture_output=True, text=True
    )
    assert run.stdout.strip() == "10", run.stderr


def test_late_joiners_get_what_is_latched(nodes: tuple[Any, Any]) -> None:
    one, other = nodes
    one.publisher("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED).publish({"transforms": [{"child_frame_id": "imu"}]})
    one.publisher("/gone", STRING).publish({"data": "before anybody listened"})
    got: list[str] = []
    other.subscribe("/gone", STRING, lambda m: got.append(m.data))
    other.subscribe(
        "/tf_static", "tf2_msgs/msg/TFMessage", lambda m: got.append(m.transforms[0].child_frame_id), LATCHED
    )
    assert wait_until(lambda: got)
    assert got == ["imu"]


def test_a_sensor_is_heard_whatever_it_offers(nodes: tuple[Any, Any]) -> None:
    one, other = nodes
    got: list[str] = []
    for topic, qos in (("/a", DEFAULT), ("/b", SENSOR)):
        other.subscribe(topic, STRING, lambda m: got.append(m.data), SENSOR)
        publisher = one.publisher(topic, STRING, qos)
        assert wait_until(lambda p=publisher: p._writer.get_matched_subscriptions())  # type: ignore[misc]
        publisher.publish({"data": topic})
    assert wait_until(lambda: len(got) == 2)
    assert not one.faults and not other.faults


def test_a_mismatch_is_said_on_both_sides(nodes: tuple[Any, Any]) -> None:
    one, other = nodes
    one.publisher("/scan", STRING, SENSOR)
    other.subscribe("/scan", STRING, print, DEFAULT)
    assert wait_until(lambda: one.faults and other.faults)
    assert other.faults == [
        "/scan: a publisher offers less than is asked for (reliability); no message will come through"
    ]
    assert one.faults == [
        "/scan: a subscription asks for more than is offered (reliability); no message will come through"
    ]
    (offered,) = other.publishers("/scan")
    assert DEFAULT.incompatible(offered.qos) == "it offers best effort, reliable is asked for"
    assert not SENSOR.incompatible(offered.qos)


def test_another_type_is_named_and_forgotten_when_it_has_gone(
    nodes: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = nodes
    monkeypatch.setattr("wbmpc.ros2.mismatch._UNSEEN", 0.2)
    one.publisher("/scan", STRING)
    other.subscribe("/scan", JOINTS, print)
    assert wait_until(lambda: one.faults and other.faults)
    time.sleep(0.3)
    says = "another type (std_msgs/msg/String) than is asked for (sensor_msgs/msg/JointState)"
    assert other.faults == [f"a publisher of /scan has {says}; no message will come through"]
    one.close()
    assert wait_until(lambda: not other.faults)


def test_a_topic_of_two_types_is_heard_in_both_whoever_comes_first(
    nodes: tuple[Any, Any], caplog: pytest.LogCaptureFixture
) -> None:
    one, other = nodes
    got: list[str] = []
    kinds = ("std_msgs/msg/Bool", STRING)
    topic = MultiTypeSubscriber(other, "/mixed", {k: lambda m, k=k: got.append(k) for k in kinds})
    third = open_node("third", "dds", NETWORK)
    for k, node in zip(kinds, (one, third), strict=True):
        publisher = node.publisher("/mixed", k)
        assert wait_until(lambda p=publisher: topic.update() or p._writer.get_matched_subscriptions())
        publisher.publish({})
        assert wait_until(lambda k=k: k in got)
    time.sleep(0.3)
    assert (one.faults, other.faults, third.faults) == ([], [], [])  # a node that sends either type has no mismatch
    assert not any("another type" in r.getMessage() for r in caplog.records)
    third.close()
    assert wait_until(lambda: topic.update() or list(topic._ends) == [kinds[0]])
    assert wait_until(lambda: [e.type for e in one.subscribers("/mixed")] == [kinds[0]])


def test_a_type_that_the_middleware_has_no_room_for_is_reported_as_long_as_it_is_there(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Some middlewares have one type for a topic: the second one is rejected, said once, and forgotten when it has gone."""
    kinds, taken = ["std_msgs/msg/Bool"], []

    def subscribe(topic: str, kind: str, *given: Any, **also: Any) -> Any:
        if taken:
            raise RuntimeError("one type only")
        taken.append(kind)
        return taken.clear

    known = lambda topic: [SimpleNamespace(type=k) for k in kinds]
    topic = MultiTypeSubscriber(
        SimpleNamespace(publishers=known, subscribe=subscribe), "/mixed", dict.fromkeys([*kinds, STRING], print)
    )  # type: ignore[arg-type]
    topic.update()
    assert (taken, topic.fault) == (["std_msgs/msg/Bool"], "")
    kinds.append(STRING)
    for _ in range(2):
        topic.update()
    says = f"/mixed: {STRING} is not heard beside std_msgs/msg/Bool: RuntimeError: one type only"
    assert topic.fault == says and caplog.messages == [says]
    kinds.remove("std_msgs/msg/Bool")
    topic.update()
    assert (taken, topic.fault) == ([STRING], "")


def test_a_callback_that_raises_does_not_end_the_bus(nodes: tuple[Any, Any], caplog: pytest.LogCaptureFixture) -> None:
    one, other = nodes
    got: list[str] = []

    def callback(message: Any) -> None:
        got.append(message.data)
        raise ValueError("no good")

    other.subscribe("/bad", STRING, callback, Qos(depth=10))
    publisher = one.publisher("/bad", STRING)
    assert wait_until(lambda: publisher._writer.get_matched_subscriptions())
    publisher.publish({"data": "1"})
    publisher.publish({"data": "2"})
    assert wait_until(lambda: len(got) == 2)
    assert "/bad: ValueError: no good" in caplog.text


# ---------------------------------------------------------------------- graph
def test_the_graph_shows_node_types_and_hashes(nodes: tuple[Any, Any]) -> None:
    """What `ros2 node list` and `ros2 topic info -v` read."""
    one, other = nodes
    infos: list[Any] = []
    one.subscribe("/clock", "rosgraph_msgs/msg/Clock", print, SENSOR)
    publisher = one.publisher("/joint_states", JOINTS, SENSOR)
    watcher = DomainParticipant(44)
    kind = "rmw_dds_common/msg/ParticipantEntitiesInfo"
    topic = Topic(watcher, "ros_discovery_info", message_class(types("jazzy"), kind))
    reader = DataReader(watcher, topic, qos=other._qos(Qos(latched=True, depth=100), kind))

    def found() -> bool:
        infos.extend(types("jazzy").decode(kind, s.data) for s in reader.take(N=64) if hasattr(s, "data"))
        return any(i.node_entities_info_seq[0].node_name == "one" and len(full(i)) == 2 for i in infos)

    full = lambda i: [*i.node_entities_info_seq[0].reader_gid_seq, *i.node_entities_info_seq[0].writer_gid_seq]
    assert wait_until(found)
    info = [i for i in infos if i.node_entities_info_seq[0].node_name == "one"][-1]
    assert bytes(info.gid.data) == one._participant.guid.bytes
    assert bytes(info.node_entities_info_seq[0].writer_gid_seq[0].data) == publisher._writer.guid.bytes
    assert wait_until(lambda: other.publishers("/joint_states"))
    (endpoint,) = other.publishers("/joint_states")
    assert (endpoint.type, endpoint.own, endpoint.qos) == (JOINTS, False, SENSOR)
    assert [e.own for e in one.publishers("/joint_states")] == [True]
    (sample,) = [s for s in other._graph._writers._known.values() if s.topic_name == "rt/joint_states"]
    assert sample.type_name == "sensor_msgs::msg::dds_::JointState_"
    # the hash that ROS 2 Jazzy prints in `ros2 topic info -v /joint_states`
    user = next(p for p in sample.qos if type(p).__name__ == "Userdata").data
    assert user == b"typehash=RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e;"


def test_who_came_and_went_between_two_looks_is_known_for_a_while(nodes: tuple[Any, Any]) -> None:
    one, other = nodes
    other.publishers("/brief")
    heard: list[Any] = []
    other.subscribe("/brief", STRING, heard.append)
    publisher = one.publisher("/brief", STRING)
    assert wait_until(publisher._writer.get_matched_subscriptions)
    publisher.publish({"data": "and I am gone"})
    assert wait_until(lambda: heard)
    one._writers.remove(publisher._writer)
    publisher._writer.__del__()
    time.sleep(0.1)
    assert not other.publishers("/brief") and [e.own for e in other.publishers("/brief", 1.0)] == [False]
    time.sleep(0.5)
    assert not other.publishers("/brief", 0.5) and not other.publishers("/other", 1.0)


def test_who_leaves_is_gone_from_the_graph(nodes: tuple[Any, Any]) -> None:
    _, other = nodes
    third = open_node("third", "dds", NETWORK)
    third.publisher("/there", STRING)
    assert wait_until(lambda: other.publishers("/there"))
    third.close()
    assert wait_until(lambda: not other.publishers("/there"))


# ---------------------------------------------------------------------- services and wrong use
def test_a_service_answers(nodes: tuple[Any, Any]) -> None:
    one, other = nodes
    one.serve("/brakes", "std_srvs/srv/SetBool", lambda q: {"success": q.data, "message": "open" if q.data else "shut"})
    for asked, says in ((True, "open"), (False, "shut")):
        answer = other.call("/brakes", "std_srvs/srv/SetBool", {"data": asked})
        assert (answer.success, answer.message) == (asked, says)
    with pytest.raises(RunAborted, match="/nobody: no server"):
        other.call("/nobody", "std_srvs/srv/Trigger", {}, timeout=0.1)


@pytest.mark.parametrize("deferred", [True, False])
def test_an_answer_waits_for_the_reader_of_who_asked(nodes: tuple[Any, Any], deferred: bool) -> None:
    """Discovery brings a client's writer and reader in any order: here its reader comes 0.3 s after the request."""
    one, other = nodes
    kind, count = "std_srvs/srv/SetBool", [0]

    def answer(request: Any) -> dict[str, Any]:
        count[0] += 1
        return {"success": True}

    one.serve("/late", kind, answer, deferred=deferred)
    header = {"client": dds.idl_types.uint64, "number": dds.idl_types.int64}
    make = lambda name, end: (kind + end, other._topic(name, kind + end, header))
    (asked, requests), (said, replies) = make("rq/lateRequest", "_Request"), make("rr/lateReply", "_Response")
    mark = "clientid=1.2.3;"
    writer = dds.DataWriter(other._participant, requests, qos=other._qos(DEFAULT, asked, mark))
    assert wait_until(lambda: dds.matched(writer))
    body = other.types.encode(asked, {"data": True})
    writer.write(requests.data_type(body[:4] + bytes(range(16)) + body[4:]))
    assert wait_until(lambda: one.work() or count[0])
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        one.work()
    reader = DataReader(other._participant, replies, qos=other._qos(DEFAULT, said, mark))
    got: list[bytes] = []
    assert wait_until(lambda: one.work() or got.extend(d for d, _ in dds.taken(reader)) or got)
    assert got[0][4:20] == bytes(range(16)) and count == [1]
    reader.__del__()
    writer.__del__()


def test_waiting_for_no_number_of_seconds_and_names_that_are_too_long_are_errors() -> None:
    """DDS takes a message about nodes whose names are no longer than 256 characters."""
    node = open_node("alone", "dds", NETWORK)
    try:
        node.serve("/s", "std_srvs/srv/SetBool", lambda q: {"success": True}, deferred=True)
        with pytest.raises(InputError, match="timeout must be finite, got nan"):
            node.call("/s", "std_srvs/srv/SetBool", {"data": True}, timeout=float("nan"))
    finally:
        node.close()
    with pytest.raises(InputError, match="a name of letters, digits and _ is needed, 200 at most"):
        open_node("x" * 300, "dds", NETWORK)


def test_services_of_another_rmw_are_reported_on_both_sides(
    nodes: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Endpoints of Fast DDS have no ``clientid`` and no ``serviceid`` in their user data (rmw_fastrtps_cpp of Jazzy, as rclpy 7.1.6
    puts it on the wire): here those of one node."""
    one, other = nodes
    kind, plain = "std_srvs/srv/SetBool", dds.dds_qos
    one.serve("/known", kind, lambda q: {"success": True}, deferred=True)
    monkeypatch.setattr(
        dds, "dds_qos", lambda qos, data, local: plain(qos, data[data.index("typehash") :], local=local)
    )
    other.serve("/strange", kind, lambda q: {"success": True})
    asks = threading.Thread(target=other.call, args=("/known", kind, {"data": True}, 60.0))
    asks.start()
    assert wait_until(lambda: one.work() or not asks.is_alive())
    assert "/known: who asks is of another RMW than rmw_cyclonedds" in caplog.text
    monkeypatch.undo()
    with pytest.raises(RunAborted, match="/strange: its server is of another RMW than rmw_cyclonedds"):
        one.call("/strange", kind, {"data": True}, timeout=0.5)
    caplog.clear()
    asks = threading.Thread(target=other.call, args=("/known", kind, {"data": True}, 60.0))
    asks.start()
    assert wait_until(lambda: one.work() or not asks.is_alive()) and not caplog.text


def test_wrong_use_is_one_message(nodes: tuple[Any, Any]) -> None:
    with pytest.raises(InputError, match="a name of letters"):
        open_node("my node", "dds", NETWORK)
    with pytest.raises(InputError, match="valid: auto, rclpy, dds"):
        open_node("n", "zenoh", NETWORK)
    nodes[0].publisher("/x", STRING)
    with pytest.raises(InputError, match=r"/x: is used with std_msgs/msg/String and std_msgs/msg/Bool"):
        nodes[0].publisher("/x", "std_msgs/msg/Bool")


def test_a_flood_of_messages_that_nobody_can_use_is_a_few_lines(
    nodes: tuple[Any, Any], caplog: pytest.LogCaptureFixture
) -> None:
    """Malformed CDR in place of a string: the bus goes on, and says it a few times."""
    one, other = nodes
    got: list[str] = []
    other.subscribe("/flood", STRING, lambda m: got.append(m.data), Qos(depth=1000))
    publisher = one.publisher("/flood", STRING, Qos(depth=1000))
    assert wait_until(lambda: publisher._writer.get_matched_subscriptions())
    for _ in range(300):
        publisher.send(b"\x00\x01\x00\x00\x05\x00\x00\x00\xff\xfe\xff\xfe\x00\x00\x00\x00")  # not UTF-8
    publisher.publish({"data": "a good one"})
    assert wait_until(lambda: got == ["a good one"])
    assert 1 <= sum("/flood: " in r.getMessage() for r in caplog.records) <= 5


@pytest.mark.parametrize("name", ["", "/", "a b", "/4/w", "a__b", "/a/", "a" * 248, "é"])
def test_names_that_ros_does_not_have_are_errors(nodes: tuple[Any, Any], name: str) -> None:
    """Truth: the design article on names of topics and services."""
    for make in (
        lambda: nodes[0].publisher(name, "std_msgs/msg/Float64"),
        lambda: nodes[0].subscribe(name, "std_msgs/msg/Float64", print),
        lambda: nodes[0].subscribers(name),
    ):
        with pytest.raises(InputError, match=f"topic or service {re.escape(repr(name))}: such a name "):
            make()
    assert full_name("a/_b_2") == "/a/_b_2"
