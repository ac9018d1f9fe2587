"""The swerve base. Truth: MuJoCo's poses of the moved robot, rigid-body motion in the plane, the published table."""

from __future__ import annotations

import casadi as ca
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wbmpc.bases.ball.model import ball_base
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics, wheel_velocities
from wbmpc.robots import load_description, load_spec

VARIANTS = [("swerve-ur10", "yaw"), ("swerve-ur10", "quaternion"), ("swerve-fixed-ur10", "yaw")]
ROBOTS = {v: load_robot(v[0], orientation=v[1]) for v in VARIANTS}
MODULES = ("LF", "RF", "LB", "RB")


def symbols(robot):
    return [
        ca.SX.sym(n, layout.size)
        for n, layout in zip("xuwm", (robot.state, robot.input, robot.parameters, robot.mode), strict=True)
    ]


def numeric(expression, *arguments):
    f = ca.Function("f", list(arguments), [ca.densify(e) for e in expression])
    return lambda *values: [np.array(o) for o in f.call([ca.DM(v) for v in values])]


def random_point(robot, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State, input, brakes."""
    x = rng.uniform(-1.5, 1.5, robot.state.size)
    if robot.state.groups["base"][-1] == "qz":
        x[3:7] = np.roll(Rotation.from_euler("z", rng.uniform(-3, 3)).as_quat(), 1)
        x[2] = robot.home[2]
    return x, rng.uniform(-1, 1, robot.input.size), rng.integers(0, 2, robot.mode.size).astype(float)


class Placed:
    """MuJoCo's robot with a free joint, put at a planner state."""

    def __init__(self, robot) -> None:
        spec = load_spec(robot.description)
        spec.body("body").add_freejoint(name="root")
        self.robot, self.m = robot, spec.compile()
        self.d = mujoco.MjData(self.m)

    def put(self, x: np.ndarray) -> mujoco.MjData:
        parts = self.robot.state.split(x)
        base = parts.pop("base")
        if base.size == 7:
            self.d.qpos[:7] = base
        else:
            self.d.qpos[:2] = base[:2]
            self.d.qpos[2] = 0.3695
            self.d.qpos[3:7] = np.roll(Rotation.from_euler("z", base[2]).as_quat(), 1)
        for group, values in parts.items():
            for name, value in zip(self.robot.state.groups[group], values, strict=True):
                self.d.qpos[self.m.joint(name).qposadr[0]] = value
        mujoco.mj_forward(self.m, self.d)
        return self.d


@pytest.mark.parametrize("variant", VARIANTS)
def test_frames_equal_mujoco(variant) -> None:
    robot = ROBOTS[variant]
    placed = Placed(robot)
    rng = np.random.default_rng(0)
    for _ in range(3):
        x, _, _ = random_point(robot, rng)
        d = placed.put(x)
        for frame in ("tool0", "mount"):
            p, q = robot.pose(x, frame)
            np.testing.assert_allclose(p, d.site(frame).xpos, atol=1e-10)
            matrix = np.zeros(9)
            mujoco.mju_quat2Mat(matrix, q)
            np.testing.assert_allclose(matrix, d.site(frame).xmat, atol=1e-10)
        for frame in ("wheel_LF", "wheel_RB", "body", "wrist_3_link"):
            np.testing.assert_allclose(robot.pose(x, frame)[0], d.body(frame).xpos, atol=1e-10)


@pytest.mark.parametrize("variant", VARIANTS)
def test_frame_velocity_is_the_derivative_of_the_pose(variant) -> None:
    robot = ROBOTS[variant]
    x, u, w, m = symbols(robot)
    flow = robot.dynamics()(x, u, w, m)
    pose, (linear, angular) = robot.frame_pose(x, "tool0"), robot.frame_velocity(x, u, "tool0")
    turn = ca.reshape(ca.jtimes(ca.reshape(pose.rotation, 9, 1), x, flow), 3, 3)
    got = numeric([ca.jtimes(pose.position, x, flow), turn @ pose.rotation.T, linear, angular], x, u, w, m)
    px, pu, pm = random_point(robot, np.random.default_rng(3))
    moved, skew, v, omega = got(px, pu, [], np.ones_like(pm))
    np.testing.assert_allclose(v, moved, atol=1e-11)
    np.testing.assert_allclose(omega.ravel(), [skew[2, 1], skew[0, 2], skew[1, 0]], atol=1e-11)


@pytest.mark.parametrize("variant", VARIANTS)
def test_rolling_rows_equal_the_motion_of_the_wheels(variant) -> None:
    """Truth: differences of MuJoCo's wheel positions along the planned motion; heading = axle × up."""
    robot = ROBOTS[variant]
    placed = Placed(robot)
    x, u, w, m = symbols(robot)
    rows = numeric([robot.base.rolling(x, u, m), robot.dynamics()(x, u, w, m)], x, u, w, m)
    rng = np.random.default_rng(4)
    h = 1e-6
    for _ in range(4):
        px, pu, pm = random_point(robot, rng)
        got, flow = rows(px, pu, [], pm)
        centers = []
        for sign in (1, -1):
            d = placed.put(px + sign * h * flow.ravel())
            centers.append(np.array([d.body(f"wheel_{n}").xpos for n in MODULES]))
        velocity = (centers[0] - centers[1]) / (2 * h)
        d = placed.put(px)
        spin = pu[robot.input["wheel"]]
        for i, n in enumerate(MODULES):
            axle = d.body(f"wheel_{n}").xmat.reshape(3, 3)[:, 1]
            heading = np.cross(axle, [0, 0, 1])
            np.testing.assert_allclose(got[i], heading @ velocity[i] - 0.1 * spin[i], atol=1e-8)
            np.testing.assert_allclose(got[4 + i], np.cross([0, 0, 1], heading) @ velocity[i], atol=1e-8)


@pytest.mark.parametrize("variant", VARIANTS)
def test_jacobian_equals_differences(variant) -> None:
    robot = ROBOTS[variant]
    x, u, w, m = symbols(robot)
    f, jacobian = robot.dynamics().jacobian(x, u, w, m)
    evaluate = numeric([f, jacobian], x, u, w, m)
    px, pu, pm = random_point(robot, np.random.default_rng(6))
    z, n = np.concatenate([px, pu]), robot.state.size
    step = 1e-6 * np.eye(z.size)
    ahead, behind = (np.column_stack([evaluate(*np.split(z + s * e, [n]), [], pm)[0] for e in step]) for s in (1, -1))
    np.testing.assert_allclose(evaluate(px, pu, [], pm)[1], (ahead - behind) / 2e-6, atol=1e-7)


def test_quaternion_keeps_its_norm_and_turns_like_yaw() -> None:
    """Truth: d|q|²/dt = 0, and the planar model."""
    planar, spatial = ROBOTS[VARIANTS[0]], ROBOTS[VARIANTS[1]]
    assert spatial.dynamics().unit_quaternions == (3,)
    assert planar.dynamics().unit_quaternions == ()
    sx, px = symbols(spatial), symbols(planar)
    f, g = numeric([spatial.dynamics()(*sx)], *sx), numeric([planar.dynamics()(*px)], *px)
    rng = np.random.default_rng(8)
    x, u, m = random_point(spatial, rng)
    (flow,) = f(x, u, [], m)
    assert abs(x[3:7] @ flow[3:7, 0]) < 1e-15
    yaw = 2 * np.arctan2(x[6], x[3])
    (flat,) = g([x[0], x[1], yaw, *x[7:]], u, [], m)
    np.testing.assert_allclose(flow[:2], flat[:2], atol=1e-12)
    assert abs(flow[2, 0]) < 1e-15
    np.testing.assert_allclose(
        flow[3:7, 0], 0.5 * u[2] * np.array([-np.sin(yaw / 2), 0, 0, np.cos(yaw / 2)]), atol=1e-12
    )


def test_closed_brakes_stop_the_legs_in_motion_and_in_rolling() -> None:
    robot = ROBOTS[VARIANTS[0]]
    x, u, w, m = symbols(robot)
    f = numeric([robot.dynamics()(x, u, w, m), robot.base.rolling(x, u, m)], x, u, w, m)
    motion = robot.input.vector({"leg": [0.1, 0.2, 0.3, 0.4]})
    flow, rows = f(robot.home, motion, [], np.array([1.0, 0, 0, 1]))
    np.testing.assert_allclose(flow[robot.state["leg"]].ravel(), [0.1, 0, 0, 0.4], atol=1e-15)
    np.testing.assert_allclose(rows[[1, 2, 5, 6]], 0, atol=1e-15)
    assert np.all(np.abs(rows[[0, 3]]) + np.abs(rows[[4, 7]]) > 0.03)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_rolling_inverse_kinematics_satisfies_the_rows_on_the_near_branch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for variant in (VARIANTS[0], VARIANTS[2]):
        robot, rolling = ROBOTS[variant], ROLLING[variant]
        leg, steer = rng.uniform(-1.5, 1.5, 4), rng.uniform(-3, 3, 4)
        twist, rate = rng.uniform(-1, 1, 3), rng.uniform(-0.3, 0.3, 4)
        if not robot.base.geometry.legs_move:
            leg, rate = np.zeros(4), np.zeros(4)
        target, speed = rolling_inverse_kinematics(robot.base.geometry, leg, steer, twist, rate)
        assert np.all(np.abs(target - steer) <= np.pi / 2 + 1e-12)
        legs = {"leg": leg} if "leg" in robot.state else {}
        rates = {"leg": rate} if "leg" in robot.state else {}
        x = robot.state.vector({"steer": target, **legs})
        u = robot.input.vector({"base": twist, "wheel": speed, **rates})
        np.testing.assert_allclose(rolling(x, u, np.ones(robot.mode.size))[0], 0, atol=1e-12)


def test_wheel_velocities_equal_rigid_motion() -> None:
    """Truth: positions before and after a small motion of body and legs, from the published lengths."""
    geometry = ROBOTS[VARIANTS[0]].base.geometry
    leg, rate, twist, h = (
        np.array([0.3, -0.2, 0.5, 0.1]),
        np.array([0.1, -0.3, 0.2, 0.05]),
        np.array([0.4, -0.7, 0.9]),
        1e-6,
    )
    hinge = np.array([[0.4031, 0.353], [0.4031, -0.353], [-0.4031, 0.353], [-0.4031, -0.353]])

    def axes(t: float) -> np.ndarray:
        a = np.array([0, 0, np.pi, np.pi]) + leg + rate * t
        s = hinge + 0.4181 * np.stack([np.cos(a), np.sin(a)], 1)
        return s @ Rotation.from_euler("z", twist[2] * t).as_matrix()[:2, :2].T + twist[:2] * t

    np.testing.assert_allclose(wheel_velocities(geometry, leg, twist, rate), (axes(h) - axes(-h)) / (2 * h), atol=1e-9)
    np.testing.assert_allclose(geometry.steer_axes(leg), axes(0), atol=1e-12)


@pytest.mark.parametrize("name", ["telescope-ur10", "pentapod-ur10"])
def test_legs_of_any_kind_move_as_in_mujoco(name: str) -> None:
    """Truth: MuJoCo's positions of the wheels' bodies, by central differences along a motion of base and legs."""
    robot = load_robot(name)
    g, rng, h = robot.base.geometry, np.random.default_rng(4), 1e-6
    n, part = g.modules, robot.state["leg"]
    leg = rng.uniform(robot.limits.state_lower[part], robot.limits.state_upper[part])
    rate, twist = rng.uniform(-0.3, 0.3, n), rng.uniform(-1.0, 1.0, 3)
    model = load_spec(robot.description).compile()
    data = mujoco.MjData(model)

    def axes(t: float) -> np.ndarray:
        for joint, value in zip(robot.state.groups["leg"], leg + rate * t, strict=True):
            data.qpos[model.joint(joint).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        body = data.body(robot.description.base.body)
        places = np.array([data.body(model.jnt_bodyid[model.joint(w).id]).xpos for w in robot.state.groups["wheel"]])
        s = ((places - body.xpos) @ body.xmat.reshape(3, 3))[:, :2]
        return s @ Rotation.from_euler("z", twist[2] * t).as_matrix()[:2, :2].T + twist[:2] * t

    np.testing.assert_allclose(g.steer_axes(leg), axes(0.0), atol=1e-12)
    velocity = wheel_velocities(g, leg, twist, rate)
    np.testing.assert_allclose(velocity, (axes(h) - axes(-h)) / (2 * h), atol=1e-9)
    target, speed = rolling_inverse_kinematics(g, leg, rng.uniform(-1, 1, n), twist, rate)
    x, u = (
        robot.state.vector({"steer": target, "leg": leg}),
        robot.input.vector({"base": twist, "wheel": speed, "leg": rate}),
    )
    state, inputs, mode = (ca.SX.sym(s, k) for s, k in (("x", x.size), ("u", u.size), ("m", n)))
    rows = ca.Function("rows", [state, inputs, mode], [robot.base.rolling(state, inputs, mode)])
    np.testing.assert_allclose(np.array(rows(x, u, np.ones(n))).ravel(), 0.0, atol=1e-12)


def test_still_wheels_keep_their_steering() -> None:
    geometry = ROBOTS[VARIANTS[0]].base.geometry
    steer = np.array([0.1, -2.0, 3.0, 0.7])
    target, speed = rolling_inverse_kinematics(geometry, np.zeros(4), steer, np.zeros(3))
    np.testing.assert_array_equal(target, steer)
    np.testing.assert_array_equal(speed, 0)


@pytest.mark.parametrize("variant", VARIANTS)
def test_geometry_equals_the_published_numbers(variant) -> None:
    """Pankert et al. 2022 and its release; the fixed robot stands in X, and its legs' angles are in its headings."""
    geometry = ROBOTS[variant].base.geometry
    assert geometry.wheel_radius == 0.10
    assert geometry.legs_move == (variant[0] == "swerve-ur10")
    leg = np.array([1, -1, -1, 1]) * np.pi / 4
    hinge = np.array([[0.4031, 0.353], [0.4031, -0.353], [-0.4031, 0.353], [-0.4031, -0.353]])
    heading = np.array([0, 0, np.pi, np.pi]) + (0 if geometry.legs_move else leg)

    def unit(a: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(a), np.sin(a)], 1)

    np.testing.assert_allclose(geometry.hinge, hinge, atol=1e-12)
    np.testing.assert_allclose(geometry.leg_length, 0.4181, atol=1e-12)
    np.testing.assert_allclose(unit(geometry.leg_heading), unit(heading), atol=1e-12)
    np.testing.assert_allclose(unit(geometry.wheel_heading), unit(heading), atol=1e-12)
    own = leg if geometry.legs_move else np.zeros(4)
    p = geometry.steer_axes(own)[[0, 1, 3, 2]]
    area = 0.5 * abs(np.sum(p[:, 0] * np.roll(p[:, 1], -1) - p[:, 1] * np.roll(p[:, 0], -1)))
    assert abs(area - 1.81) < 0.01  # Table I, configuration X


@pytest.mark.parametrize("variant", VARIANTS)
def test_home_is_in_x_and_the_hand_beside_the_robot(variant) -> None:
    robot = ROBOTS[variant]
    x, limits = robot.home, robot.limits
    assert np.all(x >= limits.state_lower) and np.all(x <= limits.state_upper)
    p, q = robot.pose(x, "tool0")
    np.testing.assert_allclose(p, [0.3, 0.65, 0.8], atol=1e-3)
    np.testing.assert_allclose(Rotation.from_quat(np.roll(q, -1)).as_matrix()[:, 2], [0, 1, 0], atol=1e-3)
    d = Placed(robot).put(x)
    for n in MODULES:
        axle = d.body(f"wheel_{n}").xmat.reshape(3, 3)[:, 1]
        np.testing.assert_allclose(np.abs(np.cross(axle, [0, 0, 1]) @ [1, 0, 0]), 1, atol=1e-12)
        np.testing.assert_allclose(d.body(f"wheel_{n}").xpos[2], 0.1, atol=1e-12)
    mass = Placed(robot).m.body_mass.sum()
    assert abs(mass - 100.87) < 0.01


def test_layouts_and_limits() -> None:
    sizes = {v: (r.state.size, r.input.size, r.parameters.size, r.mode.size) for v, r in ROBOTS.items()}
    assert sizes == {VARIANTS[0]: (21, 21, 3, 4), VARIANTS[1]: (25, 21, 3, 4), VARIANTS[2]: (17, 17, 3, 0)}
    robot = ROBOTS[VARIANTS[0]]
    assert robot.state.groups["leg"] == tuple(f"leg_{n}" for n in MODULES)
    lower, upper = (getattr(robot.limits, f"state_{s}") for s in ("lower", "upper"))
    np.testing.assert_allclose(upper[robot.state["leg"]], 1.571)
    np.testing.assert_allclose(lower[robot.state["steer"]], -3.14)
    np.testing.assert_allclose(upper[robot.state["arm"]], 2 * np.pi)
    assert np.all(np.isinf(upper[robot.state["base"]])) and np.all(np.isinf(upper[robot.state["wheel"]]))
    bound = robot.limits.input_upper
    np.testing.assert_allclose(bound[robot.input["base"]], 1.0)
    np.testing.assert_allclose(bound[robot.input["steer"]], 5.0)
    np.testing.assert_allclose(bound[robot.input["wheel"]], 10.0)
    np.testing.assert_allclose(bound[robot.input["arm"]], [2.09, 2.09, 3.14, 3.14, 3.14, 3.14])
    np.testing.assert_allclose(robot.limits.input_lower, -bound)


def test_dynamics_of_a_kinematic_base_have_no_mass_matrix() -> None:
    with pytest.raises(InputError, match="base of type ball is needed"):
        ball_base(ROBOTS[VARIANTS[0]])


def test_the_plant_and_the_planner_share_the_description() -> None:
    description = load_description("swerve-ur10")
    m = load_spec(description).compile()
    assert {m.joint(j).name for j in range(m.njnt)} == set(description.joints())
    assert not np.any(m.geom_contype)  # nothing touches until a plant says so


def _rolling(robot):
    x, u, _, m = symbols(robot)
    return numeric([robot.base.rolling(x, u, m)], x, u, m)


ROLLING = {v: _rolling(r) for v, r in ROBOTS.items()}
