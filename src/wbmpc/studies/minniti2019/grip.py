"""How much friction there is between an end effector and what it pushes, as far as pushing shows it."""

from __future__ import annotations

import numpy as np

from wbmpc.checks import finite, positive_time
from wbmpc.errors import InputError

#: Below this push [N] a ratio of forces says nothing; forces are averaged over this time [s].
PUSHED, MEAN_TIME = 4.0, 0.02
#: What the ratio may be off by, for the direction of the normal is known to about 0.05 rad; of what is measured this share is planned with.
UNSURE, KEPT = 0.05, 0.9
#: An end effector slides that is faster along the surface than this [m/s] for this time [s]; so long [s] without that, and what it
#: bears holds.
SLIDES, SLIDING_TIME, BORNE_TIME = 0.03, 0.010, 0.10


class GripMonitor:
    """A bound of the friction coefficient, from below. ``bound``: at first ``least``, what any surface is trusted to have; more as soon as
    the end effector has borne more without sliding, by the ratio of the forces across and along the normal; less where it slides,
    whose ratio is the coefficient. ``slips``: how often it has slid."""

    def __init__(self, least: float) -> None:
        if not least > 0.0:
            raise InputError(f"grip: least must be positive, got {least}")
        self.bound, self.slips, self.sliding = least, 0, False
        self._mean = np.zeros(2)  # push and force across it [N]
        self._fast = self._still = 0.0  # how long [s]

    def update(self, h: float, push: float, across: float, speed: float) -> bool:
        """Whether it slides, after another ``h`` [s] with a ``push`` [N] along the normal, a force ``across`` it [N] and a ``speed`` [m/s]
        along the surface."""
        positive_time("grip", h)
        finite("grip", push=push, across=across, speed=speed)
        if push < PUSHED:
            self._mean, self._fast, self._still, self.sliding = np.zeros(2), 0.0, 0.0, False
            return False
        forces = np.array([push, across])
        self._mean = forces if not self._mean[0] else self._mean + (1.0 - np.exp(-h / MEAN_TIME)) * (forces - self._mean)
        ratio, fast = float(self._mean[1] / self._mean[0]), speed > SLIDES
        self._fast, self._still = (self._fast + h, 0.0) if fast else (0.0, self._still + h)
        slid, self.sliding = self.sliding, self._fast >= SLIDING_TIME - 1e-9
        if self.sliding:
            self.slips += not slid
            self.bound = min(self.bound, KEPT * ratio)
        elif self._still >= BORNE_TIME:
            self.bound = max(self.bound, KEPT * (ratio - UNSURE))
        return self.sliding
