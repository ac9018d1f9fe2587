"""An inertial unit's messages that cannot be true: beyond its range, the same ones again and again, far from the one before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.bases.base import InertialDescription

Array = NDArray[np.float64]
#: A gyro or an accelerometer whose three numbers were the same to the bit so often in a row, and for so long [s], has stopped:
#: noise forbids it. (A few repeats are a unit that is slower than the encoders.)
REPEATS, STANDS = 10, 0.025
#: Share of its range from which on a reading is no measurement.
FULL = 0.999
#: More than this [rad/s], [m/s²] from one message to the next is a jump: beyond hits that are true. (Pushes of 200 N: 0.07 and 8;
#: the ball runs onto cables of 5 mm: 0.24 and 70.)
JUMP = (1.0, 90.0)
#: What the rates [rad/s] and forces [m/s²] of a message that does not count may differ by from those of the last good one.
UNKNOWN = (1.0, 20.0)


class InertialGate:
    """Judges the messages of a ``unit``; ``last`` (2, 3): gyro [rad/s] and accelerometer [m/s²] of the last one that counted."""

    def __init__(self, unit: InertialDescription, rest: Array) -> None:
        """``rest`` (3) [m/s²]: what the accelerometer reads before the first message."""
        self._full = FULL * unit.rate, FULL * unit.acceleration
        self.last = np.stack([np.zeros(3), rest])
        self._given: list[list[float]] | None = None
        self._counted = self._jumped = False
        self._same, self._for = [0, 0], [0.0, 0.0]

    def judge(self, h: float, message: Array) -> str:
        """What is wrong with a message (2, 3), ``h`` [s] after the one before: it ``exceeds`` the range, or ``repeats`` itself;
        empty if nothing is."""
        given, before = message.tolist(), self._given
        self._given = given
        exceeds = stands = False
        for k, (row, full) in enumerate(zip(given, self._full, strict=True)):
            same = before is not None and row == before[k]
            self._same[k] = self._same[k] + 1 if same else 0
            self._for[k] = self._for[k] + h if same else 0.0
            exceeds |= max(map(abs, row)) >= full  # units that are at their end say just that
            stands |= self._same[k] >= REPEATS and self._for[k] >= STANDS - 1e-9
        return "exceeds" if exceeds else "repeats" if stands else ""

    def jumps(self, message: Array) -> bool:
        """Whether a message (2, 3) is farther from the last one that counted than a robot on its wheels can get it."""
        if not self._counted:
            return False
        # (written out: generators over six numbers cost several times as much, at every message)
        (a, b, c), (d, e, f) = message.tolist()
        (x, y, z), (u, v, w) = self.last.tolist()
        turn, push = JUMP
        return bool(max(abs(a - x), abs(b - y), abs(c - z)) > turn or max(abs(d - u), abs(e - v), abs(f - w)) > push)

    def persists(self, message: Array) -> bool:
        """Whether what jumped is still there: no more needs to contradict it."""
        return self._jumped and self.jumps(message)

    def accept(self, message: Array) -> None:
        """A message (2, 3) counts."""
        self.last, self._counted, self._jumped = message, True, False

    def reject(self) -> None:
        """A message that jumps does not count."""
        self._jumped = True

    def reset(self) -> None:
        """After a gap the next message may be any: it is no jump."""
        self._given, self._counted, self._jumped = None, False, False
