"""The odometry of the release of Pankert et al. 2022, a baseline of the tracking study."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.bases.swerve.wheel_fit import WheelFit
from wbmpc.bases.swerve.wheel_odometry import Array, WheelOdometry
from wbmpc.checks import positive
from wbmpc.model.wheels import ModuleGeometry


class ReleaseOdometry:
    """Angles of steering and legs are refreshed every
    ``refresh`` [s] only, speeds instead of increments, Euler integration. ``period`` [s] between two updates. Raises
    :class:`InputError` for times that are not positive."""

    def __init__(self, geometry: ModuleGeometry, pose0: ArrayLike, period: float, refresh: float = 0.05) -> None:
        positive("odometry", period=period, refresh=refresh)
        self._reader = WheelOdometry(geometry, pose0)
        self._wheels = WheelFit(geometry, self._reader.radius)
        self._before, self._now = (np.split(self._wheels.memory[name], 3) for name in ("before", "now"))
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
            half = 0.5 * (now_leg - leg0)
            (leg, steering, rolled), (next_leg, next_steering, next_rolled) = self._before, self._now
            leg[:], steering[:], rolled[:] = held_leg - half, held_steer + half, wheel0
            next_leg[:], next_steering[:], next_rolled[:] = held_leg + half, held_steer - half, now_wheel
            self._wheels.run()
            dx, dy, turn = self._wheels.memory["twist"].tolist()
            x, y, yaw = self.pose.tolist()
            c, s = lie.cos_sin(yaw)
            self.pose = np.array([x + (c * dx - s * dy), y + (s * dx + c * dy), yaw + turn])
        self._last = (now_leg, now_wheel)
        return self.pose
