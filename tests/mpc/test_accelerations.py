"""Limits of acceleration in the plans of a receding horizon. Truth: differences of what two plans that follow each other command
for the same time, by arithmetic; the bound of a speed before the end of a range, u ≤ (a / v)(Q − q), by hand."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import wbmpc as wb
from clearing import write_arm
from toys import robot
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_mpc
from wbmpc.default_problem import ACCELERATION_SHARE, default_mpc, default_mpc_settings, default_problem
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Reference
from wbmpc.ocp.symbols import Symbols
from wbmpc.robots import load_description
from wbmpc.settings import MpcSettings
from wbmpc.types import Observation

SETTINGS = MpcSettings(horizon=2.0, intervals=16)


def narrow(width: float) -> RobotModel:
    """The swerve robot with its arm held to ``width`` [rad] about home."""
    d = robot("swerve-ur10").description
    position = {n: (d.home[n] - width, d.home[n] + width) for n in d.arm.joints}
    return RobotModel(d.model_copy(update={"limits": d.limits.model_copy(update={"position": position})}))


def test_plans_follow_each_other_within_accelerations_and_stop_in_time() -> None:
    """The end effector's goal jumps by 0.6 m, out of the arm's range: speeds rise and fall as fast as they may, never faster."""
    model = narrow(0.25)
    mpc = swerve_mpc(model, SETTINGS, SwerveCost())
    position, quaternion = model.pose(model.home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [position + [0.0, 0.0, 0.6]], quaternion)
    mpc.reference["state"] = Reference.constant(model.home)
    mpc.reference["input"] = Reference.constant(np.zeros(model.input.size))
    mpc.reset(model.home)
    limits, x, policy = model.limits, model.home.copy(), None
    limited = np.flatnonzero(np.isfinite(limits.input_rate))
    assert limited.size == model.input.size - 3  # all but the twist of the base
    used, nearest = np.zeros(model.input.size), np.inf
    at = [model.state.index(model.input.names[i]) for i in limited]
    lower, upper = limits.state_lower[at], limits.state_upper[at]
    for k in range(60):
        t = k * mpc.period
        previous = np.zeros(model.input.size) if policy is None else policy.feedforward(t)
        policy = mpc.update(Observation(t, x))
        used = np.maximum(used, np.abs(policy.u[0] - previous) / (limits.input_rate * mpc.period))
        u, q = policy.u[0][limited], x[at]
        maximum = limits.input_rate[limited] / limits.input_upper[limited]
        bounded = np.isfinite(upper)
        assert np.all((u - maximum * (upper - q))[bounded] < 1e-3)
        assert np.all((-u - maximum * (q - lower))[bounded] < 1e-3)
        nearest = min(nearest, float(np.min(np.minimum(upper - q, q - lower)[bounded])))
        x = mpc.solver.simulate(x, policy.u[0], 0.017)
        x = mpc.solver.simulate(x, policy.feedforward(t + 0.0185), mpc.period - 0.017)
    assert used[limited].max() < 1.01
    assert used[model.input["arm"]].max() > 0.9  # the goal does press against them
    assert 0.0 < nearest < 0.03  # and against the ranges


def test_rows_that_begin_at_the_last_command_have_a_slack() -> None:
    """Rows of inputs alone have none, since they can be held; those that move with the last command, beside rolling wheels, cannot always."""
    model = robot("swerve-ur10")
    mpc = swerve_mpc(model, SETTINGS, SwerveCost())
    rows = {row.name: row.penalty for row in mpc.solver.problem.path.rows}
    assert np.isinf([v for n, v in rows.items() if n.startswith("speeds.")]).all()
    assert np.isfinite([v for n, v in rows.items() if n.startswith("accelerations.")]).all()


def test_accelerations_are_joints_of_the_robot(tmp_path) -> None:  # type: ignore[no-untyped-def]
    text = robot("swerve-ur10").description.source
    source = Path(text).read_text().replace("model: swerve.xml", f"model: {robot('swerve-ur10').description.model}")
    path = tmp_path / "robot.yaml"
    path.write_text(source.replace("  acceleration:\n    leg_LF", "  acceleration:\n    leg_FL"))
    with pytest.raises(InputError, match=r"limits\.acceleration.*leg_FL"):
        load_description(path)
    path.write_text(source.replace("  acceleration:\n    leg_LF: 5.0", "  acceleration:\n    leg_LF: -5.0"))
    with pytest.raises(InputError, match=r"limits\.acceleration\.leg_LF.*greater than or equal to"):
        load_description(path)


def test_default_plans_change_speeds_no_faster_than_the_robot_file_says(tmp_path: Path) -> None:
    """A goal far away is asked for at once. Truth: 6 rad/s² in the file, of which plans use a share."""
    robot = wb.load_robot(write_arm(tmp_path))
    mpc = default_mpc(robot, default_mpc_settings(horizon=1.0, intervals=10))
    position, turn = robot.pose(robot.home + [1.5, 0.3, -0.5])
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], [position], turn)
    x, changes = robot.home.copy(), []
    policy = mpc.update(wb.Observation(0.0, x))  # a first command has none before it
    for k in range(1, 20):
        x, t = mpc.simulate(x, policy.u[0], mpc.period), k * mpc.period
        before = policy.u[0]  # what is commanded until then
        policy = mpc.update(wb.Observation(t, x))
        changes.append(np.abs(policy.u[0] - before).max())
    assert 0.5 < max(changes) / (ACCELERATION_SHARE * 6.0 * mpc.period) < 1.05


def test_default_plans_keep_pairs_apart_that_the_robot_file_lists(tmp_path: Path) -> None:
    listed = "collision: {self: {pairs: [[foot, fore]], margin: 0.02}}"
    for text, there in (("", False), (listed, True), (listed.replace("[[foot, fore]]", "[]"), False)):
        assert ("self_clearance" in default_problem(wb.load_robot(write_arm(tmp_path, text))).terms) is there


def test_a_ball_robot_follows_a_clock() -> None:
    with pytest.raises(wb.InputError, match="valid: reference=clock"):
        wb.base_type("ball").mpc(wb.load_robot("rezero"), progress="tool")


@pytest.mark.parametrize("name", ["differential-ur10", "mecanum-ur10"])
def test_plans_accelerate_wheels_no_faster_than_the_robot_file_says(name: str) -> None:
    """A base that is to go ahead and turn at once. Truth: rad/s² of the wheels in the file, by the wheels' matrix."""
    model = wb.load_robot(name)
    mpc = default_mpc(model, default_mpc_settings(horizon=2.0, intervals=20))
    goal = model.home.copy()
    goal[:3] = [2.0, -0.5, 1.5]
    position, turn = model.pose(goal)
    mpc.reference["end_effector"] = wb.Reference.poses([0.0], [position], turn)
    x, part, changes = model.home.copy(), model.input["base"], []
    policy = mpc.update(wb.Observation(0.0, x))
    for k in range(1, 15):
        x, before = mpc.simulate(x, policy.u[0], mpc.period), policy.u[0]
        policy = mpc.update(wb.Observation(k * mpc.period, x))
        changes.append(np.abs(model.base.rates @ (policy.u[0] - before)[part]) / mpc.period)
    assert 0.5 < (np.array(changes) / model.base.wheel_acceleration).max() < 0.91


