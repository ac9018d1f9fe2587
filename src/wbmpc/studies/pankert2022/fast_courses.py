"""Courses of `swerve-fast`: how they are ordered, and how far a run is off them."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.scene import SceneObstacle
from wbmpc.obstacles.shapes import Cylinder
from wbmpc.ocp import Path, Reference
from wbmpc.result import Metric
from wbmpc.settings import Settings
from wbmpc.tasks.following import states_along
from wbmpc.tasks.obstacles import Extent
from wbmpc.tasks.path_settings import follow
from wbmpc.tasks.paths import nearest_distance

#: What moves is at its goal [m]: an end effector that is sent to a point, a base at the end of a path, which its odometry measures.
AT_GOAL, AT_END = 0.010, 0.030
#: Points of a curve.
POINTS, DENSE = 400, 4001
#: Of the dense points of a curve one of so many has its heading compared.
HEADINGS = 10
UP = (0.0, 0.0, 1.0)
#: Radius [m] of a pillar of the slalom, its height over that of what is lower than most of the arm, how far [m] it is moved for a seed,
#: and how much farther [m] the path goes around it.
PILLAR, HIGH, SHIFT, ASIDE = 0.1, 0.9, 0.1, 0.1


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
    AFTER: ClassVar[float] = 5.0
    FOLLOWS: ClassVar[Literal["base"] | None] = None
    ROLLING: ClassVar[float] = np.pi / 2

    @property
    def idealizations(self) -> list[str]:
        """What this course adds to those of all closed loops."""
        return []

    def scene(self, robot: RobotModel, seed: int) -> list[SceneObstacle] | None:
        """What stands around the robot: nothing."""
        return None

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


class BasePath(Settings):
    """The base follows a path at its own speed and heads along it. ``length`` [m] ahead; ``speed`` [m/s] along the path: the desired one;
    ``acceleration`` [m/s²]: of progress, at most; ``drives``: factor on the robot's limits of speed and acceleration of wheels and base."""

    length: float = Field(4.0, ge=0.5, le=100)
    speed: float = Field(2.0, ge=0.1, le=10)
    acceleration: float = Field(2.5, ge=0.1, le=50)
    drives: float = Field(2.2, ge=0.5, le=10)

    AFTER: ClassVar[float] = 5.0
    FOLLOWS: ClassVar[Literal["base"] | None] = "base"
    ROLLING: ClassVar[float] = 0.0

    @property
    def idealizations(self) -> list[str]:
        """What this course adds to those of all closed loops."""
        return [f"the drives of wheels and base are {self.drives:g} times as fast as the robot's own"]

    def scene(self, robot: RobotModel, seed: int) -> list[SceneObstacle] | None:
        """What stands around the robot: nothing."""
        return None

    def curve(self) -> Array:
        """Poses (n, 3) [m, m, rad] of the base."""
        return headed(self.turns(), self.length)

    def turns(self) -> list[tuple[float, float]]:
        """Points of the path at which it runs straight ahead: x and y [m], from its start on."""
        raise NotImplementedError

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
        poses = self.curve()
        height = robot.pose(robot.home, mpc.path.frame)[0][2]
        points = np.column_stack([poses[:, :2], np.full(POINTS, height)])
        path = Path(points, np.array([lie.quaternion_about(UP, float(yaw)) for yaw in poses[:, 2]]))
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        mpc.path.follow(path, self.speed, self.acceleration, along={"state": states_along(robot, arc, poses)})

    def metrics(self, log: Log, ordered: float, robot: RobotModel) -> dict[str, Metric]:
        """Of the base from ``ordered`` [s] on."""
        poses = self.curve()
        times, base = log.times("base"), log.array("base")[:, :2]
        late = times >= ordered
        dense = np.linspace(0.0, self.length, DENSE)
        line = np.stack([np.interp(dense, poses[:, 0], poses[:, k]) for k in range(2)], axis=1)
        nearest = np.linalg.norm(base[late, None] - line[None, ::HEADINGS], axis=2).argmin(axis=1)
        headings = np.interp(dense[::HEADINGS][nearest], poses[:, 0], poses[:, 2])
        return {
            "time_to_goal": Metric(time_to_goal(times[late], base[late], poses[-1, :2], ordered, AT_END), "s"),
            "path_error_max": Metric(float(nearest_distance(base[late], line).max()), "m"),
            "heading_error_max": Metric(float(np.abs(log.array("base")[late, 2] - headings).max()), "rad"),
        }


