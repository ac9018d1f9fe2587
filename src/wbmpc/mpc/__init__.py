"""Model predictive control: the receding horizon, its policy, the steering guess of swerve bases, the real-time runner."""

from wbmpc.mpc.buffer import Mailbox, Sizes
from wbmpc.mpc.clock import Clock, VirtualClock, WallClock
from wbmpc.mpc.figures import Report
from wbmpc.mpc.mpc import MPC, Observation
from wbmpc.mpc.plans import Agent, Plans
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.runner import RobotInterface, Runner
from wbmpc.mpc.safety import RealTime
from wbmpc.mpc.steering import SteeringGuess, SteeringPlan, plan_steering

__all__ = [
    "MPC",
    "Agent",
    "Clock",
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
    "VirtualClock",
    "WallClock",
    "plan_steering",
]
