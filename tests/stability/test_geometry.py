"""Support polygon, triangles, regions and margins. Truth: SciPy's convex hull, sampling by brute force, and the areas of
Table I of Pankert et al. 2022."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, Delaunay

from effort import draws
from toys import robot
from wbmpc import stability
from wbmpc.errors import InputError

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
seeds = st.integers(0, 10_000)


def some_feet(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.0, 1.0, (rng.integers(3, 8), 2))


@pytest.mark.parametrize(
    ("name", "polygon", "double"), [("H", "1.16", "0.29"), ("X", "1.81", "0.45"), ("A", "1.17", "0.76")]
)
def test_table_one_of_the_paper_to_two_decimals(name: str, polygon: str, double: str) -> None:
    swerve = robot("swerve-ur10")
    feet = swerve.base.geometry.steer_axes(stability.configuration_positions(swerve, name))
    regions = stability.overlap_regions(feet)
    assert f"{stability.area(stability.support_polygon(feet)):.2f}" == polygon
    assert f"{regions[0].area:.2f}" == double
    assert len(regions) == 4 and all(len(r.triangles) == 2 for r in regions)


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_the_polygon_is_scipys_convex_hull(seed: int) -> None:
    feet = some_feet(seed)
    known = ConvexHull(feet)
    polygon = stability.support_polygon(feet)
    assert set(stability.hull(feet)) == set(known.vertices)
    assert stability.area(polygon) == pytest.approx(known.volume, rel=1e-12)  # SciPy's name for a plane's area


@given(seeds)
@settings(max_examples=draws(10, 25), deadline=None, derandomize=True)
def test_regions_cover_the_polygon_with_the_triangles_that_brute_force_finds(seed: int) -> None:
    feet, rng = some_feet(seed), np.random.default_rng(seed)
    triangles = list(combinations(range(len(feet)), 3))
    regions = stability.overlap_regions(feet)
    points = rng.uniform(-1.0, 1.0, (4000, 2))
    inside = {t: Delaunay(feet[list(t)]).find_simplex(points) >= 0 for t in triangles}
    count = sum(inside.values())
    covered = np.zeros(len(points), int)
    for region in regions:
        within = np.any([stability.margin(p, points) > 0.0 for p in region.pieces], axis=0)
        covered += within
        expected = np.all([inside[tuple(sorted(t))] for t in region.triangles], axis=0)
        assert np.all(expected[within]) and np.all(count[within] == len(region.triangles))
        share = region.area / 4.0  # of the 4 m² that were sampled
        assert within.mean() == pytest.approx(share, abs=6.0 * np.sqrt(share * (1.0 - share) / len(points)) + 1e-3)
    assert np.array_equal(covered, (count > 1).astype(int))


def test_three_feet_have_one_triangle_and_no_overlap() -> None:
    assert stability.support_triangles(SQUARE[:3]) == [(0, 1, 2)]
    assert stability.overlap_regions(SQUARE[:3]) == []
    assert len(stability.support_triangles(SQUARE)) == 4


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_margin_is_the_distance_to_the_sampled_border(seed: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = stability.support_polygon(some_feet(seed))
    points = rng.uniform(-1.5, 1.5, (50, 2))
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    border = np.vstack([a + share * (b - a) for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True)])
    distance = np.linalg.norm(points[:, None] - border[None], axis=2).min(axis=1)
    sign = np.where(Delaunay(polygon).find_simplex(points) >= 0, 1.0, -1.0)
    assert stability.margin(polygon, points) == pytest.approx(sign * distance, abs=2e-3)


@given(seeds)
@settings(max_examples=draws(10, 30), deadline=None)
def test_within_the_region_margin_no_triangle_is_left_or_entered(seed: int) -> None:
    """A circle of that radius stays in the same triangles; a slightly larger one leaves one of them."""
    feet, rng = some_feet(seed), np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(len(feet)), 30)
    points = weights @ feet
    around = np.stack([np.cos(np.linspace(0, 2 * np.pi, 721)), np.sin(np.linspace(0, 2 * np.pi, 721))], axis=1)
    for point, radius in zip(points, stability.region_margin(feet, points), strict=True):
        if radius < 1e-3:
            continue
        triangles = [Delaunay(feet[list(t)]) for t in stability.support_triangles(feet)]
        mine = [d for d in triangles if d.find_simplex(point) >= 0]
        assert all(np.all(d.find_simplex(point + 0.999 * radius * around) >= 0) for d in mine)
        assert any(np.any(d.find_simplex(point + 1.01 * radius * around) < 0) for d in mine)


def test_margins_of_a_square() -> None:
    margins = stability.triangle_margins(SQUARE, [0.5, 0.25])
    assert float(stability.margin(SQUARE, [0.5, 0.25])) == pytest.approx(0.25)
    assert float(stability.margin(SQUARE, [1.3, 1.4])) == pytest.approx(-0.5)
    assert float(margins[(0, 1, 2)]) == pytest.approx(0.25 / np.sqrt(2.0))  # to the diagonal
    assert float(margins[(0, 2, 3)]) == pytest.approx(-0.25 / np.sqrt(2.0))
    assert float(stability.margin(SQUARE, [np.nan, np.nan])) == -np.inf


def test_where_diagonals_cross_every_way_leaves_a_triangle() -> None:
    """By symmetry the middle of a square is on the edge of all four triangles: a margin of 0, and of next to it nearly 0."""
    assert stability.region_margin(SQUARE, [0.0, 0.0]) == 0.0
    assert stability.region_margin(SQUARE, [0.4, 0.4]) == 0.0
    assert stability.region_margin(SQUARE, [0.4, 0.39]) == pytest.approx(0.01 / np.sqrt(2.0))


def test_points_without_load_are_outside() -> None:
    square = stability.support_polygon(SQUARE)
    assert list(stability.margin(square, [[np.nan, 0.0], [np.inf, 0.0], [0.0, -np.inf]])) == [-np.inf] * 3
    assert stability.region_margin(SQUARE, [np.nan, np.nan]) == -np.inf


def test_two_feet_in_one_place_count_once() -> None:
    (region,) = stability.overlap_regions([[0, 0], [0, 0], [1, 0], [0, 1]])
    assert region.area == pytest.approx(0.5) and len(region.triangles) == 2


@pytest.mark.parametrize(
    "feet", [[[0, 0], [1, 1]], [[0, 0], [1, 1], [2, 2]], [[0, 0], [1, 0], [np.nan, 1]], [0.0, 1.0, 2.0]]
)
def test_feet_without_a_polygon_are_rejected(feet: list) -> None:
    with pytest.raises(InputError, match="feet"):
        stability.support_polygon(feet)
