"""What experiments with a driving swerve base share: what the robot knows of itself, and by what it finds where it is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_monitor import BrakeFault
from wbmpc.bases.swerve.calibrator import SwerveCalibrator, steer_joints
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.configuration import OneOf
from wbmpc.estimation.arm_calibration import load_arm_offset
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.settings import ACTUATOR_TIME_CONSTANT, ControlSettings, MpcSettings, Nothing, Settings
from wbmpc.simulation.localization import Localization
from wbmpc.simulation.settings import LidarSettings
from wbmpc.studies.pankert2022.reference_drive import calibrated, track_arm


class LidarPoses(LidarSettings):
    """The poses of a simulated LIDAR beside the odometry."""

    kind: Literal["lidar"] = "lidar"


class DriveCalibration(Settings):
    """A reference drive with a ``lidar`` before the run."""

    kind: Literal["drive"] = "drive"
    lidar: LidarSettings = LidarSettings()


class FileCalibration(Settings):
    """``file``: what 'wbmpc calibrate' wrote."""

    kind: Literal["file"] = "file"
    file: Path = Path("calibration.yaml")


class DrivingSettings(Settings):
    """``localization``: none (odometry alone) or lidar (:class:`LidarPoses` too), for the MPC and for baselines alike;
    ``calibration`` of the wheels: drive (:class:`DriveCalibration`), none, or file (:class:`FileCalibration`);
    ``tracked_poses``: number of arm poses at which the end effector is tracked first, for the zeros of the arm's encoders (0: zeros of
    a file, or none); ``use_gyro``: whether the odometry has it; ``settle_time`` [s]: standstill before the task, in which the gyro's
    bias is found (0: it is found on the way, and the pose is corrected late); ``actuator_time_constant`` [s]: that the controller
    assumes."""

    mpc: MpcSettings = MpcSettings()
    control: ControlSettings = ControlSettings()
    plant: SwervePerturbation = SwervePerturbation()
    use_gyro: bool = True
    calibration: OneOf[Nothing | DriveCalibration | FileCalibration] = DriveCalibration()
    localization: OneOf[Nothing | LidarPoses] = Nothing()
    tracked_poses: int = Field(0, ge=0, le=1000)
    settle_time: float = Field(20.0, ge=0, le=120)
    actuator_time_constant: float = Field(ACTUATOR_TIME_CONSTANT, ge=0, le=0.5)

    def global_poses(self, seed: int) -> Localization | None:
        """The source of global poses for one plant; None: it has none."""
        return self.localization.source(seed) if isinstance(self.localization, LidarPoses) else None

    def estimation(self, robot: RobotModel, seed: int) -> EstimatorSettings:
        """What the estimator of a controller is made of, MPC or not; may drive for the calibration first."""
        return EstimatorSettings(self._wheels(robot, seed), self._arm_offset(robot, seed), use_gyro=self.use_gyro)

    def _wheels(self, robot: RobotModel, seed: int) -> WheelCalibration:
        """What is known of the wheels."""
        geometry = swerve_base(robot).geometry
        if isinstance(self.calibration, DriveCalibration):
            return calibrated(robot, self.plant, self.calibration.lidar, seed)
        if isinstance(self.calibration, FileCalibration):
            return WheelCalibration.load(self.calibration.file, geometry, steer_joints(robot), robot.description.name)
        return WheelCalibration.unknown(geometry)

    def _arm_offset(self, robot: RobotModel, seed: int) -> np.ndarray | None:
        """Zeros (m) [rad] of the arm's encoders as far as they are known."""
        joints = list(robot.input.groups["arm"])
        if self.tracked_poses:
            log = Log()
            track_arm(robot, self.plant, self.tracked_poses, seed, log)
            rows = SwerveCalibrator(robot).fit_arm({"tracked": log.array("tracked")}, "tracked poses") or {}
            return np.array([rows[joint]["offset"] for joint in joints])
        if not isinstance(self.calibration, FileCalibration):
            return None
        return load_arm_offset(self.calibration.file, joints, robot.description.name)


def closed_brakes(robot: RobotModel, mpc: MPC) -> Callable[[BrakeFault], None] | None:
    """Legs stay closed; what takes their faults, so that the plan counts with them. None for fixed legs."""
    return BrakeControl(robot, changed=mpc.set_schedule).accept if "brake" in robot.mode else None
