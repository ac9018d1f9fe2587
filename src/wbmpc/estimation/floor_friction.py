"""How much friction there is between wheels and floor, from slips.

The floor gives a robot of mass m the acceleration a only by friction: m a ≤ μ m g, so a / g is never more than μ (Coulomb), and while
wheels slide it comes near to it. So what is felt bounds the coefficient from below, and what is felt at its most in a slip is the
coefficient. Of the robot it is the base whose acceleration is felt; what the arm does beside it is neglected.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import finite, not_negative, numbers, positive, positive_time
from wbmpc.constants import GRAVITY

Array = NDArray[np.float64]
_WHO = "floor friction"
#: Time [s] over which accelerations are averaged; speed [m/s] of a wheel against the base's at which it slides; for how long [s] it has to
#: before that counts, and to roll before a slip is over.
MEAN_TIME, SLIDES, SLIDES_FOR, OVER_AFTER = 0.05, 0.1, 0.02, 0.1
#: Of what is felt in a slip this share is planned with; least coefficient, that of ice; time [s] after a slip in which a share 1 - 1/e of
#: what was believed before comes back, for floors differ.
KEPT, LEAST, FORGETS = 0.9, 0.05, 30.0


class FloorFriction:
    """A coefficient of friction for plans. ``bound``: ``believed`` until wheels slide; then what the floor has given at its most in a slip,
    less as much as an estimate may be off. ``slips``: how often they have. Raises :class:`InputError` for a coefficient that is not
    positive."""

    def __init__(self, believed: float) -> None:
        positive(_WHO, believed=believed)
        self.believed = self.bound = float(believed)
        self.slips = 0
        self._felt = np.zeros(2)  # acceleration [m/s²], averaged
        self._sliding = self._rolling = 0.0  # for how long [s]
        self._most: float | None = None  # coefficient in the present slip

    def update(self, h: float, accel: Array, slip: float) -> bool:
        """Whether wheels slide, after another ``h`` [s] with the inertial unit's ``accel`` (3) [m/s²] in axes of the base and the fastest
        wheel's ``slip`` [m/s] against the base. Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be; nothing is
        taken in then."""
        positive_time(_WHO, h)
        finite(_WHO, slip=slip)
        not_negative(_WHO, slip=slip)
        felt = numbers(_WHO, "accel", accel, 3)[:2]
        self._felt += (1.0 - math.exp(-h / MEAN_TIME)) * (felt - self._felt)
        ratio = float(np.hypot(*self._felt)) / GRAVITY
        self._sliding = self._sliding + h if slip > SLIDES else 0.0
        self._rolling = 0.0 if slip > SLIDES else self._rolling + h
        if self._most is None and self._sliding >= SLIDES_FOR:
            self._most, self.slips = 0.0, self.slips + 1
        elif self._rolling >= OVER_AFTER:
            self._most = None
        if self._most is None:
            self.bound += (1.0 - math.exp(-h / FORGETS)) * (self.believed - self.bound)
            self.bound = max(self.bound, min(KEPT * ratio, self.believed))
            return False
        self._most = max(self._most, ratio)
        self.bound = max(min(self.bound, KEPT * self._most), LEAST)
        return True
