"""The ball robot's controller for a frequency-aware MPC: the filters' states go along with what acts."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.fall_detection import stop_for
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.mpc.filters import FilterMemory
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.types import Observation


class FrequencyAwareController(BallController):
    """A :class:`BallController` whose policies decide what filters make of the torques (:func:`wbmpc.ocp.frequency_aware`)."""

    def __init__(self, robot: Any, mpc: Any, torque: np.ndarray, *more: Any) -> None:
        super().__init__(robot, mpc, torque, *more)
        self.memory = FilterMemory(mpc.ocp.dynamics, torque)

    def _step(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        # with its filters at rest for u the wrapped model holds u, as the drives do
        return self.mpc.solver.simulate(*self.memory.dynamics.equilibrium(x, u), h)[: x.size]

    def _torques_of(self, policy: Policy, memory: FilterMemory, t: float, x: np.ndarray) -> np.ndarray:
        return memory.input(policy.law(t, memory.state(x)))[: self.limit.size]

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """State and filters at time ``until`` under the policies that will be active, through the drives' lag."""
        x, torque, memory = self.state(), self.sent.last, self.memory.copy()
        for k in range(round((until - t) / self.period)):
            now = t + k * self.period
            policy = plans.at(now)
            if policy is None:
                break
            target = self.limits.limited(self._torques_of(policy, memory, now, x), x)
            memory.advance(target, self.period)
            torque = self.sent.follow(target, torque)
            x = self._step(x, torque, self.period)
        return memory.observation(until, x)

    def command(self, t: float, plans: PolicyQueue) -> BallCommand:
        """Torques of the feedback policy at the predicted present state; the filters take in what is sent."""
        assert plans.current is not None
        if self.fall_predictor is not None:
            stop_for(self.fall_predictor.update_plan(plans.current))
        x = self.state()
        self.feedforward = self.memory.dynamics.acting(plans.current.state(t)[x.size :], plans.current.feedforward(t))[
            : self.limit.size
        ]
        self.target = self._torques_of(plans.current, self.memory, t, x)
        torque = self.limits.limited(self.target, x)
        self.memory.advance(torque, self.period)
        return self._drive(torque)
