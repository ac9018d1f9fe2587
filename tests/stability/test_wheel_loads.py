"""Wheel loads and margins of robots that move, with a payload. Truth: a box with a mast in closed form, MuJoCo's inverse dynamics and
contact forces, least squares of NumPy, finite differences."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi as ca
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from effort import draws
from planar_driving import write_robot
from toys import robot
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError
from wbmpc.model.augment import InputRate
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics
from wbmpc.ocp import OptimalControlProblem, residuals, with_accelerations
from wbmpc.ocp.accelerations import RateRows
from wbmpc.ocp.symbols import Symbols
from wbmpc.robots import load_spec
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.simulation.payloads import add_payload
from wbmpc.stability import Load, Support, configuration_positions, friction_needed

HALF, MAST, WIDE = 0.3, 0.8, 0.25
CORNERS = [((x, y), (0.0, 1.0, 0.0)) for x in (HALF, -HALF) for y in (WIDE, -WIDE)]


def compiled(model: RobotModel, dynamics: object, term: residuals.Residual) -> ca.Function:
    """The rows of a residual by the problem's state and input, the mode's values, and its reference."""
    x, u = ca.SX.sym("x", dynamics.state.size), ca.SX.sym("u", dynamics.input.size)
    m, r = ca.SX.sym("m", model.mode.size), ca.SX.sym("r", term.reference)
    s = Symbols(*dynamics.view(x, u), ca.SX.zeros(model.parameters.size), m, r, x, u)
    return ca.Function("rows", [x, u, m, r], [ca.densify(term(s))])


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """Mecanum wheels at the corners of a box; its mass is moved up a mast."""
    path = write_robot(tmp_path_factory.mktemp("box"), CORNERS, {"type": "omnidirectional", "rollers": "mecanum"})
    model = load_robot(path)
    light = [replace(k, mass=0.0) for k in model.tree.links]
    # what carries the mass is the chassis, at the root
    heavy = replace(
        light[0], mass=40.0, com=np.array([0.0, 0.0, MAST - model.base.body_height]), inertia=np.zeros((3, 3))
    )
    model.base.tree = replace(model.tree, links=(heavy, *light[1:]))
    return model


def test_a_box_tips_where_its_acceleration_is_g_b_over_h(box: RobotModel) -> None:
    assert box.tree.links[0].parent < 0 and not box.tree.links[0].rotation[0, 1:].any()
    dynamics = InputRate(box.dynamics(), ["base"])
    limit = 9.81 * HALF / MAST
    x, u = np.zeros(dynamics.state.size), np.zeros(dynamics.input.size)
    for term, slope in (
        (residuals.SupportMargin(box, dynamics=dynamics), HALF),
        (residuals.WheelLoads(box, dynamics=dynamics), 1.0),
    ):
        rows = compiled(box, dynamics, term)
        for share in (0.0, 0.5, 1.0, 1.2, -1.0):
            u[dynamics.input["base_rate"]] = [share * limit, 0.0, 0.0]
            found = np.array(rows(x, u, 0.0, 0.0)).ravel()
            # the wheels ahead of the mass are relieved, in proportion to the acceleration
            expected = min(slope * (1.0 - abs(share)), WIDE if slope == HALF else 1.0)
            assert found.min() == pytest.approx(expected, abs=1e-9)


def test_a_payload_counts_where_it_is_and_can_change(box: RobotModel) -> None:
    """A weight over one edge: the lever rule, of the box's weight and its own."""
    rows = compiled(box, box.dynamics(), residuals.WheelLoads(box, payload=True))
    x, tip = np.zeros(box.state.size), box.pose(np.zeros(box.state.size))[0]
    for mass, place in ((0.0, 0.5), (10.0, 0.5), (20.0, -0.2)):
        payload = [mass, place - tip[0], -tip[1], 0.3]
        found = np.array(rows(x, np.zeros(box.input.size), 0.0, [*[0.0] * 6, *payload])).ravel()
        ahead = (40.0 + mass * (1.0 + place / HALF)) / 40.0
        assert found == pytest.approx(2 * [ahead] + 2 * [(40.0 + mass * (1.0 - place / HALF)) / 40.0], abs=1e-9)


