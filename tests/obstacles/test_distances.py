"""Distances of shapes. Truth: closed forms of geometry, written here; no collision library."""

from __future__ import annotations

import numpy as np
import pytest

import wbmpc as wb
from effort import draws
from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.obstacles import solids
from wbmpc.obstacles.collider import Collider
from wbmpc.obstacles.geometry import _cover
from wbmpc.obstacles.solids import Solid

BALL = solids.sphere(0.05, np.zeros(3))


def rotation(rng: np.random.Generator) -> np.ndarray:
    q = rng.normal(size=4)
    return lie.quaternion_to_rotation(q / np.linalg.norm(q))


def to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    s = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return float(np.linalg.norm(p - a - s * (b - a)))


def to_box(p: np.ndarray, half: np.ndarray) -> float:
    return float(np.linalg.norm(np.maximum(np.abs(p) - half, 0.0)))


def to_cylinder(p: np.ndarray, radius: float, half: float) -> float:
    return float(np.hypot(max(np.hypot(p[0], p[1]) - radius, 0.0), max(abs(p[2]) - half, 0.0)))


def distance(first: Solid, second: Solid, place: np.ndarray, turn: np.ndarray) -> tuple[float, np.ndarray]:
    """Of a solid at the origin to another one at ``place`` and ``turn``, and their nearest points."""
    collider = Collider([first])
    collider.load([second])
    collider.place(np.stack([first.position, place]), np.stack([first.rotation, turn]))
    return collider.distance(0, 1, 10.0), collider.points


@pytest.mark.parametrize("seed", range(draws(6, 100)))
def test_a_ball_is_as_far_from_primitives_as_geometry_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    place, turn, size = rng.uniform(-1.0, 1.0, 3) * 1.5, rotation(rng), rng.uniform(0.05, 0.4, 3)
    inside = -turn.T @ place  # the ball in the other's axes
    truths = {
        "box": to_box(inside, size),
        "cylinder": to_cylinder(inside, size[0], size[1]),
        "capsule": to_segment(inside, np.array([0, 0, -size[1]]), np.array([0, 0, size[1]])) - size[0],
        "sphere": float(np.linalg.norm(inside)) - size[0],
    }
    for kind, truth in truths.items():
        if truth > 0.06:
            found, points = distance(BALL, Solid(kind, size), place, turn)
            assert found == pytest.approx(truth - 0.05, abs=1e-5), kind
            assert np.linalg.norm(points[:3]) == pytest.approx(0.05, abs=1e-5)  # the first three are the ball's own
            assert Solid(kind, size).distance(inside) == pytest.approx(truth, abs=1e-12)


@pytest.mark.parametrize("seed", range(draws(4, 50)))
def test_a_hull_is_its_vertices(seed: int) -> None:
    """A mesh of a box's corners and points inside of it is that box, wherever the compiler puts its axes."""
    rng = np.random.default_rng(seed)
    half, turn = rng.uniform(0.1, 0.5, 3), rotation(rng)
    corners = np.stack(np.meshgrid(*[[-h, h] for h in half]), axis=-1).reshape(-1, 3)
    vertices = np.concatenate([corners, rng.uniform(-half, half, (20, 3))]) + [0.3, -0.2, 0.1]
    mesh = wb.shapes.ConvexMesh(vertices).solid
    place = rng.uniform(0.8, 1.2, 3)
    found, _ = distance(BALL, mesh, place + turn @ mesh.position, turn @ mesh.rotation)
    assert found == pytest.approx(to_box(-turn.T @ place - [0.3, -0.2, 0.1], half) - 0.05, abs=1e-5)


