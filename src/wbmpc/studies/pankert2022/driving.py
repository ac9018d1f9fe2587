"""What experiments with a driving swerve base share: what the robot knows of itself, and by what it finds where it is."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.configuration import OnlyWith
from wbmpc.model.robot import RobotModel
from wbmpc.settings import ExperimentSettings, LidarSettings
from wbmpc.simulation.localization import Localisation
from wbmpc.studies.pankert2022.reference_drive import calibrated


class DrivingSettings(ExperimentSettings):
    """``localization``: none (odometry alone) or lidar (poses of a simulated ``lidar`` too), for the MPC and for baselines alike;
    ``calibration`` of the wheels: drive (a reference drive with a ``lidar`` first), none, or a file that 'wbmpc calibrate' wrote;
    ``use_gyro``, whose bias shows over ``settle_time`` [s] of standing (0: it shows under way, and the pose is corrected late);
    ``actuator_time_constant`` [s] that the controller assumes."""

    use_gyro: bool = True
    calibration: str = "drive"
    localization: Literal["none", "lidar"] = "none"
    lidar: Annotated[LidarSettings, OnlyWith(localization="lidar", calibration="drive")] = LidarSettings()
    settle_time: float = Field(20.0, ge=0, le=120)
    actuator_time_constant: float = Field(0.020, ge=0, le=0.5)

    def global_poses(self, seed: int) -> Localisation | None:
        """The source of global poses for one plant; None: it has none."""
        return self.lidar.source(seed) if self.localization == "lidar" else None

    def estimation(self, robot: RobotModel, seed: int, smoothing: float = 0.0) -> EstimatorSettings:
        """What the estimator of a controller is made of, MPC or not; may drive for the calibration first. ``smoothing`` [s]: see
        :class:`EstimatorSettings`."""
        known = calibrated(robot, self.calibration, self.plant, self.lidar, seed)
        return EstimatorSettings(calibration=known, use_gyro=self.use_gyro, smoothing=smoothing)
