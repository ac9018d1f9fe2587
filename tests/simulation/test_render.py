"""Pictures: there is something on them, and it moves with the plant."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import WbmpcError
from wbmpc.robots import load_description
from wbmpc.simulation.render import Camera, Renderer


@pytest.mark.parametrize(("name", "kind"), [("swerve-ur10", SwervePlant), ("rezero", BallPlant)])
def test_a_picture_shows_the_robot(name, kind):
    plant = kind(load_description(name))
    try:
        renderer = Renderer(plant, 320, 180, shadows=False)
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


@pytest.mark.parametrize("shadows", [False, True])
def test_lines_have_their_colors(shadows: bool) -> None:
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
