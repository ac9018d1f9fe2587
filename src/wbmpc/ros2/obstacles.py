"""Obstacles from the bus: detected objects, an occupancy grid, points of range sensors; for an MPC that keeps clear of them."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.logs import RateLimit
from wbmpc.mapping.local_map import LocalMap
from wbmpc.obstacles.world import Obstacles
from wbmpc.ros2.base_adapter import BaseAdapter
from wbmpc.ros2.bus import LARGEST, LONG, SENSOR, SMALL, Node, Qos
from wbmpc.ros2.convert import error_message, seconds
from wbmpc.ros2.obstacle_messages import Detection, read_detections, read_occupancy, read_points
from wbmpc.ros2.settings import OBSTACLE_TYPES, RosSettings
from wbmpc.ros2.sources import OneSource, Source
from wbmpc.ros2.transforms import Pose, Transforms

#: Velocities are those of straight lines through positions of so long [s], and so many at least; slower ones [m/s] are noise.
WINDOW, FEWEST, STILL = 0.5, 3, 0.05


@dataclass
class Track:
    """An object as it was seen last, at ``stamp`` [s], in axes of the world, with ``velocity`` (3) [m/s]."""

    detection: Detection
    stamp: float
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    seen: deque[tuple[float, Array]] = field(default_factory=deque)


class Tracks:
    """Objects by ``/ID``, or ``#NUMBER`` without identity: those are of one message only. ``hold`` [s]: how long one stays that newer
    messages do not have; ``max_speed`` [m/s]: what seems faster is another object, or noise, and counts as standing."""

    def __init__(self, hold: float, max_speed: float) -> None:
        self._hold, self._max_speed = hold, max_speed
        self._known: dict[str, Track] = {}

    def __iter__(self) -> Iterator[tuple[str, Track]]:
        return iter(self._known.items())

    def update(self, stamp: float, detections: Sequence[Detection]) -> None:
        """All objects that were seen at ``stamp`` [s]; positions in the world."""
        now = {f"/{d.name}" if d.name else f"#{i}": d for i, d in enumerate(detections)}
        held = lambda name, track: name.startswith("/") and abs(stamp - track.stamp) <= self._hold
        kept = {n: t for n, t in self._known.items() if held(n, t)}
        self._known = {**kept, **{n: self._seen_again(self._known.get(n), stamp, d) for n, d in now.items()}}

    def _seen_again(self, last: Track | None, stamp: float, detection: Detection) -> Track:
        seen = deque(last.seen) if last is not None and detection.name and stamp > last.stamp else deque()
        seen.append((stamp, detection.position))
        while len(seen) > FEWEST and seen[0][0] < stamp - WINDOW:
            seen.popleft()
        velocity = _slope(seen)
        speed = float(np.linalg.norm(velocity))
        if speed > self._max_speed:
            seen = deque([seen[-1]])
        if not STILL <= speed <= self._max_speed:
            velocity = np.zeros(3)
        return Track(detection, stamp, velocity, seen)


def _slope(seen: Sequence[tuple[float, Array]]) -> Array:
    """Velocity (3) of the line through positions over times, by least squares."""
    if len(seen) < FEWEST:
        return np.zeros(3)
    times, places = np.array([t for t, _ in seen]), np.array([p for _, p in seen])
    times, places = times - times.mean(), places - places.mean(axis=0)
    return np.asarray(times @ places / (times @ times))


_LOG = logging.getLogger("wbmpc")
Time = Callable[[], float]
#: Names of obstacles; those of detections go on with the object's.
DETECTIONS, GRID, POINTS = "detections", "occupancy_grid", "points"
#: A grid is placed again where its frame has moved by more than this [m, rad].
MOVED = 1e-3


@dataclass
class _Topic:
    """``read``: what a message is given to, with its stamp [s]; ``good``: when the last one that counted was of [s of the steady clock];
    ``fault``: what is wrong with the newest one; ``waiting``: the newest one that has not been read."""

    name: str
    max_age: float | None
    read: Callable[[Any, float], None]
    source: OneSource
    good: float = -np.inf
    fault: str = ""
    waiting: list[Any] = field(default_factory=list)


class ObstacleTopics:
    """Keeps ``adapter.obstacles`` (None: there are no topics) as messages say. ``steady()`` [s]: by which messages grow old; ``stamp()``: the
    bus's time [s]; ``origin()``: that which is 0 for the plan.

    Messages are decoded in the node's own thread and read in another one, of each topic the newest; one that cannot be meant is dropped
    as a whole, with a log line.
    """

    def __init__(
        self, node: Node, adapter: BaseAdapter, settings: RosSettings, steady: Time, stamp: Time, origin: Time
    ) -> None:
        self._adapter, self._settings, self._steady, self._stamp, self._origin = (
            adapter, settings, steady, stamp, origin,
        )  # fmt: skip
        self._topics: list[_Topic] = []
        self._world: Obstacles = Obstacles() if adapter.obstacles is None else adapter.obstacles
        if adapter.obstacles is None:
            return
        own = settings.obstacles
        self._limit, self._lock = RateLimit(), threading.Lock()
        self._pool = ThreadPoolExecutor(1, "obstacles")
        self.transforms = Transforms(node, settings.frames.world, settings.frames.base, steady)
        self._tracks = Tracks(own.hold, own.max_speed)
        self._map: LocalMap | None = None
        self._mapped = -np.inf  # stamp [s] of the points in it that came last
        self._grid: tuple[str, Pose, Pose] | None = None  # frame, the grid in it, where it was put
        self._grid_lost = ""
        self._down = np.array([0.0, 0.0, adapter.planner.lift])
        self._open(node, DETECTIONS, own.max_age, self._read_detections, SENSOR, SMALL)
        latched = own.grid_max_age is None
        self._open(node, GRID, own.grid_max_age, self._read_grid, Qos(latched=latched, depth=1), LONG + SMALL)
        self._open(node, POINTS, own.max_age, self._read_points, SENSOR, LARGEST)

    def _open(
        self, node: Node, key: str, max_age: float | None, read: Callable[[Any, float], None], qos: Qos, largest: int
    ) -> None:
        name = getattr(self._settings.topics, key)
        if not name:
            return
        topic = _Topic(name, max_age, read, OneSource(name))
        self._topics.append(topic)
        try:
            take = partial(self._take, topic)  # deferred: what a flood brings is not even decoded
            node.subscribe(name, OBSTACLE_TYPES[key], take, qos, deferred=True, largest=largest, sourced=True)
        except (ImportError, AttributeError) as error:
            raise InputError(f"topics.{key}: {OBSTACLE_TYPES[key]} is not installed: {error_message(error)}") from error

    # ------------------------------------------------------------------ messages
    def _take(self, topic: _Topic, message: Any, source: Source | None = None) -> None:
        """What waits already is replaced."""
        if not topic.source.takes(source):
            return
        with self._lock:
            busy, topic.waiting = bool(topic.waiting), [message]
            if not busy:
                self._pool.submit(self._work, topic)

    def _work(self, topic: _Topic) -> None:
        with self._lock:
            message, topic.waiting = topic.waiting[0], []
        self.take(topic, message)

    def take(self, topic: _Topic, message: Any) -> None:
        """Read a message; whatever is wrong with it, the node goes on."""
        try:
            stamp = self._time_of(topic, message.header)
            topic.read(message, stamp)
        except Exception as error:
            topic.fault = f"{topic.name}: {error_message(error)}"
            self._limit.log(_LOG, logging.ERROR, topic.name, topic.fault)
        else:
            topic.fault = ""
            topic.good = self._steady() - max(self._stamp() - stamp, 0.0)

    def _time_of(self, topic: _Topic, header: Any) -> float:
        """The message's stamp [s]; of one without a stamp, or of what may be old, now."""
        now, stamp = self._stamp(), seconds(header.stamp)
        if topic.max_age is None or stamp == 0.0:
            return now
        if abs(now - stamp) > topic.max_age:
            when = f"{now - stamp:.3g} s old" if now > stamp else f"{stamp - now:.3g} s ahead of the clock"
            raise InputError(f"the message is {when}, the limit is {topic.max_age:g} s (key 'obstacles')")
        return stamp

    def _in_world(self, frame: str, stamp: float, position: Array, orientation: Array) -> Pose:
        """A pose of a frame in the frame of plans."""
        origin, turn = self.transforms.pose(frame, stamp)
        moved = origin + lie.quaternion_to_rotation(turn) @ position - self._down
        return moved, np.asarray(lie.quaternion_multiply(turn, orientation))

    def _read_detections(self, message: Any, stamp: float) -> None:
        found = [
            Detection(d.name, d.half, *self._in_world(message.header.frame_id, stamp, d.position, d.orientation))
            for d in read_detections(message)
        ]
        with self._lock:
            self._tracks.update(stamp, found)
            self._place_objects()

    def _place_objects(self) -> None:
        origin, there = self._origin(), set()
        for name, track in self._tracks:
            there.add(DETECTIONS + name)
            self._world.set(
                DETECTIONS + name, track.detection.shape, position=track.detection.position,
                orientation=track.detection.orientation, velocity=track.velocity, std=self._settings.obstacles.std,
                seen=track.stamp - origin,
            )  # fmt: skip
        for name in self._world.names:
            if name.startswith(DETECTIONS) and name not in there:
                self._world.remove(name)

    def _read_grid(self, message: Any, stamp: float) -> None:
        own, frame = self._settings.obstacles, message.header.frame_id
        shape, *pose = read_occupancy(message, own.occupied, own.unknown == "occupied", own.height)
        within: Pose = pose[0], pose[1]
        position, orientation = self._in_world(frame, stamp, *within)
        with self._lock:
            self._world.set(GRID, shape, position=position, orientation=orientation)
            self._grid = None if self.transforms.carried(frame) else (frame, within, (position, orientation))

    def _read_points(self, message: Any, stamp: float) -> None:
        seen = self._adapter.snapshot()
        if seen is None:
            raise InputError("the robot's state is not known yet")
        points, own = read_points(message), self._settings.obstacles
        if self._mapped > self._stamp() + own.max_age:  # the clock went back: no points can be as far ahead
            self._map, self._mapped = None, -np.inf
        if stamp < self._mapped:
            raise InputError(f"the message is {self._mapped - stamp:.3g} s older than the last one")
        position, orientation = self._in_world(message.header.frame_id, stamp, np.zeros(3), np.array([1.0, 0, 0, 0]))
        if self._map is None:
            self._map = LocalMap(self._adapter.robot, cell=own.cell, reach=own.reach)
        cloud = position + points @ lie.quaternion_to_rotation(orientation).T
        self._map.add(cloud, position, stamp, seen[1])
        self._mapped = stamp
        self._world.set(POINTS, self._map.grid(stamp))

    # ------------------------------------------------------------------ by the node's own thread
    def update(self) -> None:
        """Where the base is, and where the grid's frame has moved."""
        if not self._topics:
            return
        estimate = self._adapter.estimate()
        if estimate is not None:
            self.transforms.note_base(self._stamp(), estimate.position, estimate.orientation)
        with self._lock:
            self._grid_lost = self._follow_grid() if self._grid is not None else ""

    def _follow_grid(self) -> str:
        """Put the grid where its frame is now; why that is not known."""
        assert self._grid is not None
        frame, within, (was, turned) = self._grid
        try:
            position, orientation = self._in_world(frame, self._stamp(), *within)
        except InputError as error:
            return f"{self._settings.topics.occupancy_grid}: {error_message(error)}"
        if np.abs(position - was).max() > MOVED or 1.0 - abs(float(orientation @ turned)) > 0.125 * MOVED**2:
            self._world.move(GRID, position, orientation)
            self._grid = frame, within, (position, orientation)
        return ""

    def begin(self) -> None:
        """The plan's time restarts."""
        if self._topics:
            with self._lock:
                self._place_objects()

    def lost(self) -> str:
        """Why it is not known what stands around; empty if it is."""
        for topic in self._topics:
            why = f" ({topic.fault})" if topic.fault else ""
            if topic.good == -np.inf:
                return topic.fault or f"no obstacles on {topic.name} yet"
            age = self._steady() - topic.good
            if topic.max_age is not None and age > topic.max_age:
                return f"the obstacles on {topic.name} are {age:.2f} s old, the limit is {topic.max_age:g} s{why}"
        return self._grid_lost if self._topics else ""

    @property
    def fault(self) -> str:
        """What is wrong with the messages that come; empty if nothing is."""
        return next((f for t in self._topics for f in (t.fault, t.source.conflict) if f), "")

    def close(self) -> None:
        """End the thread, after what it does now."""
        if self._topics:
            self._pool.shutdown(cancel_futures=True)
