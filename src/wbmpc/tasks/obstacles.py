"""`obstacles-static`, `obstacles-moving`, `obstacles-sudden`, `corridor`, `clutter`: any robot that moves follows a path among obstacles.

Scenes are as large as the robot: they are laid out about what its shapes take up at home. Plans know shape, place and velocity of what
is there, and nothing of what has not appeared yet.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.configuration import OneOf
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.route import base_part
from wbmpc.obstacles.geometry import RobotShape, robot_geometry
from wbmpc.obstacles.scene import SceneObstacle
from wbmpc.obstacles.shapes import Box, Capsule, Cylinder
from wbmpc.ocp import Reference
from wbmpc.result import Metric
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.following import ClockReference, PathTaskSettings, ProgressReference, Task
from wbmpc.tasks.loop import Hooks, Surroundings, closed_loop
from wbmpc.tasks.path_settings import AnyPath, Line, carried_base
from wbmpc.tasks.perception import PerceptionSettings

#: A person: radius and height [m].
PERSON = (0.2, 1.8)
#: People are seen from so far [m] and for so long [s] before they cross the robot's path: who walks slowly does not appear right beside a
#: robot that evades another one.
SEEN_FROM, SEEN_FOR = 4.0, 4.0
#: How exactly plans know people [m], [m/s]: as from a LIDAR.
SEEN_AS = {"std": 0.015, "velocity_std": 0.02}
UP = (0.0, 0.0, 1.0)
#: A corridor begins so far [m] ahead of the robot; over how much of the way [m] the end effector swings ahead of the base.
ENTRY, SWING = 1.0, 0.8
#: How far [m] a pillar and a shelf stand in the way of the base that would go straight.
IN_THE_WAY = 0.05
#: Share of the end effector's height that things have at most which stand in the way of the base alone.
LOW = 0.6
#: Way [m] between the end of the robot and what is in its way next.
PAST = 0.4


class PatientClock(ClockReference):
    """``patience`` [s]: how long the path of a clock may wait for the robot in all."""

    patience: float = Field(6.0, ge=0.0, le=600.0)


class Among(PathTaskSettings):
    """``obstacles``: another scene than the experiment's own; ``when_stuck``: what a robot does whose plans lead no farther:
    "alternatives" tries others (of bases that move and do not balance), "wait" does not."""

    path: AnyPath = Line(length=4.0)
    reference: OneOf[PatientClock | ProgressReference] = PatientClock()
    when_stuck: Literal["alternatives", "wait"] = "alternatives"


#: Speed of a person who crosses [m/s].
Speed = Annotated[float, Field(ge=0.01, le=10)]
#: Of a person's direction to the path's [rad].
Angle = Annotated[float, Field(ge=0.0, le=3.15)]


class Moving(Among):
    """``people``: number of people that walk; ``speeds`` [m/s]: the smallest and the largest of theirs; ``angles`` [rad]: the smallest
    and the largest to the path, to its left or right; 0 comes from behind, pi head-on."""

    people: int = Field(4, ge=1, le=50)
    speeds: tuple[Speed, Speed] = (0.2, 1.5)
    angles: tuple[Angle, Angle] = (0.25 * np.pi, 0.75 * np.pi)


class Sudden(Among):
    """A pillar appears ``ahead`` [m] of the robot's foremost part, when it has its full speed."""

    path: AnyPath = Line(length=4.0, speed=0.4)
    ahead: float = Field(0.4, ge=0.0, le=10.0)


class Corridor(Among):
    """``width`` [m]: between the walls; ``long`` [m]: length of the walls; ``offset`` [m]: of its middle, to the left of where the
    robot would go; ``angle`` [rad]: angle by which the corridor turns to the left; ``closed``: a dead end; ``chicane`` [m]: after a gap
    as long as the robot another corridor goes on so far to the left (negative: right). The end effector swings ahead of the base before
    it enters."""

    path: AnyPath = Line(length=5.0, speed=0.25)
    width: float = Field(0.9, ge=0.1, le=100.0)
    long: float = Field(2.0, ge=0.1, le=100.0)
    offset: float = Field(0.05, ge=-10.0, le=10.0)
    angle: float = Field(0.0, ge=-0.8, le=0.8)
    closed: bool = False
    chicane: float = Field(0.0, ge=-10.0, le=10.0)


