"""A mass that comes or goes at once. Truth: the weight of a known mass, and an arm that it accelerates by Newton's law."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.load_step import LoadStep
from wbmpc.bases.ball.payload import PayloadEstimator

ROBOT = robot("rezero")
N, H = ROBOT.base.nq, 0.0025
HOME = ROBOT.home[:N]
WEIGHT, INERTIA = ROBOT.base.numeric.tool_weight(HOME), ROBOT.base.numeric.mass_matrix(HOME)


def carried(force: np.ndarray, seconds: float, first: float = 0.0, learning: float = 1.0) -> PayloadEstimator:
    """The estimator after ``seconds`` of a ``force`` (nq), known masses of which hold the arm, as the model says."""
    estimator, step, velocity = PayloadEstimator(ROBOT.base.numeric.tool_weight, mass=first), LoadStep(), np.zeros(N)
    for _ in range(round(seconds / H)):
        unexplained = force - estimator.mass * WEIGHT
        by, known = step.update(velocity, np.zeros(N), INERTIA, np.zeros(N), WEIGHT, learning, H)
        estimator.change(by, known, WEIGHT, np.zeros(N))
        velocity = velocity + H * np.linalg.solve(INERTIA, unexplained)
    return estimator


def test_a_load_is_known_within_a_fifth_of_a_second() -> None:
    assert carried(1.0 * WEIGHT, 0.2).mass == pytest.approx(1.0, abs=0.15)
    assert carried(0.0 * WEIGHT, 0.2, first=1.0).mass == pytest.approx(0.0, abs=0.15)


def test_a_robot_that_has_not_been_calm_is_not_sure() -> None:
    step, velocity = LoadStep(), np.zeros(N)
    for _ in range(80):
        step.update(velocity, np.zeros(N), INERTIA, np.zeros(N), WEIGHT, 0.2, H)
    for _ in range(20):
        velocity = velocity + H * np.linalg.solve(INERTIA, WEIGHT)
        assert step.update(velocity, np.zeros(N), INERTIA, np.zeros(N), WEIGHT, 1.0, H) == (0.0, 0.0)


def test_what_is_no_weight_is_no_load() -> None:
    """A push at the base, and a torque of one arm's joint against the other's; and less than a quarter of a kilogram."""
    base = np.zeros(N)
    base[:2] = [100.0, 50.0]
    beside = np.zeros(N)
    beside[-2:] = [WEIGHT[-1], -WEIGHT[-2]]
    for force in (base, 2.0 * beside, 0.2 * WEIGHT):
        assert carried(force, 0.2).mass == 0.0
