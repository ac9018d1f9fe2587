"""Controllers between MPC and plant: prediction over the delay, tracking, servos."""

from wbmpc.control.plans import Plans
from wbmpc.control.rezero import RezeroAgent
from wbmpc.control.swerve import SwerveAgent

__all__ = ["Plans", "RezeroAgent", "SwerveAgent"]
