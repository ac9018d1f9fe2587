"""How far the radii of wheels, and what the base does by them, are from the robot's file; how tires creep in bends."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc.arrays import Array

#: Standard deviation (relative) of a radius without calibration, as the bias of a gyro is found beside it.
UNSEEN = 0.002


@dataclass(frozen=True)
class WheelErrors:
    """``radius`` (n): of driven wheels, relative to the file's; ``speed`` (m): the base's speeds over those that wheels of these radii give
    it, less 1; ``covariance`` (n + m, n + m) of both. ``creep`` () [s]: speed at which tires give way to the side over the acceleration
    to the side, of a base that has no speed to the side: as long as they hold, a tire's side slip is as large as its side force (Pacejka,
    "Tire and Vehicle Dynamics", 2012, section 1.2)."""

    radius: Array
    speed: Array
    covariance: Array
    creep: Array = field(default_factory=lambda: np.zeros(()))

    @classmethod
    def unknown(cls, wheels: int, speeds: int) -> WheelErrors:
        """The file's numbers."""
        covariance = np.diag(np.repeat([UNSEEN**2, 0.0], [wheels, speeds]))
        return cls(np.zeros(wheels), np.zeros(speeds), covariance)

    def corrected(self, rates: Array) -> Array:
        """Rows of wheel rates by the base's speeds and others, for the wheels as they are: the first n are those of driven wheels."""
        n, found = self.radius.size, rates.copy()
        found[:n] /= 1.0 + self.radius[:, None]
        found[:n, : self.speed.size] /= 1.0 + self.speed
        return found

    def of_turn(self, rows: int) -> Array:
        """Covariance (rows, rows), n of them of driven wheels, of relative errors that would turn the base as wrong as what is not known
        here: its last speed is the turn."""
        n = self.radius.size
        by = np.hstack([np.eye(n), np.zeros((n, self.speed.size))])
        by[:, -1] = 1.0
        found = UNSEEN**2 * np.eye(rows)
        found[:n, :n] = by @ self.covariance @ by.T
        return found
