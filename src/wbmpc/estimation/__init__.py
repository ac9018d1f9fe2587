"""Estimators: where the base is, and which forces disturb it."""

from wbmpc.estimation.disturbance import DisturbanceObserver
from wbmpc.estimation.drift import DriftObserver
from wbmpc.estimation.odometry import ReleaseOdometry, WheelOdometry

__all__ = ["DisturbanceObserver", "DriftObserver", "ReleaseOdometry", "WheelOdometry"]
