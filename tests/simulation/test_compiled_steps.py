"""What compiled code does in a physics step, against the same source as ordinary Python and NumPy's indexing."""

from __future__ import annotations

import numpy as np
import pytest

from toys import made
from wbmpc.kernel.step import Backend, bind
from wbmpc.simulation.arm import carry, keep
from wbmpc.simulation.contacts import near
from wbmpc.simulation.scene import from_base

BACKENDS: list[Backend] = ["compiled", "interpreted"]


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_arm_s_weight_goes_to_its_joints_alone(backend: Backend) -> None:
    rng = np.random.default_rng(0)
    bias, applied, dofs = rng.normal(size=9), rng.normal(size=9), np.array([7, 2, 4])
    expected = applied.copy()
    expected[dofs] = bias[dofs]
    made(backend, bind, carry, {"dofs": dofs, "qfrc_bias": bias, "qfrc_applied": applied}, m=3).call()
    assert np.array_equal(applied, expected)


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_last_positions_are_kept_in_a_ring(backend: Backend) -> None:
    rng, places, newest, qpos = np.random.default_rng(1), np.array([3, 0]), np.zeros(2, dtype=np.int64), np.zeros(5)
    history, sensordata, sums, total = np.zeros((4, 2)), np.zeros(6), np.zeros(3), np.zeros(3)
    arrays = {"places": places, "qpos": qpos, "history": history.reshape(-1), "newest": newest}
    arrays |= {"sensors": np.array([4, 1]), "sensordata": sensordata, "sums": sums}
    step, seen = made(backend, bind, keep, arrays, n=2, rows=4, felt=2).call, []
    for k in range(11):
        qpos[:], sensordata[:] = rng.normal(size=5), rng.normal(size=6)
        seen.append(qpos[places])
        step()
        total += [sensordata[4], sensordata[1], 1.0]
        np.testing.assert_allclose(sums, total, rtol=1e-15)
        assert newest[1] == min(k + 1, 4)
        for age in range(newest[1]):
            assert np.array_equal(history[(newest[0] - age) % 4], seen[-1 - age])


@pytest.mark.parametrize("backend", BACKENDS)
def test_shapes_that_may_be_near_are_found(backend: Backend) -> None:
    rng = np.random.default_rng(2)
    pairs, centers = rng.integers(0, 8, (30, 2)), rng.normal(size=(8, 3))
    reach, found = rng.uniform(0.0, 1.0, 30), np.zeros(30, dtype=np.int64)
    arrays = {"pairs": pairs.ravel(), "centers": centers.ravel(), "reach": reach, "found": found}
    count = made(backend, bind, near, arrays, n=30)(0.7)
    apart = np.linalg.norm(centers[pairs[:, 0]] - centers[pairs[:, 1]], axis=1) - reach
    assert 3 < count < 27 and np.array_equal(found[:count], np.flatnonzero(apart < 0.7))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_tool_is_seen_from_the_base(backend: Backend) -> None:
    rng = np.random.default_rng(6)
    (base, tool), (rotation, turned) = rng.normal(size=(2, 3)), rng.normal(size=(2, 3, 3))
    a = {"base": base, "rotation": rotation.ravel(), "tool": tool, "tool_rotation": turned.ravel()}
    a |= {"seen": np.ones(3), "turned": np.ones(9)}
    made(backend, bind, from_base, a).call()
    np.testing.assert_allclose(a["seen"], rotation.T @ (tool - base), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(a["turned"].reshape(3, 3), rotation.T @ turned, rtol=1e-12, atol=1e-14)
