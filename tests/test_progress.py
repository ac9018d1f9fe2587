"""How long robots stand, and are driven back. Truth: motions in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.tasks.scene import NEAR, PAUSE, SHARE, STANDS, DrivenBack, Standing

STEP = 0.02


def test_who_comes_to_rest_stands_from_where_it_is_near_that_place() -> None:
    """0.25 m/s up to 2 s, then a swing of 2 cm until 3 s: the last 5 cm of its way take 0.2 s."""
    standing = Standing()
    for t in np.arange(0.0, 3.0 + 1e-9, STEP):
        x = 0.25 * min(t, 2.0) + (0.02 * np.sin(6.0 * np.pi * t) if t > 2.0 else 0.0)
        standing.update(float(t), np.array([x, 0.0, 0.5]), True)
    assert standing.longest == pytest.approx(1.0 + STANDS / 0.25, abs=0.1)
    moving = Standing()
    for t in np.arange(0.0, 3.0, STEP):
        moving.update(float(t), np.array([0.25 * t, 0.0, 0.5]), True)
        standing.update(3.0 + float(t), np.zeros(3), False)
    assert moving.longest == pytest.approx(STANDS / 0.25, abs=2.0 * STEP) and standing.longest < 1.4


@pytest.mark.parametrize(
    ("velocity", "obstacle", "distance", "driven"),
    [
        ((-0.4, 0.0), (-0.5, 0.0), 0.2, True),
        ((-0.4, 0.0), (-0.5, 0.0), 1.1 * NEAR, False),  # far ahead of it
        ((-0.9 * SHARE * 0.5, 0.0), (-0.5, 0.0), 0.2, False),  # slowly
        ((-0.05, 0.4), (-0.5, 0.0), 0.2, False),  # aside
        ((0.4, 0.0), (0.5, 0.0), 0.2, False),  # on its own way
        ((-0.4, 0.0), (0.0, 0.0), 0.2, False),  # from a wall
    ],
)
def test_who_goes_back_before_somebody_is_driven(
    velocity: tuple[float, float], obstacle: tuple[float, float], distance: float, driven: bool
) -> None:
    found, to_goal = DrivenBack(), np.array([1.0, 0.0])
    for t in np.arange(0.0, 1.5 + 1e-9, STEP):
        found.update(float(t), np.array(velocity), to_goal, np.array(obstacle), distance)
    assert found.longest == pytest.approx(1.5 if driven else 0.0, abs=1e-9)


def test_two_retreats_are_two() -> None:
    found = DrivenBack()
    for t in np.arange(0.0, 3.0, STEP):
        pauses = 1.0 < t < 1.0 + 0.5 * PAUSE or 1.5 < t < 1.5 + 2.0 * PAUSE
        found.update(float(t), np.array([-0.4 * (not pauses), 0.0]), np.array([1.0, 0.0]), np.array([-0.5, 0.0]), 0.1)
    assert found.longest == pytest.approx(1.5, abs=3.0 * STEP)
