"""Paths. Truth: SciPy's quadrature of a spline of its own, closed forms of circle and line, differences of poses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from effort import draws
from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.ocp.path import Path, _turns_between

COORDINATE = st.floats(-0.3, 0.3)


@settings(max_examples=draws(10, 200), deadline=None)
@given(st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), min_size=2, max_size=6))
def test_arc_length_is_that_of_the_spline(offsets: list[tuple[float, float, float]]) -> None:
    """Waypoints that go on by a meter along x and anywhere aside."""
    points = np.array(offsets) + np.arange(len(offsets))[:, None] * [1.0, 0.0, 0.0]
    path = Path(points)
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    spline = CubicSpline(chord, points)
    speed = lambda u: float(np.linalg.norm(spline(u, 1)))
    ways = np.cumsum([quad(speed, a, b, epsabs=1e-11)[0] for a, b in itertools.pairwise(chord)])
    assert path.length == pytest.approx(ways[-1], abs=1e-8)
    # waypoints are where the quadrature has them; and s is an arc length: the way that the path makes of it
    np.testing.assert_allclose(path.at(ways)[:, :3], points[1:], atol=1e-5)
    s = np.linspace(0.0, path.length, 4001)
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.at(s)[:, :3], axis=0), axis=1))])
    np.testing.assert_allclose(walked, s, atol=1e-4)


def test_a_circle_has_its_closed_form() -> None:
    q = lie.quaternion_about((0.0, 1.0, 0.0), 0.4)
    path = Path.circle((1.0, 0.5, 0.3), (1.0, 0.0, 0.3), quaternion=q)
    s = np.array([0.0, 0.7, 4.0, -0.2])  # R = 0.5: the third is in the second round
    angle = s / 0.5
    assert path.length == pytest.approx(np.pi, abs=1e-7)
    out = np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)
    np.testing.assert_allclose(path.at(s)[:, :3], [1.0, 0.0, 0.3] + 0.5 * out, atol=1e-7)
    np.testing.assert_allclose(
        path.tangent(s), np.stack([-np.cos(angle), -np.sin(angle), 0.0 * angle], axis=1), atol=1e-6
    )
    np.testing.assert_allclose(path.curvature(s), -2.0 * out, atol=1e-3)
    np.testing.assert_allclose(path.turning(s), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(path.at(s)[:, 3:] @ q), 1.0)


@pytest.mark.parametrize("periodic", [False, True])
def test_derivatives_are_those_of_the_poses(periodic: bool) -> None:
    """With a whole turn about the vertical in a round, after which a quaternion has the other sign."""
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    points = np.stack([np.cos(angle), 0.6 * np.sin(angle), 0.2 * np.cos(2.0 * angle)], axis=1)
    path = Path(points, [lie.quaternion_about((0.0, 0.0, 1.0), a) for a in angle], periodic=periodic)
    h, s = 1e-5, np.array([0.3, 1.0, 2.2, path.length - 1e-3 if periodic else 3.0])
    low, middle, high = path.at(s - h), path.at(s), path.at(s + h)
    np.testing.assert_allclose(path.tangent(s), (high - low)[:, :3] / (2.0 * h), atol=1e-5)
    np.testing.assert_allclose(path.curvature(s), (high - 2.0 * middle + low)[:, :3] / h**2, atol=1e-3)
    turned = [
        lie.quaternion_log(lie.quaternion_multiply(b, lie.quaternion_conjugate(a)))
        for a, b in zip(low[:, 3:], high[:, 3:])
    ]
    np.testing.assert_allclose(path.turning(s), np.array(turned) / (2.0 * h), atol=1e-6)
    if periodic:  # C² where the rounds meet
        for f in (path.tangent, path.curvature, path.turning):
            np.testing.assert_allclose(f(path.length - 1e-9), f(1e-9), atol=1e-3)


def test_a_polyline_keeps_its_straight_pieces_and_rounds_its_corners() -> None:
    path = Path.polyline([[0.0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0]], blend=0.05)
    np.testing.assert_allclose(path.at([0.0, 0.5, path.length])[:, :3], [[0, 0, 0], [0.5, 0, 0], [1, 1, 0]], atol=1e-4)
    s = np.linspace(0.0, path.length, 2001)
    corner = path.at(s)[:, :3] - [1.0, 0.0, 0.0]
    off = np.minimum(np.abs(corner[:, 1]), np.abs(corner[:, 0]))
    away = np.linalg.norm(corner, axis=1) > 0.1
    assert off[away].max() < 1e-3 and 0.005 < off.max() < 0.02
    assert 1.9 < path.length < 2.0 and np.linalg.norm(path.curvature(s), axis=1).max() < 150.0


def test_the_nearest_point_is_at_a_right_angle() -> None:
    path = Path.circle((0.5, 0, 0), (0, 0, 0))
    assert path.nearest((0.3 * np.cos(1.0), 0.3 * np.sin(1.0), 0.2)) == pytest.approx(0.5, abs=1e-6)
    assert Path.line((0, 0, 0), (2, 0, 0)).nearest((-1.0, 1.0, 0.0)) == 0.0
    assert Path.line((0, 0, 0), (2, 0, 0)).nearest((0.7, 1.0, 0.0)) == pytest.approx(0.7, abs=1e-9)


@pytest.mark.parametrize(
    ("points", "turns", "words"),
    [
        ([[0, 0, 0]], None, "n ≥ 2"),
        ([[0, 0, 0], [0, 0, 0], [1, 0, 0]], None, "0 and 1 are at one place"),
        ([[0, 0, 0], [np.nan, 0, 0]], None, "finite"),
        ([[0, 0, 0], [1, 0, 0]], [[1, 0, 0]], "shape"),
    ],
)
def test_bad_paths_name_the_cause(points: list[list[float]], turns: list[list[float]] | None, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Path(points, turns)
    with pytest.raises(InputError, match="right angle"):
        Path.circle((0, 0, 1), (0, 0, 0))


def test_orientations_between_two_are_those_of_slerp() -> None:
    """Truth: lie.slerp, one by one; also the long way round, and between equal ones."""
    rng = np.random.default_rng(3)
    for q, r in (*rng.normal(size=(20, 2, 4)), np.array([[1.0, 0, 0, 0], [-1.0, 0, 0, 0]])):
        q, r = q / np.linalg.norm(q), r / np.linalg.norm(r)
        share = np.linspace(0.0, 1.0, 7)
        expected = np.array([lie.slerp(q, r, s) for s in share])
        np.testing.assert_allclose(_turns_between(q, r, share), expected, atol=1e-12)
