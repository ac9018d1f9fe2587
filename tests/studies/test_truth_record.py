"""What is recorded of the ball robot in one compiled call. Truth: MuJoCo's frames, and rotations composed by NumPy and SciPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toys import made, robot
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.kernel.step import Backend
from wbmpc.log import Log, Rows
from wbmpc.studies.minniti2019.truth_record import TruthRecord

ROBOT = robot("rezero")
ARM = slice(5, 8)


def turned(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix of a quaternion (w, x, y, z)."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_a_row_is_what_mujoco_says_and_what_follows_from_the_estimate(backend: Backend) -> None:
    plant, log, rng = BallPlant(ROBOT.description), Log(), np.random.default_rng(5)
    record = made(backend, TruthRecord, log, plant, {"more": 2, "one": None}, True)
    d, m, states, estimates = plant.data, plant.model, [], []
    for k in range(40):
        # yaw past half turns: it goes on counting
        state = np.concatenate([rng.normal(size=2), [0.4 * k], 0.5 * rng.normal(size=2), rng.normal(size=3)])
        plant.arrange(np.concatenate([state, np.zeros(8)]))
        d.qvel[:] = rng.normal(size=m.nv)
        plant.world._fresh = False
        plant.world.check()
        record.values["more"][:], record.values["one"][0] = [k, -k], 0.5 * k
        estimate = state + 0.05 * rng.normal(size=8)
        record.add(0.1 * k, np.concatenate([estimate, np.zeros(8)]))
        states.append(state)
        estimates.append(estimate)
        base, tool = d.body("base"), d.site(ROBOT.description.arm.tool)
        rotation, hand = tool.xmat.reshape(3, 3), tool.xpos - [0.0, 0.0, plant.base.ball_radius]
        np.testing.assert_allclose(log.array("hand")[-1], hand, atol=1e-12)
        np.testing.assert_allclose(turned(log.array("hand_quaternion")[-1]), rotation, atol=1e-12)
        assert log.array("hand_quaternion")[-1][0] >= 0.0
        assert np.cos(log.array("tilt")[-1]) == pytest.approx(base.xmat[8], abs=1e-12)
        believed = Rotation.from_euler("ZYX", estimate[2:5]).as_matrix() @ base.xmat.reshape(3, 3).T
        place = np.array([*estimate[:2], 0.0]) + believed @ (tool.xpos - base.xpos)
        np.testing.assert_allclose(log.array("hand_estimated")[-1], place, atol=1e-12)
        np.testing.assert_allclose(turned(log.array("hand_quaternion_estimated")[-1]), believed @ rotation, atol=1e-12)
        np.testing.assert_allclose(log.array("state")[-1], plant.truth().state, atol=1e-12)
    np.testing.assert_allclose(log.array("state")[:, :8], states, atol=1e-12)
    np.testing.assert_array_equal(log.array("estimate")[:, :8], estimates)
    np.testing.assert_array_equal(log.array("more")[:, 0], 2.0 * log.array("one"))


def test_rows_that_are_written_together_are_channels_like_others(tmp_path: Path) -> None:
    log, other = Log(), Log()
    rows: Rows = log.together({"pair": 2, "one": None})
    count = 2500  # more than there is room for at first
    for k in range(count):
        rows.values["pair"][:], rows.values["one"][0] = [k, k + 0.5], -k
        rows.add(0.01 * k)
    log.add("apart", 1.0, [7.0])
    assert sorted(log.channels) == ["apart", "one", "pair"]
    np.testing.assert_array_equal(log.array("pair"), np.arange(count)[:, None] + [0.0, 0.5])
    np.testing.assert_array_equal(log.times("one"), 0.01 * np.arange(count))
    log.array("one")[:] = 3.0  # a copy
    assert log.array("one")[-1] == 1 - count
    other.add("one_there", 0.0, 5.0)
    other.extend(log, "_there", ("one", "apart"))
    np.testing.assert_array_equal(other.array("one_there"), [5.0, *-np.arange(count)])
    log.save(tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz") as kept:
        assert kept["pair"].shape == (count, 2) and kept["one"].shape == (count,) and kept["one.time"][1] == 0.01
