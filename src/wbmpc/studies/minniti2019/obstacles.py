"""`rezero-obstacles`: the ball robot follows a path among pillars, while people cross it and one comes head-on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from wbmpc.experiment import Experiment, Scenario
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.scene import SceneObstacle
from wbmpc.obstacles.shapes import Cylinder
from wbmpc.settings import Robot
from wbmpc.studies.minniti2019.task import check_ball
from wbmpc.tasks import obstacles
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.obstacles import IN_THE_WAY, Among, Extent, Speed, passing, person
from wbmpc.tasks.path_settings import AnyPath, Line

NAME = "rezero-obstacles"
SUMMARY = "the ball robot balances among pillars, people cross and one comes head-on"
IDEALIZATIONS = [
    "the controller gets the simulator's state, 5 ms old, with noise; people and pillars are seen where they are, to some centimeters",
    "the omni wheels act as torques between ball and base; their traction limit is a clamp",
]
#: Shares of the path at which pillars stand, people cross, and a person comes head-on; radius of a pillar [m].
PILLARS, CROSSINGS, HEAD_ON, RADIUS = (0.2, 0.45), (0.33, 0.6), 0.8, 0.1
#: How far [m] to the left or right of the robot's way at most a person walks who comes head-on.
ASIDE = 0.1


class RezeroObstaclesSettings(Among):
    """People walk at ``speeds`` [m/s], between the smallest and the largest; who comes head-on, at ``head_on`` [m/s]."""

    robot: Robot = "rezero"
    path: AnyPath = Line(length=4.0, speed=0.25)
    speeds: tuple[Speed, Speed] = (0.3, 1.0)
    head_on: float = Field(0.5, ge=0.01, le=10.0)


def scene(settings: RezeroObstaclesSettings, robot: RobotModel, seed: int) -> list[SceneObstacle]:
    """Pillars on either side that reach into the robot's way, people who walk over it from both sides, each where the robot would then be, and one
    who comes along it."""
    e, rng = Extent(robot, NAME), np.random.default_rng(seed)
    length, (low, high) = settings.path.size(robot), sorted(settings.speeds)
    start = np.array([*e.base[:2], e.ground])
    pillar, found = Cylinder((0, 0, 0), (0, 0, 1.5), RADIUS), []
    for k, share in enumerate(PILLARS):
        edge = e.high[1] if k % 2 == 0 else e.low[1]
        y = edge + np.sign(edge - e.base[1]) * (RADIUS - IN_THE_WAY)
        x = e.base[0] + share * length + rng.uniform(-0.1, 0.1)
        found.append(SceneObstacle(f"pillar{k}", pillar, {"position": np.array([x, y, e.ground])}))
    for k, share in enumerate(CROSSINGS):
        angle = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 0.6) * np.pi
        at = start + [share * length, 0.0, 0.0]
        found.append(person(f"person{k}", at, passing(settings, share * length), rng.uniform(low, high), angle))
    at = start + [HEAD_ON * length, rng.uniform(-ASIDE, ASIDE), 0.0]
    return [*found, person("head-on", at, passing(settings, HEAD_ON * length), settings.head_on, np.pi)]


def build(settings: RezeroObstaclesSettings, seed: int) -> Scenario:
    """One run."""
    check_ball(settings.robot)
    scenario = obstacles.build(scene, settings, seed)
    return replace(scenario, idealizations=[*IDEALIZATIONS, *scenario.idealizations])


EXPERIMENT = Experiment.of(NAME, SUMMARY, RezeroObstaclesSettings, build, DEFINITIONS)
