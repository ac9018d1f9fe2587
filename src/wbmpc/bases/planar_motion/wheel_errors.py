"""How far the radii of wheels, and what the base does by them, are from the robot's file; and what a drive shows of that."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wbmpc.estimation.strokes import Strokes, fit_strokes

if TYPE_CHECKING:
    from wbmpc.bases.planar_motion.odometry import PlanarOdometry

Array = NDArray[np.float64]
#: Standard deviations before any measurement (relative): of a radius, and of a speed of the base, which rollers that creep and tracks that
#: skid make slower.
RADIUS, SPEED = 0.01, 0.03
#: The same without calibration: of a radius, as the bias of a gyro is found beside it.
UNSEEN = 0.002


@dataclass(frozen=True)
class WheelErrors:
    """``radius`` (n): of driven wheels, relative to the file's; ``speed`` (m): the base's speeds over those that wheels of these radii give
    it, less 1; ``covariance`` (n + m, n + m) of both."""

    radius: Array
    speed: Array
    covariance: Array

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


def fit_errors(
    odometry: Callable[[WheelErrors], PlanarOdometry], size: tuple[int, int], channels: Mapping[str, Array], source: str
) -> WheelErrors:
    """What a log's ``channels`` show (:class:`wbmpc.estimation.strokes.Strokes`); ``odometry`` at the origin for errors of (n, m)
    ``size``."""
    wheels, _ = size
    strokes = Strokes.of(channels, source)
    encoders = channels["wheel"].shape[1]
    split = lambda errors: WheelErrors(errors[:wheels], errors[wheels:], np.zeros((len(errors), len(errors))))

    def motion(errors: Array, turned: Array) -> tuple[Array, Array]:
        moving, way = odometry(split(errors)), np.zeros(2)
        before = moving.pose
        for k, row in enumerate(turned):
            moving.turn(float(k), row[:encoders], row[encoders:], None)
            way += np.hypot(*(moving.pose - before)[:2]), abs(moving.pose[2] - before[2])
            before = moving.pose
        return moving.pose, way

    found, covariance = fit_strokes(strokes, motion, np.repeat([RADIUS, SPEED], size), source)
    return WheelErrors(found[:wheels], found[wheels:], covariance)
