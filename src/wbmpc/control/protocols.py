"""What controllers are: the protocols that loops, real-time runners and base types ask, and nothing else.

A controller is assembled from parts: an estimator, monitors, the prediction over the delay, the law that follows a policy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from wbmpc.control.monitor import Fault, Monitor
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.types import Observation

if TYPE_CHECKING:
    from wbmpc.model.robot import RobotModel

__all__ = ["Controller", "Fault", "Monitor", "RobotController"]


#: Messages of one robot: what its controller reads and what it returns.
MeasurementT = TypeVar("MeasurementT", contravariant=True)
CommandT = TypeVar("CommandT", covariant=True)


class Controller(Protocol[MeasurementT, CommandT]):
    """What stands between measurements, MPC and commands of one robot, as the real-time runner asks it. Times in s."""

    def measure(self, measurement: MeasurementT) -> None:
        """Process the measurement of this tick."""

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """The state for which the next policy is computed: at ``until`` [s], under the policies that are active from ``t`` [s] until then."""

    def command(self, t: float, plans: PolicyQueue) -> CommandT:
        """The command for the tick at ``t`` [s]."""


class RobotController(Controller[MeasurementT, CommandT], Protocol):
    """A controller of a ``robot`` whose state views and experiments show, and which they stop."""

    robot: RobotModel

    @property
    def faults(self) -> Sequence[Fault]:
        """What was found in this run: of sensors, brakes, forces."""

    def state(self) -> NDArray[np.float64]:
        """The state (nx) as estimated at the last measurement."""

    def stop(self) -> CommandT:
        """The command that brings the robot to rest."""
