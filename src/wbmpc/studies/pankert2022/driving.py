"""What experiments with a driving swerve base share: what the robot knows of itself, and by what it finds where it is."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.calibrator import SwerveCalibrator
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.configuration import Rules
from wbmpc.estimation.arm_calibration import load_arm_offset
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.settings import ACTUATOR_TIME_CONSTANT
from wbmpc.simulation.localization import Localization
from wbmpc.simulation.settings import ExperimentSettings, LidarSettings
from wbmpc.studies.pankert2022.reference_drive import calibrated, track_arm


class DrivingSettings(ExperimentSettings):
    """``localization``: none (odometry alone) or lidar (poses of a simulated ``lidar`` too), for the MPC and for baselines alike;
    ``calibration`` of the wheels: drive (a reference drive with a ``lidar`` first), none, or a file that 'wbmpc calibrate' wrote;
    ``tracked_poses``: number of arm poses at which the end effector is tracked first, for the zeros of the arm's encoders (0: zeros of
    a file, or none); ``use_gyro``: whether the odometry has it; ``settle_time`` [s]: standstill before the task, in which the gyro's
    bias is found (0: it is found on the way, and the pose is corrected late); ``actuator_time_constant`` [s]: that the controller
    assumes."""

    plant: SwervePerturbation = SwervePerturbation()
    use_gyro: bool = True
    calibration: str = "drive"
    localization: Literal["none", "lidar"] = "none"
    lidar: LidarSettings = LidarSettings()
    tracked_poses: int = Field(0, ge=0, le=1000)
    settle_time: float = Field(20.0, ge=0, le=120)
    actuator_time_constant: float = Field(ACTUATOR_TIME_CONSTANT, ge=0, le=0.5)

    only_with: ClassVar[Rules] = {"lidar": {"localization": "lidar", "calibration": "drive"}}

    def global_poses(self, seed: int) -> Localization | None:
        """The source of global poses for one plant; None: it has none."""
        return self.lidar.source(seed) if self.localization == "lidar" else None

    def estimation(self, robot: RobotModel, seed: int, smoothing: float = 0.0) -> EstimatorSettings:
        """What the estimator of a controller is made of, MPC or not; may drive for the calibration first. ``smoothing`` [s]: see
        :class:`EstimatorSettings`."""
        known = calibrated(robot, self.calibration, self.plant, self.lidar, seed)
        return EstimatorSettings(known, self._arm_offset(robot, seed), use_gyro=self.use_gyro, smoothing=smoothing)

    def _arm_offset(self, robot: RobotModel, seed: int) -> np.ndarray | None:
        """Zeros (m) [rad] of the arm's encoders as far as they are known."""
        joints = list(robot.input.groups["arm"])
        if self.tracked_poses:
            log = Log()
            track_arm(robot, self.plant, self.tracked_poses, seed, log)
            rows = SwerveCalibrator(robot).fit_arm({"tracked": log.array("tracked")}, "tracked poses") or {}
            return np.array([rows[joint]["offset"] for joint in joints])
        if self.calibration in ("none", "drive"):
            return None
        return load_arm_offset(self.calibration, joints, robot.description.name)
