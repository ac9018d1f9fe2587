"""Pictures for the documents, drawn by MuJoCo: the ball robot at work (a state of a real run), all built-in robots at home.

Needs the extra ``video``. Usage: python scripts/pictures.py [rezero | robots]...
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from wbmpc.bases.ball.plant import BallPlant
from wbmpc.model.robot import load_robot
from wbmpc.simulation.film import SceneModel
from wbmpc.simulation.perturbation import Perturbation
from wbmpc.simulation.render import REFERENCE, Camera, Renderer
from wbmpc.studies.minniti2019 import steps as rezero_steps
from wbmpc.view.realtime import scene_of
from wbmpc.view.render import overview

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SIZE, FINER = (1200, 700), 2
#: All built-in robots, row by row as the gallery names them; width and height of each picture.
ROWS = (
    ("swerve-ur10", "swerve-fixed-ur10", "swerve-mabi", "rezero", "differential-ur10"),
    ("fetch", "mecanum-ur10", "ridgeback-ur5", "panda-omni", "tidybot"),
    ("ffw-sg2", "pr2", "vega", "panda", "ur5"),
    ("pentapod-ur10", "telescope-ur10"),
)
TILE = 300


def save(name: str, picture: np.ndarray) -> None:
    """Write a picture that was drawn ``FINER`` times larger: halving it smooths edges and shadows."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    small = Image.fromarray(picture).resize(SIZE, Image.Resampling.LANCZOS)
    small.quantize(256).save(IMAGES / name, optimize=True)


def draw(plant: BallPlant, camera: Camera, line: np.ndarray) -> np.ndarray:
    """The plant with the way that its end effector is asked to go."""
    with Renderer(plant, SIZE[0] * FINER, SIZE[1] * FINER) as renderer:
        return renderer.frame(camera, [(REFERENCE, line)])


def rezero() -> None:
    """The ball robot in the middle of the 0.4 m step to the other side: it leans into it. The line joins both goals."""
    settings = rezero_steps.RezeroStepsSettings(hold_time=2.0, final_hold_time=0.0, preview=False)
    result = rezero_steps.EXPERIMENT.run(settings, 0)
    robot, log = load_robot("rezero"), result.log
    home, torque = robot.equilibrium(robot.home[robot.state["arm"]])
    start = settings.settle_time + 3 * settings.hold_time
    during = (log.times("state") > start) & (log.times("state") < start + 0.7)
    k = int(np.argmax(np.where(during, log.array("tilt"), 0.0)))
    state = log.array("state")[k] * np.where(np.arange(robot.state.size) < 8, 1.0, 0.0)
    plant = BallPlant(robot.description, state, torque, Perturbation.none())
    camera = Camera(target=(0.1, -0.03, 0.47), distance=2.1, azimuth=2.9, elevation=-0.2, field=0.55)
    height = np.array([0.0, 0.0, robot.base.base.ball_radius])
    position, _ = robot.pose(home)
    line = position + height + np.outer(np.linspace(-0.2, 0.2, 21), [0.0, 1.0, 0.0])
    save("rezero.png", draw(plant, camera, line))


def robots() -> None:
    """Every built-in robot at home."""
    sheet = Image.new("RGB", (TILE * len(ROWS[0]), TILE * len(ROWS)), "white")
    for row, names in enumerate(ROWS):
        for column, name in enumerate(names):
            sheet.paste(at_home(name), (TILE * column, TILE * row))
    sheet.quantize(128).save(IMAGES / "robots.png", optimize=True)


def at_home(name: str) -> Image.Image:
    """A built-in robot, ``TILE`` wide and high."""
    puppet, reader = scene_of(load_robot(name))
    model, poses = SceneModel(reader.scene), reader.poses(puppet.data)
    model.place(poses)
    with Renderer(model, TILE * FINER, TILE * FINER) as renderer:
        picture = renderer.frame(overview([poses], reader.scene))
    return Image.fromarray(picture).resize((TILE, TILE), Image.Resampling.LANCZOS)


PICTURES = {"rezero": rezero, "robots": robots}

if __name__ == "__main__":
    for chosen in sys.argv[1:] or PICTURES:
        PICTURES[chosen]()
