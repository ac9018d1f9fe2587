"""Obstacles from the bus. Truth: what was sent, geometry by hand, limits of the settings."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, private, wait_until

from wbmpc import lie
from wbmpc.obstacles.world import Obstacles
from wbmpc.ros2.bus import SENSOR
from wbmpc.ros2.network import Network
from wbmpc.ros2.obstacles import ObstacleTopics
from wbmpc.ros2.opening import open_node
from wbmpc.ros2.settings import OBSTACLE_TYPES, RosSettings
from wbmpc.ros2.transforms import FIXED, KIND, MAX_FRAMES, Transforms

pytestmark = needs_dds
if not MISSING:
    from standin import PERIOD, check_stopped

    from wbmpc.bases.swerve.defaults import swerve_mpc
    from wbmpc.ros2.convert import header
    from wbmpc.ros2.messages import types

#: The floor is this far [m] below the origin of plans; the bus's time at which the plan's is 0 [s].
LIFT, BEGIN = 0.4, 90.0
TOPICS = {"detections": "/detections", "occupancy_grid": "/map", "points": "/points"}
QUARTER = lie.quaternion_about((0, 0, 1), 0.5 * np.pi)


class Bus:
    """A node that only knows who listens, and the topics of a robot at (1, 2) m; ``time`` [s] is that of the bus."""

    def __init__(self, topics: dict[str, str] = TOPICS, **settings: Any) -> None:
        self.time, self.calls = 100.0, {}
        self.world = Obstacles()
        still = SimpleNamespace(position=np.array([1.0, 2.0, 0.1]), orientation=QUARTER)
        adapter: Any = SimpleNamespace(
            obstacles=self.world, robot=None, planner=SimpleNamespace(lift=LIFT), snapshot=lambda: (0.0, np.zeros(1)),
            estimate=lambda: still,
        )  # fmt: skip
        given = RosSettings(topics=topics, obstacles=settings)
        now = lambda: self.time
        self.topics = ObstacleTopics(self, adapter, given, now, now, lambda: BEGIN)  # type: ignore[arg-type]
        self.topics.update()

    def subscribe(self, topic: str, kind: str, callback: Callable[..., None], *_: Any, **__: Any) -> Callable[[], None]:
        self.calls[topic] = kind, callback
        return lambda: None

    def send(self, topic: str, age: float = 0.0, **values: Any) -> str:
        """A message of this age [s], complete as on the wire; what is wrong with it."""
        kind, callback = self.calls[topic]
        stamp = round((self.time - age) * 1e9)
        head = {
            "stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9},
            **values.pop("header", {"frame_id": "odom"}),
        }
        if topic in ("/tf", "/tf_static"):
            values["transforms"] = [{"header": head, **t} for t in values["transforms"]]
        else:
            values["header"] = head
        callback(types("jazzy").decode(kind, types("jazzy").encode(kind, values)))
        if topic not in ("/tf", "/tf_static"):
            self.topics._pool.submit(lambda: None).result(60.0)  # read in the order in which they came
        return self.topics.fault

    def detect(self, *boxes: dict[str, Any], frame: str = "odom", age: float = 0.0) -> str:
        return self.send("/detections", age, header={"frame_id": frame}, detections=list(boxes))

    def obstacle(self, name: str, t: float | None = None) -> tuple[Any, np.ndarray, np.ndarray]:
        """Shape, position and rotation in the plan at a time of the bus (left out: now)."""
        t = (self.time if t is None else t) - BEGIN
        there = self.world.snapshot(t)
        (found,) = (o for o in there.obstacles if o.name == name)
        place, turn = there.pose(found, np.array([t]))
        return found.shape, place[0], turn


@pytest.fixture
def bus() -> Iterator[Callable[..., Bus]]:
    made: list[Bus] = []

    def make(*args: Any, **settings: Any) -> Bus:
        made.append(Bus(*args, **settings))
        return made[-1]

    yield make
    for one in made:
        one.topics.close()


def box(name: str, x: float, y: float = 0.0, z: float = 0.5, size: float = 0.4) -> dict[str, Any]:
    center = {"position": {"x": x, "y": y, "z": z}}
    return {"id": name, "bbox": {"center": center, "size": dict.fromkeys("xyz", size)}}


def transform(parent: str, child: str, x: float = 0.0, q: Any = (1.0, 0, 0, 0)) -> dict[str, Any]:
    there = {"translation": {"x": x}, "rotation": dict(zip("wxyz", q, strict=True))}
    return {"header": {"frame_id": parent}, "child_frame_id": child, "transform": there}


def test_detected_boxes_come_move_and_go_by_their_ids(bus: Callable[..., Bus]) -> None:
    """A walker at 0.5 m/s along y: where it is 0.4 s after the last message."""
    b = bus(hold=0.25)
    for _ in range(6):
        b.detect(box("walker", 2.0, 0.5 * (b.time - 100.0)), box("crate", 3.0))
        b.time += 0.1
    assert set(b.world.names) == {"detections/walker", "detections/crate"}
    shape, place, _ = b.obstacle("detections/walker", 100.9)
    np.testing.assert_allclose(shape.half, [0.2] * 3)
    np.testing.assert_allclose(place, [2.0, 0.45, 0.5 - LIFT], atol=1e-6)
    np.testing.assert_allclose(b.obstacle("detections/crate", 100.9)[1], [3.0, 0.0, 0.5 - LIFT])
    for kept in ({"walker", "crate"}, {"crate"}):  # 0.1 s and 0.3 s after it was seen
        b.detect(box("crate", 3.0))
        assert {n.split("/")[1] for n in b.world.names} == kept
        b.time += 0.2
    b.time += 0.2
    assert b.detect() == "" and not b.world.names
    b.detect(box("", 3.0), box("", 4.0))
    assert len(b.world.names) == 2


def test_an_id_that_jumps_counts_as_standing(bus: Callable[..., Bus]) -> None:
    b = bus(max_speed=2.0)
    for x in (0.0, 0.1, 0.2, 5.0):
        b.detect(box("one", x))
        b.time += 0.1
    np.testing.assert_allclose(b.obstacle("detections/one", b.time + 1.0)[1], [5.0, 0.0, 0.5 - LIFT])


def test_boxes_are_moved_from_their_frame(bus: Callable[..., Bus]) -> None:
    """The base is at (1, 2) and looks along y: 2 m ahead of a camera that is 0.3 m ahead of it is (1, 4.3); "map" is 10 m before "odom"."""
    b = bus()
    b.send("/tf_static", transforms=[transform("base_link", "camera", 0.3)])
    assert "unknown" in b.detect(box("a", 2.0), frame="map") or "map" in b.topics.fault
    b.send("/tf", transforms=[transform("map", "odom", 10.0)])
    assert b.detect(box("a", 2.0, z=0.0), frame="camera") == ""
    _, place, turn = b.obstacle("detections/a")
    np.testing.assert_allclose(place, [1.0, 4.3, 0.1 - LIFT], atol=1e-12)
    np.testing.assert_allclose(turn, lie.quaternion_to_rotation(QUARTER), atol=1e-12)
    assert b.detect(box("a", 2.0), frame="map") == ""
    np.testing.assert_allclose(b.obstacle("detections/a")[1], [-8.0, 0.0, 0.5 - LIFT], atol=1e-12)
    b.time += 3.0
    assert "the transform from 'map' to 'odom' has not come for 2 s" in b.detect(box("a", 2.0), frame="map")


def grid(values: Any, **info: Any) -> dict[str, Any]:
    cells = np.array(values)
    given = {"width": cells.shape[1], "height": cells.shape[0], "resolution": 0.1, **info}
    return {"info": given, "data": cells.astype(np.int8).ravel()}


def test_distances_of_an_occupancy_grid(bus: Callable[..., Bus]) -> None:
    """One solid cell of 0.1 m, in column 12 and row 4, and one of unknown occupancy; the grid's frame moves after that."""
    b = bus(height=1.5)
    cells = np.zeros((20, 30))
    cells[4, 12], cells[15, 3] = 100, -1
    b.send("/tf", transforms=[transform("map", "odom", 1.0)])
    turned = {"position": {"x": 2.0, "y": 0.0}, "orientation": dict(zip("wxyz", QUARTER, strict=True))}
    assert b.send("/map", header={"frame_id": "map"}, **grid(cells, origin=turned)) == ""
    center = lambda shift: np.array([2.0 - 0.45 - shift, 1.25, 0.0])  # turned by a quarter: rows run along -x
    for shift in (1.0, 1.2):
        b.send("/tf", transforms=[transform("map", "odom", shift)])
        b.time += 0.01
        b.topics.update()
        shape, place, turn = b.obstacle("occupancy_grid")
        for away, height in (([0.0, 0.3, 0.0], 0.0), ([0.3, 0.0, 0.0], 1.4), ([-0.5, 0.0, 0.0], 0.7)):
            point = center(shift) + away + [0.0, 0.0, height - LIFT]
            found, slope = shape.sample(((point - place) @ turn)[None])
            assert found[0] + shape.error == pytest.approx(np.linalg.norm(away), abs=0.01)
            np.testing.assert_allclose(turn @ slope[0], away / np.linalg.norm(away), atol=0.2)
        above = center(shift) + [0.0, 0.0, 1.51 - LIFT]
        assert shape.sample(((above - place) @ turn)[None])[0][0] == np.inf


