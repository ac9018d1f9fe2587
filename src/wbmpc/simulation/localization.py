"""A simulated source of global poses, such as a LIDAR with a map: slow, late, noisy."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.checks import not_negative, positive
from wbmpc.types import GlobalPose


class Localization:
    """Poses at ``rate`` [Hz], delivered ``age`` [s] after the moment they belong to, with normal noise of standard
    deviations ``position`` [m] per axis and ``yaw`` [rad]; its own generator with ``seed``."""

    def __init__(
        self, rate: float = 10.0, age: float = 0.050, position: float = 0.005, yaw: float = 0.002, seed: int = 0
    ) -> None:
        positive("localization", rate=rate)
        not_negative("localization", age=age, position=position, yaw=yaw)
        self.period, self.age = 1.0 / rate, age
        self._std, self._noise = np.array([position, position, yaw]), np.random.default_rng([seed, 1])
        self._due = 0.0
        self._waiting: deque[GlobalPose] = deque()

    def observe(self, time: float, pose: Callable[[], ArrayLike]) -> GlobalPose | None:
        """What is delivered now. To be asked at least as often as poses are due: when one is, ``pose()`` is the true one (3) of now."""
        if time >= self._due - 1e-9:
            seen = np.asarray(pose(), float) + self._std * self._noise.normal(size=3)
            self._waiting.append(GlobalPose(time, seen, np.diag(self._std**2)))
            self._due = max(self._due + self.period, time)
        if self._waiting and time >= self._waiting[0].time + self.age - 1e-9:
            return self._waiting.popleft()
        return None
