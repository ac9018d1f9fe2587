"""Controllers between MPC and plant: prediction over the delay, tracking, servos."""

from wbmpc.control.rezero import RezeroAgent
from wbmpc.control.swerve import SwerveAgent
from wbmpc.mpc import Plans

__all__ = ["Plans", "RezeroAgent", "SwerveAgent"]
