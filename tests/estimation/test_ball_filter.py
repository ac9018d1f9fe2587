"""The ball robot's filter. Truth: MuJoCo's states, motions integrated exactly from formulas, chi-square bounds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from ball_states import error_between
from scipy.linalg import solve_continuous_are
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from effort import draws, some
from toys import robot
from wbmpc import lie
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.filter import BallFilter
from wbmpc.bases.ball.filter_state import BallGeometry, BallNoise, BallState
from wbmpc.bases.ball.joint_tracker import JointTracker
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.sensors import SensorFault
from wbmpc.bases.base import InertialDescription
from wbmpc.errors import InputError, NotFinite
from wbmpc.simulation.any_perturbation import AnyPerturbation

H, SEEDS = 0.0025, draws(8, 50)
ROBOT = robot("rezero")
HOME, TORQUE = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])
MOUNT = np.array([0.0, 0.0, 0.3])
GEOMETRY = BallGeometry(0.125, ROBOT.base.wheel_torque_map().T, MOUNT)


# ---------------------------------------------------------------------- motions from formulas
def motion(seconds: float, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    """Ball center (n, 3), rotations, and velocity (n, 3) of the inertial unit of a smooth random motion: the ball's
    velocity is a sum of sines, integrated exactly, and so are the base's Euler angles."""
    t = H * np.arange(round(seconds / H) + 1)
    a, w, c = rng.uniform(0.02, 0.1, (5, 1)), rng.uniform(1.0, 5.0, (5, 1)), rng.uniform(0.0, 6.0, (5, 1))
    wave, slope = a * np.sin(w * t + c), a * w * np.cos(w * t + c)
    ball = np.stack([wave[0], wave[1], 0.0 * t], axis=1)
    turn = Rotation.from_euler("ZYX", np.stack([5.0 * wave[2], wave[3], wave[4]], axis=1))
    # d/dt (R mount) by central differences of the exact rotation
    ahead, behind = (
        Rotation.from_euler("ZYX", np.stack([5.0 * v[2], v[3], v[4]], axis=1))
        for v in (a * np.sin(w * (t + s) + c) for s in (1e-5, -1e-5))
    )
    lever = (ahead.apply(MOUNT) - behind.apply(MOUNT)) / 2e-5
    velocity = np.stack([slope[0], slope[1], 0.0 * t], axis=1) + lever
    return ball, turn, velocity


def readings(ball, turn, velocity, scale, rng, s: BallNoise):  # type: ignore[no-untyped-def]
    """What sensors with the filter's own idea of noise read: (wheel, gyro, accel) of each message, true biases and angles."""
    n = len(ball) - 1
    walk = lambda first, density: (
        rng.normal(0, first, 3) + np.cumsum(density * np.sqrt(H) * rng.normal(size=(n, 3)), axis=0)
    )
    gyro_bias, accel_bias = walk(s.gyro_bias, s.gyro_walk), walk(s.accel_bias, s.accel_walk)
    step = (turn[:-1].inv() * turn[1:]).as_rotvec()
    middle = turn[:-1] * Rotation.from_rotvec(0.5 * step)
    gyro = step / H + gyro_bias + s.gyro / np.sqrt(H) * rng.normal(size=(n, 3))
    force = middle.inv().apply(np.diff(velocity, axis=0) / H + [0, 0, 9.81])
    accel = force + accel_bias + s.accel / np.sqrt(H) * rng.normal(size=(n, 3))
    shift = np.diff(ball, axis=0)
    slip = np.sqrt(H) * rng.normal(size=(n, 3)) * [s.creep, s.creep, s.spin]
    spin = middle.inv().apply(np.stack([-shift[:, 1], shift[:, 0], 0 * shift[:, 0]], axis=1) / 0.125 + slip) - step
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(np.exp(-scale) * spin @ GEOMETRY.turn.T, axis=0)])
    age = rng.uniform(s.age - np.sqrt(3) * s.jitter, s.age + np.sqrt(3) * s.jitter, n)[:, None] if s.jitter else s.age
    read = angle[1:] - age / H * np.diff(angle, axis=0) + s.encoder * rng.normal(size=(n, 3))
    return read, gyro, accel, gyro_bias, accel_bias, angle


