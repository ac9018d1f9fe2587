"""The ball robot. Truth: MuJoCo's free-floating robot with exact rolling as constraint, contact geometry, statics."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.ocp.residuals import FrameWrench, Symbols
from wbmpc.robots import load_description, load_spec
from wbmpc.studies.minniti2019.held_arm import ServoedArm

RADIUS, WHEEL_RADIUS = 0.125, 0.064
AZIMUTHS = np.deg2rad([0, 120, 240])
ROBOT = load_robot("rezero")
N = 8


def numeric(expression, *symbols):
    """Evaluate symbolic expressions as arrays."""
    f = ca.Function("f", list(symbols), [ca.densify(e) for e in expression])
    return lambda *values: [np.array(o) for o in (f.call([ca.DM(v) for v in values]))]


def symbols(robot):
    """State, input, parameters, mode."""
    return [
        ca.SX.sym(n, layout.size)
        for n, layout in zip("xuwm", (robot.state, robot.input, robot.parameters, robot.mode), strict=True)
    ]


def random_state(rng: np.random.Generator) -> np.ndarray:
    q = [*rng.uniform(-1, 1, 2), rng.uniform(-3, 3), *rng.uniform(-0.5, 0.5, 2), *rng.uniform(-1.5, 1.5, 3)]
    return np.concatenate([q, rng.uniform(-2, 2, N)])


def local_rates(q: np.ndarray) -> np.ndarray:
    """Angular velocity in the base's axes = E(q) (yaw, pitch, roll rates); textbook matrix of ZYX angles. Complex-safe."""
    sp, cp, sr, cr = np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4])
    return np.array([[-sp, 0, 1], [cp * sr, cr, 0], [cp * cr, -sr, 0]])


def contact_map() -> np.ndarray:
    """Torque (3) on the ball, base axes, of unit wheel torques, from the contacts: point R e, rim force τ / r_w."""
    columns = []
    for b in AZIMUTHS:
        zenith = np.pi / 4
        point = np.array([np.sin(zenith) * np.cos(b), np.sin(zenith) * np.sin(b), np.cos(zenith)])
        axle = np.array([np.cos(zenith) * np.cos(b), np.cos(zenith) * np.sin(b), -np.sin(zenith)])
        rim_direction = np.cross(axle, -point)  # velocity of the rim at the contact for a positive wheel speed
        columns.append(np.cross(RADIUS * point, rim_direction / WHEEL_RADIUS))
    return np.array(columns).T


