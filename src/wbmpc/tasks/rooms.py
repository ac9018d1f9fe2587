"""`rooms`: a robot goes from one end of a random room to the other, by its MPC alone, with alternatives, or along a planned route.

Every room has a wall with a door, and things on both sides of it: pillars, boxes, shelves, and niches that open towards the start (dead
ends). Rooms are drawn until there is a route for the robot at home: what cannot be solved distinguishes nothing.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from wbmpc.arrays import Array
from wbmpc.clearance.lattice import plan_route
from wbmpc.errors import InputError, NoRoute
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.route import base_part, follow_route
from wbmpc.obstacles.scene import SceneObstacle
from wbmpc.obstacles.shapes import Box, Cylinder
from wbmpc.obstacles.world import Obstacles
from wbmpc.result import Metric
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.following import PathTaskSettings, Task
from wbmpc.tasks.loop import Hooks, Surroundings, closed_loop
from wbmpc.tasks.path_settings import Line
from wbmpc.tasks.scene import GOAL
from wbmpc.tasks.settings import TaskSettings
from wbmpc.types import Truth

#: Half the thickness [m] of walls, their height [m].
THICK, HIGH = 0.05, 1.5
#: The room reaches so far [m] behind the start and beyond the goal; nothing else stands nearer to these [m].
BEHIND, FREE = 1.2, 1.15
#: A route keeps so much [m] more than the robot's margin; how often a room is drawn at most; cells [m] of the planner.
SPARE, DRAWN, CELL = 0.05, 100, 0.15
#: So many controller periods at the goal end a run.
STAYS = 200
KINDS = ("pillar", "box", "shelf", "niche")


class RoomSettings(TaskSettings):
    """``things``: number of obstacles in the room besides the wall with the door; ``length`` [m]: from the start of the base to its goal; ``width``
    [m]: width of the room; ``door`` [m]: width of the door; ``method``: "mpc" alone, with "alternatives", or along the route of a "planner", which
    knows all things; ``speed`` [m/s] of the references; ``patience`` [s]: how long the references may wait in total."""

    things: int = Field(4, ge=0, le=40)
    length: float = Field(6.0, ge=4.0, le=50.0)
    width: float = Field(5.2, ge=3.0, le=50.0)
    door: float = Field(1.5, ge=0.5, le=10.0)
    method: Literal["mpc", "alternatives", "planner"] = "alternatives"
    speed: float = Field(0.3, ge=0.01, le=10.0)
    patience: float = Field(30.0, ge=0.0, le=600.0)


class Room(NamedTuple):
    """What stands in it; where the base shall go (3: x, y [m], yaw [rad]); a ``route`` (n, 3) there; what its planning took [s]."""

    scene: list[SceneObstacle]
    goal: Array
    route: Array
    planning: float


def draw_room(settings: RoomSettings, robot: RobotModel, seed: int) -> Room:
    """The first room of the seed's that has a route. Raises :class:`InputError` if none of :data:`DRAWN` has."""
    rng, start = np.random.default_rng(seed), robot.home[base_part(robot, "rooms")]
    half, spread = 0.5 * settings.width, 0.5 * settings.width - 1.4
    low = start[:2] - [BEHIND, half]
    high = start[:2] + [settings.length + BEHIND, half]
    keep = robot.description.collision.margin + SPARE
    for _ in range(DRAWN):
        goal = start + [settings.length, rng.uniform(-spread, spread), 0.0]
        scene = _walls(settings, rng, low, high, robot.description.base.ground)
        for k in range(settings.things):
            scene += _thing(rng, k, low, high, start, goal, robot.description.base.ground)
        world = Obstacles()
        for one in scene:
            world.set(one.name, one.shape, **one.place)
        began = time.perf_counter()
        try:
            route = plan_route(robot, world, start, goal, cell=CELL, margin=keep, bounds=(low, high))
        except NoRoute:
            continue
        return Room(scene, goal, route, time.perf_counter() - began)
    raise InputError(
        f"rooms: none of {DRAWN} rooms has a route for the robot; valid: a smaller 'things', a larger 'width' or 'door'"
    )


def _walls(
    settings: RoomSettings, rng: np.random.Generator, low: Array, high: Array, ground: float
) -> list[SceneObstacle]:
    """Four around the room, two beside the door in the middle of the way."""
    x, center = low[0] + 0.5 * (high - low)[0], rng.uniform(low[1] + settings.door, high[1] - settings.door)
    walls = {
        "near": ((low[0], low[1]), (low[0], high[1])),
        "far": ((high[0], low[1]), (high[0], high[1])),
        "right": ((low[0], low[1]), (high[0], low[1])),
        "left": ((low[0], high[1]), (high[0], high[1])),
        "door_right": ((x, low[1]), (x, center - 0.5 * settings.door)),
        "door_left": ((x, center + 0.5 * settings.door), (x, high[1])),
    }
    return [_wall(f"wall_{name}", np.array(a), np.array(b), ground) for name, (a, b) in walls.items()]


