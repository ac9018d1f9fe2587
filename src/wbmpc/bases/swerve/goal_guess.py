"""Wheels turn first: a guess for swerve bases with goals that are not known in advance.

At standstill the linearized rolling rows do not see the steering angles, so a base whose wheels point across its way would stay
where it is (see :mod:`wbmpc.bases.swerve.steering_planner`, which needs a preview of the motion: here it is the straight way to the goal).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.steering_planner import LEVER, SteeringGuess
from wbmpc.model.robot import RobotModel
from wbmpc.solver import Trajectory

if TYPE_CHECKING:
    from wbmpc.mpc.mpc import MPC

#: Speed [m/s] of the way that is foreseen, its least time [s]; a goal nearer than this [m] is reached.
SPEED, MINIMUM, THERE = 0.4, 1.0, 0.03


class GoalGuess:
    """Callable for :class:`wbmpc.mpc.mpc.MPC` (``guess=``): the base's goal is the present reference of the state."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self._base = robot, robot.state["base"]
        self.goal = robot.home[self._base].copy()
        self._guess = SteeringGuess(robot, self.preview)
        self._mpc: MPC | None = None

    def bind(self, mpc: MPC) -> None:
        """Whose reference the goal is."""
        self._mpc = mpc
        self._guess.bind(mpc)

    def __call__(self, t: float, x0: Array, trajectory: Trajectory) -> Trajectory | None:
        assert self._mpc is not None, "the guess of an MPC"
        goal = self._mpc.reference["state"].at(t)[self._base]
        if _size(goal - self.goal) > THERE:
            self.goal, self._guess = goal.copy(), SteeringGuess(self.robot, self.preview)
            self._guess.bind(self._mpc)
        return self._guess(t, x0, trajectory)

    def preview(self, times: Array, pose: Array) -> Array:
        """Body twists (n, 3) of a straight way with a cosine's profile from ``pose`` (3) now to the goal."""
        way = self.goal - pose
        if _size(way) < THERE:
            return np.zeros((len(times), 3))
        length = max(0.5 * np.pi * _size(way) / SPEED, MINIMUM)
        share = np.clip((times - times[0]) / length, 0.0, 1.0)
        yaw = pose[2] + 0.5 * (1.0 - np.cos(np.pi * share)) * way[2]
        rate, c, s = 0.5 * np.pi / length * np.sin(np.pi * share), np.cos(yaw), np.sin(yaw)
        return rate[:, None] * np.stack([c * way[0] + s * way[1], c * way[1] - s * way[0], way[2] + 0.0 * c], axis=1)


def _size(way: Array) -> float:
    return float(np.hypot(way[0], way[1]) + LEVER * abs(way[2]))