def filtered(seed: int, seconds: float, noise: BallNoise, exact: bool = False) -> tuple[np.ndarray, BallFilter]:
    """Error (19) of the filter after such a motion; its start is drawn from its prior."""
    rng, s = np.random.default_rng(seed), noise
    ball, turn, velocity = motion(seconds, rng)
    given = BallNoise(*([0.0] * 9), gyro_bias=0.0, accel_bias=0.0, scale=0.0) if exact else s
    given = replace(given, age=s.age)
    scale = rng.normal(0, given.scale)
    wheel, gyro, accel, gyro_bias, accel_bias, angle = readings(ball, turn, velocity, scale, rng, given)
    start = turn[0].as_matrix()
    if not exact:
        start = Rotation.from_rotvec(rng.normal(size=3) * [s.tilt, s.tilt, s.start]).as_matrix() @ start
    f = BallFilter(GEOMETRY, ball[0, :2] + (0.0 if exact else s.start * rng.normal(size=2)), start, s)
    start = velocity[0] + (0.0 if exact else s.speed * rng.normal(size=3))
    f.state, f._first = replace(f.state, velocity=start, wheel=angle[0]), False
    covariance = f.covariance
    covariance[16:, 16:] = 1e-16 * np.eye(3)
    f.covariance = covariance
    for w, g, a in zip(wheel, gyro, accel, strict=True):
        f.update(H, w, g, a)
    true = BallState(ball[-1], velocity[-1], turn[-1].as_matrix(), gyro_bias[-1], accel_bias[-1], angle[-1], scale)
    return error_between(f.state, true), f


def test_exact_sensors_give_the_exact_state() -> None:
    error, f = filtered(0, 2.0, BallNoise(), exact=True)
    assert np.abs(error[:2]).max() < 2e-5
    assert np.abs(error[3:9]).max() < 2e-5
    assert f.faults == ()


KEPT = np.r_[0:2, 3:15]  # without the height, which the floor says and no noise disturbs


def normalized(error: np.ndarray, covariance: np.ndarray, parts: np.ndarray) -> float:
    return float(error[parts] @ np.linalg.solve(covariance[np.ix_(parts, parts)], error[parts]))


def test_errors_are_as_large_as_the_covariance_says() -> None:
    """Normalized estimation error squared over the seeds against both 99 % bounds of chi-square, whole and by part."""
    noise = replace(BallNoise(), scale_time=1e6)
    runs = [filtered(seed, 1.5, noise) for seed in range(SEEDS)]
    parts = {"all": KEPT, "position": KEPT[:2], "velocity": np.r_[3:6], "attitude": np.r_[6:9], "biases": np.r_[9:15]}
    for name, part in parts.items():
        total, size = sum(normalized(e, f.covariance, part) for e, f in runs), SEEDS * len(part)
        low, high = chi2.ppf([0.005, 0.995], size)
        assert low < total < high, f"{name}: {total:.0f} of {size}, allowed {low:.0f} to {high:.0f}"


# ---------------------------------------------------------------------- against MuJoCo
@cache
def regulator() -> np.ndarray:
    """LQR gain (6, 16) at home: something that balances, with the true state."""
    x, u = ca.SX.sym("x", 16), ca.SX.sym("u", 6)
    f = ROBOT.dynamics()(x, u, ca.SX(11, 1), ca.SX(0, 1))
    jacobian = ca.Function("j", [x, u], [ca.jacobian(f, x), ca.jacobian(f, u)])
    a, b = (np.array(m) for m in jacobian(HOME, TORQUE))
    q, r = np.diag([20.0, 20, 20, 1, 1, 50, 50, 50, 5, 5, 1, 1, 1, 1, 1, 1]), np.diag([1.0] * 3 + [0.1] * 3)
    return np.linalg.solve(r, b.T @ solve_continuous_are(a, b, q, r))


