"""Support polygon, point of pressure and margin. Truth: SciPy's convex hull; moments that vanish; sampled edges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from wbmpc.plant.scene import Contact
from wbmpc.view.snapshot import ground
from wbmpc.view.support import hull, margin, pressure_point


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


def test_contacts_are_drawn() -> None:
    feet = [np.array([x, y, 0.0]) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    contacts = [Contact("foot", np.array([10.0, 0, 100.0]), p) for p in feet]
    hand = Contact("hand", np.array([0, 5.0, 20.0]), np.array([3.0, 3, 1]))  # held up by a door
    shown = ground([*contacts, hand])
    assert float(shown["margin"]) == pytest.approx(1.0)
    np.testing.assert_allclose(shown["pressure"], 0.0, atol=1e-12)
    assert np.isfinite(shown["support"]).all(axis=1).sum() == 4  # what holds the hand carries no foot
    np.testing.assert_allclose(shown["forces"][0], [feet[0], feet[0] + [0.02, 0, 0.2]])
    np.testing.assert_allclose(shown["forces"][4], [hand.point, hand.point + [0, 0.1, 0.4]])  # drawn ten times as large
    none = ground([])
    assert np.isnan(none["support"]).all() and float(none["margin"]) == 0.0
