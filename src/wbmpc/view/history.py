"""The last seconds of a run's numbers, for plots: by the run's own time, so that slow or paused runs keep what was before."""

from __future__ import annotations

from collections import deque

import numpy as np

from wbmpc.arrays import Array

#: Over how long a real-time factor is taken, and at least [s].
WINDOW, MINIMUM = 1.0, 0.2
#: Seconds of the run that are kept, and samples in them.
SPAN, SAMPLES = 20.0, 300
#: Distance of a trail's points at first [m], and how many there are at most.
SPACING, POINTS = 0.005, 200


class Factor:
    """How fast a run goes against the clock: the real-time factor over the last :data:`WINDOW` seconds."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, float]] = deque()

    def reset(self) -> None:
        """The run stood, or restarts: what was before does not count."""
        self._points.clear()

    def add(self, clock: float, t: float) -> float:
        """The run is at ``t`` [s] when the clock is at ``clock`` [s]; nan until there is something to compare with."""
        if not (np.isfinite(clock) and np.isfinite(t)) or (self._points and (clock, t) < self._points[-1]):
            self._points.clear()
        if np.isfinite(clock) and np.isfinite(t):
            self._points.append((clock, t))
        while len(self._points) > 2 and self._points[1][0] < clock - WINDOW:
            self._points.popleft()
        if len(self._points) < 2 or clock - self._points[0][0] < MINIMUM:
            return float("nan")
        return (t - self._points[0][1]) / (clock - self._points[0][0])


class Trail:
    """The way of a point: places at least :data:`SPACING` [m] apart; where there are more than :data:`POINTS`, every other one is
    dropped and the spacing doubles."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Another run begins."""
        self._points: list[Array] = []
        self._spacing = SPACING

    def add(self, point: Array) -> Array:
        """Add a place (3) [m]; returns all (n, 3), the newest last."""
        if not np.isfinite(point).all():
            return np.array(self._points).reshape(-1, 3)
        if not self._points or np.linalg.norm(point - self._points[-1]) >= self._spacing:
            self._points.append(point.copy())
        if len(self._points) > POINTS:
            self._points, self._spacing = self._points[::2], 2.0 * self._spacing
        return np.array([*self._points, point])


class History:
    """Rows of numbers, the first of which is the time [s]. Of rows within one sample's time the largest numbers are kept: a
    plot that leaves out peaks would show a better run."""

    def __init__(self) -> None:
        self._rows: deque[Array] = deque()

    def add(self, row: Array) -> None:
        """Add a row (n); one that is earlier than the last begins another run."""
        if self._rows and row[0] < self._rows[-1][0]:
            self._rows.clear()
        if self._rows and row[0] < self._rows[-1][0] + SPAN / SAMPLES:
            self._rows[-1][1:] = np.fmax(self._rows[-1][1:], row[1:])
        else:
            self._rows.append(row.copy())
        while self._rows[0][0] < row[0] - SPAN:
            self._rows.popleft()

    @property
    def rows(self) -> Array:
        """All rows (at most SAMPLES + 1, n)."""
        return np.array(self._rows)
