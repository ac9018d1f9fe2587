"""A controller of robots whose whole state is measured and whose drives take the model's inputs as they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import not_negative, numbers, positive
from wbmpc.control.monitor import Fault, Monitor, found_by
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.types import Observation

if TYPE_CHECKING:
    from wbmpc.model.robot import RobotModel
    from wbmpc.mpc.mpc import MPC


@dataclass(frozen=True)
class StateMeasurement:
    """The state (nx) of the problem's dynamics at ``time`` [s]."""

    time: float
    state: Array


@dataclass(frozen=True)
class InputCommand:
    """Inputs (nu) of the problem's dynamics; ``rest`` (1): 1 where the robot is to stand still instead."""

    input: Array
    rest: Array


def lag_share(period: float, lag: float) -> float:
    """Share of the way to a command that a drive of first order goes in a period [s]; 1 without a ``lag`` [s]."""
    return float(1.0 - np.exp(-period / lag)) if lag > 0.0 else 1.0


class DirectController:
    """Measured states go to the MPC, predicted over its delay, and the policy's inputs to the drives.

    ``lag`` [s] of the drives, first order: the plan leads the measured state by it. ``rate`` (nu): how fast inputs may change [1/s], left
    out: at once. ``monitors`` of measurements find ``faults``.
    ``feedback``: the policy's law in place of its feed-forward, for drives that follow exactly.
    """

    def __init__(
        self, robot: RobotModel, mpc: MPC, period: float, lag: float = 0.0, *, rate: Array | None = None,
        feedback: bool = False,
    ) -> None:  # fmt: skip
        positive("controller", period=period)
        not_negative("controller", lag=lag)
        self.robot, self.mpc, self.period, self.lag, self.feedback = robot, mpc, period, lag, feedback
        size = mpc.dynamics.input.size
        self._step = np.full(size, np.inf) if rate is None else rate * period
        self._blend = lag_share(period, lag)
        self.sent, self._rates = np.zeros((2, size))
        self.measured: StateMeasurement | None = None
        self.monitors: list[Monitor[StateMeasurement]] = []
        self.faults: list[Fault] = []

    def measure(self, measurement: StateMeasurement) -> None:
        """Take in the message of this tick. Raises :class:`InputError` for numbers that are not finite or of another length."""
        numbers("controller", "state", measurement.state, self.mpc.dynamics.state.size)
        self.measured = measurement
        self.faults += found_by(self.monitors, measurement)

    def state(self) -> Array:
        """Measured state (nx)."""
        assert self.measured is not None
        return self.measured.state

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """The state at time ``until``, by what will be sent from ``t`` on and what lagging drives still owe."""
        x, sent = self.state(), self.sent
        if self.lag > 0.0:
            x = self.mpc.simulate(x, self._rates, self.lag)
        for k in range(round((until - t) / self.period)):
            now = t + k * self.period
            if plans.at(now) is None:
                break
            sent = self._limited(sent, self._asked(now, x, plans))
            x = self.mpc.simulate(x, sent, self.period)
        return Observation(until + self.lag, x)

    def _asked(self, t: float, x: Array, plans: PolicyQueue) -> Array:
        policy = plans.at(t)
        assert policy is not None
        return policy(t, x) if self.feedback else policy.feedforward(t + 0.5 * self.period + self.lag)

    def _limited(self, sent: Array, u: Array) -> Array:
        """The way from ``sent`` to ``u`` as far as it may change within a period, all inputs by the same share."""
        step = u - sent
        return np.asarray(sent + step / max(1.0, float(np.max(np.abs(step) / self._step))))

    def command(self, t: float, plans: PolicyQueue) -> InputCommand:
        """Inputs for this tick; a stop once the plan has run out."""
        policy = plans.current
        assert policy is not None
        if t > policy.end:
            return self.stop()
        self._note(self._limited(self.sent, self._asked(t, self.state(), plans)))
        return InputCommand(self.sent, np.zeros(1))

    def stop(self) -> InputCommand:
        """Everything at rest."""
        self._note(np.zeros_like(self.sent))
        return InputCommand(self.sent, np.ones(1))

    def _note(self, sent: Array) -> None:
        self.sent = sent
        self._rates = self._rates + self._blend * (sent - self._rates)
