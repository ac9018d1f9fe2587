"""Controllers whose wheels slip sideways while they turn about: the odometry gives little weight to those."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.estimator import SwerveEstimator
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.tracking import SwerveTracking
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import wheel_velocities
from wbmpc.mpc.policy import Policy

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


class SlipEstimator(SwerveEstimator):
    """``side_slip``: which wheels a plan lets slip."""

    side_slip: SideSlip

    def slipping(self) -> NDArray[np.bool_]:
        """Wheels (n) that are known to slip."""
        return np.asarray(self.side_slip.left > 0.0)


class SlipController(SwerveController):
    """Its estimator knows which wheels slip."""

    Estimator = SlipEstimator
    estimator: SlipEstimator

    def __init__(self, robot: RobotModel, pose: Array, period: float, *args: Any, **keys: Any) -> None:
        super().__init__(robot, pose, period, *args, **keys)
        self.estimator.side_slip = SideSlip(robot, period)


class FlipTracking(SwerveTracking):
    """The law that reports to the estimator which wheels a plan lets slip."""

    def command(
        self, t: float, policy: Policy, estimator: SwerveEstimator, brake: Array
    ) -> tuple[SwerveCommand, Array]:
        """As always; what slips is known by the plan's input and its steering angles."""
        given = super().command(t, policy, estimator, brake)
        assert isinstance(estimator, SlipEstimator)
        estimator.side_slip.update(estimator.hinge_angles, self._arrays["planned"].copy(), self._arrays["u"])
        return given


class FlipController(SlipController):
    """Plans let wheels slip sideways while they turn about (:mod:`wbmpc.studies.pankert2022.wheel_flip`)."""

    Tracking = FlipTracking