class Clutter(Among):
    """``count`` pillars and boxes at random beside the way and partly in it (left out: so many that the robot is past one in its way before the
    next); plans know only what ``perception`` sees of them."""

    path: AnyPath = Line(length=4.0, speed=0.3)
    count: int | None = Field(None, ge=1, le=100)
    perception: PerceptionSettings = PerceptionSettings()


class Extent:
    """What a robot takes up at home, in its own world: ``low`` and ``high`` (3) [m] of its shapes, ``tool`` (3) and ``base`` (3: x, y, yaw)."""

    def __init__(self, robot: RobotModel, task: str) -> None:
        self.base = robot.home[base_part(robot, task)]
        self.tool = np.asarray(robot.pose(robot.home)[0])
        self.ground = robot.description.base.ground
        geometry = robot_geometry(robot)
        centers, axes = (v[0] for v in geometry.at(*geometry.kinematics(robot.home[None])))
        parts = list(zip(geometry.shapes, centers, axes, strict=True))
        self.low, self.high = _box(parts)
        #: of what is lower than most of the arm
        self.top = self.ground + LOW * (self.tool[2] - self.ground)
        self.base_low, self.base_high = _box([part for part in parts if _box([part])[0][2] < self.top] or parts)


def _box(parts: list[tuple[RobotShape, Array, Array]]) -> tuple[Array, Array]:
    """Lower and upper ends (3) [m] of shapes at centers with axes."""
    ends = [
        max(float(c @ direction + _reach(s.solid, direction @ a)) for s, c, a in parts)
        for direction in (*-np.eye(3), *np.eye(3))
    ]
    return -np.array(ends[:3]), np.array(ends[3:])


def _reach(solid: object, direction: Array) -> float:
    return float(solid.support(direction[None])[0] @ direction)  # type: ignore[attr-defined]


def static_scene(settings: Among, robot: RobotModel, seed: int) -> list[SceneObstacle]:
    """A pillar and a shelf in the way of the base, and a bar beside the end effector's path; they stand a little elsewhere for each seed."""
    e, rng = Extent(robot, "obstacles-static"), np.random.default_rng(seed)
    x, up = e.high[0], e.ground
    shift = rng.uniform(-0.05, 0.05, 3)
    pillar = np.array([x + 0.8 + shift[0], e.high[1] + 0.1 - IN_THE_WAY, up])
    shelf = np.array([x + 2.6 + shift[1], e.low[1] - 0.15 + IN_THE_WAY, up + 0.5])
    bar = np.array([x + 1.7 + shift[2], e.tool[1] + 0.25, e.tool[2]])
    return [
        SceneObstacle("pillar", Cylinder((0, 0, 0), (0, 0, 1.5), 0.1), {"position": pillar}),
        SceneObstacle("bar", Capsule((0, 0, 0), (0, 1.5, 0), 0.03), {"position": bar}),
        SceneObstacle("shelf", Box((0.3, 0.15, 0.5)), {"position": shelf}),
    ]


def moving_scene(settings: Moving, robot: RobotModel, seed: int) -> list[SceneObstacle]:
    """People who walk straight over the robot's path, from both sides and at any angle, each where the robot would then be."""
    e, rng = Extent(robot, "obstacles-moving"), np.random.default_rng(seed)
    length, (low, high), (least, most) = settings.path.size(robot), sorted(settings.speeds), sorted(settings.angles)
    apart = float(np.linalg.norm(np.maximum(e.high[:2] - e.base[:2], e.base[:2] - e.low[:2]))) + PERSON[0]
    people = []
    for k in range(settings.people):
        along = np.array([(k + 0.5) / settings.people * length, 0.0, 0.0])
        meet = passing(settings, float(along[0]))
        angle = rng.choice([-1.0, 1.0]) * rng.uniform(least, most)
        place, pace = [*e.base[:2], e.ground] + along, rng.uniform(low, high)
        people.append(person(f"person{k}", place, meet, pace, angle, settings.path.speed, apart))
    return people


