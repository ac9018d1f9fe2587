"""LeanControl of the ball robot. Truth: the planar pendulum on a ball by hand, with masses and inertia that MuJoCo sums up;
MuJoCo's centers of mass and the torques that hold its arm."""

from __future__ import annotations

import casadi as ca
import mujoco
import numpy as np
import pytest
from scipy.optimize import linprog

from toys import robot
from wbmpc.bases.ball.balance import Balance, _support, divergent
from wbmpc.bases.ball.balance import load_offset as offset_of
from wbmpc.bases.ball.defaults import EndEffectorCost, RezeroCost, rezero_problem
from wbmpc.bases.ball.residuals import CapturePoint, JointEffort
from wbmpc.model.robot import load_robot
from wbmpc.ocp import Reference
from wbmpc.ocp.residuals import Symbols
from wbmpc.robots import load_spec
from wbmpc.settings import MpcSettings
from wbmpc.solver import SQP, InteriorPoint, Solver

ROBOT = robot("rezero")
RADIUS, WHEEL_RADIUS, BALL_MASS, BALL_INERTIA = 0.125, 0.064, 2.65, 0.0166


def in_mujoco(state: np.ndarray) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """MuJoCo's robot without floor, its base free, in a state (16) of the minimal model; forward kinematics done."""
    spec = load_spec(ROBOT.description)
    spec.body("base").add_freejoint()
    model = spec.compile()
    data = mujoco.MjData(model)
    yaw, pitch, roll = state[2:5]
    turn = np.zeros(4)
    mujoco.mju_euler2Quat(turn, np.array([yaw, pitch, roll]), "zyx")
    data.qpos[:7] = [*state[:2], 0.0, *turn]
    data.qpos[7 + 4 :] = state[5:8]
    mujoco.mj_forward(model, data)
    return model, data


def load_offset(state: np.ndarray) -> np.ndarray:
    """Center of mass (3) [m] of all but the ball, from the ball's center."""
    model, data = in_mujoco(state)
    first = model.body("base").subtreemass * data.body("base").subtree_com - BALL_MASS * data.body("ball").xipos
    return first / (model.body("base").subtreemass - BALL_MASS) - data.body("ball").xipos


def evaluated(residual, state: np.ndarray, u: np.ndarray, w: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    x, v, p = (ca.SX.sym(n, size) for n, size in (("x", 16), ("u", 6), ("w", w.size)))
    none = ca.SX(0, 1)
    value = residual(Symbols(x, v, p, none, none, x, v))
    return np.array(ca.Function("r", [x, v, p], [value])(state, u, w)).ravel()


@pytest.mark.parametrize("poles", [(4.7, 4.7), (4.0, 6.0)])
def test_the_divergent_component_does_not_depend_on_eigenvectors(poles: tuple[float, float]) -> None:
    """Truth: what it is. ξ̇ = Ω ξ with these poles, and by the angles it is the offset; axes that are not at right angles."""
    grows, offset = np.array([[1.0, 0.4], [-0.7, 0.8]]), np.array([[0.1, 0.5], [-0.6, 0.2]])
    a = np.zeros((10, 10))
    a[:5, 5:] = np.eye(5)
    a[8:, 3:5] = grows @ np.diag(np.square(poles)) @ np.linalg.inv(grows)
    a[5:8, 3:5] = [[1.0, 2.0], [-3.0, 0.5], [0.3, 0.0]]
    pole, component = divergent(a, offset)
    turned = component @ a @ np.linalg.pinv(component)
    np.testing.assert_allclose(component @ a, turned @ component, atol=1e-9)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(turned).real), poles, atol=1e-6)
    np.testing.assert_allclose(component[:, 3:5], offset, atol=1e-9)
    assert pole == pytest.approx(np.mean(poles))


