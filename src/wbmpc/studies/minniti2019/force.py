"""A force sensor in the end effector: zeroed while nothing touches; not believed if it stands still, or contradicts the robot's motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.ball.inertial_gate_step import REPEATS, STANDS
from wbmpc.checks import finite, numbers, positive_time
from wbmpc.control.monitor import SimpleFault
from wbmpc.errors import InputError

#: Sensor and motion contradict each other by more than this [N], for so long [s], and the sensor is wrong. (What the motion says
#: of a free end effector on its way is 1.3 N at most; the end effector's pull at its place beyond a panel, where no force is planned, is 5 N.)
MAX_MISMATCH, MISMATCH_TIME = 3.0, 0.3
#: A message farther than this [N] from the one before does not count; the next one does, whatever it says: a hit counts one
#: message later.
JUMP = 30.0
#: A touch that has lasted so long [s] is none if the motion says less than this share of its force, both averaged over the last
#: of these times [s]. (A zero that moves by more than a touch's threshold would send the end effector against a panel that is not there
#: yet; sound touches: 0.55 or more, at 8 to 60 N.)
CONFIRMED, SHARE, MEAN_TIME = 0.15, 0.4, 0.1
#: What a sensor reads at rest is averaged over this time [s]. It is left as it is up to the first of these [N], what an ordinary
#: zeroing leaves (0.1 N for each axis); beyond the second the sensor is broken, or something touches it: it is not believed.
ZERO_TIME, ZERO_LEFT, MAX_ZERO = 0.3, 0.3, 5.0


class ForceReadings(NamedTuple):
    """At ``time`` [s], after another ``interval`` [s] in which the sensor ``measured`` a push [N] and the motion ``estimated`` one; of an end
    effector that is not ``touching`` it only counts that the motion says it is pushed."""

    time: float
    interval: float
    touching: bool
    measured: float
    estimated: float


class ForceMonitor:
    """Judges a sensor's messages. ``fault``: why it is not believed any more, for good; empty while it is. ``zero`` (3) [N]: what
    it reads without a force, in its own axes."""

    def __init__(self) -> None:
        self.fault, self.zero = "", np.zeros(3)
        self._at_rest, self._rested = np.zeros(3), 0.0  # the mean [N], and over how long [s]
        self._last: Array | None = None
        self._jumped = False
        self._same, self._for, self._apart, self._touched = 0, 0.0, 0.0, 0.0
        self._pushes = np.zeros(2)  # measured and estimated while the end effector touches, averaged [N]

    def judge(self, h: float, force: ArrayLike) -> Array:
        """The force (3) [N] that counts after a message, ``h`` [s] after the one before.

        One that is not finite is none, and so is the first that jumps (:data:`JUMP`): the one before counts. None, or the same to
        the bit, :data:`REPEATS` times in a row and for :data:`STANDS`: the sensor has stopped, for noise forbids that. Zero once
        there is a ``fault``. Raises :class:`InputError` for another number of numbers."""
        positive_time("force sensor", h)
        measured = np.array(force, float)
        if measured.shape != (3,):
            raise InputError(f"force sensor: 'force' needs 3 numbers, got {measured}")
        if self.fault:
            return np.zeros(3)
        previous, new = self._last, bool(np.isfinite(measured).all())
        again = not new or (previous is not None and np.array_equal(measured, previous))
        self._same, self._for = (self._same + 1, self._for + h) if again else (0, 0.0)
        self._jumped = bool(
            new and previous is not None and not self._jumped and np.linalg.norm(measured - previous) > JUMP
        )
        if new and not self._jumped:
            self._last = measured
        if self._same >= REPEATS and self._for >= STANDS - 1e-9:
            what = "gives the same numbers again and again" if new else "gives no finite numbers"
            self.fault = f"the force sensor {what}"
        return np.zeros(3) if self.fault or self._last is None else self._last - self.zero

    def rest(self, h: float, force: ArrayLike) -> None:
        """Nothing touches, and the sensor reads a ``force`` (3) [N] beside what it carries, ``h`` [s] after the one before."""
        positive_time("force sensor", h)
        self._rested = min(self._rested + h, max(ZERO_TIME, h))
        self._at_rest = self._at_rest + h / self._rested * (numbers("force sensor", "force", force, 3) - self._at_rest)

    def tare(self) -> str:
        """From now on something may touch: what was read at rest is the zero, or the reason of a ``fault``, which is returned."""
        size, self._rested = float(np.linalg.norm(self._at_rest)), 0.0
        if size > MAX_ZERO:
            self.fault = self.fault or f"the force sensor reads {size:.1f} N where nothing touches"
        elif size > ZERO_LEFT:
            self.zero = self.zero + self._at_rest
        self._at_rest = np.zeros(3)
        return self.fault

    def update(self, readings: ForceReadings, /) -> list[SimpleFault]:
        """What is new."""
        known = self.fault
        self._compare(*readings[1:])
        return [SimpleFault(readings.time, self.fault)] if self.fault and not known else []

    def _compare(self, h: float, touching: bool, measured: float, estimated: float) -> None:
        finite("force sensor", measured=measured, estimated=estimated)
        apart = abs(measured - estimated) > MAX_MISMATCH if touching else estimated > MAX_MISMATCH
        self._apart = self._apart + h if apart else 0.0
        if self.fault:
            return
        if self._unconfirmed(h, touching, measured, estimated):
            self.fault = f"the force sensor reports a touch of {measured:.1f} N that the robot's motion does not show"
        elif self._apart >= MISMATCH_TIME - 1e-9:
            self.fault = (
                f"the force sensor measures {measured:.1f} N, the robot's motion shows {estimated:.1f} N"
                if touching
                else f"the end effector is pushed by {estimated:.1f} N that the force sensor does not measure"
            )

    def _unconfirmed(self, h: float, touching: bool, measured: float, estimated: float) -> bool:
        """Whether a touch has lasted that the motion hardly shows."""
        pushes = np.array([measured, estimated]) if touching else np.zeros(2)
        self._pushes = self._pushes + (1.0 - np.exp(-h / MEAN_TIME)) * (pushes - self._pushes)
        self._touched = self._touched + h if touching else 0.0
        return bool(self._touched >= CONFIRMED - 1e-9 and self._pushes[1] < SHARE * self._pushes[0])