def person(
    name: str, place: Array, meet: float, pace: float, angle: float, speed: float = 0.0, apart: float = 0.0
) -> SceneObstacle:
    """A person who walks with ``pace`` [m/s] in direction ``angle`` [rad] and is at ``place`` (3) [m] at the time ``meet`` [s], as is a robot
    with ``speed`` [m/s] along x; or later: no person appears within ``apart`` [m] of that robot."""
    velocity = pace * np.array([np.cos(angle), np.sin(angle), 0.0])
    lead = min(max(SEEN_FROM / pace, SEEN_FOR), meet)
    ahead = np.array([speed, 0.0, 0.0])
    off = lead * (ahead - velocity)  # from the robot to the person who appears
    distance = float(np.linalg.norm(off))
    if distance < apart:
        off = apart * (off / distance if distance > 1e-9 else -velocity / pace)
    motion = {"position": place - lead * ahead + off, "velocity": velocity}
    return SceneObstacle(name, Cylinder((0, 0, 0), (0, 0, PERSON[1]), PERSON[0]), {**motion, **SEEN_AS}, meet - lead)


def passing(settings: Among, way: float) -> float:
    """When [s] a robot that nothing delays has gone so far [m]."""
    return settings.settle_time + 0.5 * settings.path.ramp + way / settings.path.speed


def sudden_scene(settings: Sudden, robot: RobotModel, seed: int) -> list[SceneObstacle]:
    """A pillar right ahead of the base, for each seed a little aside."""
    e, rng = Extent(robot, "obstacles-sudden"), np.random.default_rng(seed)
    way = 0.5 * settings.path.size(robot)
    appears, aside = passing(settings, way), rng.uniform(-0.1, 0.1)
    place = [e.high[0] + way + settings.ahead + 0.1, e.base[1] + aside, e.ground]
    return [SceneObstacle("pillar", Cylinder((0, 0, 0), (0, 0, 1.5), 0.1), {"position": place}, appears)]


def corridor_scene(settings: Corridor, robot: RobotModel, seed: int) -> list[SceneObstacle]:
    """Two walls as high as the robot, and a third across their end if it is closed."""
    e = Extent(robot, "corridor")
    high = 0.5 * (e.high[2] - e.ground)
    entry = np.array([e.high[0] + ENTRY, e.base[1] + settings.offset, e.ground + high])
    c, s = np.cos(settings.angle), np.sin(settings.angle)
    turn, quaternion = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), lie.quaternion_about(UP, settings.angle)
    aside, along = 0.5 * settings.width + 0.1, 0.5 * settings.long
    parts = {"left": ((along, aside), (along, 0.1)), "right": ((along, -aside), (along, 0.1))}
    end, middle = settings.long, 0.0
    if settings.chicane:
        begin, middle = end + float(e.high[0] - e.low[0]), settings.chicane
        for side, off in (("left", aside), ("right", -aside)):
            parts[f"next_{side}"] = ((begin + along, middle + off), (along, 0.1))
        end = begin + settings.long
    if settings.closed:
        parts["end"] = ((end + 0.1, middle), (0.1, aside + 0.1))
    return [
        SceneObstacle(
            name, Box((*half, high)), {"position": entry + turn @ np.array([*place, 0.0]), "orientation": quaternion}
        )
        for name, (place, half) in parts.items()
    ]