ROBOTS = {name: robot(name) for name in ("mecanum-ur10", "differential-ur10", "tidybot", "swerve-ur10")}


def of_support(model: RobotModel) -> ca.Function:
    """Force, moment, loads of the feet, and feet by state, input, its rate, and a payload."""
    x, u, a = (
        ca.SX.sym(n, size) for n, size in (("x", model.state.size), ("u", model.input.size), ("a", model.input.size))
    )
    payload, support = ca.SX.sym("payload", 4), Support(model, x)
    change = model.dynamics()(x, u, ca.SX.zeros(model.parameters.size), ca.SX.ones(model.mode.size))
    load = support.load(motion=(u, change, a), payload=payload)
    return ca.Function("load", [x, u, a, payload], [*load, support.foot_loads(load), support.feet])


@pytest.mark.parametrize("name", ROBOTS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=draws(3, 50), deadline=None)
def test_load_with_a_payload_is_that_of_mujocos_inverse_dynamics(name: str, seed: int) -> None:
    """The robot on a free joint: what moves it less what its own weight does is the ground's answer."""
    model, rng = ROBOTS[name], np.random.default_rng(seed)
    spec = load_spec(model.description)
    add_payload(spec, model.tool, 7.0)
    spec.body("payload").inertia = [1e-9] * 3
    spec.body(model.description.base.body).add_freejoint(name="root")
    m = spec.compile()
    d = mujoco.MjData(m)
    x, u, rate = rng.normal(size=model.state.size), rng.normal(size=model.input.size), rng.normal(size=model.input.size)
    x[model.state["base"]] = [0.0, 0.0, x[2]]
    if "wheel" in model.input:  # they spin in MuJoCo, and are no part of other models
        x[model.state["wheel"]] = u[model.input["wheel"]] = rate[model.input["wheel"]] = 0.0
    d.qpos[:7] = [0.0, 0.0, model.base.body_height, np.cos(x[2] / 2), 0.0, 0.0, np.sin(x[2] / 2)]
    for group in model.state.groups.keys() - {"base"}:
        for k, joint in enumerate(model.state.groups[group]):
            at = m.joint(joint)
            d.qpos[at.qposadr[0]] = x[model.state[group]][k]
            d.qvel[at.dofadr[0]], d.qacc[at.dofadr[0]] = u[model.input[group]][k], rate[model.input[group]][k]
    to_twist = getattr(model.base, "twist", np.eye(3))
    (vx, vy, w), (ax, ay, aw) = to_twist @ u[model.input["base"]], to_twist @ rate[model.input["base"]]
    turn = np.array([[np.cos(x[2]), -np.sin(x[2])], [np.sin(x[2]), np.cos(x[2])]])
    d.qvel[:2], d.qvel[5] = turn @ [vx, vy], w
    d.qacc[:2], d.qacc[5] = turn @ [ax - w * vy, ay + w * vx], aw
    mujoco.mj_inverse(m, d)
    force = d.qfrc_inverse[0:3]
    moment = d.xmat[m.body(model.description.base.body).id].reshape(3, 3) @ d.qfrc_inverse[3:6]
    moment = moment + np.cross([0.0, 0.0, model.base.body_height], force)
    found = [np.array(v) for v in of_support(model)(x, u, rate, [7.0, 0.0, 0.0, 0.0])]
    assert found[0].ravel() == pytest.approx(-force, abs=1e-5 * np.abs(force).max())
    assert found[1].ravel() == pytest.approx(-moment, abs=1e-5 * np.abs(moment).max())
    # equal springs under a stiff body: of all loads that answer force and moment the least in squares
    feet = found[3]
    matrix = np.stack([np.ones(len(feet)), feet[:, 1], -feet[:, 0]])
    expected = np.linalg.pinv(matrix) @ [force[2], moment[0], moment[1]]
    assert found[2].ravel() == pytest.approx(expected, abs=1e-4)


