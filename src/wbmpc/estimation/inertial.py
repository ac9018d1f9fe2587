"""An inertial unit's messages that cannot be true: beyond its range, the same ones again and again, far from the one before."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wbmpc.bases.base import InertialDescription
from wbmpc.estimation.inertial_gate_step import Gate, judge
from wbmpc.kernel.step import Backend, bind

Array = NDArray[np.float64]
#: Share of its range from which on a reading is no measurement.
FULL = 0.999
#: What the rates [rad/s] and forces [m/s²] of a message that does not count may differ by from those of the last good one.
UNKNOWN = (1.0, 20.0)
#: Faults of a message, in the order of the step's codes.
_FAULTS = ("", "exceeds", "repeats")


class Assessment(NamedTuple):
    """Of a message: its ``fault`` (it ``exceeds`` the range, or ``repeats`` itself; empty if nothing is wrong); whether it ``jumps``: is
    farther from the last one that counted than a robot on its wheels can get it; how far it is from that, squared: ``turned``
    [rad²/s²], ``pushed`` [m²/s⁴]."""

    fault: str
    jumps: bool
    turned: float
    pushed: float


class InertialGate:
    """Judges the messages of a ``unit``; ``message`` (6) is the present one: gyro [rad/s], accelerometer [m/s²]; ``last`` (6): the last one
    that counted. ``backend``: machine code, or the same source as ordinary Python."""

    def __init__(self, unit: InertialDescription, rest: Array, backend: Backend = "compiled") -> None:
        """``rest`` (3) [m/s²]: what the accelerometer reads before the first message."""
        self.message, self.last, self._gate = np.zeros(6), np.concatenate([np.zeros(3), rest]), np.zeros(Gate.FULL + 2)
        self._gate[Gate.FULL :] = FULL * unit.rate, FULL * unit.acceleration
        arrays = {"message": self.message, "last": self.last, "gate": self._gate, "given": np.zeros(6)}
        self._judge = bind(judge, arrays, backend)

    def judge(self, h: float) -> Assessment:
        """What the ``message`` is, ``h`` [s] after the one before."""
        code, jumps, turned, pushed = self._judge(h)
        return Assessment(_FAULTS[code], jumps, turned, pushed)

    def persists(self, assessment: Assessment) -> bool:
        """Whether what jumped is still there: no more needs to contradict it."""
        return assessment.jumps and bool(self._gate[Gate.JUMPED])

    def accept(self) -> None:
        """The message counts."""
        self.last[:] = self.message
        self._gate[Gate.COUNTED], self._gate[Gate.JUMPED] = 1.0, 0.0

    def reject(self) -> None:
        """A message that jumps does not count."""
        self._gate[Gate.JUMPED] = 1.0

    def reset(self) -> None:
        """After a gap the next message may be any: it is no jump."""
        self._gate[: Gate.SAME] = 0.0