class SCurve(BasePath):
    """The base goes to the side and back again while it drives ahead; the curvature of its path is zero at both ends and changes steadily.
    ``width`` [m] to the side.

    Wheels 0.9 m from the base's center limit how fast it turns, not grip: the faster drives allow one that heads along its path 2.9 s at
    the least, and the floor alone 2.5 s. So heading weighs less than by default."""

    kind: Literal["s-curve"] = "s-curve"
    width: float = Field(0.8, ge=0.0, le=10)

    WEIGHTS: ClassVar[dict[str, float]] = {
        "input": 0.05,
        "contour": 20.0,
        "contour.orientation": 0.1,
        "progress": 10.0,
    }
    GOALS: ClassVar[dict[str, float]] = {
        "time_to_goal": 2.4,
        "path_error_max": 0.015,
        "wheel_slip_max": 0.05,
        "time_unloaded": 0.1,
    }

    def turns(self) -> list[tuple[float, float]]:
        """To the side, and back."""
        return [(0.0, 0.0), (0.5 * self.length, self.width), (self.length, 0.0)]


class Slalom(BasePath):
    """The base winds through low pillars that stand to its right and left in turn; the arm passes above them. They are a little elsewhere
    than the path was made for. ``pillars``: number of pillars; ``first`` [m]: how far ahead the first one stands; ``spacing`` [m] between
    two; ``overlap`` [m]: how far each stands in the way of a base that goes straight."""

    kind: Literal["slalom"] = "slalom"
    length: float = Field(9.5, ge=0.5, le=100)
    first: float = Field(3.0, ge=0.5, le=100)
    pillars: int = Field(3, ge=1, le=50)
    spacing: float = Field(2.4, ge=0.2, le=20)
    overlap: float = Field(0.1, ge=-1.0, le=1.0)

    WEIGHTS: ClassVar[dict[str, float]] = {"input": 0.05, "contour": 0.1, "progress": 10.0}
    GOALS: ClassVar[dict[str, float]] = {"wheel_slip_max": 0.05, "time_unloaded": 0.1}
    AFTER: ClassVar[float] = 9.0

    def turns(self) -> list[tuple[float, float]]:
        """Past each pillar on its free side."""
        aside = self.overlap + ASIDE
        past = [(self.first + self.spacing * k, -aside if k % 2 else aside) for k in range(self.pillars)]
        return [(0.0, 0.0), *past, (self.length, 0.0)]

    def scene(self, robot: RobotModel, seed: int) -> list[SceneObstacle]:
        """The pillars, each for the seed a little elsewhere."""
        e, rng = Extent(robot, self.kind), np.random.default_rng(seed)
        found = []
        for k in range(self.pillars):
            aside = e.base_high[1] + PILLAR - self.overlap if k % 2 else e.base_low[1] - PILLAR + self.overlap
            place = np.array([self.first + self.spacing * k, aside, e.ground]) + [*rng.uniform(-SHIFT, SHIFT, 2), 0.0]
            high = HIGH * (e.top - e.ground)
            found.append(SceneObstacle(f"pillar{k}", Cylinder((0, 0, 0), (0, 0, high), PILLAR), {"position": place}))
        return found

    def metrics(self, log: Log, ordered: float, robot: RobotModel) -> dict[str, Metric]:
        """Of the base from ``ordered`` [s] on: it leaves its path to evade."""
        found = super().metrics(log, ordered, robot)
        del found["path_error_max"]
        return found


def headed(turns: list[tuple[float, float]], length: float) -> Array:
    """Poses (n, 3) [m, m, rad] along a path over ``length`` [m] ahead that goes through ``turns``, x and y [m], by quintic steps, and heads
    along itself."""
    x = np.linspace(0.0, length, POINTS)
    places, aside = np.array(turns).T
    k = np.clip(np.searchsorted(places, x, side="right") - 1, 0, len(places) - 2)
    wide = np.maximum(places[k + 1] - places[k], 1e-9)
    share, step = np.clip((x - places[k]) / wide, 0.0, 1.0), aside[k + 1] - aside[k]
    y = aside[k] + step * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    slope = step / wide * 30.0 * share**2 * (1.0 - share) ** 2
    return np.stack([x, y, np.arctan(slope)], axis=1)


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
