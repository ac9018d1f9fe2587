"""The odometry of the release of Pankert et al. 2022, a baseline of the tracking study."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.checks import positive
from wbmpc.estimation.wheel_fit import WheelFit
from wbmpc.estimation.wheel_odometry import Array, WheelOdometry
from wbmpc.model.wheels import ModuleGeometry


class ReleaseOdometry:
    """Angles of steering and legs are refreshed every
    ``refresh`` [s] only, speeds instead of increments, Euler integration. ``period`` [s] between two updates. Raises
    :class:`InputError` for times that are not positive."""

    def __init__(self, geometry: ModuleGeometry, pose0: ArrayLike, period: float, refresh: float = 0.05) -> None:
        positive("odometry", period=period, refresh=refresh)
        self._reader = WheelOdometry(geometry, pose0)
        self._wheels = WheelFit(geometry, self._reader.radius)
        self.pose = self._reader.pose
        self._every, self._count = max(1, round(refresh / period)), 0
        self._held: tuple[Array, Array] | None = None
        self._last: tuple[Array, Array] | None = None

    def update(self, leg: ArrayLike, steer: ArrayLike, wheel: ArrayLike) -> Array:
        """The pose after positions (n) [rad]; the first call only stores them."""
        now_leg, now_steer, now_wheel = self._reader.checked(leg, steer, wheel)
        if self._held is None or self._count % self._every == 0:
            self._held = (now_leg, now_steer)
        self._count += 1
        if self._last is not None:
            held_leg, held_steer = self._held
            leg0, wheel0 = self._last
            swing = now_leg - leg0
            memory = self._wheels.memory
            np.concatenate([held_leg - 0.5 * swing, held_steer + 0.5 * swing, wheel0], out=memory["before"])
            np.concatenate([held_leg + 0.5 * swing, held_steer - 0.5 * swing, now_wheel], out=memory["now"])
            self._wheels.run()
            dx, dy, turn = memory["twist"]
            c, s = np.cos(self.pose[2]), np.sin(self.pose[2])
            self.pose = self.pose + np.array([c * dx - s * dy, s * dx + c * dy, turn])
        self._last = (now_leg, now_wheel)
        return self.pose