class FloatingRobot:
    """MuJoCo with a free base and a ball joint; rolling without slip and without spin as an exact constraint."""

    def __init__(self, payload: float = 0.0) -> None:
        spec = load_spec(load_description("rezero"))
        if payload > 0.0:  # a small ball of iron at the tool
            tool = next(s for s in spec.sites if s.name == "tool")
            held = tool.parent.add_body(name="payload", pos=tool.pos)
            held.mass, held.ipos, held.inertia, held.explicitinertial = payload, [0, 0, 0], [1e-9] * 3, True
        spec.body("base").add_freejoint(name="root")
        self.m = spec.compile()
        self.d = mujoco.MjData(self.m)
        self.ball = self.m.body("ball").id
        self.dof = self.m.joint("ball").dofadr[0]

    def accelerations(
        self, x: np.ndarray, u: np.ndarray, hand_force: np.ndarray, seed: int, wrenches: dict | None = None
    ) -> np.ndarray:
        """v̇ (8) by the KKT system [H Jᵀ; J 0]. ``wrenches``: force and moment (6) by frame, world axes, at its origin."""
        m, d, q, v = self.m, self.d, x[:N], x[N:]
        base = Rotation.from_euler("ZYX", q[2:5]).as_matrix()
        omega = local_rates(q) @ v[2:5]
        spin = np.array([-v[1] / RADIUS, v[0] / RADIUS, 0.0])
        relative = Rotation.random(rng=np.random.default_rng(seed))
        d.qpos[:3] = [q[0], q[1], 5.0]  # far above any floor
        d.qpos[3:7] = np.roll(Rotation.from_matrix(base).as_quat(), 1)
        d.qpos[7:11] = np.roll(relative.as_quat(), 1)
        d.qpos[11:] = q[5:]
        d.qvel[:3], d.qvel[3:6] = [v[0], v[1], 0.0], omega
        d.qvel[6:9] = relative.as_matrix().T @ (base.T @ spin - omega)
        d.qvel[9:] = v[5:]
        mujoco.mj_forward(m, d)
        nv = m.nv
        force = np.zeros(nv)
        force[6:9] = relative.as_matrix().T @ contact_map() @ u[:3]
        force[9:] = u[3:6]
        jp, jr = np.zeros((3, nv)), np.zeros((3, nv))
        mujoco.mj_jacSite(m, d, jp, jr, m.site("tool").id)
        force += jp.T @ hand_force
        for frame, wrench in (wrenches or {}).items():
            mujoco.mj_applyFT(m, d, wrench[:3], wrench[3:], *self.place(frame), force)
        inertia = np.zeros((nv, nv))
        mujoco.mj_fullM(m, d, inertia)
        mujoco.mj_jacBody(m, d, jp, jr, self.ball)
        dp, dr = np.zeros((3, nv)), np.zeros((3, nv))
        mujoco.mj_jacDot(m, d, dp, dr, d.xpos[self.ball], self.ball)
        down = np.array([0, 0, -RADIUS])
        rows = np.vstack([jp + np.cross(jr.T, down).T, jr[2:3]])
        slopes = np.vstack([dp + np.cross(dr.T, down).T, dr[2:3]])
        left = np.block([[inertia, rows.T], [rows, np.zeros((4, 4))]])
        a = np.linalg.solve(left, np.concatenate([force - d.qfrc_bias, -slopes @ d.qvel]))[:nv]
        # ω = E(q) r, so ω̇ = E ṙ + Ė r; Ė by the complex step, exact to rounding
        turned = np.imag(local_rates(q + 1e-30j * v)) / 1e-30 @ v[2:5]
        euler = np.linalg.solve(local_rates(q), a[3:6] - turned)
        return np.concatenate([a[:2], euler, a[9:]])

    def place(self, frame: str) -> tuple[np.ndarray, int]:
        """Where a site or body is in the world, and which body it belongs to."""
        m, d = self.m, self.d
        if frame in [m.site(i).name for i in range(m.nsite)]:
            return d.site_xpos[m.site(frame).id], int(m.site(frame).bodyid[0])
        return d.xpos[m.body(frame).id], m.body(frame).id


CONTACTS = [("force", ["tool"]), ("wrench", ["tool"]), ("wrench", ["base"]), ("wrench", ["arm_forearm_link", "tool"])]


@pytest.mark.parametrize(("kind", "frames"), CONTACTS)
def test_contact_wrenches_equal_mujocos(kind: str, frames: list[str]) -> None:
    """Truth: mj_applyFT at the frame's origin; the residual is the wrench that acts at its frame."""
    robot = load_robot("rezero", contact=kind, contact_frame=frames)
    x_, u_, w_, m_ = symbols(robot)
    given = [Symbols(x_, u_, w_, m_, ca.SX.zeros(6 if kind == "wrench" else 3), x_, u_)] * len(frames)
    residuals = [FrameWrench(robot, f)(s) for f, s in zip(frames, given, strict=True)]
    evaluate = numeric([robot.dynamics()(x_, u_, w_, m_), *residuals], x_, u_, w_, m_)
    rng = np.random.default_rng(4)
    for seed in range(5):
        x, u = random_state(rng), rng.uniform(-20, 20, robot.input.size)
        split = robot.input.split(u)
        groups = [robot.base.contacts[f] for f in frames]
        parts = [np.concatenate([split[g] for g in by_kind.values()]) for by_kind in groups]
        wrenches = {f: np.pad(p, (0, 6 - p.size)) for f, p in zip(frames, parts, strict=True)}
        f, *rows = evaluate(x, u, np.zeros(robot.parameters.size), [])
        truth = FLOATING.accelerations(x, u[:6], np.zeros(3), seed, wrenches)
        np.testing.assert_allclose(f.ravel()[N:], truth, atol=1e-8 * (1 + np.abs(truth).max()))
        for row, part in zip(rows, parts, strict=True):
            np.testing.assert_array_equal(row.ravel(), part)


