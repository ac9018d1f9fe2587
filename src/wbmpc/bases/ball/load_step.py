"""A mass that comes into the end effector, or leaves it, at once: felt by the arm within a tenth of a second.

The acceleration of the arm that the model does not explain, times its inertia, is a force; where that is the weight of a mass in all
joints alike, it is one. :mod:`wbmpc.bases.ball.payload` weighs more exactly, and takes seconds: meanwhile the arm would fall.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Gain [1/s] of the arm's speed under the model; of the mass [1/s]; masses [kg] from which on it counts, and until when.
SPEED_GAIN, MASS_GAIN, BEGINS, ENDS = 60.0, 40.0, 0.25, 0.05
#: A robot that has been calm for so long [s] feels a load that comes until so long after it [s]: in fast motions the model's errors
#: look like one.
CALM, AFTER = 0.3, 0.1
#: What counts as calm: see ``learning`` of the disturbance observer.
STILL = 0.7
#: Coordinates of ball and base, before those of the arm.
BASE = 5
#: Largest share of the force that may be no weight; least share of what moves the arm by the model: less may be an error of its inertia.
UNLIKE, UNEXPLAINED = 0.5, 0.5


class LoadStep:
    """``changing``: whether a mass is coming or going now."""

    def __init__(self) -> None:
        self._speed: Array | None = None
        self.changing = False
        self._calm, self._left = CALM, AFTER  # for how long [s] it has been, and will count as calm

    def update(
        self, velocity: Array, model: Array, inertia: Array, force: Array, weight: Array, learning: float, h: float
    ) -> tuple[float, float]:
        """By how much [kg] the mass changes over ``h`` [s], and which share of that is in the known ``force`` (nq) already.

        ``velocity`` (nq) as measured, ``model`` (nq) [.../s²]: the accelerations that the model explains; ``inertia`` (nq, nq); ``weight``
        (nq) of 1 kg; ``learning``: how calm the robot is, from 0 to 1.
        """
        speed = velocity.copy() if self._speed is None else self._speed
        apart = SPEED_GAIN * (velocity - speed)
        self._speed = speed + h * (model + apart)
        self._calm = self._calm + h if learning > STILL else 0.0
        self._left = AFTER if self._calm >= CALM else self._left - h
        own, by_kilogram, known = (inertia @ apart)[BASE:] + force[BASE:], weight[BASE:], force[BASE:]
        square = float(by_kilogram @ by_kilogram)
        if square == 0.0:
            return 0.0, 0.0
        mass = float(by_kilogram @ own) / square
        unlike = float(np.linalg.norm(own - mass * by_kilogram))
        moved = UNEXPLAINED * float(np.linalg.norm((inertia @ model)[BASE:]))
        enough = abs(mass) > ENDS if self.changing else abs(mass) > max(BEGINS, moved / square**0.5)
        enough = enough and (self.changing or self._left > 0.0)
        self.changing = enough and unlike < UNLIKE * abs(mass) * square**0.5
        if not self.changing:
            return 0.0, 0.0
        return h * MASS_GAIN * mass, min(max(float(by_kilogram @ known) / (square * mass), 0.0), 1.0)
