"""Estimators: where the base is, how it moves, which forces disturb it, whether brakes and encoders answer."""

from wbmpc.estimation.ball import BallFilter, BallGeometry, BallNoise, BallState
from wbmpc.estimation.brakes import BrakeFault, BrakeMonitor
from wbmpc.estimation.calibration import WheelFit, WheelRecord, calibrate, fit_wheels, replay
from wbmpc.estimation.contact import ContactMonitor
from wbmpc.estimation.disturbance import DisturbanceObserver
from wbmpc.estimation.door import DoorFilter, DoorNoise
from wbmpc.estimation.drift import DriftObserver
from wbmpc.estimation.encoders import EncoderFault, EncoderMonitor
from wbmpc.estimation.force import ForceMonitor
from wbmpc.estimation.fused import FusedOdometry
from wbmpc.estimation.fused_filter import OdometryNoise
from wbmpc.estimation.mass_offset import MassOffset, Tipping, estimate_mass_offset
from wbmpc.estimation.momentum import MomentumObserver
from wbmpc.estimation.odometry import ReleaseOdometry, WheelOdometry
from wbmpc.estimation.offset import OffsetObserver
from wbmpc.estimation.payload import PayloadEstimator
from wbmpc.estimation.push import PushEstimator
from wbmpc.estimation.rezero import JointTracker, RezeroEstimator
from wbmpc.estimation.rocking import Rocking, rockings
from wbmpc.estimation.wheels import WheelCalibration

__all__ = [
    "BallFilter",
    "BallGeometry",
    "BallNoise",
    "BallState",
    "BrakeFault",
    "BrakeMonitor",
    "ContactMonitor",
    "DisturbanceObserver",
    "DoorFilter",
    "DoorNoise",
    "DriftObserver",
    "EncoderFault",
    "EncoderMonitor",
    "ForceMonitor",
    "FusedOdometry",
    "JointTracker",
    "MassOffset",
    "MomentumObserver",
    "OdometryNoise",
    "OffsetObserver",
    "PayloadEstimator",
    "PushEstimator",
    "ReleaseOdometry",
    "RezeroEstimator",
    "Rocking",
    "Tipping",
    "WheelCalibration",
    "WheelFit",
    "WheelOdometry",
    "WheelRecord",
    "calibrate",
    "estimate_mass_offset",
    "fit_wheels",
    "replay",
    "rockings",
]