def clutter_scene(settings: Clutter, robot: RobotModel, seed: int) -> list[SceneObstacle]:
    """One obstacle in each part of the way, on a random side. Every other one reaches into the way of the base, and is so low that the arm passes
    over it; the others are of any height and stand beside all of the robot."""
    e, rng = Extent(robot, "clutter"), np.random.default_rng(seed)
    length, found = settings.path.size(robot), []
    count = settings.count or max(int(2.0 * length / (e.high[0] - e.low[0] + PAST)), 1)
    part = length / count
    for k in range(count):
        half, side, inside = rng.uniform(0.08, 0.2), rng.choice([-1.0, 1.0]), k % 2 == 0
        high = (e.top - e.ground) * rng.uniform(0.7, 1.0) if inside else rng.uniform(0.4, 1.8)
        low, up = (e.base_low, e.base_high) if inside else (e.low, e.high)
        edge = (up[1] if side > 0.0 else -low[1]) + (-IN_THE_WAY if inside else rng.uniform(0.3, 1.0))
        place = [e.high[0] + 0.5 + (k + rng.uniform(0.3, 0.7)) * part, side * (edge + half), e.ground]
        pillar = Cylinder((0, 0, 0), (0, 0, high), half)
        shape = pillar if rng.random() < 0.5 else Box((half, half, 0.5 * high), (0, 0, 0.5 * high))
        found.append(SceneObstacle(f"clutter{k}", shape, {"position": place}))
    return found


def swung_ahead(robot: RobotModel, reference: Reference) -> Reference:
    """Poses in which the end effector turns about the base from where it is beside it to straight ahead, over the first :data:`SWING` [m]."""
    base, poses = carried_base(robot, reference.values), reference.values.copy()
    share = np.clip(np.linalg.norm(poses[:, :3] - poses[0, :3], axis=1) / SWING, 0.0, 1.0)
    beside = poses[:, :2] - base[:, :2]
    angle = -_wrapped(np.arctan2(beside[:, 1], beside[:, 0]) - base[:, 2]) * share**2 * (3.0 - 2.0 * share)
    c, s = np.cos(angle), np.sin(angle)
    poses[:, 0] = base[:, 0] + c * beside[:, 0] - s * beside[:, 1]
    poses[:, 1] = base[:, 1] + s * beside[:, 0] + c * beside[:, 1]
    turns = [
        lie.quaternion_multiply(lie.quaternion_about(UP, float(a)), q) for a, q in zip(angle, poses[:, 3:], strict=True)
    ]
    return Reference.poses(reference.times, poses[:, :3], np.array(turns))


def _wrapped(angle: Array) -> Array:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))


#: Of settings, a robot and a seed.
SceneOf = Callable[[Any, RobotModel, int], list[SceneObstacle]]


def build(scene: SceneOf, settings: Among, seed: int) -> Scenario:
    """A path of the end effector among what ``scene`` makes."""
    task = Task(settings, obstacles=True)
    robot, mpc, end = task.robot, task.mpc, task.end
    metrics: Callable[[Log], dict[str, Metric]] | None = task.metrics
    if isinstance(settings.reference, PatientClock):
        end += settings.reference.patience
        if isinstance(settings, Corridor):
            mpc.reference["end_effector"], metrics = swung_ahead(robot, mpc.reference["end_effector"]), None
    made = scene(settings, robot, seed) if settings.obstacles is None else None
    return closed_loop(
        robot, mpc, end, seed, settings, since=settings.settle_time, hooks=Hooks(metrics=metrics), around=Surroundings(
            made, getattr(settings, "perception", None), paced=True, alternatives=settings.when_stuck == "alternatives"
        ),
    )  # fmt: skip


def _experiment(name: str, summary: str, settings_type: type[Among], scene: SceneOf) -> Experiment:
    return Experiment.of(name, summary, settings_type, partial(build, scene), DEFINITIONS)


STATIC = _experiment("obstacles-static", "a path past a pillar, a bar and a shelf", Among, static_scene)
MOVING = _experiment("obstacles-moving", "a path that people cross", Moving, moving_scene)
SUDDEN = _experiment("obstacles-sudden", "a pillar appears right ahead", Sudden, sudden_scene)
CORRIDOR = _experiment("corridor", "a path through a narrow corridor", Corridor, corridor_scene)
CLUTTER = _experiment("clutter", "a path among obstacles that only range sensors see", Clutter, clutter_scene)
