"""What a base moves besides the twist of its wheels: slip on a slope, a pushed or dragged base."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc import lie
from wbmpc.checks import numbers, positive


@dataclass
class BaseSlipObserver:
    """Body twist (vx, vy, wz) [m/s, rad/s] that explains the difference of measured poses and commanded wheel twists.

    First-order filter with ``time_constant`` [s]; the pose must not come from the wheels alone. The estimate is the
    parameter ``drift`` of the dynamics of a base on wheels: with it in the plan there is no steady offset.
    """

    time_constant: float = 0.5
    drift: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        positive("drift observer", time_constant=self.time_constant)
        self.drift = numbers("drift observer", "drift", self.drift, 3)
        self._pose: np.ndarray | None = None

    def update(self, pose: np.ndarray, twist: np.ndarray, h: float) -> np.ndarray:
        """Estimate (3,) after a measured pose (x, y, yaw); ``twist`` (3,) of the wheels has acted for ``h`` [s] before it."""
        if self._pose is not None:
            moved = lie.se2_log(self._pose, pose) / h
            self.drift = self.drift + (1.0 - np.exp(-h / self.time_constant)) * (moved - twist - self.drift)
        self._pose = np.array(pose, float)
        return self.drift
