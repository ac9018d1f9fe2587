"""What robots on fixed wheels take and give."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc.arrays import Array


@dataclass(frozen=True)
class PlanarCommand:
    """Speeds of wheels (n), arm joints and steering joints [rad/s]."""

    wheel: Array
    arm: Array
    steer: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def stop(cls, wheels: int, arm: int, steer: int = 0) -> PlanarCommand:
        """Everything at rest."""
        return cls(np.zeros(wheels), np.zeros(arm), np.zeros(steer))


@dataclass(frozen=True)
class PlanarMeasurement:
    """Positions [rad] of wheels (n), arm and steering joints as the encoders report them at ``time`` [s]; ``gyro`` (3) [rad/s] and ``accel`` (3)
    [m/s²] of the inertial unit in the axes of the base: at rest ``accel`` points up; ``effort`` (m) [N m or N]: what the arm's drives report,
    which carry the arm and what it holds; empty where they report none."""

    time: float
    wheel: Array
    arm: Array
    gyro: Array = field(default_factory=lambda: np.zeros(3))
    accel: Array = field(default_factory=lambda: np.zeros(3))
    steer: Array = field(default_factory=lambda: np.zeros(0))
    effort: Array = field(default_factory=lambda: np.zeros(0))
