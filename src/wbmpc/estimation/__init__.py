"""Estimators: where the base is, and which forces disturb it, whether brakes answer."""

from wbmpc.estimation.brakes import BrakeFault, BrakeMonitor
from wbmpc.estimation.calibration import WheelRecord, calibrate
from wbmpc.estimation.disturbance import DisturbanceObserver
from wbmpc.estimation.drift import DriftObserver
from wbmpc.estimation.fused import FusedOdometry, OdometryNoise
from wbmpc.estimation.odometry import ReleaseOdometry, WheelOdometry
from wbmpc.estimation.wheels import WheelCalibration

__all__ = [
    "BrakeFault",
    "BrakeMonitor",
    "DisturbanceObserver",
    "DriftObserver",
    "FusedOdometry",
    "OdometryNoise",
    "ReleaseOdometry",
    "WheelCalibration",
    "WheelOdometry",
    "WheelRecord",
    "calibrate",
]
