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
        line = renderer.frame(Camera(follow=False), lines=[[-1, 0, 1], [1, 0, 1]])
        assert np.array_equal(plant.data.qpos, previous)
        plant.data.qpos[0] += 30.0
        empty = renderer.frame(Camera(follow=False))
    assert still.shape == (180, 320, 3) and still.dtype == np.uint8
    assert np.array_equal(still, again)
    assert 500 < np.any(still != empty, axis=2).sum() < 0.9 * 320 * 180
    assert np.any(still != line)
