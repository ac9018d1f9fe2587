"""What experiments with a path have in common: its settings, how it is followed by a clock or at the robot's own speed, its metrics."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from pydantic import Field

from wbmpc.arrays import Array
from wbmpc.configuration import OneOf
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Path, Reference
from wbmpc.result import Metric
from wbmpc.settings import Settings
from wbmpc.tasks.arm_reach import reached_share
from wbmpc.tasks.path_settings import AnyPath, Line, carried_base, duration, follow, timed
from wbmpc.tasks.paths import nearest_distance
from wbmpc.tasks.settings import TaskSettings

_LOG = logging.getLogger(__name__)
#: The end of a path is reached within this [m]; points of a path that errors are measured to; of a table of the base beside it.
THERE, DENSE, TABLE = 0.01, 4001, 501
#: How many times the clock's time a robot at its own speed is given.
PATIENCE = 2.0


class ClockReference(Settings):
    """The reference moves at the path's speed whatever the robot does."""

    kind: Literal["clock"] = "clock"


class ProgressReference(Settings):
    """The path's speed is the desired one, and the robot goes as fast as limits and obstacles allow. ``time_limit`` [s]: of the path (left
    out: twice the time at the desired speed)."""

    kind: Literal["progress"] = "progress"
    time_limit: float | None = Field(None, gt=0, le=3600)


class PathTaskSettings(TaskSettings):
    """``path``: a line, circle, sine, poses, or the table of a csv file; ``reference``: of a clock (:class:`ClockReference`), or the
    progress along the path (:class:`ProgressReference`)."""

    path: AnyPath = Line()
    reference: OneOf[ClockReference | ProgressReference] = ClockReference()


class Task:
    """A path from the robot's home on, set as the task of an MPC: ``end`` [s] of the run."""

    def __init__(self, settings: PathTaskSettings, obstacles: bool = False) -> None:
        progress = isinstance(settings.reference, ProgressReference)
        self.robot, self.mpc = robot, mpc = settings.prepare(obstacles, progress="end_effector" if progress else None)
        given, self._since = settings.path, settings.settle_time
        start = mpc.path.pose(0.0) if progress else mpc.reference["end_effector"].at(0.0)
        self.path = given.smooth(robot, start[:3], start[3:])
        if not robot.description.base.moves:
            _warn_of_reach(robot, self.path)
        self._least = duration(self.path.length, given.speed)  # no robot is earlier
        if isinstance(settings.reference, ProgressReference):
            self.end = self._since + (settings.reference.time_limit or PATIENCE * (self._least + given.ramp))
            speed = Reference(np.array([0.0, self._since]), np.array([[0.0], [given.speed]]), "hold")
            along = {"state": beside(robot, self.path)} if _base_goes_along(robot, mpc) else None
            mpc.path.follow(self.path, speed, given.speed / given.ramp, along=along)
        else:
            curve = given.curve(robot, start[:3], start[3:])
            reference, end = timed(curve, given.speed, given.ramp, self._since)
            self.end = end + 1.0
            follow(robot, mpc, reference)

    def metrics(self, log: Log) -> dict[str, Metric]:
        """When the end effector is at the end of the path and how far off the path it was up to there, whenever that was."""
        t, tool = log.times("end_effector"), log.array("end_effector")
        last = self.path.at([self.path.length])[0, :3]
        there = (t >= self._since + 0.9 * self._least) & (np.linalg.norm(tool - last, axis=1) <= THERE)
        arrival = float(t[np.argmax(there)]) if there.any() else np.inf
        dense = self.path.at(np.linspace(0.0, self.path.length, DENSE))[:, :3]
        counted = (t >= self._since) & (t <= arrival)  # none in a run that ended before its task began
        off = nearest_distance(tool[counted], dense) if counted.any() else np.array([np.inf])
        return {
            "path_time": Metric(arrival - self._since, "s"),
            "contour_error_rms_world": Metric(float(np.sqrt(np.mean(off**2))), "m"),
            "contour_error_max_world": Metric(float(off.max()), "m"),
        }


def _warn_of_reach(robot: RobotModel, path: Path) -> None:
    """Where a path leaves what the arm of a robot whose base stands can reach."""
    poses = path.at(np.linspace(0.0, path.length, TABLE))
    share = reached_share(robot, poses[:, :3], poses[:, 3:])
    if share < 1.0:
        _LOG.warning(
            "path: the arm of '%s' can follow %.2g m of its %.3g m; give a shorter 'path.length' or another 'path.direction' (left out, a "
            "length is chosen that it can follow)",
            robot.description.name,
            share * path.length,
            path.length,
        )


def _base_goes_along(robot: RobotModel, mpc: MPC) -> bool:
    """Whether the problem has a reference of the base."""
    references: Any = mpc.reference
    return "state" in references and "base" in robot.state and references["state"].values.shape[1] == robot.state.size


def beside(robot: RobotModel, path: Path) -> Callable[[Array], Array]:
    """States (n, nx) at arc lengths (n) [m]: home, with the base where it carries the end effector along the path."""
    s = np.linspace(0.0, path.length, TABLE)
    return states_along(robot, s, carried_base(robot, path.at(s)))


def states_along(robot: RobotModel, arc: Array, base: Array) -> Callable[[Array], Array]:
    """States (n, nx) at arc lengths (n) [m]: home, with the base at poses (k, 3) of the lengths ``arc`` (k) [m], straight between them."""
    part = robot.state["base"].start

    def states(at: Array) -> Array:
        values = np.tile(robot.home, (len(at), 1))
        for k in range(3):
            values[:, part + k] = np.interp(at, arc, base[:, k])
        return values

    return states