@pytest.mark.parametrize("kind", ["sphere", "capsule", "ellipsoid", "cylinder", "box"])
def test_no_point_of_a_solid_is_beyond_its_support(kind: str) -> None:
    """Truth: points of the solid, drawn by its inequality."""
    rng = np.random.default_rng(1)
    size = np.array([0.2, 0.35, 0.1])
    solid = Solid(kind, size)
    reach = np.array([0.6, 0.6, 0.6])
    contains = {
        "sphere": lambda p: (p**2).sum(axis=1) <= 0.04,
        "capsule": lambda p: np.hypot(np.hypot(p[:, 0], p[:, 1]), np.maximum(np.abs(p[:, 2]) - 0.35, 0.0)) <= 0.2,
        "ellipsoid": lambda p: ((p / size) ** 2).sum(axis=1) <= 1.0,
        "cylinder": lambda p: (np.hypot(p[:, 0], p[:, 1]) <= 0.2) & (np.abs(p[:, 2]) <= 0.35),
        "box": lambda p: (np.abs(p) <= size).all(axis=1),
    }[kind]
    points = rng.uniform(-reach, reach, (20000, 3))
    d = rng.normal(size=(40, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    most = (points[contains(points)] @ d.T).max(axis=0)
    support = solid.support(d)
    assert (most <= np.sum(support * d, axis=1) + 1e-12).all() and contains((1.0 - 1e-9) * support).all()
    assert np.linalg.norm(support, axis=1).max() <= solid.radius + 1e-12


def test_many_obstacles_and_another_mesh_take_the_place_of_the_last_ones() -> None:
    collider = Collider([BALL])
    balls = [solids.sphere(0.1, np.zeros(3)) for _ in range(100)]
    collider.load(balls)
    collider.place(np.stack([np.zeros(3), *[[0.0, 0.0, 1.0 + k] for k in range(100)]]), np.tile(np.eye(3), (101, 1, 1)))
    assert collider.distance(0, 73, 200.0) == pytest.approx(73.0 - 0.15)
    cube = wb.shapes.ConvexMesh(np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)).solid
    collider.load([balls[0], cube])
    collider.place(np.array([[0, 0, 0], [9, 0, 0], [2.5, 0.5, 0.5]]), np.tile(np.eye(3), (3, 1, 1)))
    assert collider.distance(0, 2, 9.0) == pytest.approx(2.0 - 0.05, abs=1e-5)


def test_a_grid_is_linear_between_its_cells_and_takes_its_error_off() -> None:
    origin, cell = np.array([-1.0, -1.0, 0.0]), 0.1
    axes = [origin[a] + cell * np.arange(n) for a, n in enumerate((21, 21, 11))]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    grid = wb.shapes.DistanceGrid(origin, cell, 0.3 * x - 0.5 * y + 0.2 * z + 1.0)
    points = np.array([[0.123, -0.456, 0.789], [0.0, 0.0, 0.5], [5.0, 0.0, 0.0]])
    value, gradient = grid.sample(points)
    truth = points[:2] @ [0.3, -0.5, 0.2] + 1.0 - 0.5 * np.sqrt(3) * 0.1
    np.testing.assert_allclose(value[:2], truth, atol=1e-12)
    np.testing.assert_allclose(gradient[:2], [[0.3, -0.5, 0.2]] * 2, atol=1e-9)
    assert np.isinf(value[2]) and not gradient[2].any()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: wb.shapes.Sphere(0.0), ("sphere", "radius", "positive")),
        (lambda: wb.shapes.Capsule((0, 0), (0, 0, 1), 0.1), ("capsule", "'a'", "3")),
        (lambda: wb.shapes.Cylinder((0, 0, 0), (0, 0, 0), 0.1), ("cylinder", "same point")),
        (lambda: wb.shapes.Box((0.1, -0.1, 0.1)), ("box", "half", "positive")),
        (lambda: wb.shapes.Box((1, 1, 1), orientation=(1, 1, 0, 0)), ("box", "orientation", "unit quaternion")),
        (lambda: wb.shapes.HalfSpace((0, 0, 0)), ("half-space", "normal")),
        (lambda: wb.shapes.ConvexMesh(np.zeros((3, 3))), ("convex mesh", "(3, 3)")),
        (lambda: wb.shapes.ConvexMesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])), ("convex mesh", "plane")),
        (lambda: wb.shapes.DistanceGrid((0, 0, 0), 0.1, np.zeros((3, 3))), ("distance grid", "three dimensions")),
        (lambda: wb.shapes.Sphere(float("nan")), ("sphere", "radius", "finite")),
    ],
)  # fmt: skip
def test_a_wrong_shape_is_named(make, words) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError) as error:
        make()
    assert all(word in str(error.value) for word in words)


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "box"])
def test_balls_about_a_solid_are_nowhere_farther_than_it(kind: str) -> None:
    """Truth: the exact distance of points outside. The balls stick out by less than a ball's radius."""
    rng = np.random.default_rng(0)
    for size in (np.array([0.06, 0.3, 0.1]), np.array([0.25, 0.3, 0.1]), np.array([0.4, 0.05, 0.02])):
        solid = Solid(kind, size, np.array([0.1, -0.2, 0.3]), rotation(rng))
        balls = _cover(solid)
        points = rng.uniform(-0.8, 0.8, (500, 3))
        truth = solid.distance(points)
        places = solid.position + points @ solid.rotation.T
        found = np.min([np.linalg.norm(places - c, axis=1) - r for c, r in balls], axis=0)
        outside = truth > 0.0
        assert (found <= truth + 1e-9)[outside].all()
        assert (found >= truth - 0.1)[outside].all()
