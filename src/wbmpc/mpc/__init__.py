"""Model predictive control: receding horizon, policy, input filters, steering guess of swerve bases, real-time runner."""

from wbmpc.mpc.buffer import Mailbox, Sizes
from wbmpc.mpc.clock import Clock, VirtualClock, WallClock
from wbmpc.mpc.figures import Report
from wbmpc.mpc.filters import FilterMemory
from wbmpc.mpc.mpc import MPC, Observation
from wbmpc.mpc.plans import Agent, Plans
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.runner import RobotInterface, Runner
from wbmpc.mpc.safety import RealTime
from wbmpc.mpc.steering import SteeringGuess, SteeringPlan, plan_steering
from wbmpc.mpc.turning import TurningGuess, fast_enough

__all__ = [
    "MPC",
    "Agent",
    "Clock",
    "FilterMemory",
    "Mailbox",
    "Observation",
    "Plans",
    "Policy",
    "RealTime",
    "Report",
    "RobotInterface",
    "Runner",
    "Sizes",
    "SteeringGuess",
    "SteeringPlan",
    "TurningGuess",
    "VirtualClock",
    "WallClock",
    "fast_enough",
    "plan_steering",
]
