"""What keeps robots upright in plans on speeds. Truth: MuJoCo's centers of mass, a box with a mast in closed form, differences of stances."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pytest

import wbmpc as wb
from planar_driving import write_robot
from wbmpc.bases import base_type
from wbmpc.default_problem import CENTER_SHARE, ZMP_SHARE, default_mpc, default_problem
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.obstacles.pairs import draw_states
from wbmpc.ocp import Reference, residuals
from wbmpc.ocp.symbols import Symbols
from wbmpc.robots import load_spec
from wbmpc.settings import SupportMarginSettings
from wbmpc.stability import GRAVITY, StanceOf
from wbmpc.stability import robot as stability_robot

HALF, MAST, WIDE = 0.3, 0.8, 0.25
CORNERS = [((x, y), (0.0, 1.0, 0.0)) for x in (HALF, -HALF) for y in (WIDE, -WIDE)]


def rows(robot: RobotModel, term: residuals.Residual) -> ca.Function:
    """Of state, input and reference."""
    x, u, r = (ca.SX.sym(n, k) for n, k in (("x", robot.state.size), ("u", robot.input.size), ("r", term.reference)))
    none = ca.SX(0, 1)
    return ca.Function("rows", [x, u, r], [ca.densify(term(Symbols(x, u, none, none, r, x, u)))])


def test_a_problem_compiles_the_stances_of_its_robot_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made, numeric = [], stability_robot.Numeric
    monkeypatch.setattr(stability_robot, "Numeric", lambda function: made.append(function) or numeric(function))
    default_problem(load_robot("fetch"))
    assert len(made) == 1


@pytest.mark.parametrize("name", ["fetch", "pr2", "vega"])
def test_the_center_of_mass_is_that_of_mujoco(name: str) -> None:
    robot = load_robot(name)
    x = ca.SX.sym("x", robot.state.size)
    center = ca.Function("center", [x], [robot.base.chain(x).center_of_mass()])
    model = load_spec(robot.description).compile()
    data, body = mujoco.MjData(model), model.body(robot.description.base.body).id
    for state in draw_states(robot, 5, seed=1):
        for group in set(robot.state.groups) - {"base"}:
            for joint, value in zip(robot.state.groups[group], state[robot.state[group]], strict=True):
                data.qpos[model.jnt_qposadr[model.joint(joint).id]] = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        turn = data.xmat[body].reshape(3, 3)
        truth = turn.T @ (data.subtree_com[body] - data.xpos[body])
        np.testing.assert_allclose(np.array(center(state)).ravel(), truth, atol=1e-6)


def test_a_box_tips_where_its_acceleration_is_g_b_over_h(tmp_path: Path) -> None:
    robot = load_robot(write_robot(tmp_path, CORNERS, {"type": "omnidirectional", "rollers": "mecanum"}))
    light = [replace(k, mass=0.0) for k in robot.tree.links]
    mast = np.array([0.0, 0.0, MAST - robot.base.body_height])
    heavy = replace(light[0], mass=40.0, com=mast, inertia=np.zeros((3, 3)))
    robot.base.tree = replace(robot.tree, links=(heavy, *light[1:]))
    term, h, last = residuals.Upright(robot), 0.02, np.zeros(robot.input.size)
    function, part = rows(robot, term), term.groups["zmp"]
    for axis, half, other in ((0, HALF, WIDE), (1, WIDE, HALF)):
        u = last.copy()
        u[axis] = 2.0 * h  # from rest: 2 m/s²
        shift = 2.0 * MAST / GRAVITY[2]
        found = np.array(function(robot.home, u, [*last, h]))[part, 0]
        np.testing.assert_allclose(np.sort(found), np.sort([half + shift, half - shift, other, other]), atol=1e-6)
    none = np.array(function(robot.home, u, [*last, 0.0]))[part, 0]  # a first command has none before it
    np.testing.assert_allclose(np.sort(none), [WIDE, WIDE, HALF, HALF], atol=1e-9)


def test_the_center_counts_where_the_arm_takes_it() -> None:
    """Truth: differences of the margin of stances at rest along the motion."""
    robot = load_robot("vega")
    term, stance, rng = residuals.Upright(robot), StanceOf(robot), np.random.default_rng(0)
    function = rows(robot, term)
    for _ in range(6):
        state = robot.home.copy()
        state[robot.state["arm"]] += rng.uniform(-0.15, 0.15, len(robot.state.groups["arm"]))
        u, e = rng.uniform(robot.limits.input_lower, robot.limits.input_upper), 1e-5
        found = np.array(function(state, u, np.zeros(term.reference)))[term.groups["center"], 0]
        rates = robot.state.vector({g: u[robot.input[g]] for g in ("steer", "arm")})
        now, ends = stance(state), [stance(state + s * e * rates).polygon_margin for s in (1.0, -1.0)]
        least = np.argmin(np.array(function(state, 0 * u, np.zeros(term.reference)))[term.groups["center"], 0])
        assert found[least] == pytest.approx(
            now.polygon_margin + term.approach * (ends[0] - ends[1]) / (2 * e), abs=1e-4
        )


def test_default_plans_keep_a_tall_robot_upright() -> None:
    """A goal 2 m away: its torso leant to it until the center of mass was beyond the wheels. Truth: the stances on the way."""
    robot = load_robot("vega")
    mpc, stance, x, t = default_mpc(robot), StanceOf(robot), robot.home.copy(), 0.0
    assert "upright" in mpc.ocp.terms
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [position + [0.0, -2.0, 0.0]], orientation)
    margins = []
    for _ in range(120):
        policy = mpc.update(wb.Observation(t, x))
        x, t = mpc.simulate(x, policy(t), mpc.period), t + mpc.period
        margins.append(stance(x).polygon_margin)
    assert min(margins) > 0.9 * CENTER_SHARE * stance(robot.home).polygon_margin


@pytest.mark.parametrize(
    "name, parts", [("ridgeback-ur5", ()), ("mecanum-ur10", ()), ("fetch", ("zmp",)), ("vega", ("center", "zmp"))]
)
def test_robots_have_rows_for_what_can_tip_them_over(name: str, parts: tuple[str, ...]) -> None:
    """Truth: stances in random states, and at home under the largest acceleration of each input, all at their worst."""
    robot = load_robot(name)
    terms, stance, home = default_problem(robot).terms, StanceOf(robot), robot.home
    assert (terms["upright"].residual.parts if "upright" in terms else ()) == parts
    still, rates = stance(home), np.nan_to_num(robot.limits.input_rate, posinf=0.0)
    center = min(stance(x).polygon_margin for x in draw_states(robot, 100))
    assert (center < CENTER_SHARE * still.polygon_margin) == ("center" in parts)
    shifts = np.array([stance(home, u_rate=row).zmp - still.zmp for row in np.diag(rates)])
    ways = [still.feet[i] - still.feet[j] for i in range(len(still.feet)) for j in range(i)]
    sides = [np.array([-w[1], w[0]]) / np.linalg.norm(w) for w in ways]
    worst = max(float(np.abs(shifts @ side).sum()) for side in sides)
    assert (still.polygon_margin - worst < ZMP_SHARE * still.polygon_margin) == ("zmp" in parts)


def test_plans_of_steered_wheels_do_not_tip_a_light_base_over() -> None:
    """A goal 1.5 m behind: the base speeds up and brakes by more than its feet bear. Truth: how single accelerations move the point at
    home, by differences of stances."""
    robot, e = load_robot("ffw-sg2"), 1e-3
    mpc, stance, x, t = base_type("swerve").mpc(robot), StanceOf(robot), robot.home.copy(), 0.0
    position, orientation = robot.pose(robot.home)
    mpc.reference["end_effector"] = Reference.poses([0.0], [position + [-1.5, 0.0, 0.0]], orientation)
    still = stance(robot.home)
    shifts = np.array([stance(robot.home, u_rate=e * row).zmp - still.zmp for row in np.eye(robot.input.size)]) / e
    sides = np.roll(still.feet, -1, axis=0) - still.feet
    outward = np.stack([sides[:, 1], -sides[:, 0]], axis=1) / np.linalg.norm(sides, axis=1, keepdims=True)
    outward *= np.sign(np.sum(outward * (still.feet - still.feet.mean(axis=0)), axis=1))[:, None]
    level = np.sum(outward * still.feet, axis=1)
    before, margins = None, list[float]()
    for _ in range(100):
        policy = mpc.update(wb.Observation(t, x))
        u = policy.u[0]
        change = np.zeros_like(u) if before is None else (u - before.feedforward(t)) / mpc.period
        margins.append(float(np.min(level - outward @ (stance(x).zmp + change @ shifts))))
        before, x, t = policy, mpc.simulate(x, u, mpc.period), t + mpc.period
    assert min(margins) > 0.9 * ZMP_SHARE * still.polygon_margin
    assert np.linalg.norm(x[:2]) > 0.5  # it went there


@pytest.mark.parametrize(
    "name, parts", [("ffw-sg2", ("zmp",)), ("swerve-fixed-ur10", ()), ("swerve-ur10", ()), ("telescope-ur10", ())]
)
def test_steered_bases_have_rows_where_accelerations_of_their_wheels_tip_them_over(
    name: str, parts: tuple[str, ...]
) -> None:
    """Not those whose legs move their feet. Truth: by hand, a height of the center of mass z shifts the point by z a / g."""
    robot = load_robot(name)
    terms = base_type("swerve").mpc(robot).ocp.terms
    assert (terms["upright"].residual.parts if "upright" in terms else ()) == parts
    limits, still = robot.limits, StanceOf(robot)(robot.home)
    fastest = limits.input_rate[robot.input["wheel"]].min() * robot.description.base.wheel_radius
    shift = still.com[2] * fastest / -GRAVITY[2]
    assert (shift > 0.5 * still.polygon_margin) == bool(parts)


def test_what_keeps_wheels_loaded_takes_their_place() -> None:
    assert "upright" not in default_problem(load_robot("fetch"), stability=SupportMarginSettings()).terms
    assert "upright" not in default_problem(load_robot("ur5")).terms  # it stands on no feet
