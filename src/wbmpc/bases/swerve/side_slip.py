"""Wheels of a swerve base of which the controller knows that they slip sideways: they turn about while the base goes on."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.swerve.model import swerve_base
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import wheel_velocities

#: Sideways speed [m/s] at which a wheel slips; for how long [s] after it the wheel does (drives lag).
SLIPS_AT, SLIPS_FOR = 0.02, 0.1


class SideSlip:
    """Which wheels slip sideways, under a plan with flips (:meth:`update`) or where a controller says so (:meth:`announce`), one of them
    every ``period`` [s]: ``left`` (n) [s], for how long each still does."""

    def __init__(self, robot: RobotModel, period: float) -> None:
        self._geometry, self._input, self._period = swerve_base(robot).geometry, robot.input, period
        self.left = np.zeros(swerve_base(robot).geometry.modules)

    def update(self, leg: np.ndarray, steer: np.ndarray, u: np.ndarray) -> None:
        """Under leg angles ``leg`` (n), planned steering angles ``steer`` (n) [rad] and the input u (nu)."""
        geometry, inputs = self._geometry, self._input
        v = wheel_velocities(geometry, leg, u[inputs["base"]], u[inputs["leg"]] if "leg" in inputs else 0.0)
        heading = geometry.wheel_heading + geometry.leg_angles(leg) + steer
        side = v[:, 1] * np.cos(heading) - v[:, 0] * np.sin(heading)
        self.announce(side)

    def announce(self, side: np.ndarray) -> None:
        """Wheels (n) that slip sideways at ``side`` (n) [m/s] for a period."""
        self.left = np.where(np.abs(side) > SLIPS_AT, SLIPS_FOR, np.maximum(self.left - self._period, 0.0))