def test_what_is_unknown_is_free_or_solid_as_the_settings_say(bus: Callable[..., Bus]) -> None:
    for unknown, solid in (("free", False), ("occupied", True)):
        b = bus(unknown=unknown)
        b.send("/map", **grid([[-1, 0], [0, 64]]))
        assert (np.asarray(b.obstacle("occupancy_grid")[0].values)[:, :, 0] < 0.0).tolist() == [
            [solid, False],
            [False, False],
        ]


def cloud(points: Any, **values: Any) -> dict[str, Any]:
    data = np.asarray(points, np.float32)
    fields = [{"name": n, "offset": 4 * i, "datatype": 7, "count": 1} for i, n in enumerate("xyz")]
    raw = np.frombuffer(data.tobytes(), np.uint8)
    return {
        "width": len(data),
        "height": 1,
        "point_step": 12,
        "row_step": len(raw),
        "fields": fields,
        "data": raw,
        **values,
    }


def test_points_become_a_map(bus: Callable[..., Bus]) -> None:
    """A wall 1 m ahead of a sensor on the base, which looks along y; points that are not finite do not count."""
    b = bus(cell=0.1)
    b.send("/tf_static", transforms=[transform("base_link", "lidar", 0.3)])
    side, up = np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(0.1, 1.0, 30))
    wall = np.stack([np.full(side.size, 1.0), side.ravel(), up.ravel()], axis=1)
    for _ in range(3):
        b.time += 0.1
        assert b.send("/points", header={"frame_id": "lidar"}, **cloud([*wall, [np.nan] * 3])) == ""
    shape, place, _ = b.obstacle("points")
    found = shape.sample(np.array([[1.0, 3.3 - 0.5, 0.6 - LIFT]]) - place)[0][0] + shape.error
    assert found == pytest.approx(0.5, abs=0.1)


