"""Encoders that repeat themselves while the gyro turns: they do not say that the base stands, nor that the gyro is off."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.arrays import Array

#: A gyro that says more than this [rad/s] turns, whatever its bias; one that has said less for so long [s] rests.
TURNS, RESTS = 0.2, 5.0
#: Messages farther apart than this [s] are a gap in time, and no repetition.
_APART = 0.1


class Counted(NamedTuple):
    """Whether a message counts, and the mean ``rate`` [rad/s] of the gyro since the last one that did; None: it says nothing."""

    counts: bool
    rate: float | None


class Repetition:
    """Holds messages back whose ``angles`` (n) of the wheels repeat themselves while the gyro turns. The next one that moves counts for
    the time of all of them; so does one by which the gyro has rested for :data:`RESTS`, for the wheels may have been blocked while others
    turned the base, but then the gyro says nothing: what it turned is no bias."""

    def __init__(self) -> None:
        self._angles: Array | None = None
        self.forget()

    def forget(self) -> None:
        """What is held back counts no more."""
        self.time = self._turned = -np.inf  # of the last message, and of the last turn beside angles that are held [s]
        self._turn, self._held = 0.0, False

    def move_clock(self, by: float) -> None:
        """The clock's zero moves [s]."""
        self.time, self._turned = self.time + by, self._turned + by

    def count(self, t: float, since: float, angles: Array, rate: float | None, bias: float = 0.0) -> Counted:
        """A message of time ``t`` [s], after one that counted at ``since``; ``rate`` [rad/s]: mean of the gyro since the last message, None
        without one; ``bias``: what is known of its own."""
        before, self.time = max(self.time, since), t
        turns, gap = rate is not None and abs(rate - bias) > TURNS, np.isfinite(before) and t - before > _APART
        same = not gap and (turns or self._held) and self._angles is not None and np.array_equal(angles, self._angles)
        if not same:
            self._angles = np.array(angles)
        if not (same or self._held):
            return Counted(True, rate)
        if rate is not None:
            self._turn += rate * (t - before)
        if turns:
            self._turned = t
        if same and rate is not None and t - self._turned < RESTS:
            self._held = True
            return Counted(False, None)
        mean = None if same or gap or rate is None else self._turn / (t - since)
        self._turn, self._held, self._turned = 0.0, False, -np.inf
        return Counted(True, mean)
