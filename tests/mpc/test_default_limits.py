"""Limits of the default problem. Truth: the ranges of the robot's file."""

from __future__ import annotations

import numpy as np

from wbmpc import Observation, Reference
from wbmpc.default_problem import default_mpc
from wbmpc.model.robot import load_robot


def test_a_goal_out_of_reach_pulls_no_joint_past_its_stop() -> None:
    """The robot is the model itself; what one iteration per update leaves is half a degree."""
    robot = load_robot("panda")
    mpc, x, worst = default_mpc(robot), robot.home.copy(), 0.0
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.constant([*(position - [0.0, 0.0, 1.5]), *orientation])
    for k in range(150):
        t = k * mpc.period
        x = mpc.solver.simulate(x, mpc.update(Observation(t, x))(t, x), mpc.period)
        worst = max(worst, float(np.max([x - robot.limits.state_upper, robot.limits.state_lower - x])))
    assert worst < 0.01
