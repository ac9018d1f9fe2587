"""`pick-from-shelf`: the end effector goes into a shelf, lifts something and comes out, while the base stands against the shelf's foot."""

from __future__ import annotations

from functools import partial

import numpy as np
from pydantic import Field

from wbmpc.experiment import Experiment
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.scene import SceneObstacle
from wbmpc.obstacles.shapes import Box
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.obstacles import IN_THE_WAY, Among, Extent, build
from wbmpc.tasks.path_settings import AnyPath, Poses

NAME = "pick-from-shelf"
#: Half of the width of a shelf, of the thickness of its boards, height and half depth of its foot [m]; how far it stands elsewhere by seed.
WIDE, THIN, FOOT, DEEP, ELSEWHERE = 0.6, 0.01, 0.15, 0.3, 0.02
#: In, up and out again [m].
PICK = ((1.2, 0.0, 0.0), (1.2, 0.0, 0.05), (0.8, 0.0, 0.05))


class PickSettings(Among):
    """The shelf is where ``path`` goes farthest ahead: ``inside`` [m]: distance that the end effector moves into the shelf; ``opening``
    [m] between two boards."""

    path: AnyPath = Poses(poses=PICK, speed=0.15)
    inside: float = Field(0.2, ge=0.01, le=5.0)
    opening: float = Field(0.6, ge=0.05, le=5.0)


def shelf(settings: PickSettings, robot: RobotModel, seed: int) -> list[SceneObstacle]:
    """Two boards with a wall behind them, and a foot that the base would run into if it went all the way with the end effector."""
    e, rng = Extent(robot, NAME), np.random.default_rng(seed)
    points = settings.path.curve(robot, *robot.pose(robot.home)).points
    goal = points[np.argmax(points[:, 0])] + rng.uniform(-ELSEWHERE, ELSEWHERE, 3)
    way, front = goal[0] - e.tool[0], goal[0] - settings.inside
    depth = 0.5 * (settings.inside + DEEP)
    middle, half = np.array([front + depth, goal[1], goal[2]]), 0.5 * settings.opening
    foot = min(front, e.base_high[0] + way - IN_THE_WAY)
    parts = {
        "lower-board": (middle - [0, 0, half + THIN], (depth, WIDE, THIN)),
        "upper-board": (middle + [0, 0, half + THIN], (depth, WIDE, THIN)),
        "back": (middle + [depth + THIN, 0, 0], (THIN, WIDE, half)),
        "foot": (np.array([foot + DEEP, goal[1], e.ground + 0.5 * FOOT]), (DEEP, WIDE, 0.5 * FOOT)),
    }
    return [SceneObstacle(name, Box(size), {"position": at}) for name, (at, size) in parts.items()]


EXPERIMENT = Experiment.of(
    NAME,
    "the end effector goes into a shelf and out, the base stops at its foot",
    PickSettings,
    partial(build, shelf),
    DEFINITIONS,
)
