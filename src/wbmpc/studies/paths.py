"""Reference paths of studies: a sine followed at constant speed, the way from a robot's home to a path's start."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.tasks.paths import rise, risen

#: Largest speeds of an approach [m/s] and [rad/s], and how far apart [m, rad] poses may be without one.
APPROACH_SPEED, APPROACH_RATE, CLOSE = 0.2, 0.4, 1e-3


@dataclass(frozen=True)
class SinePath:
    """A sine of ``amplitude`` [m] over ``length`` [m] with ``periods``, run with ``speed`` [m/s] along its arc.

    The speed rises and falls over ``ramp`` [s] by a cosine; the motion starts at ``start`` [s].
    """

    amplitude: float
    length: float
    periods: float
    speed: float
    start: float
    ramp: float

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = np.linspace(0.0, self.length, 40001)
        y = self.amplitude * np.sin(2.0 * np.pi * self.periods * x / self.length)
        return np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))]), x, y

    @property
    def arc_length(self) -> float:
        """Length along the path [m]."""
        return float(self._table[0][-1])

    @property
    def end(self) -> float:
        """When the motion ends [s]."""
        return self.start + self.arc_length / self.speed + self.ramp

    def arc(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Arc length [m] and its rate [m/s] at times t [s]."""
        t = np.asarray(t, float) - self.start
        late = t - self.arc_length / self.speed
        return self.speed * (risen(t, self.ramp) - risen(late, self.ramp)), self.speed * (
            rise(t, self.ramp) - rise(late, self.ramp)
        )

    def point(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates along and across [m] at times t [s]."""
        s, _ = self.arc(t)
        lengths, x, y = self._table
        return np.interp(s, lengths, x), np.interp(s, lengths, y)

    def curve(self) -> tuple[np.ndarray, np.ndarray]:
        """The path itself, finely sampled: along and across [m]."""
        return self._table[1], self._table[2]


@dataclass(frozen=True)
class Approach:
    """From an end effector pose (position (3) [m], quaternion (4)) to another along a straight line, smoothly, from time 0 on.

    ``duration`` [s]: as long as the largest speeds ask for; 0 where the poses are the same.
    """

    start: tuple[np.ndarray, np.ndarray]
    goal: tuple[np.ndarray, np.ndarray]

    @cached_property
    def duration(self) -> float:
        """How long the approach takes [s]; a cosine's largest speed is π / 2 times its mean."""
        way = float(np.linalg.norm(self.start[0] - self.goal[0]))
        angle = 2.0 * float(np.arccos(min(abs(self.start[1] @ self.goal[1]), 1.0)))
        if way < CLOSE and angle < CLOSE:
            return 0.0
        return 0.5 * np.pi * max(way / APPROACH_SPEED, angle / APPROACH_RATE)

    def offset(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """What is left of the way at times t [s]: offsets (n, 3) [m] from the goal, quaternions (n, 4) there."""
        t = np.atleast_1d(np.asarray(t, float))
        left = 1.0 - rise(t, self.duration) if self.duration > 0.0 else 0.0 * t
        turns = [lie.slerp(self.goal[1], self.start[1], a) for a in left]
        return left[:, None] * (self.start[0] - self.goal[0]), np.array(turns)
