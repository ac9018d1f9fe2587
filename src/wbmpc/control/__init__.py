"""Controllers between MPC and plant: prediction over the delay, tracking, servos, brakes."""

from wbmpc.control.brakes import BrakeControl
from wbmpc.control.fall import FallForecast
from wbmpc.control.frequency import FrequencyAwareAgent
from wbmpc.control.leaning import Leaning
from wbmpc.control.leg_guard import LegGuard
from wbmpc.control.lqr import LqrAgent, LqrWeights, RegulatorGains
from wbmpc.control.rezero import RezeroAgent
from wbmpc.control.rolling import FourWheelSteeringAgent, RollingAgent
from wbmpc.control.separate import ArmLoop, HandInverse, SeparateAgent
from wbmpc.control.swerve import SwerveAgent
from wbmpc.control.taskspace import TaskGains, TaskSpaceAgent
from wbmpc.control.tracking import ActuatorGains, TrackingAgent
from wbmpc.mpc import Plans

__all__ = [
    "ActuatorGains",
    "ArmLoop",
    "BrakeControl",
    "FallForecast",
    "FourWheelSteeringAgent",
    "FrequencyAwareAgent",
    "HandInverse",
    "Leaning",
    "LegGuard",
    "LqrAgent",
    "LqrWeights",
    "Plans",
    "RegulatorGains",
    "RezeroAgent",
    "RollingAgent",
    "SeparateAgent",
    "SwerveAgent",
    "TaskGains",
    "TaskSpaceAgent",
    "TrackingAgent",
]
