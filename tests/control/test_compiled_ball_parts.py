"""Compiled parts of the ball robot's loop against the same source as ordinary Python, and against NumPy's algebra."""

from __future__ import annotations

from copy import deepcopy

import mujoco
import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from toys import made
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.sensor_faults import BallReadings, EncoderMonitor
from wbmpc.bases.ball.sensors import BallSensors, WheelGeometry
from wbmpc.bases.ball.torque_limits import TorqueLimits
from wbmpc.model.robot import load_robot

ROBOT = load_robot("rezero")
HOME = ROBOT.home


@pytest.mark.parametrize("scale", [0.5, 3.0, 20.0])
def test_torques_of_both_back_ends(scale: float) -> None:
    """They say the same, within the limits; truth of how much of a lean is kept: a linear program over lean and spin, about the vertical of
    SciPy's rotation of the base."""
    rng, one, other = np.random.default_rng(1), TorqueLimits(ROBOT, 6), made("interpreted", TorqueLimits, ROBOT, 6)
    limit, most, x = one.limit[:3], ROBOT.description.limits.spin_effort, HOME.copy()
    for _ in range(30):
        torque, (pitch, roll) = scale * rng.normal(size=6), rng.uniform(-0.3, 0.3, 2)
        x[3:5] = pitch, roll
        found = one.limited(torque, x)
        np.testing.assert_allclose(found, other.limited(torque, x), rtol=1e-12, atol=1e-13)
        effect = Rotation.from_euler("ZYX", [x[2], pitch, roll]).as_matrix() @ ROBOT.base.wheel_torque_map()
        assert abs(effect[2] @ found[:3]) <= most + 1e-9
        lean, turn = effect[:2] @ torque[:3], np.linalg.solve(effect, [0.0, 0.0, 1.0])
        rows = np.column_stack([np.linalg.solve(effect, [*lean, 0.0]), turn])  # share of the lean, spin
        best = linprog([-1.0, 0.0], np.vstack([rows, -rows]), np.tile(limit, 2), bounds=[(0, 1), (-most, most)])
        np.testing.assert_allclose(effect[:2] @ found[:3], best.x[0] * lean, atol=1e-8)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_what_the_sensors_see(backend: str) -> None:
    """Truth: the same integrals by SciPy's rotations, over random motions; both back ends."""
    rng, h, p = np.random.default_rng(2), 5e-4, BallPerturbation.none()
    wheels, mount = WheelGeometry(rng.normal(size=(4, 3))), rng.normal(size=3)
    draw = p.draw(np.random.default_rng(0), [], 4, 3)
    sensors = made(backend, BallSensors, p, draw, wheels, mount, h, 0, rng, (14, 12), (10, 9))
    matrix = lambda q: Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix()
    turn, push, wheel, before = np.zeros(3), np.zeros(3), np.zeros(4), None
    q, v = np.zeros(14), np.zeros(12)
    sensors.attach(q, v)
    for k in range(5):
        q[:], v[:] = rng.normal(size=14), rng.normal(size=12)
        q[3:7] /= np.linalg.norm(q[3:7])
        q[10:14] /= np.linalg.norm(q[10:14])
        seen, rotation = sensors.seen(sensors.measure()), matrix(q[3:7])
        velocity = v[:3] + rotation @ np.cross(v[3:6], mount)
        if before is not None:
            turn += h * v[3:6]
            push += 0.5 * (rotation + before[0]).T @ (velocity - before[1] + [0.0, 0.0, 9.81 * h])
            wheel += h * wheels.turn @ matrix(q[10:14]) @ v[9:12]
        before = rotation, velocity
        for ours, truth in zip(seen, (q, v, turn, push, k, wheel), strict=True):
            np.testing.assert_allclose(ours, truth, atol=1e-13)


def test_monitors_of_both_back_ends() -> None:
    """Joints that stand, that move and that surprise; they find the same, at the same times."""
    rng = np.random.default_rng(3)
    both = [made(b, EncoderMonitor, 3, ["a", "b", "c"]) for b in ("compiled", "interpreted")]
    arm, said = np.zeros(3), []
    for k in range(200):
        arm = arm + [0.0, 1e-3, 2e-3 * (k % 50 > 25)]
        more = (rng.normal(size=3) + [0.0, 0.5, 0.2], 10.0 * rng.normal(size=3), ("wheel_1 stalled",) * (k > 150))
        found = [m.update(BallReadings(0.0025 * k, 0.0025, arm, *more, rng_surprise(k))) for m in both]
        assert found[0] == found[1]
        said += [(f.part, f.kind) for f in found[0]]
    assert ("wheel_1", "stalled") in said and len(said) > 1


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize(
    ("surprised", "moves", "stalled"), [(False, 1e-3, True), (True, 1e-3, False), (True, 0.0, True)]
)
def test_what_a_surprise_makes_of_the_model_is_not_believed(
    backend: str, surprised: bool, moves: float, stalled: bool
) -> None:
    """A joint stands while the model has it accelerate for 15 ms to 7 rad/s, just after a reading that moved by 1 mrad."""
    monitor, found = made(backend, EncoderMonitor, 3, ["elbow"]), []
    for k in range(30):
        acceleration = np.array([500.0 if 4 <= k < 10 else 0.0])
        arm, surprise = np.array([moves * (k >= 3)]), np.array([float(surprised and k == 3)])
        found += monitor.update(BallReadings(0.0025 * k, 0.0025, arm, np.zeros(1), acceleration, (), surprise))
    assert [str(fault.kind) for fault in found] == ["stalled"] * stalled


def rng_surprise(k: int) -> np.ndarray:
    return np.array([False, k % 40 == 0, False])


def test_the_estimated_state_is_that_of_the_filter() -> None:
    """Truth: MuJoCo's pose and velocity for a filter that is set to them; the yaw goes on over a whole turn. Copies are on their own."""
    plant = BallPlant(ROBOT.description, HOME, None, BallPerturbation.none())
    estimator, d = BallEstimator(ROBOT, HOME), plant.data
    rng, mount, expected = np.random.default_rng(4), plant.sensors.mount, 0.0
    for k in range(9):
        expected = 0.9 * k
        turned = Rotation.from_euler("ZYX", [expected, 0.1, -0.2])
        d.qpos[3:7], d.qvel[:6] = turned.as_quat()[[3, 0, 1, 2]], rng.normal(size=6)
        mujoco.mj_kinematics(plant.model, d)
        state = estimator.filter.state
        state.rotation, state.position = turned.as_matrix(), d.qpos[:3]
        state.velocity = d.qvel[:3] + turned.as_matrix() @ np.cross(d.qvel[3:6], mount)
        estimator.filter.state = state
        estimator.filter.arrays["rate"][:] = d.qvel[3:6]
        copy = deepcopy(estimator)
        truth = plant.state()
        truth[2] = expected
        np.testing.assert_allclose(estimator.state, truth, atol=1e-9)
        estimator.filter.arrays["x"][0] += 1.0
        assert copy.state[0] == truth[0]