def test_layout_of_contacts() -> None:
    groups = lambda **contact: load_robot("rezero", **contact).input.groups
    assert [*groups(contact="wrench")] == ["wheel", "arm", "force", "moment"]
    several = [*groups(contact="wrench", contact_frame=["arm_forearm_link", "tool"])]
    assert several[2:] == ["force_arm_forearm_link", "moment_arm_forearm_link", "force_tool", "moment_tool"]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_equations_of_motion_equal_mujoco_with_exact_rolling(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = random_state(rng)
    u = np.concatenate([rng.uniform(-8, 8, 3), rng.uniform(-10, 10, 3)])
    end_effector = rng.uniform(-20, 20, 3)
    truth = FLOATING.accelerations(x, u, end_effector, seed)
    for derivative, arguments in (
        (DERIVATIVE, (x, u, ROBOT.parameters.vector({"force": end_effector}), [])),
        (CONTACT, (x, [*u, *end_effector], np.zeros(N + 2), [])),
    ):
        (f,) = derivative(*arguments)
        np.testing.assert_allclose(f.ravel()[:N], x[N:], atol=0)
        np.testing.assert_allclose(f.ravel()[N:], truth, atol=1e-8 * (1 + np.abs(truth).max()))


@pytest.mark.parametrize("mass", [0.0, 1.7])
def test_payload_is_a_mass_at_the_tool(mass: float) -> None:
    """Truth: MuJoCo's robot with a body of that mass there."""
    loaded, truth = load_robot("rezero", payload=True), FloatingRobot(mass)
    names = symbols(loaded)
    f, slope = loaded.dynamics().jacobian(*names)
    evaluate = numeric([f, slope, ca.jacobian(f, ca.vertcat(*names[:2]))], *names)
    rng = np.random.default_rng(8)
    for seed in range(5):
        x, u = random_state(rng), rng.uniform(-8, 8, 6)
        want = truth.accelerations(x, u, np.zeros(3), seed)
        value, given_slope, automatic = evaluate(x, u, loaded.parameters.vector({"payload": [mass]}), [])
        np.testing.assert_allclose(value.ravel()[N:], want, atol=1e-6 * (1 + np.abs(want).max()))
        np.testing.assert_allclose(given_slope, automatic, atol=1e-8 * np.abs(automatic).max())
        weight = np.array([0.0, 0.0, -9.81 * mass])
        same = loaded.dynamics().parameters.vector({"force": weight})
        still = np.concatenate([x[:N], np.zeros(N)])  # at rest it is its weight, moved or not
        forces = [
            numeric([loaded.base.generalized_force(*names[:3])], *names)(still, u, w, [])[0] for w in (same, 0 * same)
        ]
        np.testing.assert_allclose(
            (forces[0] - forces[1]).ravel(), mass * loaded.base.numeric.tool_weight(x[:N]), atol=1e-9
        )


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_disturbance_is_a_generalized_force(seed: int) -> None:
    """Truth: M (v̇ with − v̇ without) = the disturbance."""
    rng = np.random.default_rng(seed)
    x, u, push = random_state(rng), rng.uniform(-5, 5, 6), rng.uniform(-10, 10, N)
    (with_push,) = DERIVATIVE(x, u, ROBOT.parameters.vector({"disturbance": push}), [])
    (without,) = DERIVATIVE(x, u, ROBOT.parameters.vector({}), [])
    change = (with_push - without).ravel()[N:]
    np.testing.assert_allclose(ROBOT.base.numeric.mass_matrix(x[:N]) @ change, push, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_wheel_power_equals_power_of_the_generalized_force(seed: int) -> None:
    """Truth: rim speed = speed of the ball's surface at each contact; power balance τ·ψ̇ = Q·v."""
    rng = np.random.default_rng(seed)
    x, torque = random_state(rng), rng.uniform(-5, 5, 3)
    q, v = x[:N], x[N:]
    base = Rotation.from_euler("ZYX", q[2:5]).as_matrix()
    relative = base.T @ np.array([-v[1] / RADIUS, v[0] / RADIUS, 0]) - local_rates(q) @ v[2:5]
    speeds = contact_map().T @ relative  # velocities are dual to torques
    s, r, u, w = ca.SX.sym("q", N), ca.SX.sym("v", N), ca.SX.sym("u", 6), ca.SX.sym("w", ROBOT.parameters.size)
    got, force = numeric([ROBOT.base.wheel_speeds(s, r), ROBOT.base.generalized_force(s, u, w)], s, r, u, w)(
        q, v, [*torque, 0, 0, 0], np.zeros(ROBOT.parameters.size)
    )
    np.testing.assert_allclose(got.ravel(), speeds, atol=1e-12)
    np.testing.assert_allclose(force.ravel() @ v, torque @ speeds, atol=1e-11)


def test_wheel_torque_map_equals_the_contacts() -> None:
    np.testing.assert_allclose(ROBOT.base.wheel_torque_map(), contact_map(), atol=1e-12)


def test_moment_on_the_hand_does_the_work_of_its_turning() -> None:
    """Virtual work, with the end effector's turning by differences of its orientation."""
    q, moment, h = ROBOT.home[:N] + 0.1 * np.sin(np.arange(N)), np.array([0.7, -1.1, 0.4]), 1e-6
    work = []
    for k in range(N):
        turned = [ROBOT.pose(np.concatenate([q + s * h * np.eye(N)[k], np.zeros(N)]))[1] for s in (-1.0, 1.0)]
        turn = lie.quaternion_log(lie.quaternion_multiply(turned[1], lie.quaternion_conjugate(turned[0])))
        work.append(moment @ turn / (2.0 * h))
    np.testing.assert_allclose(ROBOT.base.numeric.tool_moment(q, moment), work, atol=1e-6)


def test_mass_matrix_and_inverse_dynamics_agree() -> None:
    """Truth: M a + h is linear in a with slope M."""
    q, v, a = np.split(np.random.default_rng(2).normal(size=24), 3)
    change = ROBOT.base.numeric.inverse_dynamics(q, v, a) - ROBOT.base.numeric.inverse_dynamics(q, v, np.zeros(N))
    np.testing.assert_allclose(ROBOT.base.numeric.mass_matrix(q) @ a, change, atol=1e-9)


@pytest.mark.parametrize("contact", ["none", "force", "wrench"])
def test_jacobian_equals_differences_and_automatic_differentiation(contact: str) -> None:
    robot = load_robot("rezero", contact=contact)
    d, (x, u, w, m) = robot.dynamics(), symbols(robot)
    f, jacobian = d.jacobian(x, u, w, m)
    z = ca.vertcat(x, u)
    plain = d(x, u, w, m)
    evaluate = numeric([f, jacobian, plain, ca.jacobian(plain, z)], x, u, w, m)
    rng = np.random.default_rng(5)
    for _ in range(5):
        p = rng.uniform(-2, 2, robot.parameters.size)
        point = np.concatenate([random_state(rng), rng.uniform(-3, 3, robot.input.size)])
        value, slope, again, automatic = evaluate(point[:16], point[16:], p, [])
        np.testing.assert_allclose(value, again, atol=1e-11)
        np.testing.assert_allclose(slope, automatic, atol=1e-8 * np.abs(automatic).max())
        step = 1e-6 * np.eye(len(point))
        ahead, behind = (
            np.column_stack([evaluate(*np.split(point + e * h, [16]), p, [])[0] for h in step]) for e in (1, -1)
        )
        np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, atol=1e-6 * np.abs(slope).max())
    count = ca.Function("f", [x, u, w, m], ca.cse([f, jacobian])).n_instructions()
    print(f"rezero contact={contact}: acceleration and Jacobian take {count} instructions")
    assert count < 11000


@pytest.mark.parametrize("force", [(0.0, 0, 0), (-15.0, 5.0, 3.0)])
@pytest.mark.parametrize("arm", [(0.0, 1.0, 0.8), (1.2, -0.7, 1.1)])
def test_equilibrium_rests_and_balances_moments(arm, force) -> None:
    """Truth: statics about the ball's contact point, with the center of mass computed by MuJoCo."""
    x, u = ROBOT.base.numeric.equilibrium(arm, yaw=0.4, force=force)
    elsewhere = load_robot("rezero", contact="wrench", contact_frame="base")
    np.testing.assert_allclose(elsewhere.base.numeric.equilibrium(arm, yaw=0.4, force=force)[0], x, atol=1e-9)
    np.testing.assert_allclose(x[[0, 1, 2, 5, 6, 7]], [0, 0, 0.4, *arm], atol=0)
    (f,) = DERIVATIVE(x, u, ROBOT.parameters.vector({"force": force}), [])
    np.testing.assert_allclose(f, 0, atol=1e-8)
    FLOATING.accelerations(x, u, np.asarray(force), 0)  # places MuJoCo's robot
    m, d = FLOATING.m, FLOATING.d
    contact = d.xpos[FLOATING.ball] - [0, 0, RADIUS]
    weight = np.array([0, 0, -9.81 * m.body_subtreemass[m.body("base").id]])
    moment = np.cross(d.subtree_com[m.body("base").id] - contact, weight)
    moment += np.cross(d.site_xpos[m.site("tool").id] - contact, force)
    np.testing.assert_allclose(moment[:2], 0, atol=1e-7)


def test_home_is_the_equilibrium_within_the_limits() -> None:
    x, limits = ROBOT.home, ROBOT.limits
    np.testing.assert_allclose(x[ROBOT.state["arm"]], [0, 1.0, 0.8], atol=0)
    assert 0.02 < abs(x[3]) < 0.3  # the arm in front leans the base back
    assert np.all(x >= limits.state_lower) and np.all(x <= limits.state_upper)
    np.testing.assert_allclose(limits.input_upper, [4, 4, 4, 20, 20, 20])
    np.testing.assert_allclose(limits.state_upper[ROBOT.state["arm"]], [2.6, 1.75, 2.4])
    np.testing.assert_allclose(limits.state_upper[ROBOT.state["arm_velocity"]], 4.0)
    np.testing.assert_allclose(limits.state_lower[ROBOT.state["arm_velocity"]], -4.0)


def test_functions_of_numbers_in_several_threads() -> None:
    """Truth: CasADi's own call of the same function. Threads do not write into each other's arguments."""
    q = [random_state(np.random.default_rng(k))[:N] for k in range(4)]
    ROBOT.base.numeric.mass_matrix(q[0])
    expected = [np.array(ROBOT.base.numeric._numeric["M"].function(v)) for v in q]

    def all_equal(k: int) -> bool:
        return all(np.array_equal(ROBOT.base.numeric.mass_matrix(q[k]), expected[k]) for _ in range(2000))

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(all_equal, range(4)))
    with pytest.raises(InputError, match="M: 8 numbers are needed, got 1"):
        ROBOT.base.numeric.mass_matrix(0.0)


