"""Compiled rolling inverse kinematics against NumPy's, whose rows and motions tests/model/test_swerve.py holds against MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from toys import made, robot
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.rolling import Rolling
from wbmpc.kernel.step import Backend
from wbmpc.model.wheels import rolling_inverse_kinematics

GEOMETRIES = [swerve_base(robot(name)).geometry for name in ("swerve-ur10", "telescope-ur10", "pentapod-ur10")]
ROLLING = {b: [made(b, Rolling, g) for g in GEOMETRIES] for b in ("compiled", "interpreted")}


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@settings(max_examples=100, deadline=None)
@given(kind=st.integers(0, 2), seed=st.integers(0, 2**31), moving=st.booleans(), driving=st.booleans())
def test_it_rolls_as_numpy_says(backend: Backend, kind: int, seed: int, moving: bool, driving: bool) -> None:
    """Hinged and sliding legs, still and moving ones, wheels that stand."""
    g, rng = GEOMETRIES[kind], np.random.default_rng(seed)
    leg, steer, rate = rng.uniform(-1.0, 1.0, (3, g.modules)) * np.array([[1.0], [3.0], [0.3 * moving]])
    twist = rng.uniform(-1.0, 1.0, 3) * driving
    found, truth = (
        ROLLING[backend][kind](leg, steer, twist, rate),
        rolling_inverse_kinematics(g, leg, steer, twist, rate),
    )
    # the two directions of a wheel that moves straight across are a rounding apart
    near = np.abs(np.abs(truth[0] - steer) - np.pi / 2) > 1e-9
    for one, other in zip(found, truth, strict=True):
        np.testing.assert_allclose(one[near], other[near], rtol=1e-11, atol=1e-11)
