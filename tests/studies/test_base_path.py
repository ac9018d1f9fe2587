"""Base motions. Truth: their own twists integrated by SciPy, and what they promise about rest and speeds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from effort import draws
from wbmpc.studies.base_path import STEP, Segment, in_turn, random_twists


def integrated(path, end: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    def rate(t: float, pose: np.ndarray) -> list[float]:
        vx, vy, w = path.twist(t)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return [c * vx - s * vy, s * vx + c * vy, w]

    return solve_ivp(rate, (0.0, end), np.zeros(3), rtol=1e-9, atol=1e-9, max_step=STEP).y[:, -1]


def test_segments_in_turn() -> None:
    path, spans = in_turn([Segment((0.4, 0.1, 0.0), 4.0), Segment((0.1, 0.0, 0.5), 5.0)], 1.0, 2.0, 1.0)
    assert spans == [(1.0, 5.0), (7.0, 12.0)]
    np.testing.assert_allclose(path.twist(3.0), [0.4, 0.1, 0.0], atol=1e-12)
    for rest in (0.0, 1.0, 5.0, 6.0, 7.0, 12.0, 13.9, 100.0):
        np.testing.assert_allclose(path.twist(rest), 0.0, atol=1e-12)
    # a ramp of 1 s at both ends takes one second of full speed away
    np.testing.assert_allclose(path.pose(6.0), [1.2, 0.3, 0.0], atol=1e-6)
    np.testing.assert_allclose(path.pose(13.0), integrated(path, 13.0), atol=1e-5)


@pytest.mark.parametrize("seed", range(draws(1, 4)))
def test_random_twists(seed: int) -> None:
    path = random_twists(40.0, 0.5, 0.4, seed)
    np.testing.assert_array_equal(path.twists, random_twists(40.0, 0.5, 0.4, seed).twists)
    speed = np.hypot(path.twists[:, 0], path.twists[:, 1])
    assert 0.2 < speed.max() <= 0.5 + 1e-9
    assert 0.1 < np.abs(path.twists[:, 2]).max() <= 0.4 + 1e-9
    np.testing.assert_allclose(path.twists[[0, -1]], 0.0, atol=1e-12)
    # no jump: a change takes a second, cosines rise by π / 2 per ramp
    assert np.abs(np.diff(path.twists, axis=0)).max() <= np.pi / 2 * STEP * 1.001
    np.testing.assert_allclose(path.poses[-1], integrated(path, 40.0), atol=1e-4)