class Balancing:
    """A simulated robot that balances, moves to and fro, and is watched by an estimator."""

    def __init__(self, seed: int, *faults: SensorFault, **changes: float) -> None:
        self.plant = BallPlant(
            ROBOT.description,
            HOME,
            TORQUE,
            AnyPerturbation(state_age=0.0, actuator_time_constant=0.01, **changes),
            seed,
        )
        self.plant.sensors.faults = faults
        self.estimator = BallEstimator(ROBOT, HOME)
        self.seen: list[tuple[float, str]] = []

    def run(self, seconds: float, amplitude: float = 0.1) -> Balancing:
        gain, limit = regulator(), ROBOT.limits.input_upper[:6]
        for _ in range(round(seconds / H)):
            m = self.plant.measure()
            self.estimator.update(m.time, m.wheel, m.arm, m.gyro, m.accel)
            self.seen += [(m.time, name) for name in self.estimator.filter.faults]
            target = HOME.copy()
            target[0], target[2] = amplitude * np.sin(2.0 * m.time), amplitude * np.sin(1.5 * m.time)
            torque = TORQUE - gain @ (self.plant.state() - target)
            self.plant.step(BallCommand(np.clip(torque, -limit, limit)), 5)
        m = self.plant.measure()
        self.estimator.update(m.time, m.wheel, m.arm, m.gyro, m.accel)
        assert not self.plant.fell
        return self

    def error(self) -> np.ndarray:
        """Of the filter (19)."""
        d, sensors = self.plant.data, self.plant.sensors
        rotation = lie.quaternion_to_rotation(d.qpos[3:7])
        velocity = d.qvel[:3] + rotation @ np.cross(d.qvel[3:6], MOUNT)
        scale = float(np.log(self.plant.draw.radius[0]))
        true = BallState(
            d.qpos[:3] - [0, 0, 0.125], velocity, rotation, sensors.bias["gyro"], sensors.bias["accel"],
            self.plant.sensors.wheel, scale,
        )  # fmt: skip
        return error_between(self.estimator.filter.state, true)


def test_errors_in_physics_stay_within_the_covariance() -> None:
    """Perturbed robots in MuJoCo, whose biases are drawn evenly and whose ball creeps: no part may have larger errors
    than the covariance says (99 %), nor may it claim errors that are five times too large."""
    runs = [Balancing(seed).run(1.25) for seed in range(SEEDS)]
    parts = {"position": np.r_[0:2], "velocity": np.r_[3:6], "tilt": np.r_[6:8], "yaw": np.r_[8:9]}
    parts |= {"gyro bias": np.r_[9:12], "accelerometer bias": np.r_[12:15]}
    for name, part in parts.items():
        total = sum(normalized(r.error(), r.estimator.filter.covariance, part) for r in runs)
        size = SEEDS * len(part)
        assert size / 25.0 < total < chi2.ppf(0.99, size), f"{name}: {total:.0f} of {size}"


def twisted(seed: int, reported: float) -> Balancing:
    """A robot that is twisted by 1.5 N m about the vertical from 1 to 3.5 s; the estimator gets ``reported`` times its torque."""
    run, gain, limit = Balancing(seed), regulator(), ROBOT.limits.input_upper[:6]
    base, torque = run.plant.model.body(run.plant.base.body).id, TORQUE
    for _ in range(round(3.5 / H)):
        m, turning = run.plant.measure(), ROBOT.base.wheel_torque_map()[2] @ torque[:3]
        run.estimator.update(m.time, m.wheel, m.arm, m.gyro, m.accel, reported * turning)
        run.plant.data.xfrc_applied[base, 5] = 1.5 if m.time > 1.0 else 0.0
        torque = np.clip(TORQUE - gain @ (run.plant.state() - HOME), -limit, limit)
        run.plant.step(BallCommand(torque), 5)
    m = run.plant.measure()
    run.estimator.update(m.time, m.wheel, m.arm, m.gyro, m.accel, reported * turning)
    return run


