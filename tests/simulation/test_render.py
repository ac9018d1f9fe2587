"""Pictures: there is something on them, and it moves with the plant."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import pairwise
from typing import Literal

import numpy as np
import pytest

from wbmpc import lie
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import WbmpcError
from wbmpc.obstacles.solids import Solid, along, sphere
from wbmpc.robots import load_description
from wbmpc.simulation import render
from wbmpc.simulation.film import SceneModel
from wbmpc.simulation.render import Camera, Renderer, simplified
from wbmpc.simulation.scene import Body, Scene, Shape
from wbmpc.simulation.world import SUN


@pytest.mark.parametrize(("name", "kind"), [("swerve-ur10", SwervePlant), ("rezero", BallPlant)])
def test_a_picture_shows_the_robot(name, kind):
    plant = kind(load_description(name))
    try:
        renderer = Renderer(plant, 320, 180, shadows="none")
    except WbmpcError as error:
        pytest.skip(str(error))
    previous = plant.data.qpos.copy()
    with renderer:
        still = renderer.frame(Camera(follow=False))
        again = renderer.frame(Camera(follow=False))
        line = renderer.frame(Camera(follow=False), lines=[((230, 70, 30), [[-1, 0, 1], [1, 0, 1]])])
        assert np.array_equal(plant.data.qpos, previous)
        plant.data.qpos[0] += 30.0
        empty = renderer.frame(Camera(follow=False))
    assert still.shape == (180, 320, 3) and still.dtype == np.uint8
    assert np.array_equal(still, again)
    assert 500 < np.any(still != empty, axis=2).sum() < 0.9 * 320 * 180
    assert np.any(still != line)


def test_the_sky_is_left_out_only_where_the_floor_hides_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: the picture with the sky. Elevations [rad] of a camera that sees the horizon, just none of it, and none at all."""
    plant, field = SwervePlant(load_description("swerve-ur10")), 0.6
    cameras = [Camera(elevation=e, field=field) for e in (0.0, -0.5 * field, -0.5 * field - 0.06, -1.0)]
    pictures = []
    for horizon in (render._HORIZON, -np.inf, np.inf):  # as it is; the sky is always drawn; it is never drawn
        monkeypatch.setattr(render, "_HORIZON", horizon)
        try:
            renderer = Renderer(plant, 320, 180, shadows="none", samples=0)
        except WbmpcError as error:
            pytest.skip(str(error))
        with renderer:
            pictures.append([renderer.frame(camera) for camera in cameras])
    for own, truth in zip(*pictures[:2], strict=True):
        np.testing.assert_array_equal(own, truth)
    assert np.any(pictures[1][0] != pictures[2][0])


@pytest.mark.parametrize("shadows", ["none", "floor", "all"])
def test_lines_have_their_colors(shadows: Literal["none", "floor", "all"]) -> None:
    """Labels name them by these; a picture with shadows is drawn twice and added."""
    plant, color = SwervePlant(load_description("swerve-ur10")), (30, 110, 200)
    try:
        renderer = Renderer(plant, 320, 180, shadows=shadows)
    except WbmpcError as error:
        pytest.skip(str(error))
    line = np.array([[-1.0, 0.0, 1.2], [np.nan, 0.0, 0.0], [1.0, 0.0, 1.2]])
    with renderer:
        plain, drawn = renderer.frame(Camera(follow=False)), renderer.frame(Camera(follow=False), [(color, line)])
    changed = np.any(plain != drawn, axis=2)
    near = np.abs(drawn.astype(int) - color).max(axis=2) < 12
    assert 20 < changed.sum() < 2000 and near[changed].sum() > 0.3 * changed.sum() and not near[~changed].any()


