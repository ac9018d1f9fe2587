"""Torques of a ball robot within its drives' limits: balance comes before yaw."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.model.robot import RobotModel

Array = NDArray[np.float64]


class TorqueLimits:
    """Of ``size`` drives, the wheels first. ``limit`` (n + m) [N m]; ``spin`` (n): torque about the vertical that the wheels' do to
    the ball."""

    def __init__(self, robot: RobotModel, size: int) -> None:
        self.limit: Array = robot.limits.input_upper[:size]
        self.spin: Array = robot.base.wheel_torque_map()[2]
        length = np.linalg.norm(self.spin)
        self._along = self.spin / length
        self._maximum = robot.description.limits.spin_effort / length

    def possible(self, torque: Array) -> Array:
        """Torques within the limits. Wheels that are clipped one by one would spin the ball.

        What leans stays as it is while some spin within its limit lets all wheels have it, and the spin nearest to the one
        asked for is taken; what leans is scaled as a whole only where there is none.
        """
        n = self.spin.size
        along, limit, maximum = self._along, self.limit[:n], self._maximum
        spin = float(along @ torque[:n])
        lean = torque[:n] - spin * along
        # spins that wheel i can have beside c lean: -c at_i ± room_i; they overlap if every two of them do, and with ±most
        at, room = np.append(lean / along, 0.0), np.append(limit / np.abs(along), maximum)
        apart = at[:, None] - at
        scale = min(1.0, float(np.min((room[:, None] + room) / np.maximum(apart, 1e-12))))
        at *= scale
        spin = min(max(spin, float(np.max(-at - room))), float(np.min(-at + room)))
        wheels = np.clip(scale * lean + spin * along, -limit, limit)  # only rounding is clipped
        return np.concatenate([wheels, np.clip(torque[n:], -self.limit[n:], self.limit[n:])])
