"""Courses of `swerve-fast`: how they are ordered, and how far a run is off them."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from wbmpc import lie
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Path, Reference
from wbmpc.result import Metric
from wbmpc.settings import Settings
from wbmpc.tasks.path_settings import follow
from wbmpc.tasks.paths import nearest_distance

Array = np.ndarray
#: What moves is at its goal [m]: an end effector that is sent to a point, a base at the end of a path, which its odometry measures.
AT_GOAL, AT_END = 0.010, 0.030
#: Points of a curve.
POINTS, DENSE = 400, 4001
UP = (0.0, 0.0, 1.0)


class Sideways(Settings):
    """The end effector goes straight to a goal, to the side of the arm, as fast as plans choose. ``length`` [m] of the way.

    Speeds weigh more and the end effector less than by default: what is only pulled by its distance from the goal comes to it too fast to
    stop there."""

    kind: Literal["sideways"] = "sideways"
    length: float = Field(2.0, ge=0.1, le=100)

    WEIGHTS: ClassVar[dict[str, float]] = {"end_effector": 0.2, "input": 12.0}
    GOALS: ClassVar[dict[str, float]] = {
        "time_to_goal": 2.7,
        "tilt_max": float(np.deg2rad(0.05)),
        "time_unloaded": 0.1,
    }
    FOLLOWS: ClassVar[Literal["base"] | None] = None
    ROLLING: ClassVar[float] = np.pi / 2

    @property
    def idealizations(self) -> list[str]:
        """What this course adds to those of all closed loops."""
        return []

    def equipped(self, robot: RobotModel) -> RobotModel:
        """The robot as it is."""
        return robot

    def order(self, t: float, robot: RobotModel, mpc: MPC) -> None:
        """Give ``mpc`` the goal at ``t`` [s]: no plan sees it before."""
        position, turn = robot.pose(robot.home)
        follow(robot, mpc, Reference.poses([t], [position + [0.0, self.length, 0.0]], turn, hold=True))

    def metrics(self, log: Log, ordered: float, robot: RobotModel) -> dict[str, Metric]:
        """Of the end effector from ``ordered`` [s] on."""
        start = robot.pose(robot.home)[0]
        goal = start + np.array([0.0, self.length, 0.0])
        times, tool = log.times("end_effector"), log.array("end_effector")
        late = times >= ordered
        return {
            "time_to_goal": Metric(time_to_goal(times[late], tool[late], goal, ordered, AT_GOAL), "s"),
            "path_error_max": Metric(path_error(tool[late], start, goal), "m"),
        }


class SCurve(Settings):
    """The base goes to the side and back again while it drives ahead, and heads along its path, whose curvature is zero at both ends and
    changes steadily. ``length`` [m] ahead; ``width`` [m] to the side; ``speed`` [m/s] along the path: the desired one; ``acceleration`` [m/s²]:
    of progress, at most; ``drives``: factor on the robot's limits of speed and acceleration of wheels and base."""

    kind: Literal["s-curve"] = "s-curve"
    length: float = Field(4.0, ge=0.5, le=100)
    width: float = Field(0.8, ge=0.0, le=10)
    speed: float = Field(2.0, ge=0.1, le=10)
    acceleration: float = Field(4.0, ge=0.1, le=50)
    drives: float = Field(2.2, ge=0.5, le=10)

    WEIGHTS: ClassVar[dict[str, float]] = {"input": 0.05, "contour": 10.0, "progress": 10.0}
    GOALS: ClassVar[dict[str, float]] = {"path_error_max": 0.015, "wheel_slip_max": 0.05, "time_unloaded": 0.1}
    FOLLOWS: ClassVar[Literal["base"] | None] = "base"
    ROLLING: ClassVar[float] = 0.0

    @property
    def idealizations(self) -> list[str]:
        """What this course adds to those of all closed loops."""
        return [f"the drives of wheels and base are {self.drives:g} times as fast as the robot's own"]

    def curve(self) -> Array:
        """Poses (n, 3) [m, m, rad] of the base."""
        x, half = np.linspace(0.0, self.length, POINTS), 0.5 * self.length
        back = x > half
        share = np.where(back, self.length - x, x) / half
        aside = self.width * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        slope = self.width / half * 30.0 * share**2 * (1.0 - share) ** 2 * np.where(back, -1.0, 1.0)
        return np.stack([x, aside, np.arctan(slope)], axis=1)

    def equipped(self, robot: RobotModel) -> RobotModel:
        """The robot with its limits of wheels and base times ``drives``; its simulated drives follow them."""
        own = robot.description.limits
        wheels = robot.input.groups["wheel"]
        faster = lambda values: {n: v * (self.drives if n in wheels else 1.0) for n, v in values.items()}
        limits = own.model_copy(
            update={
                "base_linear": self.drives * own.base_linear,
                "base_angular": self.drives * own.base_angular,
                "velocity": faster(own.velocity),
                "acceleration": faster(own.acceleration),
            }
        )
        return RobotModel(robot.description.model_copy(update={"limits": limits}))

    def order(self, t: float, robot: RobotModel, mpc: MPC) -> None:
        """Let ``mpc`` follow the path from ``t`` [s] on: no plan sees it before."""
        poses, base = self.curve(), robot.state["base"].start
        height = robot.pose(robot.home, mpc.path.frame)[0][2]
        points = np.column_stack([poses[:, :2], np.full(POINTS, height)])
        path = Path(points, np.array([lie.quaternion_about(UP, float(yaw)) for yaw in poses[:, 2]]))
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])

        def states(s: Array) -> Array:
            values = np.tile(robot.home, (len(s), 1))
            for k in range(3):
                values[:, base + k] = np.interp(s, arc, poses[:, k])
            return values

        mpc.path.follow(path, self.speed, self.acceleration, along={"state": states})

    def metrics(self, log: Log, ordered: float, robot: RobotModel) -> dict[str, Metric]:
        """Of the base from ``ordered`` [s] on."""
        poses = self.curve()
        times, base = log.times("base"), log.array("base")[:, :2]
        late = times >= ordered
        dense = np.linspace(0.0, self.length, DENSE)
        line = np.stack([np.interp(dense, poses[:, 0], poses[:, k]) for k in range(2)], axis=1)
        return {
            "time_to_goal": Metric(time_to_goal(times[late], base[late], poses[-1, :2], ordered, AT_END), "s"),
            "path_error_max": Metric(float(nearest_distance(base[late], line).max()), "m"),
        }


def time_to_goal(times: Array, positions: Array, goal: Array, ordered: float, near: float) -> float:
    """Time [s] from the order at ``ordered`` [s] until positions (n, d) [m] at ``times`` (n) [s] stay within ``near`` [m] of the ``goal``
    (d); no number if they do not."""
    away = np.flatnonzero(np.linalg.norm(positions - goal, axis=1) > near)
    first = int(away[-1]) + 1 if away.size else 0
    return float(times[first] - ordered) if first < len(times) else float("nan")


def path_error(positions: Array, start: Array, goal: Array) -> float:
    """Largest distance [m] of positions (n, 3) from the straight way from ``start`` to ``goal`` (3 each)."""
    way = goal - start
    share = np.clip((positions - start) @ way / (way @ way), 0.0, 1.0)
    return float(np.linalg.norm(positions - start - share[:, None] * way, axis=1).max())
