"""Wheels turn first, for swerve bases that go along a path at their own speed: the motion that is foreseen is the path's.

At standstill the linearized rolling rows do not see the steering angles, and progress does not run away as a clock does: without a guess
a base whose wheels point across its path would wait for good.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.steering_planner import SteeringGuess, speed
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.path import Following, PathProgress
from wbmpc.solver import Trajectory

if TYPE_CHECKING:
    from wbmpc.mpc.mpc import MPC

#: Way [m] over which the base's direction on the path is measured.
WAY = 1e-3


class PathGuess:
    """Callable for :class:`wbmpc.mpc.mpc.MPC` (``guess=``): the base goes as the path's references of the state (``along``) say."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self._base = robot, robot.state["base"]
        self._guess = SteeringGuess(robot, self.preview)
        self._path: PathProgress | None = None

    def bind(self, mpc: MPC) -> None:
        """Whose path it is."""
        self._path = mpc.path
        self._guess.bind(mpc)

    def _following(self) -> Following | None:
        following = None if self._path is None else self._path.following
        return following if following is not None and "state" in following.along else None

    def __call__(self, t: float, x0: Array, trajectory: Trajectory) -> Trajectory | None:
        if self._following() is None:
            return None
        found = self._guess(t, x0, trajectory)
        if found is not None and self._path is not None:
            # progress where the base moves
            moving = speed(found.u[:, self.robot.input["base"]]) > 0.0
            rate = np.append(np.diff(self._path.desired(t, found.grid)), 0.0)
            self._path.write(found, np.concatenate([[0.0], np.cumsum(np.where(moving, rate[:-1], 0.0))]))
        return found

    def preview(self, times: Array, pose: Array) -> Array:
        """Body twists (n, 3) of the base at ``times`` (n) [s], of which the first is now."""
        following = self._following()
        assert following is not None and self._path is not None
        since = times - times[0]
        s, h = self._path.desired(float(times[0]), since), 1e-2
        rate = (self._path.desired(float(times[0]), since + h) - s) / h
        at, ahead = (following.along["state"](v)[:, self._base] for v in (s, s + WAY))
        way = (ahead - at) / WAY * rate[:, None]
        c, q = np.cos(at[:, 2]), np.sin(at[:, 2])
        return np.stack([c * way[:, 0] + q * way[:, 1], c * way[:, 1] - q * way[:, 0], way[:, 2]], axis=1)
