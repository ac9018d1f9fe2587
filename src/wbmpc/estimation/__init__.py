"""Estimators: where the base is, and which forces disturb it."""

from wbmpc.estimation.disturbance import DisturbanceObserver
from wbmpc.estimation.odometry import ReleaseOdometry, WheelOdometry

__all__ = ["DisturbanceObserver", "ReleaseOdometry", "WheelOdometry"]