def test_pole_and_reach_of_a_planar_pendulum() -> None:
    """Arm straight up: nearly symmetric. (M11, M12; M12, M22) (ẍ, θ̈) = (T / r, m g h θ − T)."""
    model, data = in_mujoco(np.zeros(16))
    offset = load_offset(np.zeros(16))
    mass, height = model.body("base").subtreemass[0] - BALL_MASS, offset[2]
    inertia = 0.0  # about the load's center of mass, y axis
    for b in range(1, model.nbody):
        if model.body(b).name != "ball":
            turn = data.body(b).ximat.reshape(3, 3)
            arm = data.body(b).xipos - data.body("ball").xipos - offset
            inertia += (turn @ np.diag(model.body(b).inertia) @ turn.T)[1, 1]
            inertia += model.body(b).mass[0] * (arm @ arm - arm[1] ** 2)
    m11, m12, m22 = BALL_MASS + BALL_INERTIA / RADIUS**2 + mass, mass * height, inertia + mass * height**2
    pole = np.sqrt(m11 * mass * 9.81 * height / (m11 * m22 - m12**2))
    found = Balance.of(ROBOT, np.zeros(3), directions=4)
    assert found.pole == pytest.approx(pole, rel=0.02)
    # along x two wheels at 4 N m against each other, without spin: a torque about y of
    torque = 2.0 * 4.0 * np.sin(np.deg2rad(120)) * np.cos(np.pi / 4) * RADIUS / WHEEL_RADIUS
    lean = torque * (m12 / RADIUS + m11) / (m11 * mass * 9.81 * height)
    assert found.reach[0] == pytest.approx(height * lean, rel=0.03)
    assert found.reach[0] == pytest.approx(found.reach[2], rel=1e-6)
    # a force f on the end effector at height z: m g h θ + f z = M12 ẍ with M11 ẍ = f holds the lean
    z = data.site("tool").xpos[2] - data.body("ball").xipos[2]
    assert found.answer == pytest.approx((z - m12 / m11) / (mass * 9.81), rel=0.02)


def test_reach_grows_with_the_torque_and_ends_at_the_spin_friction() -> None:
    description = ROBOT.description
    limits = description.limits.model_copy(update={"spin_effort": np.inf})
    free = type(ROBOT)(description.model_copy(update={"limits": limits}))
    some, more = Balance.of(ROBOT, np.zeros(3)).reach, Balance.of(free, np.zeros(3)).reach
    assert np.all(more >= some - 1e-12) and more.max() > 1.05 * some.max()
    weak = type(ROBOT)(description.model_copy(update={"limits": limits.model_copy(update={"wheel_effort": 2.0})}))
    np.testing.assert_allclose(Balance.of(weak, np.zeros(3)).reach, 0.5 * more, rtol=1e-9)


def test_capture_point_is_the_offset_and_its_rate() -> None:
    rng = np.random.default_rng(3)
    for _ in range(3):
        x = np.concatenate([rng.uniform(-0.5, 0.5, 8), rng.uniform(-1.0, 1.0, 8)])
        later, previous = (np.concatenate([x[:8] + h * x[8:], x[8:]]) for h in (1e-6, -1e-6))
        rate = (load_offset(later) - load_offset(previous)) / 2e-6
        want = (load_offset(x) + rate / 4.7)[:2]
        found = evaluated(CapturePoint(ROBOT, 4.7), x, np.zeros(6), np.zeros(ROBOT.parameters.size))
        along = np.array([want[0], (want[0] + want[1]) / np.sqrt(2), want[1], (want[1] - want[0]) / np.sqrt(2)])
        np.testing.assert_allclose(found, along, atol=1e-8)


def test_capture_point_counts_from_the_lean_that_answers_a_force() -> None:
    x, force = 0.1 * np.ones(16), np.array([-16.0, 5.0])
    given, expected, none = ca.SX.sym("x", 16), ca.SX(ca.DM(force)), ca.SX(0, 1)
    symbols = Symbols(given, ca.SX(6, 1), ca.SX(ROBOT.parameters.size, 1), none, expected, given, none)
    term = CapturePoint(ROBOT, 4.7, directions=2, answer=2e-3)
    found = np.array(ca.Function("r", [given], [term(symbols)])(x)).ravel()
    own = evaluated(CapturePoint(ROBOT, 4.7, directions=2), x, np.zeros(6), np.zeros(ROBOT.parameters.size))
    np.testing.assert_allclose(found - own, 2e-3 * force, atol=1e-12)
    assert term.reference == 2 and CapturePoint(ROBOT, 4.7).reference == 0


def test_capture_point_counts_what_a_push_will_do() -> None:
    x, none = 0.1 * np.ones(16), np.zeros(ROBOT.parameters.size)
    w = ROBOT.parameters.vector({"push": [-0.03, 0.05], "disturbance": np.ones(8)})
    own, pushed = (evaluated(CapturePoint(ROBOT, 4.7, pushed=p), x, np.zeros(6), w) for p in (False, True))
    np.testing.assert_allclose(own, evaluated(CapturePoint(ROBOT, 4.7), x, np.zeros(6), none), atol=1e-12)
    along = [-0.03, 0.02 / np.sqrt(2), 0.05, 0.08 / np.sqrt(2)]  # x, the diagonal, y, the other diagonal
    np.testing.assert_allclose(pushed - own, along, atol=1e-12)