def test_figures_of_the_source() -> None:
    """Truth: published masses; m + I / r² = 3.712 kg on x and y; about 25 kg in all."""
    mass = ROBOT.base.numeric.mass_matrix(ROBOT.home[:N])
    spin = 0.0166 / 0.125**2
    np.testing.assert_allclose(2.65 + spin, 3.712, atol=1e-3)
    np.testing.assert_allclose(mass[0, 0], 2.65 + spin + 18.66 + 3.7, atol=1e-9)
    np.testing.assert_allclose(mass[1, 1], mass[0, 0], atol=1e-12)


def test_layouts_and_frames() -> None:
    force = load_robot("rezero", contact="force")
    assert (ROBOT.state.size, ROBOT.input.size, ROBOT.parameters.size, ROBOT.mode.size) == (16, 6, 13, 0)
    assert (force.state.size, force.input.size, force.parameters.size) == (16, 9, 10)
    assert {"base", "tool"} <= set(ROBOT.frames)
    loaded = load_robot("rezero", payload=True)
    assert loaded.parameters.groups["payload"] == ("mass",) and loaded.parameters.size == 14
    with pytest.raises(InputError, match="no mass at the end effector"):
        ServoedArm(loaded)
    with pytest.raises(InputError, match="did you mean 'tool'"):
        ROBOT.frame_pose(ca.SX.sym("x", 16), "tol")


def test_frame_velocity_is_the_derivative_of_the_pose() -> None:
    x, u, _, _ = symbols(ROBOT)
    pose, (linear, angular) = ROBOT.frame_pose(x, "tool"), ROBOT.frame_velocity(x, u, "tool")
    rotated = ca.jtimes(ca.reshape(pose.rotation, 9, 1), x[:N], x[N:])
    p, r, v, w, drift = numeric(
        [ca.jtimes(pose.position, x[:N], x[N:]), pose.rotation, linear, angular, ca.reshape(rotated, 3, 3)], x, u
    )(random_state(np.random.default_rng(1)), np.zeros(6))
    np.testing.assert_allclose(v, p, atol=1e-12)
    skew = drift @ r.T
    np.testing.assert_allclose(w.ravel(), [skew[2, 1], skew[0, 2], skew[1, 0]], atol=1e-12)


FLOATING = FloatingRobot()
_X = symbols(ROBOT)
DERIVATIVE = numeric([ROBOT.dynamics()(*_X)], *_X)
_FORCE_ROBOT = load_robot("rezero", contact="force")
_Y = symbols(_FORCE_ROBOT)
CONTACT = numeric([_FORCE_ROBOT.dynamics()(*_Y)], *_Y)
