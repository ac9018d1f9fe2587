"""Estimators: where the base is, and which forces disturb it, whether brakes answer."""

from wbmpc.estimation.brakes import BrakeFault, BrakeMonitor
from wbmpc.estimation.disturbance import DisturbanceObserver
from wbmpc.estimation.drift import DriftObserver
from wbmpc.estimation.odometry import ReleaseOdometry, WheelOdometry

__all__ = ["BrakeFault", "BrakeMonitor", "DisturbanceObserver", "DriftObserver", "ReleaseOdometry", "WheelOdometry"]
