"""What a drive with global poses shows of the errors of wheels."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.odometry import PlanarOdometry
from wbmpc.bases.planar_motion.strokes import Strokes, fit_strokes
from wbmpc.bases.planar_motion.wheel_errors import WheelErrors

#: Standard deviations before any measurement (relative): of a radius, and of a speed of the base, which rollers that creep and tracks that
#: skid make slower.
RADIUS, SPEED = 0.01, 0.03


def fit_errors(
    odometry: Callable[[WheelErrors], PlanarOdometry], size: tuple[int, int], channels: Mapping[str, Array], source: str
) -> WheelErrors:
    """What a log's ``channels`` show (:class:`wbmpc.bases.planar_motion.strokes.Strokes`); ``odometry`` at the origin for errors of (n, m)
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
