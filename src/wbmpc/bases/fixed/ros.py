"""An arm on a base that does not move, on a ROS 2 bus: speeds out, joint states in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.common.ros import SpeedRosAdapter
from wbmpc.bases.common.ros_settings import FixedRosSettings
from wbmpc.bases.optional import mounting
from wbmpc.control.direct import DirectController, InputCommand, StateMeasurement
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Reference
from wbmpc.ros2.base_adapter import Estimate, Groups
from wbmpc.ros2.goals import Task
from wbmpc.ros2.joints import Inertial, JointSample


@dataclass(frozen=True)
class BusMeasurement(StateMeasurement):
    """``origin`` [s]: where the runner's clock has its zero, on the one behind it."""

    origin: float = 0.0


class FixedRosAdapter(SpeedRosAdapter):
    """See :class:`wbmpc.ros2.base_adapter.BaseAdapter`. The pose of the base is that of the robot's file."""

    watches = "joints"
    controller: DirectController

    def __init__(self, robot: RobotModel, settings: FixedRosSettings, period: float) -> None:
        super().__init__(robot, settings)
        lag = settings.actuator_time_constant
        self.controller = DirectController(robot, self.mpc, period, lag, rate=robot.limits.input_rate)
        self._rest = {"arm": np.zeros(robot.input.size)}

    def groups(self, command: InputCommand) -> Groups:
        return {"arm": command.input}

    # ------------------------------------------------------------------ states
    def measurement(
        self, now: float, at: float, sample: JointSample, imu: Inertial | None, origin: float = 0.0
    ) -> StateMeasurement:
        """Joint states, read at ``at`` [s] of the runner's clock, whose zero is at ``origin`` [s]."""
        return BusMeasurement(at, sample.groups["arm"], origin)

    def stand(self, measurement: StateMeasurement) -> None:
        """Follow the joints while they are not commanded."""
        self.controller.measure(measurement)

    def snapshot(self) -> tuple[float, Array] | None:
        """Time [s] of the runner's clock and the state (nx) measured for it; from any thread. None before the first."""
        seen = self.controller.measured
        if seen is None:
            return None
        assert isinstance(seen, BusMeasurement)
        return self.on_runners_clock(seen.time + seen.origin), seen.state

    # ------------------------------------------------------------------ tasks
    def references(self, task: Task, x: Array) -> dict[str, Reference]:
        """For the terms ``end_effector``, ``state`` and ``input``; the arm likes its home."""
        effector = task.end_effector
        return {
            "end_effector": Reference.poses(effector.times, effector.positions, effector.orientations),
            "state": Reference.constant(self.robot.home),
            "input": Reference.constant(np.zeros(self.robot.input.size)),
        }

    # ------------------------------------------------------------------ what is reported
    def estimate(self) -> Estimate | None:
        """Where the base stands: exact, at rest."""
        if self.controller.measured is None:
            return None
        none = np.zeros((6, 6))
        return Estimate(*mounting(self.robot.base), np.zeros(6), none, none)