@pytest.mark.parametrize(
    ("kind", "size"),
    [("sphere", (0.1,)), ("capsule", (0.05, 0.3)), ("cylinder", (0.05, 0.3)), ("box", (0.3, 0.2, 0.1))],
)
def test_a_shadow_on_the_floor_lies_along_the_sun(kind: str, size: tuple[float, ...]) -> None:
    """Truth: the ray past a body's middle, its outline from many points on it, and a pinhole camera that looks straight down: rows fall
    along y."""
    camera = Camera((0.0, 0.0, 0.0), 5.0, 0.5 * np.pi, -0.5 * np.pi, 0.6, follow=False)
    lying = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)  # its z axis is along x
    shape = Shape("body", kind, size, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (0.9, 0.2, 0.1, 1.0))
    scene_model = SceneModel(Scene("body", (Body("body", "world", True),), (shape,)))
    middle, pictures = np.array([0.2, -0.1, 0.8]), {}
    scene_model.place([[*middle, *lying]])
    for shadows in ("none", "floor"):
        try:
            renderer = Renderer(scene_model, 320, 180, shadows=shadows, samples=0)  # type: ignore[arg-type]
        except WbmpcError as error:
            pytest.skip(str(error))
        with renderer:
            pictures[shadows] = renderer.frame(camera).astype(int)
    changed = np.argwhere(np.abs(pictures["floor"] - pictures["none"]).max(axis=2) > 20)
    pixels = 0.5 * 180 / np.tan(0.3) / 5.0  # for each meter on the floor
    found = (changed - [89.5, 159.5])[:, ::-1] / [pixels, -pixels]
    solid = {"sphere": lambda: sphere(size[0], np.zeros(3)), "box": lambda: Solid("box", np.array(size))}.get(
        kind, lambda: along(kind, np.array([0.0, 0.0, -size[1]]), np.array([0.0, 0.0, size[1]]), size[0])
    )()
    turn = lie.quaternion_to_rotation(np.array(lying)) @ solid.rotation
    # the outline across a direction on the floor is that of the body across what casts it
    for direction in (np.array([1.0, 0.0]), np.array([0.0, 1.0]), np.array([0.6, 0.8])):
        cast = np.array([*direction, -(direction @ np.array(SUN[:2])) / SUN[2]])
        ends = [
            float((middle + turn @ solid.support(sign * (cast @ turn)[None] / np.linalg.norm(cast))[0]) @ cast)
            for sign in (-1.0, 1.0)
        ]
        seen = found @ direction
        np.testing.assert_allclose([seen.min(), seen.max()], ends, atol=0.02)


def test_lines_keep_their_way_with_few_points() -> None:
    """Truth: the distance of every point to the nearest of many points of the shorter line."""
    t = np.linspace(0.0, 1.0, 400)
    curve = np.column_stack([t, 0.2 * np.sin(9.0 * t), 0.1 * t**2])
    short = simplified(curve, 0.01)
    fine = np.concatenate([a + np.linspace(0.0, 1.0, 200)[:, None] * (b - a) for a, b in pairwise(short)])
    assert max(np.linalg.norm(fine - p, axis=1).min() for p in curve) < 0.0101 and 4 < len(short) < 30
    corner = np.array([[0.0, 0, 0], [0.5, 0, 0], [1, 0, 0], [1, 0.5, 0], [1, 1, 0]])
    np.testing.assert_array_equal(simplified(corner, 0.001), corner[[0, 2, 4]])
    still = np.ones((50, 3))
    assert (
        len(simplified(still, 0.01)) == 2
        and simplified(still[:0], 0.01).shape == (0, 3)
        and len(simplified(still[:1], 0.01)) == 1
    )


def test_without_a_screen_mujoco_comes_without_what_opens_windows() -> None:
    """Truth: the modules of a new process, and its environment."""
    code = "import os, sys; from wbmpc.model.robot import load_robot; load_robot('panda'); print('glfw' in sys.modules, 'MUJOCO_GL' in os.environ)"
    clean = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")}
    for more, expected in (
        ({}, "False False"),
        ({"DISPLAY": ":9"}, "True False"),
        ({"MUJOCO_GL": "egl"}, "False True"),
    ):
        done = subprocess.run([sys.executable, "-c", code], env=clean | more, capture_output=True, text=True)
        assert done.stdout.strip() == expected, done.stderr
