"""Zero-moment point and margins of a described robot. Truth: MuJoCo's center of mass, its inverse dynamics of a floating
robot, and the contact forces of the simulated one."""

from __future__ import annotations

import casadi as ca
import mujoco
import numpy as np
import pytest

from effort import some
from toys import robot
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError
from wbmpc.model.augment import InputRate
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import residuals
from wbmpc.robots import load_spec
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.stability import (
    Load,
    StanceOf,
    assess,
    configuration_positions,
    margin,
    slope_gravity,
    support_polygon,
    support_triangles,
    zero_moment_point,
)

SWERVE = robot("swerve-ur10")
STANCE = StanceOf(SWERVE)
WRENCH = np.array([40.0, -30.0, -60.0, 5.0, -8.0, 3.0])


def some_state(seed: int) -> np.ndarray:
    rng, x, state = np.random.default_rng(seed), SWERVE.home.copy(), SWERVE.state
    x[state["base"]] = rng.normal(size=3)
    x[state["leg"]] += rng.uniform(-0.5, 0.5, 4)
    x[state["steer"]] = rng.uniform(-2.0, 2.0, 4)
    x[state["arm"]] = rng.uniform(-2.0, 2.0, 6)
    return x


def floating(model: RobotModel, x: np.ndarray) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot on a free joint in MuJoCo, without ground, at a state whose base has moved to the origin."""
    spec = load_spec(model.description)
    spec.body(model.description.base.body).add_freejoint(name="root")
    m = spec.compile()
    d = mujoco.MjData(m)
    yaw = x[model.state["base"]][2]
    d.qpos[3:7] = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
    d.qpos[2] = model.base.body_height
    for group in ("leg", "steer", "wheel", "arm"):
        for name, value in zip(model.state.groups.get(group, ()), x[model.state[group]], strict=True):
            d.qpos[m.joint(name).qposadr[0]] = value
    mujoco.mj_forward(m, d)
    return m, d


def groups(model: RobotModel, values: np.ndarray, m: mujoco.MjModel, out: np.ndarray) -> None:
    for group in ("leg", "steer", "wheel", "arm"):
        for name, value in zip(model.input.groups.get(group, ()), values[model.input[group]], strict=True):
            out[m.joint(name).dofadr[0]] = value


@pytest.mark.parametrize("seed", range(4))
def test_mass_and_center_of_mass_are_mujocos(seed: int) -> None:
    x = some_state(seed)
    _, d = floating(SWERVE, x)
    stance = STANCE(x)
    assert stance.com == pytest.approx(d.subtree_com[1], abs=1e-9)
    assert stance.mass == pytest.approx(100.874, abs=1e-3)
    assert stance.zmp == pytest.approx(d.subtree_com[1][:2], abs=1e-9)
    feet = np.array(
        [d.xpos[mujoco.mj_name2id(d.model, mujoco.mjtObj.mjOBJ_BODY, f"steer_{n}")] for n in ("LF", "RF", "LB", "RB")]
    )
    assert stance.feet == pytest.approx(feet[:, :2], abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_zero_moment_point_in_motion_is_that_of_mujocos_inverse_dynamics(seed: int) -> None:
    rng, x = np.random.default_rng(100 + seed), some_state(seed)
    m, d = floating(SWERVE, x)
    u, rate = rng.normal(size=SWERVE.input.size), rng.normal(size=SWERVE.input.size)
    gravity = slope_gravity(0.15, uphill=0.7)
    m.opt.gravity[:] = gravity
    yaw, base = x[SWERVE.state["base"]][2], SWERVE.input["base"]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    (vx, vy, w), (ax, ay, aw) = u[base], rate[base]
    d.qacc[:] = 0.0  # not the free fall of the first call
    d.qvel[0:2] = turn @ [vx, vy]
    d.qvel[5] = w
    d.qacc[0:2] = turn @ [ax - w * vy, ay + w * vx]  # of a twist that turns with the body
    d.qacc[5] = aw
    groups(SWERVE, u, m, d.qvel)
    groups(SWERVE, rate, m, d.qacc)
    point = d.site(SWERVE.tool).xpos.copy()
    mujoco.mj_inverse(m, d)
    # what the world must do to the free joint, less the wrench on the end effector, is the ground's answer
    force = d.qfrc_inverse[0:3] - WRENCH[:3]
    rotation = d.xmat[1].reshape(3, 3)
    moment = rotation @ d.qfrc_inverse[3:6] + np.cross(d.xpos[1], d.qfrc_inverse[0:3])
    moment -= WRENCH[3:] + np.cross(point, WRENCH[:3])
    stance = STANCE(x, WRENCH, gravity, u, rate)
    assert stance.force == pytest.approx(-force, abs=1e-6)
    assert stance.moment == pytest.approx(-moment, abs=1e-6)
    assert stance.zmp == pytest.approx([-moment[1] / force[2], moment[0] / force[2]], abs=1e-9)


def test_loads_of_the_library_add_up_to_the_robots() -> None:
    x = some_state(2)
    stance = STANCE(x, WRENCH)
    tool = SWERVE.pose(x)[0] - [*x[SWERVE.state["base"]][:2], 0.0]
    load = Load.gravity(stance.mass, stance.com) + Load.wrench(WRENCH[:3], WRENCH[3:], tool)
    assert zero_moment_point(load) == pytest.approx(stance.zmp, abs=1e-9)
    still = load + Load.inertia(stance.mass, stance.com, [0.0, 0.0, 0.0])
    assert still.moment == pytest.approx(stance.moment, abs=1e-9)
    braking = load + Load.inertia(stance.mass, stance.com, [-1.0, 0.0, 0.0])
    # a deceleration moves the point ahead: a z / (g + …)
    ahead = stance.mass * stance.com[2] / -stance.force[2]
    assert zero_moment_point(braking) - stance.zmp == pytest.approx([ahead, 0.0], abs=1e-9)
    assert np.isnan(zero_moment_point(Load.wrench([0.0, 0.0, 1.0]))).all()


# ---------------------------------------------------------------------- the simulated robot
def stood(configuration: str, arm: np.ndarray | None = None, tilt: np.ndarray | None = None) -> SwervePlant:
    a = assess(SWERVE, configuration, arm=arm)
    # more friction than any floor has: on one it would slide before it tips, and tipping is what is tested
    plant = SwervePlant(SWERVE.description, SWERVE.state.split(a.x), AnyPerturbation.none(friction=6.0), 0)
    if tilt is not None:
        plant.model.opt.gravity[:] = tilt
    return plant


def at_rest(plant: SwervePlant, seconds: float) -> None:
    for _ in range(round(seconds / 0.0025)):
        plant.step(SwerveCommand.stop(), 5)


def center_of_pressure(plant: SwervePlant) -> np.ndarray:
    wheels = [plant.model.body(plant.model.joint(m.wheel).bodyid[0]).id for m in plant.base.modules]
    feet, forces = plant.data.xpos[wheels][:, :2], plant.truth().wheel_force
    return forces @ feet / forces.sum()


@pytest.mark.parametrize(("configuration", "slope"), some([("H", 0.0), ("X", 0.1), ("A", 0.05)], [1]))
def test_the_grounds_center_of_pressure_is_the_zero_moment_point(configuration: str, slope: float) -> None:
    gravity = slope_gravity(slope, uphill=2.0)
    plant = stood(configuration, tilt=gravity)
    plant.push([30.0, 40.0, -50.0], [3.0, 2.0, 0.0], body="wrist_3_link", point=tool_in_wrist())
    at_rest(plant, 1.5)
    a = assess(SWERVE, configuration, [30.0, 40.0, -50.0, 3.0, 2.0, 0.0], gravity)
    assert center_of_pressure(plant) - plant.truth().pose[:2] == pytest.approx(a.stance.zmp, abs=2e-3)


def tool_in_wrist() -> np.ndarray:
    _, d = floating(SWERVE, SWERVE.home)
    tool = SWERVE.pose(SWERVE.home)[0]
    wrist = d.body("wrist_3_link")
    return wrist.xmat.reshape(3, 3).T @ (tool - wrist.xpos)


@pytest.mark.parametrize(("configuration", "direction"), some([(c, d) for c in "HXA" for d in (0.3, 1.9, -1.2)], [4]))
def test_the_robot_tips_when_the_margin_is_negative(configuration: str, direction: float) -> None:
    """Pushed at the end effector: 4 % less than the force at which the margin vanishes it stands, 4 % more it tips."""
    along = np.array([np.cos(direction), np.sin(direction), 0.0])
    of = lambda size: assess(SWERVE, configuration, [*(size * along), 0.0, 0.0, 0.0]).stance.polygon_margin
    low, high = 0.0, 3000.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if of(middle) > 0.0 else (low, middle)
    tilts = []
    for share in (0.96, 1.04):
        plant = stood(configuration)
        plant.push(share * low * along, body="wrist_3_link", point=tool_in_wrist())
        # drives and brakes would give way before the robot tips: a static robot has stiff joints
        for joints in plant._v.values():
            plant.model.dof_damping[joints] = 1e5
        at_rest(plant, 1.5)
        tilts.append(plant.truth().tilt)
    assert tilts[0] < 0.02 < 0.06 < tilts[1]


# ---------------------------------------------------------------------- the optimizer's residual
def symbols(model: RobotModel, dynamics: object) -> tuple[residuals.Symbols, list[ca.SX]]:
    x, u = ca.SX.sym("x", dynamics.state.size), ca.SX.sym("u", dynamics.input.size)
    w, m, r = ca.SX.sym("w", model.parameters.size), ca.SX.sym("m", model.mode.size), ca.SX.sym("r", 6)
    own_x, own_u = dynamics.view(x, u)
    return residuals.Symbols(own_x, own_u, w, m, r, x, u), [x, u, w, m, r]


def test_residual_of_the_polygon_has_the_numeric_margin() -> None:
    term = residuals.SupportMargin(SWERVE)
    s, given = symbols(SWERVE, SWERVE.dynamics())
    f = ca.Function("f", given, [term(s)])
    for seed in range(3):
        x = SWERVE.home + 0.2 * (some_state(seed) - SWERVE.home)
        rows = np.array(f(x, 0.0, 0.0, 1.0, WRENCH)).ravel()
        stance = STANCE(x, WRENCH)
        assert rows.min() == pytest.approx(float(margin(support_polygon(stance.feet), stance.zmp)), abs=1e-9)
        assert rows.size == term.size == 4


def test_residual_of_triangles_has_their_numeric_margins() -> None:
    triangles = support_triangles(STANCE(SWERVE.home).feet)[:2]
    term = residuals.SupportMargin(SWERVE, triangles)
    s, given = symbols(SWERVE, SWERVE.dynamics())
    f, stance = ca.Function("f", given, [term(s)]), STANCE(SWERVE.home, WRENCH)
    rows = np.array(f(SWERVE.home, 0.0, 0.0, 1.0, WRENCH)).ravel()
    for part, triangle in zip(term.groups.values(), triangles, strict=True):
        assert rows[part].min() == pytest.approx(min_edge(stance.feet[list(triangle)], stance.zmp), abs=1e-9)


def min_edge(corners: np.ndarray, point: np.ndarray) -> float:
    """Smallest signed distance to the lines of a triangle, by the areas of its parts."""
    return min(
        float(np.linalg.det(np.stack([b - a, point - a])) / np.linalg.norm(b - a))
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    )


def test_residual_with_accelerations_has_the_inertia_of_the_arm() -> None:
    dynamics = InputRate(SWERVE.dynamics(), ["arm"])
    term = residuals.SupportMargin(SWERVE, dynamics=dynamics)
    s, given = symbols(SWERVE, dynamics)
    f, rng = ca.Function("f", given, [term(s)]), np.random.default_rng(7)
    u, rate = rng.normal(size=SWERVE.input.size), np.zeros(SWERVE.input.size)
    rate[SWERVE.input["arm"]] = rng.normal(size=6)
    arm = u[SWERVE.input["arm"]]
    all_u = u.copy()
    all_u[dynamics.input["arm_rate"]] = rate[SWERVE.input["arm"]]
    rows = np.array(f(np.concatenate([SWERVE.home, arm]), all_u, 0.0, 1.0, WRENCH)).ravel()
    stance = STANCE(SWERVE.home, WRENCH, u=u, u_rate=rate)
    assert rows.min() == pytest.approx(stance.polygon_margin, abs=1e-9)
    assert abs(rows.min() - STANCE(SWERVE.home, WRENCH).polygon_margin) > 1e-3


# ---------------------------------------------------------------------- bad input
def test_bad_input_is_one_message() -> None:
    with pytest.raises(InputError, match="stands on 3 feet or more"):
        assess(robot("rezero"))
    with pytest.raises(InputError, match="unknown configuration 'Y'"):
        configuration_positions(SWERVE, "Y")
    with pytest.raises(InputError, match="outside its limits"):
        configuration_positions(SWERVE, "2,0,0,0")
    with pytest.raises(InputError, match="4 angles"):
        configuration_positions(SWERVE, "0.1,0.2")
    with pytest.raises(InputError, match="legs are fixed"):
        configuration_positions(robot("swerve-fixed-ur10"), "H")
    with pytest.raises(InputError, match="'wrench' needs 6 finite numbers"):
        STANCE(SWERVE.home, [0.0, np.nan, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(InputError, match="different feet of 0 to 3"):
        residuals.SupportMargin(SWERVE, [(0, 1, 7)])


@pytest.mark.parametrize(
    ("mass", "words"), [(float("nan"), "'mass' must be finite"), (-5.0, "'mass' must not be negative")]
)
def test_masses_that_no_load_has(mass: float, words: str) -> None:
    for load in (
        lambda: Load.gravity(mass, [0.0, 0.0, 1.0]),
        lambda: Load.inertia(mass, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]),
    ):
        with pytest.raises(InputError, match=words):
            load()
