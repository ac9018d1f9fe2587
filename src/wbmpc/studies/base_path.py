"""Reference motions of a mobile base: body twists over time, integrated to poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.tasks.paths import rise

#: Step [s] of the table that a path is kept in.
STEP = 0.01


@dataclass(frozen=True)
class Segment:
    """A motion: body twist ``(vx, vy, wz)`` [m/s, rad/s] at full speed, for ``duration`` [s] with its ramps."""

    twist: tuple[float, float, float]
    duration: float


@dataclass(frozen=True)
class BasePath:
    """Poses (n, 3) and body twists (n, 3) at ``times`` (n,) every :data:`STEP`; before and after them they hold (at rest)."""

    times: np.ndarray
    twists: np.ndarray
    poses: np.ndarray

    @classmethod
    def of(cls, twists: np.ndarray) -> BasePath:
        """From body twists (n, 3) every :data:`STEP`, integrated exactly from the origin."""
        poses = [np.zeros(3)]
        for middle in 0.5 * (twists[:-1] + twists[1:]):
            poses.append(lie.se2_step(poses[-1], middle * STEP))
        return cls(STEP * np.arange(len(twists)), twists, np.array(poses))

    def _at(self, t: ArrayLike, values: np.ndarray) -> np.ndarray:
        t = np.asarray(t, float)
        return np.stack([np.interp(t, self.times, values[:, i]) for i in range(3)], axis=-1)

    def pose(self, t: ArrayLike) -> np.ndarray:
        """Poses (..., 3) at times [s]; yaw is not wrapped."""
        return self._at(t, self.poses)

    def twist(self, t: ArrayLike) -> np.ndarray:
        """Body twists (..., 3) at times [s]; zero after the end."""
        t = np.asarray(t, float)
        return np.where((t > self.times[-1])[..., None], 0.0, self._at(t, self.twists))


def in_turn(
    segments: list[Segment], start: float, pause: float, ramp: float
) -> tuple[BasePath, list[tuple[float, float]]]:
    """Segments from rest to rest, one after another, ``pause`` [s] between them: the path, and the segments' times [s]."""
    end, spans = start, []
    for s in segments:
        spans.append((end, end + s.duration))
        end += s.duration + pause
    t = STEP * np.arange(round(end / STEP) + 1)
    twists = np.zeros((t.size, 3))
    for s, (first, last) in zip(segments, spans, strict=True):
        share = rise(t - first, ramp) - rise(t - (last - ramp), ramp)
        twists += share[:, None] * np.array(s.twist)
    return BasePath.of(twists), spans


def random_twists(duration: float, speed: float, rate: float, seed: int) -> BasePath:
    """Body twists that change every 2 to 6 s: a direction and a speed up to ``speed`` [m/s], a yaw rate up to ``rate`` [rad/s].

    In one case of five the base shall stand instead. Starts and ends at rest.
    """
    ramp, rests = 1.0, 0.2
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(round(duration / STEP) + 1)
    twists, previous, when = np.zeros((t.size, 3)), np.zeros(3), 0.5
    while when < duration - ramp - 1.0:
        angle, v = rng.uniform(-np.pi, np.pi), speed * rng.uniform(0.2, 1.0)
        target = np.array([v * np.cos(angle), v * np.sin(angle), rate * rng.uniform(-1.0, 1.0)])
        target = np.zeros(3) if rng.uniform() < rests else target
        twists += rise(t - when, ramp)[:, None] * (target - previous)
        previous, when = target, when + ramp + rng.uniform(1.0, 5.0)
    twists -= rise(t - (duration - ramp - 0.5), ramp)[:, None] * previous
    return BasePath.of(twists)