def test_a_ball_that_creeps_under_a_lasting_twist_is_no_bias_of_the_gyro() -> None:
    """As before a door: the end effector's force twists the robot for seconds. Yaw and the gyro's bias about the vertical stay within their
    covariance (99 %); without the torque they do not."""
    part = np.array([8, 11])
    wrong = lambda run: normalized(run.error(), run.estimator.filter.covariance, part)
    assert wrong(twisted(0, 1.0)) < chi2.ppf(0.99, 2)
    assert wrong(twisted(0, 0.0)) > 3.0 * chi2.ppf(0.99, 2)


def test_state_of_the_minimal_model() -> None:
    run = Balancing(3).run(3.0)
    error = np.abs(run.estimator.state - run.plant.state())
    assert error[0:2].max() < 1e-3 and error[2] < 0.02 and error[3:5].max() < 3e-3
    assert error[5:8].max() < 2.5e-3  # zero errors of the arm's encoders
    assert error[8:10].max() < 0.01 and error[10:13].max() < 0.03 and error[13:16].max() < 0.1


@pytest.mark.parametrize("speed", some([1.0, -4.0], [0]))
def test_a_slipping_wheel_is_found_and_does_no_harm(speed: float) -> None:
    fault = SensorFault("slip", 1, 1.0, 1.3, speed)
    run = Balancing(0, fault).run(2.0)
    times = [t for t, name in run.seen if name == "wheel_1 slips"]
    assert times and 1.0 < times[0] < 1.02 and times[-1] < 1.32
    assert len(times) > 0.5 * 0.3 / H
    assert np.hypot(*run.error()[:2]) < 2e-3
    trusting = Balancing(0, fault)
    trusting.estimator.filter._gate = np.inf
    assert np.hypot(*trusting.run(2.0).error()[:2]) > 4.0 * np.hypot(*run.error()[:2])


def test_a_stalled_encoder_is_found_and_does_no_harm() -> None:
    run = Balancing(0, SensorFault("stalled", 2, 1.0, 1.5)).run(1.8)
    times = [t for t, name in run.seen if name == "wheel_2 stalled"]
    assert times and 1.0 < times[0] < 1.1 and times[-1] < 1.51
    assert len(times) > 0.8 * 0.5 / H
    assert np.hypot(*run.error()[:2]) < 3e-3
    assert not [n for _, n in Balancing(0).run(1.8).seen if "stalled" in n]


def test_a_ball_that_spins_on_the_floor_is_found() -> None:
    """On a floor that becomes slippery yawing spins the ball under the robot; the gyro keeps the heading, which a filter that believes
    all rows loses."""

    def heading(gate: float | None) -> tuple[float, list[str]]:
        run = Balancing(1)
        run.estimator.filter._gate = gate or run.estimator.filter._gate
        run.run(2.0, amplitude=0.4)
        run.plant.model.geom_friction[:, 1] *= 0.05
        return abs(float(run.run(1.0, amplitude=0.4).error()[8])), [name for _, name in run.seen]

    wrong, names = heading(None)
    assert names.count("ball spins") > 100
    assert wrong < 5e-3 and heading(np.inf)[0] > 4.0 * wrong


@pytest.mark.parametrize("seed", some([0, 1], [0]))
def test_a_ball_that_friction_holds_keeps_the_heading(seed: int) -> None:
    """A robot that yaws for 6 s. The gyro's bias (up to 10 mrad/s) would turn the heading by 60 mrad; the wheels show it within a second,
    and what they say of the heading is right to their radii."""
    assert abs(Balancing(seed).run(6.0, amplitude=0.2).error()[8]) < 1.3e-3


