"""Robots on a ROS 2 bus whose drives take speeds and whose problem is the default one."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.default_problem import DefaultCost, default_problem, keep_clear, stay_at_home
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import OptimalControlProblem, Reference
from wbmpc.ros2.base_adapter import BaseAdapter, Groups, PendingChanges, obstacles_of
from wbmpc.ros2.goals import Planner, Task
from wbmpc.ros2.settings import drive_groups


def references_of(task: Task, robot: RobotModel) -> dict[str, Reference]:
    """For the terms ``end_effector``, ``state`` and ``input`` of a base in the plane; the arm, and what else the base has, like their home."""
    base, effector = task.base, task.end_effector
    states = np.tile(robot.home, (base.times.size, 1))
    states[:, robot.state["base"]] = base.poses
    inputs = np.zeros((base.times.size, robot.input.size))
    inputs[:, robot.input["base"]] = base.twists @ np.linalg.pinv(robot.base.twist).T
    return {
        "end_effector": Reference.poses(effector.times, effector.positions, effector.orientations),
        "state": Reference(base.times, states),
        "input": Reference(base.times, inputs),
    }


class SpeedRosAdapter(BaseAdapter):
    """See :class:`wbmpc.ros2.base_adapter.BaseAdapter`. A base type makes the ``controller``, which :meth:`begin` stops between runs."""

    settings: Any  # with the default problem's ``mpc`` and ``cost``
    controller: Any

    def __init__(self, robot: RobotModel, settings: Any) -> None:
        self.robot, self.settings = robot, settings
        self.planner = Planner(robot, settings.speeds, settings.goals)
        self.pending, self.obstacles = PendingChanges(), obstacles_of(settings)
        problem = keep_clear(self.problem(settings.cost), robot, self.obstacles)
        solver, rate = settings.mpc.solver(), settings.mpc.rate
        self.mpc = MPC(problem, solver, rate, guess=self.pending, obstacles=self.obstacles)
        stay_at_home(robot, self.mpc)
        self.pending.bind(self.mpc)
        self._rest = {g: np.zeros(len(names)) for g, names in drive_groups(robot).items()}
        robot.pose(robot.home)  # builds the function: not in a tick

    def problem(self, cost: DefaultCost) -> OptimalControlProblem:
        """The controller's problem with other weights."""
        return default_problem(self.robot, self.settings.mpc, cost)

    def rest(self) -> Groups:
        """Everything at rest."""
        return self._rest

    def begin(self, x: Array) -> None:
        """A new run; odometry goes on."""
        self.controller.stop()
        self.mpc.reset(x)
