"""What swerve robots take and give: commands of their drives and brakes, measurements of their sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc.arrays import Array
from wbmpc.types import GlobalPose


@dataclass(frozen=True)
class SwerveCommand:
    """Speeds of wheels (n), steering (n) and arm joints [rad/s]; brakes (n, or 0 for fixed legs), 1 = open."""

    wheel: Array
    steer: Array
    arm: Array
    brake: Array

    @classmethod
    def stop(cls, modules: int = 4, arm: int = 6) -> SwerveCommand:
        """Everything at rest, brakes closed."""
        return cls(np.zeros(modules), np.zeros(modules), np.zeros(arm), np.zeros(modules))


@dataclass(frozen=True)
class SwerveMeasurement:
    """Positions [rad] as the encoders report them at ``time`` [s] (``leg`` is empty for fixed legs).

    ``gyro`` (3) [rad/s] and ``accel`` (3) [m/s²]: inertial unit, axes of the base; at rest ``accel`` points up.
    ``place``: a global pose that has just come in, older than the message. ``effort`` (m) [N m]: torques that the arm's drives
    report, which carry the arm and what it holds; empty where they report none.
    """

    time: float
    leg: Array
    steer: Array
    wheel: Array
    arm: Array
    gyro: Array = field(default_factory=lambda: np.zeros(3))
    accel: Array = field(default_factory=lambda: np.zeros(3))
    place: GlobalPose | None = None
    effort: Array = field(default_factory=lambda: np.zeros(0))