def _wall(name: str, a: Array, b: Array, ground: float) -> SceneObstacle:
    """From a to b (2) [m], along an axis of the world."""
    half = 0.5 * np.abs(b - a) + THICK
    shape = Box((float(half[0]), float(half[1]), 0.5 * HIGH))
    return SceneObstacle(name, shape, {"position": np.array([*(0.5 * (a + b)), ground + 0.5 * HIGH])})


def _thing(
    rng: np.random.Generator, k: int, low: Array, high: Array, start: Array, goal: Array, ground: float
) -> list[SceneObstacle]:
    """One thing somewhere, as far from start and goal as nothing is nearer."""
    kind = KINDS[int(rng.choice(len(KINDS), p=[0.4, 0.3, 0.2, 0.1]))]
    size, tall, turned = rng.uniform(0.1, 0.25, 2), rng.uniform(0.5, HIGH), rng.random() < 0.5
    reach = {"pillar": 0.25, "box": 0.35, "shelf": 0.6, "niche": 1.1}[kind]
    while True:
        place = rng.uniform(low + 0.3, high - 0.3)
        if min(np.linalg.norm(place - start[:2]), np.linalg.norm(place - goal[:2])) > FREE + reach:
            break
    name, at = f"{kind}{k}", np.array([*place, ground])
    if kind == "pillar":
        return [SceneObstacle(name, Cylinder((0, 0, 0), (0, 0, tall), float(size[0])), {"position": at})]
    if kind == "niche":  # open towards the start
        corners = place + np.array([[-0.5, 0.8], [0.5, 0.8], [0.5, -0.8], [-0.5, -0.8]])
        return [_wall(f"{name}_{i}", corners[i], corners[i + 1], ground) for i in range(3)]
    half = size if kind == "box" else np.array([0.5, 0.15])[:: -1 if turned else 1]
    shape = Box((float(half[0]), float(half[1]), 0.5 * tall))
    return [SceneObstacle(name, shape, {"position": at + [0.0, 0.0, 0.5 * tall]})]


def build(settings: RoomSettings, seed: int) -> Scenario:
    """Straight from the start to the goal, or along the route."""
    robot = load_robot(settings.robot)
    room = draw_room(settings, robot, seed)
    step = room.goal - robot.home[base_part(robot, "rooms")]
    length = float(np.linalg.norm(step[:2]))
    line = Line(length=length, direction=float(np.arctan2(step[1], step[0])), speed=settings.speed)
    shared = {name: getattr(settings, name) for name in TaskSettings.model_fields}
    task = Task(PathTaskSettings(**shared, path=line), obstacles=True)
    mpc, end, goal = task.mpc, task.end, task.robot.pose(robot.home)[0] + [*step[:2], 0.0]
    if settings.method == "planner":
        end = 1.0 + follow_route(mpc, task.robot, room.route, settings.settle_time, speed=settings.speed)
    end += settings.patience

    near: deque[bool] = deque(maxlen=STAYS)

    def seen(t: float, truth: Truth) -> None:
        near.append(bool(np.linalg.norm(truth.tool - goal) <= GOAL))

    def metrics(log: Log) -> dict[str, Metric]:
        t, tool = log.times("end_effector"), log.array("end_effector")
        there = np.linalg.norm(tool - goal, axis=1) <= GOAL
        arrival = float(t[np.argmax(there)]) - settings.settle_time if there.any() else np.inf
        return {
            "arrival_time": Metric(arrival, "s"),
            "planning_time": Metric(room.planning if settings.method == "planner" else 0.0, "s"),
            "solve_time_mean": Metric(float(np.mean(mpc.statistics.solve_times)), "s"),
        }

    return closed_loop(
        task.robot, mpc, end, seed, settings, since=settings.settle_time,
        hooks=Hooks(metrics=metrics, truth=seen, done=lambda: len(near) == STAYS and all(near)),
        around=Surroundings(room.scene, paced=True, alternatives=settings.method == "alternatives"),
    )  # fmt: skip


EXPERIMENT = Experiment.of(
    "rooms", "through a random room: MPC alone, with alternatives, along a route", RoomSettings, build, DEFINITIONS
)