def test_points_of_a_time_that_went_back_are_a_map_of_their_own(bus: Callable[..., Bus]) -> None:
    """A simulator was restarted: until it came as far as before its points were dropped, as newer than nothing, while the topic counted as
    heard. What comes late on the same clock is said to be."""
    b = bus({"points": "/points"})
    for begin, x in ((100.0, 3.0), (5.0, 2.0)):
        b.time = begin
        for _ in range(5):
            b.time += 0.05
            wall = [[x, y, z] for y in np.arange(1.0, 3.0, 0.04) for z in np.arange(0.3, 1.0, 0.04)]
            assert b.send("/points", **cloud(wall)) == ""
    shape, place, _ = b.obstacle("points")
    at = lambda x: float(shape.sample(np.array([[x, 2.0, 0.6 - LIFT]]) - place)[0][0])
    assert at(2.0) < 0.1 < 0.8 < at(3.0)
    assert "0.1 s older than the last one" in b.send("/points", 0.1, **cloud(wall))
    b.time += 0.05
    assert b.send("/points", **cloud(wall)) == ""


BAD = {
    "/detections": [
        ({"detections": [box("a", np.nan)]}, "not finite"),
        ({"detections": [box("a", 1e9)]}, "too large"),
        ({"detections": [box("a", 1.0, size=0.0)]}, "three positive lengths"),
        ({"detections": [box("a", 1.0), box("a", 2.0)]}, "two detections have the id 'a'"),
        ({"detections": [box("a" * 101, 1.0)]}, "at most 100 characters"),
        ({"detections": [box("a\n", 1.0)]}, "can be printed"),
        ({"detections": [box("", 1.0)] * 201}, "201 detections; valid: at most 200"),
        ({"detections": [{**box("a", 1.0), "header": {"frame_id": "moon"}}]}, "in the frame 'moon'"),
        ({"header": {"frame_id": "moon"}, "detections": [box("a", 1.0)]}, "moon"),
        ({"detections": [box("a", 1.0)], "age": 0.6}, "0.6 s old, the limit is 0.5 s"),
        ({"detections": [box("a", 1.0)], "age": -5.0}, "5 s ahead of the clock"),
    ],
    "/map": [
        ({**grid(np.zeros((3, 3))), "data": np.zeros(8, np.int8)}, "3 x 3 cells has 8 values"),
        (grid(np.zeros((3, 3)), width=2**31, height=2**31), "valid: 2 or more each"),
        (grid(np.zeros((3, 3)), resolution=0.0), "valid: 0.001 to 10 m"),
        (grid(np.zeros((3, 3)), resolution=np.nan), "valid: 0.001 to 10 m"),
        (grid(np.full((3, 3), 101)), "valid: -1 to 100"),
        (grid(np.zeros((3, 3)), origin={"position": {"x": np.inf}}), "not finite"),
        (grid(np.zeros((3, 3)), origin={"orientation": {"w": 0.0, "x": 1.0}}), "leans"),
        ({"header": {"frame_id": "moon"}, **grid(np.zeros((3, 3)))}, "moon"),
    ],
    "/points": [
        (cloud(np.zeros((9, 3)), width=10), "has rows of 108"),
        (cloud(np.zeros((9, 3)), row_step=96), "has rows of 96 and 108 bytes"),
        (cloud(np.zeros((9, 3)), width=1_000_000), "a cloud of 1000000 points; valid: at most 500000"),
        (cloud(np.zeros((9, 3)), fields=[]), "field 'x' is missing"),
        (cloud(np.zeros((9, 3)), fields=[{"name": n, "offset": 10, "datatype": 7} for n in "xyz"]), "begins at byte 10"),
        (cloud(np.zeros((9, 3)), fields=[{"name": n, "datatype": 7} for n in "xyz"]), "'x', 'y' and 'z' overlap"),
        (cloud(np.zeros((9, 3)), fields=[{"name": "x", "datatype": 7}] * 2 + cloud([])["fields"]), "two fields 'x', 'y' or 'z'"),
        ({"header": {"frame_id": "moon"}, **cloud(np.zeros((9, 3)))}, "moon"),
        (cloud(np.full((9, 3), np.nan)), "none of the cloud's 9 points is a measurement"),
        (cloud(np.array([[1.0, np.nan, 1.0], [np.inf, 0.0, 0.0]])), "none of the cloud's 2 points is a measurement"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(("topic", "values", "why"), [(t, v, w) for t, cases in BAD.items() for v, w in cases])
def test_messages_that_cannot_be_meant_change_nothing(
    bus: Callable[..., Bus], topic: str, values: dict[str, Any], why: str, caplog: pytest.LogCaptureFixture
) -> None:
    b = bus({key: name for key, name in TOPICS.items() if name == topic})
    for _ in range(7):
        found = b.send(topic, **values)
        assert found.startswith(f"{topic}: ") and why in found
    assert not b.world.names and b.topics.lost() == found
    lines = [r for r in caplog.records if r.levelno == logging.ERROR]
    assert 1 <= len(lines) <= 5


@pytest.mark.parametrize(
    "wrong",
    [
        {"transform": {"translation": {"x": np.nan}}},
        {"transform": {"rotation": {"w": 2.0}}},
        {"child_frame_id": ""},
        {"child_frame_id": "base_link", "transform": {"translation": {"x": 5.0}}},  # nobody else says where the base is
    ],
)
def test_transforms_that_cannot_be_meant_are_left_out(bus: Callable[..., Bus], wrong: dict[str, Any]) -> None:
    b = bus()
    b.send("/tf", transforms=[{**transform("odom", "camera"), **wrong}, transform("odom", "lidar", 1.0)])
    b.send("/tf", transforms=[transform("lidar", "odom", 1.0)])  # a loop
    assert b.detect(box("a", 1.0), frame="base_link") == ""
    np.testing.assert_allclose(b.obstacle("detections/a")[1], [1.0, 3.0, 0.6 - LIFT], atol=1e-12)
    assert "camera" in b.detect(box("a", 1.0), frame="camera")


def test_a_flood_of_frames_keeps_none_out_for_good(bus: Callable[..., Bus]) -> None:
    """A thousand names, and one more; the base is none of the bus's. A frame that hangs nowhere is not unknown."""
    b = bus()
    for k in range(10):
        b.send("/tf", transforms=[transform("nowhere", f"{k}-{i}") for i in range(100)])
    assert "no transforms lead from 'odom' to the frame '1-1'" in b.detect(box("a", 1.0), frame="1-1")
    b.send("/tf", transforms=[transform("base_link", "camera")])
    assert b.detect(box("a", 1.0), frame="camera") == ""
    b.time += 2.5
    b.topics.update()
    assert "unknown frame '1-1'" not in b.detect(box("a", 1.0), frame="1-1")


@pytest.mark.parametrize("own", [True, False], ids=["another publisher", "nobody knows whose"])
def test_a_flood_of_fixed_frames_takes_none_away_that_is_of_use(own: bool) -> None:
    """Fixed frames never grow old: a thousand of them filled the table until the node was started again. Truth: the frames of the robot
    and of its camera, sent before and after the flood."""
    frames = Transforms(SimpleNamespace(subscribe=lambda *_, **__: None), "odom", "base_link", lambda: 100.0)  # type: ignore[arg-type]
    robot, flood = ((object(),), (object(),)) if own else ((), ())
    one = lambda parent, child: SimpleNamespace(transforms=[types("jazzy").decode(*encoded(parent, child))])
    encoded = lambda parent, child: (
        "geometry_msgs/msg/TransformStamped",
        types("jazzy").encode("geometry_msgs/msg/TransformStamped", transform(parent, child, 1.0)),
    )
    frames.note_base(100.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    frames.take(one("base_link", "mast"), True, *robot)
    frames.take(one("mast", "camera"), True, *robot)
    for k in range(3000):
        frames.take(one("base_link", f"{k}"), True, *flood)
        if k % 500 == 0:
            np.testing.assert_allclose(frames.pose("camera", 100.0)[0], [2.0, 0.0, 0.0])
    frames.take(one("base_link", "late"), True, *robot)
    np.testing.assert_allclose(frames.pose("camera", 100.0)[0], [2.0, 0.0, 0.0])
    np.testing.assert_allclose(frames.pose("late", 100.0)[0], [1.0, 0.0, 0.0])
    assert len(frames._frames) == MAX_FRAMES


def test_what_is_old_is_lost(bus: Callable[..., Bus]) -> None:
    """Detections of 0.2 s with a limit of 0.5 s: 0.3 s later they are as old as they may be. A map that is latched stays."""
    b = bus({"detections": "/detections", "occupancy_grid": "/map"})
    assert b.topics.lost() == "no obstacles on /detections yet"
    b.detect(box("a", 1.0), age=0.2)
    assert b.topics.lost() == "no obstacles on /map yet"
    b.send("/map", age=1000.0, **grid(np.zeros((3, 3))))
    b.time += 0.29
    assert b.topics.lost() == ""
    b.time += 0.02
    assert b.topics.lost() == "the obstacles on /detections are 0.51 s old, the limit is 0.5 s"
    assert b.detect() == "" and b.topics.lost() == ""  # nothing stands there: that is known, too


def test_a_second_publisher_does_not_count(bus: Callable[..., Bus]) -> None:
    b = bus()
    kind, callback = b.calls["/detections"]
    for source, x in ((Publisher(), 1.0), (Publisher(), 2.0)):
        b.calls["/detections"] = kind, lambda m, s=source: callback(m, s)
        b.detect(box("a", x))
    np.testing.assert_allclose(b.obstacle("detections/a")[1][0], 1.0)
    assert "2 publishers on /detections" in b.topics.fault


class Publisher:
    """Somebody who stays on the bus."""

    def gone(self) -> bool:
        return False

    def prefer(self) -> None:
        pass


def test_boxes_over_the_bus() -> None:
    """Two nodes: what one publishes, the other one's world has."""
    network = Network.of(private())
    here, there = open_node("here", "dds", network), open_node("there", "dds", network)
    b = Bus({"detections": "/detections"})
    try:
        kind, callback = b.calls["/detections"]
        assert kind == OBSTACLE_TYPES["detections"]
        here.subscribe("/detections", kind, callback, sourced=True)
        publisher: Any = there.publisher("/detections", kind)
        assert wait_until(lambda: publisher._writer.get_matched_subscriptions())
        publisher.publish({"header": {"frame_id": "odom"}, "detections": [box("crate", 3.0)]})
        assert wait_until(lambda: "detections/crate" in b.world)
        np.testing.assert_allclose(b.obstacle("detections/crate")[1], [3.0, 0.0, 0.5 - LIFT])
    finally:
        here.close()
        there.close()
        b.topics.close()


def test_a_robot_stops_when_its_detections_do(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The node waits for the first ones, hands them to its MPC (here one without rows, which needs no compilation), and stops 0.6 s after
    the last ones."""
    given: list[Any] = []

    def made(*arguments: Any, obstacles: Any, **options: Any) -> Any:
        given.append(obstacles)
        return swerve_mpc(*arguments)

    monkeypatch.setattr("wbmpc.bases.swerve.ros.swerve_mpc", made)
    p = pair(topics={"detections": "/detections"}, obstacles={"max_age": 0.6})
    assert p.until(lambda: p.control.state == "waiting: no obstacles on /detections yet"), p.control.state
    publisher = p.standin.node.publisher("/detections", OBSTACLE_TYPES["detections"])
    assert p.until(lambda: publisher._writer.get_matched_subscriptions())
    sending = [True]

    def change(message: dict[str, Any]) -> dict[str, Any]:
        if sending and round(p.standin.time / PERIOD) % 5 == 0:
            publisher.publish({"header": header(p.standin.time, "odom"), "detections": [box("crate", 9.0)]})
        return message

    p.standin.change = change
    p.ready()
    assert given[0] is p.control.adapter.obstacles and given[0].names == ("detections/crate",)
    p.go(2.0)
    assert p.until(lambda: p.control.state.startswith("running")), p.control.state
    sending.clear()
    check_stopped(p, "the obstacles on /detections are 0.6", caplog)


def test_a_flood_on_a_topic_of_obstacles_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    """300 messages between two steps of the node: threads that keep a robot upright need the interpreter. Truth: the number that
    waits for the node's thread at most, and the message that was sent last."""
    network = Network.of(private())
    node, other = open_node("control", "dds", network), open_node("other", "dds", network)
    adapter: Any = SimpleNamespace(
        obstacles=Obstacles(),
        robot=None,
        planner=SimpleNamespace(lift=LIFT),
        snapshot=lambda: None,
        estimate=lambda: None,
    )
    now, kind = (lambda: 100.0), OBSTACLE_TYPES["detections"]
    topics = ObstacleTopics(node, adapter, RosSettings(topics={"detections": "/detections"}), now, now, lambda: BEGIN)
    try:
        publisher = other.publisher("/detections", kind, SENSOR)
        assert wait_until(lambda: publisher._writer.get_matched_subscriptions())
        decoded: list[str] = []
        decode = node.types.decode
        monkeypatch.setattr(node.types, "decode", lambda kind, data: (decoded.append(kind), decode(kind, data))[1])
        for k in range(300):
            publisher.publish({"header": {"frame_id": "odom"}, "detections": [box(f"last {k}", 3.0)]})
        waiting = lambda: [w[2][0] for w in node._deferred._waiting.get("/detections", ())]
        assert wait_until(lambda: decoded or (waiting() and b"last 299" in waiting()[-1]))
        assert kind not in decoded
        assert wait_until(lambda: (node.work(), "detections/last 299" in adapter.obstacles)[1])
        assert decoded.count(kind) <= 20
    finally:
        topics.close()
        node.close()
        other.close()


def test_transforms_wait_for_the_nodes_own_thread_and_no_fixed_one_is_lost() -> None:
    """Messages of 600 frames, 200 a second, kept joint states from arriving for 1.6 s: one thread brings both. Truth: the frames that were
    sent; the names of what waits."""
    network = Network.of(private())
    node, other = open_node("control", "dds", network), open_node("other", "dds", network)
    frames = Transforms(node, "odom", "base_link", lambda: 100.0)
    try:
        moving, fixed = other.publisher("/tf", KIND), other.publisher("/tf_static", KIND, FIXED)
        assert wait_until(lambda: all(p._writer.get_matched_subscriptions() for p in (moving, fixed)))
        for k in range(60):
            fixed.publish({"transforms": [transform("odom", f"fixed{k}")]})
        moving.publish({"transforms": [transform("odom", "moving")]})
        waiting = lambda topic: len(node._deferred._waiting.get(topic, ()))
        assert wait_until(lambda: waiting("/tf") == 1 and waiting("/tf_static") == 60) and not frames._frames
        expected = {"moving", *(f"fixed{k}" for k in range(60))}
        assert wait_until(lambda: (node.work(), set(frames._frames) == expected)[1])
    finally:
        node.close()
        other.close()