def test_a_payload_counts_in_lean_and_effort() -> None:
    """Truth: the same robot in MuJoCo with a body of 2 kg at its tool."""
    loaded, rng, mass = load_robot("rezero", payload=True), np.random.default_rng(5), 2.0
    w = loaded.parameters.vector({"payload": [mass]})
    x = np.concatenate([rng.uniform(-0.5, 0.5, 8), np.zeros(8)])
    model, data = in_mujoco(x)
    tool, joints = data.site("tool").xpos - data.body("ball").xipos, loaded.state.groups["arm"]
    all_but_ball = model.body("base").subtreemass - BALL_MASS
    want = (all_but_ball * load_offset(x) + mass * tool) / (all_but_ball + mass)
    along = evaluated(CapturePoint(loaded, 4.7, directions=2), x, np.zeros(6), w)
    np.testing.assert_allclose(along, want[:2], atol=1e-9)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("tool").id)
    dofs = [model.joint(n).dofadr[0] for n in joints]
    hold = data.qfrc_bias[dofs] + 9.81 * mass * jacobian[2, dofs]
    np.testing.assert_allclose(evaluated(JointEffort(loaded), x, np.array([0, 0, 0, *hold]), w), 0.0, atol=1e-8)


def test_effort_is_what_exceeds_the_holding_torque() -> None:
    rng = np.random.default_rng(4)
    for _ in range(3):
        x = np.concatenate([rng.uniform(-0.5, 0.5, 8), np.zeros(8)])
        model, data = in_mujoco(x)
        hold = data.qfrc_bias[[model.joint(n).dofadr[0] for n in ROBOT.state.groups["arm"]]]
        extra, wheels, disturbance = rng.normal(size=3), rng.normal(size=3), rng.normal(size=8)
        w = ROBOT.parameters.vector({"disturbance": disturbance})
        u = np.concatenate([wheels, hold + extra - disturbance[5:]])
        np.testing.assert_allclose(evaluated(JointEffort(ROBOT), x, u, w), extra, atol=1e-8)


def test_the_plan_keeps_the_lean_within_its_limit() -> None:
    """A far goal of the end effector: with the limit the plan's divergent lean stays inside; without it the same plan passes it.
    Few iterations of two problems that nothing else solves: compiling them takes longer."""
    lean = {}
    for share in (0.0, 0.3):
        cost = RezeroCost(end_effector=EndEffectorCost(limit=10.0), lean=share)
        settings = MpcSettings(horizon=1.3, intervals=13, first_interval=0.0, barrier_mu=1e-3)
        sqp = SQP(iterations=12, backend="interpreted", interior_point=InteriorPoint(barrier=1e-3))
        solver = Solver(rezero_problem(ROBOT, settings, cost), sqp)
        home, torque = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])
        place, quaternion = ROBOT.pose(home)
        for name, value in (("body", home), ("twist", np.zeros(6)), ("torque", torque)):
            solver.set_reference(name, Reference.constant(value))
        solver.set_reference("end_effector", Reference.poses([0.0], [place + [1.5, 0.0, 0.0]], quaternion))
        solver.warm_start(home, torque)
        found = solver.solve(home)
        balance = Balance.of(ROBOT, ROBOT.home[ROBOT.state["arm"]])
        x = ca.SX.sym("x", 16)
        offset = offset_of(ROBOT.base, x[:8])
        capture = ca.Function("capture", [x], [offset + ca.jacobian(offset, x[:8]) @ x[8:] / balance.pole])
        lean[share] = max(float(np.abs(np.array(capture(s))).max()) for s in found.x[1:]) / float(balance.reach.min())
    assert lean[0.3] < 0.31 < lean[0.0]


@pytest.mark.parametrize("maximum", [0.3, 2.0, np.inf])
def test_the_reach_is_that_of_a_linear_program(maximum: float) -> None:
    """Truth: SciPy's solver, for random effects of three to six wheels, some of which do not spin the ball."""
    rng = np.random.default_rng(8)
    for k in range(30):
        n = 3 + k % 4
        effect, limits, spin = rng.normal(size=n), rng.uniform(0.5, 4.0, n), rng.normal(size=n) * (rng.random(n) < 0.8)
        rows, bounds = (None, None) if maximum == np.inf else (np.vstack([spin, -spin]), [maximum, maximum])
        truth = -linprog(-effect, A_ub=rows, b_ub=bounds, bounds=[(-v, v) for v in limits]).fun
        assert _support(effect, limits, spin, maximum) == pytest.approx(truth, rel=1e-9)
