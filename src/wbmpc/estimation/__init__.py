"""Estimators: where the base is."""

from wbmpc.estimation.odometry import WheelOdometry

__all__ = ["WheelOdometry"]
