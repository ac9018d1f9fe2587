"""`Reference.at`. Truth: NumPy's and SciPy's interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from wbmpc.ocp import Reference

TIMES = np.array([0.0, 0.5, 0.6, 2.0])


@pytest.mark.parametrize("t", [-1.0, 0.0, 0.3, 0.5, 1.234, 2.0, 3.0])
def test_linear_and_held(t: float) -> None:
    values = np.random.default_rng(0).normal(size=(4, 3))
    expected = [np.interp(t, TIMES, values[:, i]) for i in range(3)]
    np.testing.assert_allclose(Reference(TIMES, values).at(t), expected, atol=1e-14)
    held = values[max(np.sum(t >= TIMES) - 1, 0)]
    np.testing.assert_array_equal(Reference(TIMES, values, "hold").at(t), held)


def test_poses_turn_between_samples() -> None:
    turns = Rotation.from_rotvec(np.outer([0.0, 0.1, 0.15, 0.3], [0.6, 0.0, 0.8]))
    quaternions = turns.as_quat()[:, [3, 0, 1, 2]] * np.array([1, -1, 1, -1])[:, None]  # of any sign
    reference = Reference.poses(TIMES, np.zeros((4, 3)), quaternions)
    for t in (0.0, 0.21, 0.55, 1.0, 1.9):
        q = reference.at(t)[3:]
        assert np.linalg.norm(q) == pytest.approx(1.0)
        apart = Rotation.from_quat(q[[1, 2, 3, 0]]).inv() * Slerp(TIMES, turns)(t)
        assert apart.magnitude() < 1e-4  # a normalized line is not quite an arc
