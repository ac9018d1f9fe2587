"""What a swerve robot with a tip on a wall measures."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.messages import SwerveMeasurement


@dataclass(frozen=True)
class WipeMeasurement(SwerveMeasurement):
    """Also the ``force`` (3) [N] of the end effector on its tip, in the end effector's axes, mean over 2.5 ms."""

    force: Array = field(default_factory=lambda: np.zeros(3))