def test_loads_at_rest_are_mujocos_contact_forces() -> None:
    model = ROBOTS["swerve-ur10"]
    x = model.home.copy()
    x[model.state["leg"]] = configuration_positions(model, "H")
    x[model.state["steer"]] = 0.0
    plant = SwervePlant(model.description, model.state.split(x), AnyPerturbation.none(payload=10.0), 0)
    for _ in range(200):
        plant.step(SwerveCommand.stop(), 5)
    truth = plant.truth()
    zero = np.zeros(model.input.size)
    loads = np.array(of_support(model)(truth.state, zero, zero, [10.0, 0.0, 0.0, 0.0])[2]).ravel()
    assert truth.wheel_force == pytest.approx(loads, abs=5.0)


def test_loads_of_a_robot_that_speeds_up_are_mujocos_contact_forces() -> None:
    """Sideways with 1 m/s², the arm and 10 kg held: the mean of contact forces over half a second."""
    model, change = ROBOTS["swerve-ur10"], 1.0
    geometry, x, zero = model.base.geometry, model.home.copy(), np.zeros(4)
    x[model.state["leg"]] = configuration_positions(model, "H")
    x[model.state["steer"]], _ = rolling_inverse_kinematics(geometry, zero, zero, np.array([0.0, 1.0, 0.0]))
    heading = geometry.wheel_heading + x[model.state["leg"]] + x[model.state["steer"]]
    plant = SwervePlant(model.description, model.state.split(x), AnyPerturbation.none(payload=10.0), 0)
    still, forces, state = SwerveCommand.stop(), [], plant.truth().state
    arm = state[model.state["arm"]]
    for k in range(240):
        hold = 20.0 * (arm - state[model.state["arm"]])
        wheel = change * 0.0025 * (k + 1) * np.sin(heading) / geometry.wheel_radius
        plant.step(replace(still, wheel=wheel, arm=hold), round(0.0025 / plant.timestep))
        truth = plant.truth()
        forces.append(truth.wheel_force)
        state = truth.state
    rate, u = np.zeros(model.input.size), np.zeros(model.input.size)
    rate[model.input["base"].start + 1] = change
    rate[model.input["wheel"]] = change * np.sin(heading) / geometry.wheel_radius
    loads, static = (
        np.array(of_support(model)(state, u, a, [10.0, 0.0, 0.0, 0.0])[2]).ravel() for a in (rate, 0.0 * rate)
    )
    assert np.abs(loads - static).max() > 20.0  # what the acceleration shifts from one side to the other
    assert np.mean(forces[60:], axis=0) == pytest.approx(loads, abs=8.0)


@cache
def of_feet() -> ca.Function:
    """Loads and forces of the feet, and feet, by state, force and moment."""
    model = ROBOTS["swerve-ur10"]
    x, force, moment = ca.SX.sym("x", model.state.size), ca.SX.sym("f", 3), ca.SX.sym("m", 3)
    support = Support(model, x)
    loads = support.foot_loads((force, moment))
    forces = support.foot_forces((force, moment), loads)
    return ca.Function("feet", [x, force, moment], [loads, forces, support.feet])


@given(seed=st.integers(0, 10_000))
@settings(max_examples=draws(5, 50), deadline=None)
def test_forces_of_the_feet_answer_the_load_and_need_no_less_than_the_least_friction(seed: int) -> None:
    """Sums of forces and moments; a linear programme finds the least coefficient of all answers."""
    rng = np.random.default_rng(seed)
    force = np.array([*rng.uniform(-400.0, 400.0, 2), -rng.uniform(1500.0, 2500.0)])
    moment = np.array([*rng.uniform(-100.0, 100.0, 2), rng.uniform(-100.0, 100.0)])
    n, t, feet = (np.array(v) for v in of_feet()(ROBOTS["swerve-ur10"].home, force, moment))
    n = n.ravel()
    assert t.sum(axis=0) == pytest.approx(-force[:2], abs=1e-8)
    assert np.sum(feet[:, 0] * t[:, 1] - feet[:, 1] * t[:, 0]) == pytest.approx(-moment[2], abs=1e-8)
    assert (n > 0.0).all()
    assert np.max(np.linalg.norm(t, axis=1) / n) >= friction_needed(feet, Load(force, moment)) - 1e-6


