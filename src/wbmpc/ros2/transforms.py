"""Poses of frames from /tf and /tf_static, for messages that are in a frame of their own."""

from __future__ import annotations

import logging
import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError, unknown_name
from wbmpc.logs import RateLimit
from wbmpc.ros2.bus import SMALL, Node, Qos
from wbmpc.ros2.convert import error_message, seconds
from wbmpc.ros2.obstacle_messages import read_transform
from wbmpc.ros2.sources import Source

_LOG = logging.getLogger("wbmpc")
Pose = tuple[Array, Array]
TF, KIND = "/tf", "tf2_msgs/msg/TFMessage"
#: Frames that are known at most, and how many are between a frame and the root of its tree.
MAX_FRAMES, MAX_DEPTH = 1000, 50
#: Transforms of a frame that are kept, and for how long [s] the last one holds.
KEPT, LASTS = 200, 2.0
#: Of /tf many messages may come at once; those of /tf_static are sent again to who comes later.
MOVING, FIXED = Qos(reliable=False, depth=100), Qos(latched=True, depth=100)


@dataclass
class _Frame:
    """``seen``: stamp [s], pose in the parent; ``at``: when the last one came [s]; of a fixed one infinite; ``source``: its publisher."""

    parent: str
    seen: deque[tuple[float, Pose]]
    at: float
    source: Source | None = None

    def pose(self, stamp: float) -> Pose:
        """The one whose stamp is nearest."""
        stamps = [s for s, _ in self.seen]
        k = bisect_left(stamps, stamp)
        near = [i for i in (k - 1, k) if 0 <= i < len(stamps)]
        return self.seen[min(near, key=lambda i: abs(stamps[i] - stamp))][1]


class Transforms:
    """Where frames are in ``world``. ``base`` moves in it as :meth:`note_base` says, whatever is on /tf; ``now()`` [s]: by which
    transforms grow old."""

    def __init__(self, node: Node, world: str, base: str, now: Callable[[], float]) -> None:
        self._world, self._base, self._now = world, base, now
        self._frames: dict[str, _Frame] = {}
        self._owned: dict[Source | None, dict[str, None]] = {}  # names by publisher, in the order of their last use
        self._forgot = -np.inf  # when old ones last were [s]
        self._lock, self._limit = threading.Lock(), RateLimit()
        # not in the thread that brings joint states: a message of many frames takes longer than a period of these
        listen = partial(node.subscribe, kind=KIND, deferred=True, largest=SMALL, sourced=True)
        listen(TF, callback=lambda m, source=None: self.take(m, False, source), qos=MOVING)
        listen("/tf_static", callback=lambda m, source=None: self.take(m, True, source), qos=FIXED)

    def take(self, message: Any, fixed: bool, source: Source | None = None) -> None:
        """A tf2_msgs/TFMessage of a publisher; transforms that cannot be meant are left out."""
        for one in message.transforms:
            try:
                parent, child, *pose = read_transform(one)
                if child != self._base:
                    self._put(parent, child, seconds(one.header.stamp), (pose[0], pose[1]), fixed, source)
            except InputError as error:
                self._limit.log(_LOG, logging.ERROR, "tf", f"/tf: {error_message(error)}")

    def note_base(self, stamp: float, position: Array, orientation: Array) -> None:
        """The base's pose in the world at ``stamp`` [s]."""
        self._put(self._world, self._base, stamp, (position, orientation), False)

    def _put(
        self, parent: str, child: str, stamp: float, pose: Pose, fixed: bool, source: Source | None = None
    ) -> None:
        with self._lock:
            if child not in self._frames and child != self._base and len(self._frames) >= MAX_FRAMES:
                self._forget_old()
                if len(self._frames) >= MAX_FRAMES:
                    self._make_room()
            frame = self._frames.get(child)
            if fixed or frame is None or frame.parent != parent or stamp < frame.seen[-1][0]:  # or time went back
                if frame is not None:
                    self._own(child, frame.source, False)
                frame = self._frames[child] = _Frame(parent, deque(maxlen=KEPT), 0.0, source)
            frame.seen.append((stamp, pose))
            self._own(child, frame.source)
            frame.at = np.inf if fixed else self._now()

    def _forget_old(self) -> None:
        """Frames that have not come for :data:`LASTS`: what a flood brought makes room again. Not more often than that."""
        now = self._now()
        if abs(now - self._forgot) > LASTS:
            self._forgot = now
            for name in [n for n, f in self._frames.items() if now - f.at > LASTS and n != self._base]:
                self._own(name, self._frames.pop(name).source, False)

    def _own(self, name: str, source: Source | None, owned: bool = True) -> None:
        """A frame is its publisher's, and the one that is of use, or no longer."""
        names = self._owned.setdefault(source, {})
        names.pop(name, None)
        if owned and name != self._base:
            names[name] = None
        if not names:
            del self._owned[source]

    def _make_room(self) -> None:
        """The publisher that has most of the frames loses the one that was neither sent nor asked for for longest: a node that makes up
        names takes no place of others', and fixed frames never grow old."""
        most = max(self._owned.values(), key=len)
        del self._frames[next(iter(most))], most[next(iter(most))]
        text = f"/tf: there are more than {MAX_FRAMES} frames; the oldest of the publisher that has most are forgotten"
        self._limit.log(_LOG, logging.ERROR, "room", text)

    def pose(self, name: str, stamp: float) -> Pose:
        """Position (3) [m] and orientation (4) of a frame in the world at ``stamp`` [s]. Raises :class:`InputError` where nothing leads
        there, or what leads there is old."""
        if name == self._world:
            return np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
        with self._lock:
            down, up = self._chain(name, stamp), self._chain(self._world, stamp)
            common = next((f for f in down if f in up), None)
            if common is None and name in self._frames:
                raise InputError(f"no transforms lead from '{self._world}' to the frame '{name}'")
            if common is None:
                raise unknown_name("frame", name, sorted({self._world, *self._frames})[:20])
            return _compose(_inverse(up[common]), down[common])

    def carried(self, name: str) -> bool:
        """Whether a frame moves with the base."""
        with self._lock:
            for _ in range(MAX_DEPTH):
                if name == self._base or name not in self._frames:
                    break
                name = self._frames[name].parent
        return name == self._base

    def _chain(self, name: str, stamp: float) -> dict[str, Pose]:
        """Pose of a frame in itself and in all frames above it."""
        found: dict[str, Pose] = {name: (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))}
        at = name
        while (frame := self._frames.get(at)) is not None and frame.parent not in found and len(found) < MAX_DEPTH:
            if self._now() - frame.at > LASTS:
                raise InputError(f"the transform from '{frame.parent}' to '{at}' has not come for {LASTS:g} s")
            self._own(at, frame.source)
            found[frame.parent] = _compose(frame.pose(stamp), found[at])
            at = frame.parent
        return found


def _compose(first: Pose, second: Pose) -> Pose:
    """``second`` in axes of ``first``."""
    position = first[0] + lie.quaternion_to_rotation(first[1]) @ second[0]
    return position, np.asarray(lie.quaternion_multiply(first[1], second[1]))


def _inverse(pose: Pose) -> Pose:
    q = np.asarray(lie.quaternion_conjugate(pose[1]))
    return -lie.quaternion_to_rotation(q) @ pose[0], q
