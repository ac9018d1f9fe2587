"""The state of a swerve robot for which the next policy is computed: over the computation delay and the drives' lag."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.estimator import SwerveEstimator
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.tracking import SwerveTracking
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import aligned_steering
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.types import Observation

#: Steering errors [rad] of a start from which wheels are aligned first.
CROOKED = 0.05


class SwervePrediction:
    """``brakes(t)``: brakes (n, 1 = open) at t [s].

    The MPC's state holds the *planned* steering angles; a servo closes their difference to the measured ones. (With measured
    angles the rolling rows of four wheels are never exactly consistent, and their only exact solution is standstill.)
    """

    def __init__(
        self, robot: RobotModel, estimator: SwerveEstimator, tracking: SwerveTracking, brakes: Callable[[float], Array]
    ) -> None:
        self.robot, self._estimator, self._tracking, self._brakes = robot, estimator, tracking, brakes

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """The state at time ``until``, by the inputs that will be applied from ``t`` on, and what the drives still owe.

        The plan's clock runs ahead of the wall's by the lag: what is commanded now acts that much later.
        """
        tracking = self._tracking
        lag, period = tracking.settings.lag, tracking.period
        # A first-order drive still moves by lag times its present rate after the last command: the state leads by that.
        tracking.ahead(self._start(t, plans), self._brakes(t))
        for k in range(round((until - t) / period)):
            now = t + (k + 0.5) * period
            policy = plans.at(now)
            if policy is None:
                break
            tracking.predict(policy.feedforward(now + lag), self._brakes(now))
        return Observation(until + lag, tracking.predicted)

    def _start(self, t: float, plans: PolicyQueue) -> Array:
        """The estimated state (nx) with the steering angles that the plan has at t [s]."""
        x, steer = self._estimator.state(), self.robot.state["steer"]
        if not self._tracking.settings.planned_steering:
            return x
        if plans.current is not None:
            x[steer] = plans.current.state(t + self._tracking.settings.lag)[steer]
            return x
        # Wheels that have no common center can only stand: the first plan starts from the nearest that have one.
        measured, leg = self._estimator.steer, self._estimator.leg
        aligned = aligned_steering(swerve_base(self.robot).geometry, leg if leg.size else 0.0, measured)
        if np.abs(aligned - measured).max() > CROOKED:
            x[steer] = aligned
        return x
