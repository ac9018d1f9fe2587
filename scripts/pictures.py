"""Pictures of both robots at work for the README: states of real runs, drawn by MuJoCo. Needs the extra ``video``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from wbmpc.experiments import rezero_steps, swerve_track
from wbmpc.model import load_robot
from wbmpc.plant import Perturbation, RezeroPlant, SwervePlant
from wbmpc.plant.render import Camera, Renderer

IMAGES = Path(__file__).parents[1] / "docs" / "images"
SIZE = (1200, 675)


def save(name: str, picture: np.ndarray) -> None:
    IMAGES.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).quantize(192).save(IMAGES / name, optimize=True)


def swerve() -> None:
    """The swerve robot on its way along the sine, at 60 % of one period's run."""
    result = swerve_track.run(swerve_track.SwerveTrackSettings(periods=1, rest=2.0), 0)
    robot, log = load_robot("swerve-ur10"), result.log
    k = int(0.6 * len(log.times("base")))
    parts = {g: log.array(g)[k] for g in ("base", "steer", "arm")}
    state = robot.state.split(robot.home) | parts
    plant = SwervePlant(robot.description, state, Perturbation.none())
    camera = Camera(target=(0.35, 0.35, 0.5), distance=4.3, azimuth=2.5, elevation=-0.32)
    with Renderer(plant, *SIZE) as renderer:
        save("swerve.png", renderer.frame(camera, log.array("hand_reference")[::4]))


def rezero() -> None:
    """The ball robot in the middle of a step: it leans into it."""
    result = rezero_steps.run(rezero_steps.RezeroStepsSettings(hold=2.0, rest=0.0), 0)
    robot, log = load_robot("rezero"), result.log
    _, torque = robot.equilibrium(robot.home[robot.state["arm"]])
    k = int(np.argmax(log.array("tilt")))
    state = log.array("state")[k] * np.where(np.arange(robot.state.size) < 8, 1.0, 0.0)
    plant = RezeroPlant(robot.description, state, torque, Perturbation.none())
    camera = Camera(target=(0.12, 0.0, 0.55), distance=2.4, azimuth=2.0, elevation=-0.2)
    with Renderer(plant, *SIZE) as renderer:
        save("rezero.png", renderer.frame(camera))


if __name__ == "__main__":
    swerve()
    rezero()