def test_a_box_slides_where_its_acceleration_is_mu_g(box: RobotModel) -> None:
    """In closed form: every tire pushes with its load times the acceleration over g."""
    dynamics = InputRate(box.dynamics(), ["base"])
    rows = compiled(box, dynamics, residuals.TireFriction(box, dynamics=dynamics))
    loads = compiled(box, dynamics, residuals.WheelLoads(box, dynamics=dynamics))
    x, u = np.zeros(dynamics.state.size), np.zeros(dynamics.input.size)
    for asked in (0.0, 1.0, 2.0):
        u[dynamics.input["base_rate"]] = [asked, 0.0, 0.0]
        carried = np.array(loads(x, u, 0.0, 0.0)).ravel()
        found = np.array(rows(x, u, 0.0, [*[0.0] * 6, 0.15])).ravel()
        assert found == pytest.approx(0.15 * carried - np.hypot(carried * asked / 9.81, 0.01), abs=1e-9)


@pytest.mark.parametrize("name", ["tidybot", "differential-ur10", "swerve-ur10"])
def test_feet_are_under_mujocos_wheels(name: str) -> None:
    model = ROBOTS[name]
    x = np.random.default_rng(1).normal(size=model.state.size)
    spec = load_spec(model.description)
    m = spec.compile()
    d = mujoco.MjData(m)
    for group in model.state.groups.keys() - {"base"}:
        for joint, value in zip(model.state.groups[group], x[model.state[group]], strict=True):
            d.qpos[m.joint(joint).qposadr[0]] = value
    mujoco.mj_kinematics(m, d)
    body = m.body(model.description.base.body).id
    footprint = model.base.footprint
    feet = footprint.positions(x)
    for foot, wheel in zip(feet, footprint.names, strict=True):
        if not wheel.startswith("caster"):
            center = d.xmat[body].reshape(3, 3).T @ (d.xpos[m.joint(wheel).bodyid[0]] - d.xpos[body])
            assert foot == pytest.approx(center[:2], abs=2e-3)
    s = ca.SX.sym("x", model.state.size)
    symbols = ca.Function("feet", [s], [ca.horzcat(*footprint.expressions(s))])
    assert np.array(symbols(x)).T - feet == pytest.approx(np.zeros(feet.shape), abs=1e-12)


def test_rows_without_input_become_rates_that_bring_them_back() -> None:
    """Finite differences of the wheels' side slip along the dynamics; rolling rows have the wheels' rates, and stay."""
    model, rng = ROBOTS["swerve-ur10"], np.random.default_rng(3)
    dynamics = InputRate(model.dynamics(), ["base", "arm"])
    inner = residuals.Rolling(model)
    rows, plain = (compiled(model, dynamics, r) for r in (RateRows(inner, dynamics, 20.0), inner))
    x, u, h = rng.normal(size=dynamics.state.size), rng.normal(size=dynamics.input.size), 1e-6
    s = ca.SX.sym("x", x.size)
    rate = dynamics(s, ca.DM(u), ca.SX.zeros(model.parameters.size), ca.SX.ones(model.mode.size))
    step = h * np.array(ca.Function("f", [s], [rate])(x)).ravel()
    before, after = (np.array(plain(x + k * step, u, 1.0, 0.0)).ravel() for k in (-0.5, 0.5))
    now, found = np.array(plain(x, u, 1.0, 0.0)).ravel(), np.array(rows(x, u, 1.0, 0.0)).ravel()
    n = model.base.wheels
    assert found[:n] == pytest.approx(now[:n], abs=1e-12)
    assert found[n:] == pytest.approx((after - before)[n:] / h + 20.0 * now[n:], abs=1e-5)


def test_bad_input_is_one_message() -> None:
    with pytest.raises(InputError, match="nothing says how the wheels of 'differential-ur10' share the load"):
        residuals.WheelLoads(ROBOTS["differential-ur10"])
    with pytest.raises(InputError, match="stands on 3 feet or more"):
        residuals.WheelLoads(robot("rezero"))
    model = ROBOTS["mecanum-ur10"]
    with pytest.raises(InputError, match="own dynamics"):
        with_accelerations(OptimalControlProblem(InputRate(model.dynamics(), ["arm"]), 1.0, 4), model)
