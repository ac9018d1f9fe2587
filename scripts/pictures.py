"""Pictures for the documents: clips of both papers' robots at work, all built-in robots at home.

Needs the extra ``video``. Usage: python scripts/pictures.py [clips | robots]...
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

from wbmpc.cli import main as wbmpc
from wbmpc.model.robot import load_robot
from wbmpc.simulation.film import SceneModel
from wbmpc.simulation.render import Renderer
from wbmpc.view.realtime import scene_of
from wbmpc.view.render import overview

IMAGES = Path(__file__).parents[1] / "docs" / "images"
FINER = 2
#: By name the experiment of a clip, where it begins and ends [s], and its speed against the run.
CLIPS = {"swerve": ("swerve-track", 8, 62, 6), "rezero": ("rezero-steps", 4, 22, 2)}
SHAPE = ("--width", "560", "--height", "316", "--no-labels")
#: All built-in robots, row by row as the gallery names them; width and height of each picture.
ROWS = (
    ("swerve-ur10", "swerve-fixed-ur10", "swerve-mabi", "rezero", "differential-ur10"),
    ("fetch", "mecanum-ur10", "ridgeback-ur5", "panda-omni", "tidybot"),
    ("ffw-sg2", "pr2", "vega", "panda", "ur5"),
    ("pentapod-ur10", "telescope-ur10"),
)
TILE = 300


def clips() -> None:
    """Of seed 1."""
    with tempfile.TemporaryDirectory() as folder:
        for name, (experiment, *times) in CLIPS.items():
            start, end, speed = map(str, times)
            out = f"{folder}/{name}"
            during = ("--start", start, "--end", end, "--speed", speed)
            wbmpc(["run", experiment, "--seed", "1", "--out", out])
            wbmpc(["render", out, "--webp", str(IMAGES / f"{name}.webp"), "--force", *during, *SHAPE])


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


PICTURES = {"clips": clips, "robots": robots}

if __name__ == "__main__":
    for chosen in sys.argv[1:] or PICTURES:
        PICTURES[chosen]()
