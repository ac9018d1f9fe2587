"""How deep solids are inside of each other. Truth: facets of the hull of all differences of corners (scipy) where both are polyhedra,
MuJoCo for others, closed forms for capsules; and the first solid, moved out by that much, touches the second one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from test_nearest import by_mujoco, drawn, rotation

from effort import draws
from wbmpc.clearance.depth_step import Hull, depth, hull_arrays, write_depth
from wbmpc.clearance.pairs_step import Body, Gaps, gap
from wbmpc.clearance.simplex_step import Work
from wbmpc.clearance.support_step import Solids
from wbmpc.obstacles.solids import KINDS, Solid

CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
PAIRS = [(a, b) for i, a in enumerate(KINDS) for b in KINDS[i:]]


def measured(
    first: Solid, second: Solid, place: np.ndarray, axes: np.ndarray, turn: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Distance, normal and nearest points of ``first`` at a place with axes, and ``second`` at the origin; as pairs of a robot's parts."""
    both = [first, second]
    starts = np.cumsum([0, *[len(s.vertices) for s in both]]).astype(np.int64)
    solids = Solids(
        np.array([KINDS.index(s.kind) for s in both]), np.array([s.size for s in both]).ravel(), np.array([s.radius for s in both]),
        starts, np.concatenate([np.zeros(0), *[s.vertices.ravel() for s in both]]),
    )  # fmt: skip
    places, turns, work = (
        np.concatenate([place, np.zeros(3)]),
        np.concatenate([axes.ravel(), turn.ravel()]),
        np.zeros(40),
    )
    gaps, hull = Gaps(*(np.zeros(3) for _ in range(4))), Hull(**hull_arrays())
    a, b = Body(0, places, 0, turns, 0), Body(1, places, 3, turns, 9)
    d = gap(solids, a, b, 10.0, work)
    if d > -np.inf:
        return d, work[Work.V : Work.V + 3], np.zeros(3), np.zeros(3)
    d = depth(solids, a, b, hull, work)
    write_depth(solids, gaps, a, d, 0, work)
    return d, gaps.normal, gaps.own, gaps.other


def core(solid: Solid) -> tuple[np.ndarray, float]:
    """Corners of its core, and the radius about that."""
    if solid.kind == "mesh":
        return solid.vertices, 0.0
    half = {"sphere": [0.0, 0.0, 0.0], "capsule": [0.0, 0.0, solid.size[1]]}.get(solid.kind, solid.size)
    return CORNERS * half, 0.0 if solid.kind == "box" else float(solid.size[0])


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_a_solid_that_is_moved_out_by_its_depth_touches(pair: tuple[str, str]) -> None:
    rng, deep = np.random.default_rng(PAIRS.index(pair)), 0
    for _ in range(draws(40, 1000)):
        first, second = (drawn(kind, rng) for kind in pair)
        place, axes, turn = rng.uniform(-0.15, 0.15, 3), rotation(rng), rotation(rng)
        d, normal, own, other = measured(first, second, place, axes, turn)
        if d >= 0.0 or not own.any():
            continue
        deep += 1
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(own - other, d * normal, atol=1e-12)
        after = measured(first, second, place - (d - 1e-6) * normal, axes, turn)[0]
        assert -1e-5 < after < 1e-5, (first, second, place)
        assert first.distance(((own - place) @ axes)[None])[0] < 1e-4
        if {*pair} & {"ellipsoid", "cylinder"}:
            assert d > by_mujoco(first, second, place, axes, turn) - 2e-3
        else:
            (points, radius), (others, around) = core(first), core(second)
            every = (points @ axes.T + place)[:, None] - (others @ turn.T)[None]
            truth = float(ConvexHull(every.reshape(-1, 3)).equations[:, 3].max()) - radius - around
            assert d == pytest.approx(truth, abs=2e-7)
    assert deep >= 3 or {*pair} <= {"sphere", "capsule"}


def test_lines_that_cross_are_their_radii_deep() -> None:
    capsule = Solid("capsule", np.array([0.1, 0.5, 0.0]))
    across = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    d, normal, own, other = measured(capsule, capsule, np.array([0.0, 0.0, 0.2]), across, np.eye(3))
    assert d == pytest.approx(-0.2, abs=1e-12)
    np.testing.assert_allclose(np.abs(normal), [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(own - other, d * normal, atol=1e-12)
