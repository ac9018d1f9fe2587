"""The swerve base with another arm, from its description only. Truth: the release's joint limits (Pankert et al. 2022);
the arm's forward kinematics multiplied by hand; MuJoCo's true pose of base and end effector after a drive."""

from __future__ import annotations

import numpy as np
import pytest

from driving import Motion, drive
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.model.robot import load_robot

ROBOT = load_robot("swerve-mabi")
LOWER, UPPER = np.array([-6.1, -3.0, -2.4, -6.1, -2.2, -4.6]), np.array([6.1, 0.0, 2.4, 6.1, 2.2, 4.6])


def test_limits_are_those_of_the_release() -> None:
    arm = ROBOT.state["arm"]
    np.testing.assert_allclose(ROBOT.limits.state_lower[arm], LOWER)
    np.testing.assert_allclose(ROBOT.limits.state_upper[arm], UPPER)
    np.testing.assert_allclose(ROBOT.limits.input_upper[ROBOT.input["arm"]], 0.5)


def rotation(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    out[j, i], out[i, j] = s, -s
    return out


@pytest.mark.parametrize("seed", range(3))
def test_the_hand_is_where_six_turns_put_it(seed: int) -> None:
    q = np.random.default_rng(seed).uniform(0.9 * LOWER, 0.9 * UPPER)
    place, turn = np.array([0.0, 0.0, 0.3695 + 0.14 + 0.12]), np.eye(3)
    offsets = [(0, 0, 0.13), (0.5, 0, 0), (0.1, 0, 0), (0.35, 0, 0), (0.1, 0, 0), (0.05, 0, 0)]
    for axis, angle, offset in zip((2, 1, 1, 0, 1, 0), q, offsets, strict=True):
        turn = turn @ rotation(axis, angle)
        place = place + turn @ np.array(offset)
    x = ROBOT.home.copy()
    x[ROBOT.state["arm"]] = q
    np.testing.assert_allclose(ROBOT.pose(x)[0], place, atol=1e-9)
    y = SwervePlant(ROBOT.description, x, SwervePerturbation.none(), settle=0.0).truth()
    np.testing.assert_allclose(y.tool, place, atol=1e-6)
    np.testing.assert_allclose(y.tool_rotation[:, 2], turn[:, 0], atol=1e-6)


def test_it_drives_and_its_hand_rides_along() -> None:
    result = drive(Motion((0.15, 0.12, 0.2), 2.0, start=1.0), "swerve-mabi", perturbation=SwervePerturbation(), seed=2)
    assert result.reason == ""
    way = np.linalg.norm(result.reference * [1, 1, 0.8])
    assert np.linalg.norm((result.truth - result.reference) * [1, 1, 0.8]) < 0.05 * way