# ---------------------------------------------------------------------- lean and bias
def test_balance_distinguishes_bias_from_lean() -> None:
    """Near upright only g · lean + bias is seen. A known lean leaves a bias error of g · spread, and no more."""
    known = BallFilter(GEOMETRY, np.zeros(2), np.eye(3), replace(BallNoise(), accel_bias=0.3, tilt=0.1))
    bias = np.array([0.2, -0.15, 0.0])
    for k in range(400):  # no two messages are the same: a unit that repeats itself has stopped
        alive = 1e-9 * (k % 2)
        known.update(H, np.zeros(3), np.full(3, alive), [0.0, 0.0, 9.81 + alive] + bias)
    lean = np.array([0.0, 0.0, 1.0]) - known.state.rotation[2]
    assert np.abs(known.state.accel_bias[:2] - bias[:2]).max() > 0.05 and np.abs(lean).max() > 5e-3
    assert np.sqrt(np.diag(known.covariance)[12:14]).min() > 0.2
    known.correct_lean([0.0, 0.0, 1.0], 1e-3)
    assert known.state.accel_bias[:2] == pytest.approx(bias[:2], abs=0.02)
    assert np.sqrt(np.diag(known.covariance)[6:8]).max() < 1.1e-3
    assert np.sqrt(np.diag(known.covariance)[12:14]) == pytest.approx(9.81e-3, rel=0.3)


def test_standing_robot_uses_its_balance_once() -> None:
    """With a model that is exact and an accelerometer that was never calibrated the lean becomes right."""
    exact = {"mass": 0.0, "inertia": 0.0, "com_offset": 0.0, "joint_offset": 0.0}
    wrong, right = (Balancing(4, accel_bias=0.4, **exact) for _ in range(2))
    noise = replace(BallNoise(), accel_bias=0.4 / np.sqrt(3.0), tilt=0.1)
    wrong.estimator = BallEstimator(ROBOT, HOME, noise, balance=1.0)
    right.estimator = BallEstimator(ROBOT, HOME, noise, balance=1e-3)
    tilts = [np.abs(r.run(3.5, amplitude=0.0).error()[6:8]).max() for r in (wrong, right)]
    assert tilts[1] < 2e-3 < 3.0 * tilts[1] < tilts[0]


# ---------------------------------------------------------------------- poses of others
def test_a_pose_from_elsewhere_is_weighed_by_its_covariance() -> None:
    """Kalman by hand: prior and measurement of the same spread give their mean with half of the variance, here of a robot
    that stands and knows its place within 0.1 m and 0.1 rad; a pose without a covariance is exact."""
    estimator = BallEstimator(ROBOT, HOME, replace(BallNoise(), start=0.1))
    still = (np.zeros(3), HOME[ROBOT.state["arm"]], np.zeros(3), np.array([0.0, 0.0, 9.81]))
    for k in range(3):
        previous = estimator.update(k * H, *still)
    prior = estimator.filter.covariance
    state = estimator.correct(2 * H, previous[:3] + [0.2, -0.1, 0.06], 0.1**2 * np.eye(3))
    np.testing.assert_allclose(state[:3] - previous[:3], [0.1, -0.05, 0.03], rtol=2e-2)
    np.testing.assert_allclose(state[3:8], previous[3:8], atol=2e-3)  # its lean is not a question of its place
    now = estimator.filter.covariance
    np.testing.assert_allclose(np.diag(now)[:2], 0.5 * np.diag(prior)[:2], rtol=2e-2)
    state = estimator.correct(2 * H, [1.0, 2.0, 0.5 + 2.0 * np.pi], np.zeros((3, 3)))
    np.testing.assert_allclose(state[:3], [1.0, 2.0, 0.5], atol=1e-4)  # half a radian is much for one linear step
    assert np.linalg.eigvalsh(estimator.filter.covariance).min() > -1e-12
    with pytest.raises(InputError, match="'pose' needs 3 finite numbers"):
        estimator.correct(0.0, [0.0, np.nan, 0.0], np.eye(3))


