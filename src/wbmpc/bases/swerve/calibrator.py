"""Calibration of a swerve base's wheels from the channels of a log."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wbmpc.bases.swerve.calibration import WheelFit, WheelRecord, fit_wheels
from wbmpc.estimation.wheel_calibration import WheelCalibration
from wbmpc.model.robot import RobotModel


def steer_joints(robot: RobotModel) -> list[str]:
    """The names by which a calibration file knows the modules."""
    return list(robot.state.groups["steer"])


class SwerveCalibrator:
    """See :class:`wbmpc.bases.base.Calibrator`."""

    def __init__(self, robot: RobotModel) -> None:
        self.names, self.geometry = steer_joints(robot), robot.base.geometry

    def fit(self, channels: Mapping[str, np.ndarray], prior: WheelCalibration, source: str) -> WheelFit:
        """From ``channels`` as :meth:`wbmpc.bases.swerve.calibration.WheelRecord.of` reads them."""
        return fit_wheels(self.geometry, WheelRecord.of(channels, source), prior=prior)
