"""Reference paths: a sine followed at constant speed, smooth ramps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike


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
        return self.speed * (_ramp(t, self.ramp) - _ramp(late, self.ramp)), self.speed * (
            _rise(t, self.ramp) - _rise(late, self.ramp)
        )

    def point(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates along and across [m] at times t [s]."""
        s, _ = self.arc(t)
        lengths, x, y = self._table
        return np.interp(s, lengths, x), np.interp(s, lengths, y)

    def curve(self) -> tuple[np.ndarray, np.ndarray]:
        """The path itself, finely sampled: along and across [m]."""
        return self._table[1], self._table[2]


def _rise(t: np.ndarray, length: float) -> np.ndarray:
    q = np.clip(t / length, 0.0, 1.0)
    return 0.5 * (1.0 - np.cos(np.pi * q))


def _ramp(t: np.ndarray, length: float) -> np.ndarray:
    """Integral of :func:`_rise`."""
    q = np.clip(t / length, 0.0, 1.0)
    return length * (0.5 * q - np.sin(np.pi * q) / (2.0 * np.pi)) + np.maximum(t - length, 0.0)


def nearest_distance(points: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """Distance (n,) [m] of points (n, 3) to a finely sampled curve (m, 3)."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(curve).query(points)[0])