def test_a_late_pose_counts_where_the_robot_was_then() -> None:
    """The start was wrong by a known offset; exact poses of 0.1 s ago correct it, whatever the robot did since."""
    run, offset = Balancing(3), np.array([0.3, -0.2, 0.4])
    wrong = HOME.copy()
    wrong[:3] += offset
    run.estimator = BallEstimator(ROBOT, wrong, replace(BallNoise(), start=1.0))
    run.run(1.0)
    past, previous = run.plant.state()[:3].copy(), run.plant.time
    run.run(0.1)
    run.estimator.correct(previous, past, np.zeros((3, 3)))
    truth = run.plant.state()
    np.testing.assert_allclose(run.estimator.state[:2], truth[:2], atol=0.02)
    assert abs(run.estimator.state[2] - truth[2]) < 0.01


# ---------------------------------------------------------------------- arm, input
def test_joint_tracker_follows_a_sine() -> None:
    rng, t = np.random.default_rng(0), H * np.arange(2000)
    count = 2.0 * np.pi / 2**17
    tracker = JointTracker([0.0], count / np.sqrt(12.0), 1e-3, 7e-4)
    errors = []
    for now in t:
        seen = 0.5 * np.sin(6.0 * (now - rng.uniform(0.0, 2e-3)))
        tracker.update(H, np.array([np.round(seen / count) * count]))
        errors.append([tracker.angle[0] - 0.5 * np.sin(6.0 * now), tracker.rate[0] - 3.0 * np.cos(6.0 * now)])
    rms = np.sqrt(np.mean(np.array(errors)[200:] ** 2, axis=0))
    assert rms[0] < 2e-3 and rms[1] < 0.15


def test_bad_readings_are_rejected() -> None:
    f = BallFilter(GEOMETRY, np.zeros(2), np.eye(3), BallNoise())
    with pytest.raises(InputError, match="'wheel' needs 3"):
        f.update(H, np.zeros(2), np.zeros(3), np.zeros(3))
    with pytest.raises(NotFinite, match="'gyro'"):
        f.update(H, np.zeros(3), [0.0, np.nan, 0.0], np.zeros(3))
    with pytest.raises(NotFinite, match="'wheel'"):
        f.update(H, [0.0, np.inf, 0.0], np.zeros(3), np.zeros(3))
    wide = BallFilter(
        GEOMETRY, np.zeros(2), np.eye(3), BallNoise(), InertialDescription().model_copy(update={"rate": 1e12})
    )
    with pytest.raises(NotFinite, match="no state follows"):
        for _ in range(3):
            wide.update(H, np.zeros(3), [1e9, 0.0, 0.0], np.zeros(3))
    with pytest.raises(InputError, match="positive spread"):
        f.correct_lean([0, 0, 1], 0.0)
    with pytest.raises(InputError, match="ball base"):
        BallEstimator(robot("swerve-ur10"), HOME)


@pytest.mark.parametrize(("gyro", "accel"), [(0.0, 0.0), (0.3, 0.0), (0.0, 40.0), (3.0, 0.0), (0.0, 100.0)])
def test_a_motion_that_changes_is_known_less_well(gyro: float, accel: float) -> None:
    """Noise of turning and push by the formulas of docs/explanation/ball-robot.md: c h Δ beside σ √h, of two messages that differ by Δ; not of
    one that jumps (1 rad/s, 90 m/s²): such a one is judged, not believed a little less."""
    s = BallNoise()
    f = BallFilter(GEOMETRY, np.zeros(2), np.eye(3), s)
    rest = np.array([0.0, 0.0, 9.81])
    f.update(H, np.zeros(3), np.zeros(3), rest)
    f.update(H, np.zeros(3), np.array([gyro, 0.0, 0.0]), rest + [0.0, accel, 0.0])
    known = gyro < 1.0 and accel < 90.0
    turning = s.gyro**2 * H + known * (0.05 * H * gyro) ** 2
    push = s.accel**2 * H + known * (0.05 * H * accel) ** 2
    noise = f.arrays["q"].reshape(23, 23)
    assert np.diag(noise)[:6] == pytest.approx([turning] * 3 + [push] * 3)
