"""Base position and arm at the moment of a message, compiled: see :class:`wbmpc.bases.swerve.drives.Smoothing`."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.swerve.compilation import step
from wbmpc.bases.swerve.drive_step import smooth
from wbmpc.kernel.ir import Floats


@step
def smooth_pose(
    m: int, base: int, pose: Floats, drives: Floats, mean: Floats, sag: Floats, arm: Floats, read: Floats, rates: Floats, value: Floats,
    started: bool, age: float, time: float, h: float,
) -> None:  # fmt: skip
    """x and y of the base's ``pose`` (3) and the ``arm`` (m), smoothed, into ``value`` (2 + m). ``drives`` (nu): rates of the inputs, of which
    the base's begin at ``base``; the arm turns at ``mean`` + ``sag`` (m) [rad/s]."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    vx, vy = drives[base], drives[base + 1]
    rates[0], rates[1] = c * vx - s * vy, s * vx + c * vy
    read[0], read[1] = pose[0], pose[1]
    for i in range(m):
        rates[2 + i], read[2 + i] = mean[i] + sag[i], arm[i]
    smooth(2 + m, read, rates, value, started, age, time, h)
