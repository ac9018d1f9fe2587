"""The local map. Truth: where the points were, and the poses of the robot's own shapes in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

import wbmpc as wb
from wbmpc.errors import InputError, SensorFailure
from wbmpc.mapping import LocalMap
from wbmpc.obstacles.collider import Collider
from wbmpc.obstacles.geometry import robot_geometry

EYE = np.array([0.0, 0.0, 0.5])
SMALL = {"size": (3.0, 3.0, 1.0), "cell": 0.1, "floor": 0.1, "reach": 2.0}


def wall(x: float, shift: float = 0.0) -> np.ndarray:
    y, z = np.meshgrid(np.arange(-0.475, 0.5, 0.05), np.arange(0.225, 0.8, 0.05))
    return np.stack([np.full(y.size, x), y.ravel() + shift, z.ravel()], axis=1)


def centers(found: LocalMap) -> np.ndarray:
    return found.origin + found.cell * np.argwhere(found.occupied)


def test_points_become_occupied_cells_where_they_are() -> None:
    found = LocalMap(**SMALL)
    assert found.add(wall(1.03), EYE, 0.0) == len(wall(1.03))
    assert found.occupied.sum() == 10 * 6
    far = np.abs(wall(1.03)[:, None] - centers(found)[None]).max(axis=2).min(axis=1)
    assert far.max() <= 0.05 + 1e-9


def test_what_moves_away_is_free_again_and_what_is_hidden_stays() -> None:
    found = LocalMap(**SMALL)
    far, near = wall(1.23), EYE + 0.6 * (wall(1.23) - EYE)
    found.add(near, EYE, 0.0)
    assert found.occupied.sum() == 6 * 4
    for k in range(4):
        found.add(far, EYE, 0.1 + 0.1 * k)  # seen through where the first one was
    assert (np.abs(centers(found)[:, 0] - 1.23) < 0.06).all() and found.occupied.sum() == 60
    for k in range(5):
        found.add(near, EYE, 0.6 + 0.1 * k)  # now in front of the other one, which nobody sees
    assert found.occupied.sum() == 84


def test_no_return_clears_and_is_no_obstacle() -> None:
    found = LocalMap(**SMALL)
    found.add(wall(0.73), EYE, 0.0)
    for k in range(4):
        found.add(EYE + 5.0 * (wall(0.73) - EYE), EYE, 0.1 * k)  # beyond the reach
    assert not found.occupied.any() and found.dropped == 0


def test_the_floor_is_none_and_walls_go_down_to_it() -> None:
    found = LocalMap(**SMALL)
    floor = wall(1.03)
    floor[:, 2] = np.linspace(-0.03, 0.05, len(floor))
    found.add(floor, EYE, 0.0)
    assert not found.occupied.any()
    low = wall(1.03)
    low[:, 2] = 0.15
    found.add(low, EYE, 0.1)
    values = found.grid(0.1).sample(np.array([[1.03, 0.0, 0.02], [1.03, 0.0, 0.15]]))[0]
    assert (values < 0.0).all()


def test_the_robot_is_no_obstacle_to_itself() -> None:
    """Points on all its shapes, and near them by less than the padding; a pillar beside it stays."""
    robot = wb.load_robot("differential-ur10")
    found, geometry = LocalMap(robot, padding=0.05), robot_geometry(robot)
    place, axes = (v[0] for v in geometry.at(*geometry.kinematics(robot.home[None])))
    rng, points = np.random.default_rng(0), []
    for s, p, a in zip(geometry.shapes, place, axes, strict=True):
        d = rng.normal(size=(50, 3))
        d /= np.linalg.norm(d, axis=1)[:, None]
        points.append(p + (s.solid.support(d) + 0.03 * d) @ a.T)
    eye = np.array([0.0, 0.0, 2.0])
    pillar = np.stack([np.full(40, 1.03), np.full(40, 0.03), np.linspace(0.2, 1.5, 40)], axis=1)
    assert found.add(np.concatenate([*points, pillar]), eye, 0.0, robot.home) == 40
    collider = Collider([s.solid for s in geometry.shapes])
    collider.load([wb.shapes.Sphere(0.01).solid])
    for center in centers(found):
        collider.place(np.concatenate([place, center[None]]), np.concatenate([axes, np.eye(3)[None]]))
        assert min(collider.distance(k, len(place), 1.0) for k in range(len(place))) > 0.1


def test_points_that_are_no_measurements_are_dropped_and_counted() -> None:
    found = LocalMap(**SMALL)
    bad = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [1e9, 0, 0], [1e300, 1e300, 0], [-1e9, 1e9, 1e9]])
    assert found.add(np.concatenate([bad, wall(1.03)]), EYE, 0.0) == len(wall(1.03))
    assert found.dropped == 5 and found.occupied.sum() == 60
    assert found.add(wall(0.5), EYE, -1.0) == 0 and found.dropped == 5 + len(wall(0.5))  # older than the last one
    with pytest.raises(InputError, match="rows of 3"):
        found.add(np.zeros((4, 2)), EYE, 1.0)
    with pytest.raises(InputError, match="origin"):
        found.add(wall(1.0), [0.0, np.nan, 0.0], 1.0)


def test_the_window_follows_and_keeps_what_is_in_it() -> None:
    found = LocalMap(**SMALL)
    found.add(wall(1.03), EYE, 0.0)
    before = centers(found)
    found.add(np.zeros((0, 3)), EYE + [0.63, -0.2, 0.0], 0.1)
    np.testing.assert_allclose(centers(found), before, atol=1e-9)
    assert np.abs(found.origin + 0.05 * np.array(found.shape) - [0.65, -0.15, 0.0])[:2].max() < 0.1
    found.add(np.zeros((0, 3)), EYE + [40.0, 0.0, 0.0], 0.2)
    assert not found.occupied.any()


def test_cells_are_forgotten_and_old_sources_stop_the_robot() -> None:
    found, world = LocalMap(memory=1.0, max_age=0.3, **SMALL), wb.Obstacles()
    with pytest.raises(SensorFailure, match="no scan"):
        found.publish(world, 0.0)
    found.add(wall(1.03), EYE, 0.0, source="lidar")
    found.add(wall(1.03)[:3], EYE, 0.2, source="camera")
    found.publish(world, 0.25)
    assert world.snapshot(0.29).obstacles[0].name == "map"
    with pytest.raises(SensorFailure, match="'map'"):
        world.snapshot(0.31)  # the camera alone is new
    found.grid(1.1)
    assert 0 < found.occupied.sum() <= 3
    with pytest.raises(SensorFailure, match="'late'"):
        found.add(wall(1.03), EYE, 9.0, source="late")
        found.publish(world, 1.2)


def test_rays_pass_the_cells_that_they_cross() -> None:
    """Truth: points along the rays, densely."""
    rng = np.random.default_rng(3)
    found = LocalMap(size=(2.0, 2.0, 1.0), cell=0.1, reach=3.0)
    found.add(np.zeros((0, 3)), EYE, 0.0)
    found._evidence[:] = 6
    ends = EYE + rng.uniform(-1.5, 1.5, (30, 3))
    found.add(ends, EYE, 0.1)
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    corner, crossed = found.origin - 0.05, np.zeros(found.shape, bool)
    last = np.zeros(found.shape, bool)
    for end in ends:
        cells = np.floor((EYE + share * (end - EYE) - corner) / 0.1).astype(int)
        cells = cells[((cells >= 0) & (cells < found.shape)).all(axis=1)]
        crossed[tuple(cells.T)] = True
        inside = np.floor((end - corner) / 0.1).astype(int)
        if ((inside >= 0) & (inside < found.shape)).all():
            last[tuple(inside)] = True
    assert (found._evidence[crossed & ~last] == 5).mean() > 0.97  # a cell just touched at a corner may differ
    assert (found._evidence[~crossed] == 6).mean() > 0.999
    assert (found._evidence[last] == 6).all()
