"""Support polygon, point of pressure and margin. Truth: SciPy's convex hull; moments that vanish; sampled edges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from wbmpc import lie
from wbmpc.simulation.scene import Body, Contact, Scene, Shape
from wbmpc.view.camera import clearest
from wbmpc.view.snapshot import active_triangle, ground, hull, margin, pressure_point, status_text


@pytest.mark.parametrize("seed", range(10))
def test_hull(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(3 + seed, 2))
    theirs = points[ConvexHull(points).vertices]  # counter-clockwise too
    ours = hull(points)
    start = int(np.argmin(np.linalg.norm(theirs - ours[0], axis=1)))
    np.testing.assert_array_equal(np.roll(theirs, -start, axis=0), ours)


@pytest.mark.parametrize("seed", range(5))
def test_pressure_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, forces = rng.normal(size=(4, 3)), rng.uniform(1.0, 5.0, 4)
    at = pressure_point(points, forces)
    moments = [np.cross(p - at, [0, 0, f]) for p, f in zip(points, forces, strict=True)]
    np.testing.assert_allclose(np.sum(moments, axis=0), 0.0, atol=1e-12)
    assert np.isnan(pressure_point(np.zeros((0, 3)), np.zeros(0))).all()


def test_margin() -> None:
    corners = hull(np.array([[0.0, 0.0], [2.0, 0.0], [2.5, 1.0], [0.0, 1.5]]))
    edges = np.concatenate(
        [
            a + np.linspace(0, 1, 2001)[:, None] * (b - a)
            for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
        ]
    )
    for inside in ([0.3, 0.4], [1.0, 1.0], [2.2, 0.9]):
        nearest = np.linalg.norm(edges - inside, axis=1).min()
        assert margin(corners, np.array(inside)) == pytest.approx(nearest, abs=1e-3)
    assert margin(corners, np.array([-0.2, 0.5])) == pytest.approx(-0.2)
    assert margin(corners[:2], np.zeros(2)) == 0.0 and margin(corners, np.full(2, np.nan)) == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_the_active_triangle_is_without_the_foot_that_carries_least(seed: int) -> None:
    """Truth: the loads of a table that rests on three of its legs, by moments about the point of pressure."""
    rng = np.random.default_rng(seed)
    feet = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]]) + rng.uniform(-0.2, 0.2, (4, 2))
    lifted = int(rng.integers(4))
    resting = np.delete(np.arange(4), lifted)
    inside = rng.dirichlet([2.0, 2, 2]) @ feet[resting]
    loads = np.zeros(4)
    loads[resting] = np.linalg.solve(np.vstack([feet[resting].T, np.ones(3)]), [*inside, 1.0])
    found = active_triangle(feet, 100.0 * loads)
    assert {tuple(c) for c in found} == {tuple(f) for f in feet[resting]}
    assert margin(found, inside) > 0.0
    assert len(active_triangle(feet[:2], loads[:2])) == 0


def test_contacts_are_drawn() -> None:
    feet = [np.array([x, y, 0.0]) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    contacts = [Contact("foot", np.array([10.0, 0, 100.0]), p) for p in feet]
    end_effector = Contact("hand", np.array([0, 5.0, 20.0]), np.array([3.0, 3, 1]))  # held up by a door
    shown = ground([*contacts, end_effector])
    assert float(shown["margin"]) == pytest.approx(1.0)
    np.testing.assert_allclose(shown["pressure"], 0.0, atol=1e-12)
    assert np.isfinite(shown["support"]).all(axis=1).sum() == 4  # what holds the end effector carries no foot
    np.testing.assert_allclose(shown["forces"][0], [feet[0], feet[0] + [0.02, 0, 0.2]])
    np.testing.assert_allclose(
        shown["forces"][4], [end_effector.point, end_effector.point + [0, 0.1, 0.4]]
    )  # drawn ten times as large
    heavy = [Contact("foot", np.array([0.0, 0, f]), p) for f, p in zip((300.0, 200, 50, 180), feet, strict=True)]
    corners = ground(heavy)["triangle"].tolist()
    assert sorted(corners) == sorted(p.tolist() for p in (feet[0], feet[1], feet[3]))
    none = ground([])
    assert np.isnan(none["support"]).all() and float(none["margin"]) == 0.0


def test_margins_are_distances_inside_or_outside() -> None:
    said = status_text({"error": np.nan, "margin": 0.0312, "triangle_margin": -0.148})
    assert said == "  \nZMP 31 mm inside the polygon, 148 mm outside the triangle"


@pytest.mark.parametrize("turn", [0.0, 0.9, 2.1, -2.5])
def test_the_camera_stands_where_no_wall_hides_the_robot(turn: float) -> None:
    """Truth: the wall is on one side of the robot, so that an eye on that side sees nothing; a low sill hides nothing."""
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    heading = lie.quaternion_about((0.0, 0.0, 1.0), turn)
    bodies = (Body("base", "world", True), Body("arm", "base", True), Body("door", "world", True))
    poses = np.array([[0, 0, 0.2, 1, 0, 0, 0], [0, 0, 0.8, 1, 0, 0, 0], [*(0.5 * ahead), *heading]])
    eyes = [np.array([0.0, 0.0, 1.5]) + 3.0 * ahead, np.array([0.0, 0.0, 1.5]) - 3.0 * ahead]
    for height, chosen in ((2.0, 1), (0.02, 0)):
        door = Shape("door", "box", (0.02, 2.0, height), (0, 0, height, 1, 0, 0, 0), (1, 1, 1, 1))
        assert clearest(Scene("base", bodies, (door,)), poses, eyes) == chosen
    hull_of_robot = Shape("base", "box", (0.5, 0.5, 0.5), (0, 0, 0, 1, 0, 0, 0), (1, 1, 1, 1))
    assert clearest(Scene("base", bodies[:2], (hull_of_robot,)), poses[:2], eyes) == 0
