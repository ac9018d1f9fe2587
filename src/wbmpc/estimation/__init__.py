"""Estimators: where the base is, how it moves, and which forces disturb it."""

from wbmpc.estimation.ball import BallFilter, BallGeometry, BallNoise, BallState
from wbmpc.estimation.disturbance import DisturbanceObserver
from wbmpc.estimation.drift import DriftObserver
from wbmpc.estimation.odometry import ReleaseOdometry, WheelOdometry
from wbmpc.estimation.rezero import JointTracker, RezeroEstimator

__all__ = [
    "BallFilter",
    "BallGeometry",
    "BallNoise",
    "BallState",
    "DisturbanceObserver",
    "DriftObserver",
    "JointTracker",
    "ReleaseOdometry",
    "RezeroEstimator",
    "WheelOdometry",
]
