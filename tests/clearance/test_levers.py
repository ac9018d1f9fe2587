"""Prices of slacks of pairs of a robot's own parts. Truth: differences of exact distances of the shapes, and the distances of plans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import wbmpc as wb
from wbmpc.clearance.levers import LEAST, NEAR, SMALL, STATES, levers, prices
from wbmpc.default_problem import CLEARANCE_SLACK, default_mpc, default_problem
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.obstacles.geometry import robot_geometry
from wbmpc.obstacles.pairs import distances, draw_states
from wbmpc.ocp import Constraint, Reference, residuals, sets
from wbmpc.ocp.clearance_residuals import SelfClearance
from wbmpc.ocp.scaling import reach

#: A state of a run in which the upper arm was pressed into the torso, and the goal that did it.
PRESSED = [
    0.4311, -2.3547, -1.0295, 0.3706, 1.2436, 1.0231, 1.1497, -0.0169, 1.8036, 0.8919, -2.4611, -0.5617, 1.4347, -0.2287, -0.6231,
]  # fmt: skip
GOAL = [1.1828, -0.7234, 0.881, 0.4216, -0.2258, 0.8553, -0.1991]


def test_a_goal_a_meter_away_does_not_press_an_upper_arm_into_the_torso() -> None:
    """A joint turns it beside its axis: millimeters of this distance are decimeters of the end effector."""
    robot = load_robot("vega")
    mpc, x, goal = default_mpc(robot), np.array(PRESSED), np.array(GOAL)
    mpc.reset(x)
    mpc.reference["end_effector"] = Reference.poses([0.0], [goal[:3]], goal[3:] / np.linalg.norm(goal[3:]))
    for _ in range(15):
        mpc.update(wb.Observation(0.0, x))
    plan = mpc.solver.trajectory()
    ahead = distances(robot_geometry(robot), [("torso_l3", "L_arm_l2")], plan.x[plan.grid < 0.35], 0.3)[:, 0]
    assert len(ahead) > 5 and ahead.min() > ahead[0] - 1e-4


def test_levers_are_slopes_of_distances() -> None:
    robot = load_robot("fetch")
    term = SelfClearance(robot)
    states, arm, e = draw_states(robot, STATES), robot.state["arm"], 1e-5
    apart = lambda x: distances(robot_geometry(robot), list(term.pairs or ()), x, 0.5)
    at = apart(states)
    slopes = []
    for j in range(arm.start, arm.stop):
        step = np.zeros(robot.state.size)
        step[j] = e
        slopes.append((apart(states + step) - apart(states - step)) / (2.0 * e))
    length = np.linalg.norm(slopes, axis=0)
    near = (at < NEAR) & (at > 1e-3)
    found = levers(term)
    for k in range(term.size):
        if near[:, k].sum() > 5:
            assert found[k] == pytest.approx(np.quantile(length[near[:, k], k], SMALL), rel=0.25)


def test_prices_follow_levers_and_the_weight_of_the_end_effector() -> None:
    robot = load_robot("vega")
    ocp, term = default_problem(robot), SelfClearance(robot)
    found, arm = np.array(prices(ocp, term, CLEARANCE_SLACK)), reach(robot)
    # by hand: 4000 / m² for 4 s and half of it at the end, 3 m away, over the time of the approach
    pull = 3.0 * (4000.0 * 4.0 + 2000.0) / float(term.approach or 0.0)
    known = np.nan_to_num(levers(term), nan=arm)
    np.testing.assert_allclose(found, pull * np.clip(arm / known, 1.0, 1.0 / LEAST))
    assert found.max() > 10.0 * found.min() and found.min() > CLEARANCE_SLACK
    np.testing.assert_array_equal(ocp.terms["self_clearance"].slacks, found)
    # rows of distances alone have no way to follow: their slack is what is asked for
    assert prices(ocp, replace(term, approach=0.0), 5.0) == (5.0,) * term.size


def test_a_slack_has_one_price_or_one_for_each_row() -> None:
    robot = load_robot("fetch")
    rows = residuals.Input(robot, reference=None)
    make = lambda slack: Constraint("a", rows, sets.Box(-1.0, 1.0), hard=True, slack=slack)
    np.testing.assert_array_equal(make([2.0] * rows.size).slacks, make(2.0).slacks)
    for bad, text in (([1.0, 2.0], f"one number or {rows.size}"), ([1.0] * (rows.size - 1) + [0.0], "positive")):
        with pytest.raises(InputError, match=text):
            make(bad)
