"""The last seconds of a run's numbers, for plots: by the run's own time, so that slow or paused runs keep what was before."""

from __future__ import annotations

from collections import deque

import numpy as np

Array = np.ndarray
#: Seconds of the run that are kept, and samples in them.
SPAN, SAMPLES = 20.0, 300


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
