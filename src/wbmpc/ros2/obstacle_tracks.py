"""Detected objects over several messages: which one is which, how fast it moves, and when it is gone."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from wbmpc.arrays import Array
from wbmpc.ros2.obstacle_messages import Detection

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
