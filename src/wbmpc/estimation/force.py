"""A force sensor in the hand that cannot be believed: it stands still, or contradicts what the robot's motion says of the force."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.checks import finite, positive_time
from wbmpc.errors import InputError
from wbmpc.estimation.inertial import REPEATS, STANDS

Array = NDArray[np.float64]
#: Sensor and motion contradict each other by more than this [N], for so long [s], and the sensor is wrong. (What the motion says
#: of a free hand on its way is 1.3 N at most; the hand's pull at its place beyond a panel, where no force is planned, is 5 N.)
UNFELT, UNFELT_TIME = 3.0, 0.3


class ForceMonitor:
    """Judges a sensor's messages. ``fault``: why it is not believed any more, for good; empty while it is."""

    def __init__(self) -> None:
        self.fault = ""
        self._last: Array | None = None
        self._same, self._for, self._apart = 0, 0.0, 0.0

    def judge(self, h: float, force: ArrayLike) -> Array:
        """The force (3) [N] that counts after a message, ``h`` [s] after the one before.

        One that is not finite is none: the one before counts. None, or the same to the bit, :data:`REPEATS` times in a row and for
        :data:`STANDS`: the sensor has stopped, for noise forbids that. Zero once there is a ``fault``. Raises
        :class:`InputError` for another number of numbers."""
        positive_time("force sensor", h)
        given = np.array(force, float)
        if given.shape != (3,):
            raise InputError(f"force sensor: 'force' needs 3 numbers, got {given}")
        if self.fault:
            return np.zeros(3)
        before, new = self._last, bool(np.isfinite(given).all())
        again = not new or (before is not None and np.array_equal(given, before))
        self._same, self._for = (self._same + 1, self._for + h) if again else (0, 0.0)
        if new:
            self._last = given
        if self._same >= REPEATS and self._for >= STANDS - 1e-9:
            what = "gives the same numbers again and again" if new else "gives no finite numbers"
            self.fault = f"the force sensor {what}"
        return np.zeros(3) if self.fault or self._last is None else self._last

    def compare(self, h: float, touching: bool, felt: float, found: float) -> str:
        """The ``fault`` after another ``h`` [s] in which the sensor has ``felt`` a push [N] and the motion ``found`` one; of a
        hand that is not ``touching`` it must only be told that it is pushed."""
        finite("force sensor", felt=felt, found=found)
        apart = abs(felt - found) > UNFELT if touching else found > UNFELT
        self._apart = self._apart + h if apart else 0.0
        if not self.fault and self._apart >= UNFELT_TIME - 1e-9:
            self.fault = (
                f"the force sensor feels {felt:.1f} N, the robot's motion says {found:.1f} N"
                if touching
                else f"the hand is pushed by {found:.1f} N that the force sensor does not feel"
            )
        return self.fault
