"""What robots on fixed wheels take and give."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlanarCommand:
    """Speeds of wheels (n) and arm joints [rad/s]."""

    wheel: Array
    arm: Array

    @classmethod
    def stop(cls, wheels: int, arm: int) -> PlanarCommand:
        """Everything at rest."""
        return cls(np.zeros(wheels), np.zeros(arm))


@dataclass(frozen=True)
class PlanarMeasurement:
    """Positions [rad] of wheels (n) and arm as the encoders report them at ``time`` [s]; ``gyro`` (3) [rad/s] and ``accel`` (3)
    [m/s²] of the inertial unit in the axes of the base: at rest ``accel`` points up."""

    time: float
    wheel: Array
    arm: Array
    gyro: Array = field(default_factory=lambda: np.zeros(3))
    accel: Array = field(default_factory=lambda: np.zeros(3))
