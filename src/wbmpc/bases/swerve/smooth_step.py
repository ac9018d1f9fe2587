"""Base position and arm at the moment of a message, compiled: see :class:`wbmpc.bases.swerve.drives.Smoothing`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.bases.swerve.compilation import step
from wbmpc.bases.swerve.drive_step import smooth
from wbmpc.kernel.ir import Floats


class Speeds(NamedTuple):
    """How fast base and arm move."""

    drives: Floats  # (nu), rates of the inputs
    mean: Floats  # (m) [rad/s], of the arm
    sag: Floats  # (m) [rad/s], beyond that


class Smoothed(NamedTuple):
    """Of x, y and the arm (2 + m each): what was read, how fast it changes, and its value."""

    read: Floats
    rates: Floats
    value: Floats


@step
def smooth_pose(
    m: int,
    base: int,
    pose: Floats,
    arm: Floats,
    speeds: Speeds,
    smoothed: Smoothed,
    started: bool,
    age: float,
    time: float,
    h: float,
) -> None:
    """x and y of the base's ``pose`` (3) and the ``arm`` (m) are ``smoothed``. The base's ``drives`` begin at ``base``."""
    drives, read, rates = speeds.drives, smoothed.read, smoothed.rates
    c, s = np.cos(pose[2]), np.sin(pose[2])
    vx, vy = drives[base], drives[base + 1]
    rates[0], rates[1] = c * vx - s * vy, s * vx + c * vy
    read[0], read[1] = pose[0], pose[1]
    for i in range(m):
        rates[2 + i], read[2 + i] = speeds.mean[i] + speeds.sag[i], arm[i]
    smooth(2 + m, read, rates, smoothed.value, started, age, time, h)