def test_joints_that_steer_wheels_need_not_stop_before_their_range_ends() -> None:
    """With no time since the last command only the range and the end of the joint's own range count: the top speed at the end of the range is
    0 of the range inside for steering (its bound is its top speed), and for the arm as much outside as the speed is above 0, by hand."""
    model = robot("swerve-ur10")
    rows = wb.residuals.AccelerationLimit(model, ["steer", "arm"])
    x, u, p = ca.SX.sym("x", model.state.size), ca.SX.sym("u", model.input.size), ca.SX.sym("p", rows.reference)
    found = ca.Function("rows", [x, u, p], [rows(Symbols(x, u, ca.SX(0, 1), ca.SX(model.mode.size, 1), p, x, u))])
    limits, ends = model.limits, model.home.copy()
    for group in ("steer", "arm"):
        ends[model.state[group]] = limits.state_upper[model.state[group]]
    assert np.isfinite(ends).all()
    upper = np.array(found(ends, limits.input_upper, np.zeros(rows.reference))).ravel()[: len(rows.inputs)]
    low, high = (v[model.input["arm"]] for v in (limits.input_lower, limits.input_upper))
    np.testing.assert_allclose(upper, [0.0] * 4 + (-high / (high - low)).tolist(), atol=1e-12)


@pytest.mark.parametrize("given", [None, (0.8, 1.5)])
def test_a_base_that_takes_speeds_changes_them_no_faster_than_its_driver(
    given: tuple[float, float] | None,
) -> None:
    """Without limits, plans reversed a base from full speed to full speed within 20 ms, against the swing of its arms, until it fell.
    Truth: differences of commands."""
    known = robot("pr2").description
    most = known.base.acceleration if given is None else given
    if given is not None:
        known = known.model_copy(update={"base": known.base.model_copy(update={"acceleration": given})})
    model = RobotModel(known)
    mpc = default_mpc(model)
    np.testing.assert_allclose(model.limits.input_rate[:3], [most[0], most[0], most[1]])
    position, quaternion = model.pose(model.home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [position + [-0.5, 1.0, 0.0]], quaternion)
    x, last, largest = model.home.copy(), np.zeros(3), np.zeros(3)
    for k in range(80):
        t = k * mpc.period
        policy = mpc.update(Observation(t, x))
        u = policy(t)
        largest, last = np.maximum(largest, np.abs(u[:3] - last) / mpc.period), u[:3]
        x = mpc.simulate(x, u, mpc.period)
    assert np.all(largest < [1.01 * most[0], 1.01 * most[0], 1.01 * most[1]])
    assert largest.max() > 0.5 * most[0] and np.linalg.norm(x[:2]) > 0.3
