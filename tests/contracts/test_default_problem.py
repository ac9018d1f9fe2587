"""The default problem of robots whose base types have problems of their own. Truth: forward kinematics of the robot."""

from __future__ import annotations

import numpy as np
import pytest

import wbmpc as wb
from toys import robot
from wbmpc.default_problem import default_mpc
from wbmpc.errors import InputError


def test_the_end_effector_of_a_swerve_robot_comes_to_its_goal() -> None:
    model = robot("swerve-ur10")
    mpc, (start, turn) = default_mpc(model), model.pose(model.home)
    goal = start + [0.4, 0.2, 0.0]
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], [goal], turn, hold=True)
    x = model.home.copy()
    for k in range(150):
        policy = mpc.update(wb.Observation(0.02 * k, x))
        x = mpc.simulate(x, policy.feedforward(0.02 * k + 0.01), 0.02)
    assert np.linalg.norm(model.pose(x)[0] - goal) < 5e-3
    assert mpc.statistics.failures == 0


def test_a_robot_that_balances_is_an_error_that_names_what_to_call() -> None:
    with pytest.raises(InputError, match=r"'rezero' are torques.*base_type"):
        default_mpc(robot("rezero"))
