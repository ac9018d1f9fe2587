"""Model predictive control: the receding horizon, its policy, the steering guess of swerve bases."""

from wbmpc.mpc.mpc import MPC, Observation
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.steering import SteeringGuess

__all__ = ["MPC", "Observation", "Policy", "SteeringGuess"]
