"""Calibration of a swerve base's wheels from the channels of a log."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wbmpc.bases.swerve.calibration import WheelFit, fit_wheels
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.wheel_record import WheelRecord
from wbmpc.errors import InputError
from wbmpc.estimation.arm_calibration import calibrate_arm
from wbmpc.estimation.calibration_file import ARM_KEYS, read_rows
from wbmpc.estimation.wheel_calibration import WheelCalibration
from wbmpc.model.robot import RobotModel


def steer_joints(robot: RobotModel) -> list[str]:
    """The names by which a calibration file knows the modules."""
    return list(robot.state.groups["steer"])


class SwerveCalibrator:
    """See :class:`wbmpc.bases.calibrator.Calibrator`."""

    def __init__(self, robot: RobotModel) -> None:
        self.names, self.geometry, self._robot = steer_joints(robot), swerve_base(robot).geometry, robot
        self.robot = robot.description.name

    def fit(self, channels: Mapping[str, np.ndarray], prior: WheelCalibration, source: str) -> WheelFit:
        """From ``channels`` as :meth:`wbmpc.bases.swerve.wheel_record.WheelRecord.of` reads them."""
        found = fit_wheels(self.geometry, WheelRecord.of(channels, source), prior=prior)
        found.calibration.check(source, self.geometry, self.names)
        return found

    def fit_arm(self, channels: Mapping[str, np.ndarray], source: str) -> dict[str, dict[str, float]] | None:
        """See :class:`wbmpc.bases.calibrator.Calibrator`."""
        if "tracked" not in channels:
            return None
        joints, rows = list(self._robot.input.groups["arm"]), np.atleast_2d(np.asarray(channels["tracked"], float))
        m = len(joints)
        if rows.shape[1] != m + 4 or not (rows[:, -1] > 0.0).all():
            raise InputError(
                f"{source}: channel 'tracked': rows of {m} angles of the arm, 3 positions of its end effector in axes of the base and "
                f"their standard deviation, above 0, are needed, got {rows.shape}"
            )
        found = calibrate_arm(self._robot, rows[:, :m], rows[:, m : m + 3], float(rows[0, -1])).rows(joints)
        return read_rows(source, "arm", found, "joint of the arm", joints, ARM_KEYS)
