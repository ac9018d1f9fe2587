"""How much friction there is between an end effector and what it pushes, as far as pushing shows it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.checks import finite, numbers, positive, positive_time

#: Below this push [N] a ratio of forces says nothing; forces and speeds are averaged over these times [s]: what encoders and gyroscopes say
#: of the speed of a tip that stands has a deviation of 0.04 m/s, and is 0.02 m/s at most after that.
PUSHED, MEAN_TIME, SPEED_TIME = 4.0, 0.02, 0.05
#: What the ratio may be off by, for the direction of the normal is known to about 0.05 rad; of what is measured this share is planned with.
UNSURE, KEPT = 0.05, 0.9
#: An end effector slides that is faster along the surface than this [m/s]; so long [s] without that, and what it bears holds.
SLIDES, BORNE_TIME = 0.03, 0.10


class GripEstimator:
    """A bound of the friction coefficient, from below. ``bound``: at first ``least``, what any surface is trusted to have; more as soon as
    the end effector has borne more without sliding, by the ratio of the forces across and along the normal; less, but not less than that,
    where it slides, whose ratio is the coefficient. ``slips``: how often it has slid."""

    def __init__(self, least: float) -> None:
        positive("grip", least=least)
        self.least, self.bound, self.slips, self.sliding = least, least, 0, False
        self._forces = np.zeros(2)  # push and force across it [N]
        self._velocity = np.zeros(2)  # along the surface [m/s]
        self._still = 0.0  # how long [s]

    def update(self, h: float, push: float, across: float, velocity: ArrayLike) -> bool:
        """Whether it slides, after another ``h`` [s] with a ``push`` [N] along the normal, a force ``across`` it [N] and a ``velocity`` (2) [m/s]
        along the surface."""
        positive_time("grip", h)
        finite("grip", push=push, across=across)
        speed = numbers("grip", "velocity", velocity, 2)
        if push < PUSHED:
            self._forces, self._velocity, self._still, self.sliding = np.zeros(2), np.zeros(2), 0.0, False
            return False
        mean = lambda time, old, new: old + (1.0 - np.exp(-h / time)) * (new - old)
        self._forces = mean(MEAN_TIME if self._forces[0] else 1e-9, self._forces, np.array([push, across]))
        self._velocity = mean(SPEED_TIME, self._velocity, speed)
        ratio, slid = float(self._forces[1] / self._forces[0]), self.sliding
        self.sliding = bool(np.linalg.norm(self._velocity) > SLIDES)
        self._still = 0.0 if self.sliding else self._still + h
        if self.sliding:
            self.slips += not slid
            self.bound = max(min(self.bound, KEPT * ratio), self.least)
        elif self._still >= BORNE_TIME:
            self.bound = max(self.bound, KEPT * (ratio - UNSURE))
        return self.sliding
