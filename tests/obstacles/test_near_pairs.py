"""Least distances of a robot's own parts. Truth: MuJoCo's distances of every pair of their shapes."""

from __future__ import annotations

from itertools import combinations

import pytest

from wbmpc.model.robot import load_robot
from wbmpc.obstacles.collider import Collider
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.obstacles.pairs import distances, draw_states


@pytest.mark.parametrize("name", ["pentapod-ur10", "tidybot"])
def test_no_pair_that_is_near_is_passed_over(name: str) -> None:
    """Only shapes whose spheres are near, and each against the sphere around the other, are measured."""
    robot, reach = load_robot(name), 0.1
    geometry, states = robot_geometry(robot), draw_states(robot, 12, seed=4)
    parts = list(combinations(geometry.frames, 2))
    found = distances(geometry, parts, states, reach)
    collider = Collider([s.solid for s in geometry.shapes])
    centers, axes = geometry.at(*geometry.kinematics(states))
    for k in range(len(states)):
        collider.place(centers[k], axes[k])
        for p, (a, b) in enumerate(parts):
            shapes = [(int(i), int(j)) for i in geometry.fixed_to(a) for j in geometry.fixed_to(b)]
            true = min([reach, *(collider.distance(i, j, 1.0) for i, j in shapes)])
            assert found[k, p] == pytest.approx(true, abs=1e-6), (k, a, b)
    assert 0.02 < (found < reach).mean() < 0.8
