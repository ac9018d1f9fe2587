"""Wheels that hang in the air over a whole record: a stiff base on four stiff legs stands on three of them."""

from __future__ import annotations

import logging

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.slipping_wheels import FEWEST, SHARE
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry, outlier_wheel
from wbmpc.bases.swerve.wheel_record import WheelRecord
from wbmpc.model.wheels import ModuleGeometry

_LOG = logging.getLogger("wbmpc")
#: Length [m] of pieces of the way, in which counts of encoders cancel; root mean square of what wheels contradict each other over their
#: way above which one is sought that hangs. What it counts then: hardly anything, as wheels that slip.
PIECE, CONTRADICTS, WEIGHT = 0.05, 0.005, 1e-3


def hanging_wheel(geometry: ModuleGeometry, record: WheelRecord, found: WheelCalibration) -> int | None:
    """The wheel that contradicts the others over a record, with the numbers that were ``found``: no zero and no radius explains
    it, and the others agree. None: there is none, or too few wheels to say which.

    A wheel in the air turns and rolls as it is commanded, and does not pull its leg along."""
    if geometry.modules < FEWEST:
        return None
    apart = _contradictions(geometry, record, found)
    if not len(apart) or np.mean(apart**2) < CONTRADICTS**2:
        return None
    legs = record.leg.mean(axis=0) if record.leg.size else np.zeros(geometry.modules)
    wheel, share = outlier_wheel(apart, geometry.steer_axes(legs))
    return wheel if share > SHARE else None


def weights_on_the_ground(geometry: ModuleGeometry, record: WheelRecord, found: WheelCalibration) -> Array | None:
    """Weights (n) that leave out the :func:`hanging_wheel`, with a warning; None: there is none."""
    wheel = hanging_wheel(geometry, record, found)
    if wheel is None:
        return None
    _LOG.warning(
        "log: wheel %d of %d contradicts the others as one does that hangs in the air: left out", wheel + 1, geometry.modules
    )  # fmt: skip
    return np.where(np.arange(geometry.modules) == wheel, WEIGHT, 1.0)


def _contradictions(geometry: ModuleGeometry, record: WheelRecord, found: WheelCalibration) -> Array:
    """(k, n, 2): by what wheels contradict each other over their way, in each piece of it."""
    wheels = WheelOdometry(
        geometry, wheel_radius=found.wheel_radius, leg_offset=found.leg_offset, steer_offset=found.steer_offset
    )
    rolled = np.abs(np.diff(record.wheel, axis=0)).mean(axis=1) * geometry.wheel_radius
    pieces, off, way = [], np.zeros((geometry.modules, 2)), 0.0
    for k, (steer, wheel) in enumerate(zip(record.steer, record.wheel, strict=True)):
        wheels.update(record.leg[k], steer, wheel)
        off, way = off + wheels.residual, way + (rolled[k - 1] if k else 0.0)
        if way >= PIECE:
            pieces.append(off / way)
            off, way = np.zeros((geometry.modules, 2)), 0.0
    return np.array(pieces)
