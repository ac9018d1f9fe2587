"""Distances to occupied cells. Truth: SciPy's exact transform, and closed forms of balls and boxes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

import wbmpc as wb
from effort import draws
from wbmpc.clearance import grid_step
from wbmpc.errors import InputError
from wbmpc.mapping import distance_grid
from wbmpc.mapping.distances import ERROR, DistanceTransform, signed


@pytest.mark.parametrize("seed", range(draws(6, 100)))
def test_transforms_are_exact(seed: int) -> None:
    """Up to the farthest distance; also where nothing, or everything, is occupied in a line."""
    rng = np.random.default_rng(seed)
    shape = tuple(int(n) for n in rng.integers(2, 14, 3))
    occupied = rng.random(shape) < rng.choice([0.01, 0.1, 0.5, 0.9])
    occupied.flat[0], occupied.flat[-1] = True, False
    truth = 0.1 * (distance_transform_edt(~occupied) - distance_transform_edt(occupied))
    for farthest in (100.0, 0.35):
        found = DistanceTransform(shape, 0.1, farthest)(3 * occupied.astype(np.int64), 2)  # type: ignore[arg-type]
        np.testing.assert_allclose(found, np.clip(truth, -farthest, farthest), atol=1e-12)


def test_nothing_and_everything_are_as_far_as_it_goes() -> None:
    empty = np.zeros((4, 5, 6), np.int64)
    transform = DistanceTransform((4, 5, 6), 0.1, 2.0)
    np.testing.assert_array_equal(transform(empty, 1), 2.0)
    np.testing.assert_array_equal(transform(empty + 1, 1), -2.0)


def test_machine_code_is_the_source() -> None:
    evidence = np.random.default_rng(0).integers(0, 4, (4, 5, 6))
    lines, start, apex, out = np.zeros(48), np.zeros(6), np.zeros(6, np.int64), np.zeros((2, 120))
    signed.interpreted(4, 5, 6, evidence.ravel(), 3, 0.1, 0.4, out[0], lines, apex, start, out[1])
    np.testing.assert_array_equal(out[1], DistanceTransform((4, 5, 6), 0.1, 0.4)(evidence, 3).ravel())


@pytest.mark.parametrize("seed", range(draws(3, 50)))
def test_no_point_is_nearer_than_the_grid_says(seed: int) -> None:
    """What is solid may be anywhere in its cell: truth is the distance to whole cells, cubes."""
    rng = np.random.default_rng(seed)
    occupied = rng.random((7, 8, 6)) < (0.01, 0.1, 0.3)[seed % 3]
    occupied[3, 3, 3] = True
    points = rng.uniform(0.0, 1.0, (2000, 3)) * (np.array(occupied.shape) - 1.0)
    cubes = np.abs(points[:, None] - np.argwhere(occupied)[None]) - 0.5
    truth = np.linalg.norm(np.maximum(cubes, 0.0), axis=2).min(axis=1)
    found, _ = distance_grid((0, 0, 0), 1.0, occupied).sample(points)
    assert (found <= truth).all()


def test_a_ball_of_cells_is_a_ball() -> None:
    """To within the diagonal of half a cell and its error, with normals that point away from the center."""
    cell, radius = 0.05, 0.4
    axis = np.arange(-20, 21) * cell
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    grid = distance_grid(3 * [axis[0]], cell, np.sqrt(x**2 + y**2 + z**2) <= radius)
    points = np.random.default_rng(0).uniform(-0.95, 0.95, (3000, 3))
    points = points[np.linalg.norm(points, axis=1) > radius + 2 * cell]
    value, slope = grid.sample(points)
    length = np.linalg.norm(points, axis=1)
    assert np.abs(value + ERROR * cell - (length - radius)).max() < np.sqrt(3) / 2 * cell + 0.01
    assert np.mean(np.sum(slope * points, axis=1) / length) > 0.97


@pytest.mark.parametrize("layer", [0.1, 0.14])
def test_balls_are_nearest_where_samples_say(layer: float) -> None:
    """The compiled search against the sampling of each ball; the second side has another direction."""
    rng = np.random.default_rng(2)
    occupied = np.zeros((30, 30, 12), bool)
    occupied[4:6, :, :8], occupied[20:24, 20:25, :] = True, True
    cubes = distance_grid((-0.4, -0.2, 0.1), 0.1, occupied)
    grid = wb.shapes.DistanceGrid(cubes.origin, 0.1, cubes.values, cubes.error, layer)
    frame, radius = np.repeat([0, 1], 6), rng.uniform(0.05, 0.1, 12)
    local, position = rng.uniform(-0.3, 0.3, (12, 3)), rng.uniform([0.3, 0.3, 0.4], [2.0, 2.0, 0.9], (5, 2, 3))
    turn, ball, center = np.eye(3), np.full((5, 2, 2), -1), np.zeros((5, 12, 3))
    distance, normal, limit = np.full((5, 2, 2), 9.0), np.zeros((5, 2, 2, 3)), 9.0
    grid_step.nearest(
        5, 2, 12, 2, grid_step.Balls(frame, local.ravel(), radius), position.ravel(), np.tile(turn, (5, 2, 1, 1)).ravel(),
        grid_step.Grid(30, 30, 12, 0.1, layer, np.asarray(grid.values).ravel(), np.asarray(grid.origin), turn.ravel()),
        grid_step.Sides(distance.ravel(), normal.ravel(), ball.ravel(), center.ravel()),
    )  # fmt: skip
    value, slope = grid.sample((position[:, frame] + local).reshape(-1, 3))
    value, slope = value.reshape(5, 12) + ERROR * 0.1 - radius, slope.reshape(5, 12, 3)
    normals = slope / np.linalg.norm(slope, axis=2, keepdims=True).clip(1e-9)
    for k in range(5):
        for f in range(2):
            steep = np.linalg.norm(slope[k], axis=1) > grid_step.FLAT
            mine = np.flatnonzero((frame == f) & np.isfinite(value[k]) & steep)
            first = mine[np.argmin(value[k, mine])]
            assert ball[k, f, 0] == first and distance[k, f, 0] == pytest.approx(value[k, first], abs=1e-12)
            np.testing.assert_allclose(normal[k, f, 0], normals[k, first], atol=1e-12)
            others = [b for b in mine if normals[k, b] @ normals[k, first] <= grid_step.SAME]
            least = min((value[k, b] for b in others), default=limit)
            assert distance[k, f, 1] == pytest.approx(least, abs=1e-12)


@pytest.mark.parametrize("occupied", [np.zeros((3, 3)), np.zeros((3, 3, 3)), np.zeros((3, 1, 3), bool)])
def test_occupied_cells_are_truth_values_in_three_dimensions(occupied: np.ndarray) -> None:
    with pytest.raises(InputError, match="'occupied'"):
        distance_grid((0, 0, 0), 0.1, occupied)


def test_what_is_older_than_it_may_be_ends_plans() -> None:
    world = wb.Obstacles()
    world.set("map", distance_grid((0, 0, 0), 0.1, np.zeros((3, 3, 3), bool)), seen=1.0, max_age=0.5)
    assert len(world.snapshot(1.5).obstacles) == 1
    with pytest.raises(wb.WbmpcError, match=r"'map' was seen 0\.60 s ago"):
        world.snapshot(1.6)
    with pytest.raises(InputError, match="'max_age' counts from 'seen'"):
        world.set("map", wb.shapes.Sphere(0.1), max_age=0.5)
