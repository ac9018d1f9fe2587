"""Gaps in time. Truth: bases that turn and go on arcs by formula (exact on SE(2)); wheels from rolling without slip."""

from __future__ import annotations

import numpy as np
import pytest
from wheels_on_paper import ring

from wbmpc import lie
from wbmpc.bases.ball.filter import BallFilter
from wbmpc.bases.ball.filter_state import BallGeometry, BallNoise
from wbmpc.bases.ball.joint_tracker import JointTracker
from wbmpc.bases.ball.sensor_faults import BallReadings, EncoderMonitor
from wbmpc.bases.swerve.fused_odometry import LEAP_STD, FusedOdometry
from wbmpc.bases.swerve.odometry_filter import OdometryNoise
from wbmpc.model.robot import load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics

FOUR = ring(4)
PERIOD = 0.0025
TWIST = np.array([0.2, 0.1, 0.8])


class Turning:
    """A base that goes on with a twist, with the gyro that an exact one would be."""

    def __init__(self, odometry: FusedOdometry) -> None:
        self.odometry, self.t, self.zero = odometry, 0.0, np.zeros(4)
        self.steer, self.rates = rolling_inverse_kinematics(FOUR, self.zero, self.zero, TWIST, self.zero)

    def go(self, seconds: float, read: bool = True, turning: float = 1.0) -> None:
        """Time passes; ``turning``: share of the twist in which the base goes on."""
        for _ in range(round(seconds / PERIOD)):
            self.t += PERIOD
            self.wheel = getattr(self, "wheel", self.zero) + turning * self.rates * PERIOD
            self.pose = lie.se2_step(getattr(self, "pose", np.zeros(3)), turning * TWIST * PERIOD)
            if read:
                self.read(turning)

    def read(self, turning: float) -> None:
        self.odometry.update(self.t, self.zero, self.steer, self.wheel, turning * TWIST[2])


def started(**noise: float) -> Turning:
    base = Turning(FusedOdometry(FOUR, noise=OdometryNoise(mean_age=0.0, **noise)))
    base.wheel, base.pose = base.zero, np.zeros(3)
    base.read(1.0)
    base.go(1.0)
    return base


@pytest.mark.parametrize("seconds", [0.2, 1.0, 10.0])
@pytest.mark.parametrize("turning", [1.0, 0.0, -0.5])
def test_a_gap_is_what_the_wheels_did_over_it(seconds: float, turning: float) -> None:
    """The base turns, goes on, stands or turns back unheard, and is heard again with the gyro of before."""
    base = started()
    previous = base.odometry.covariance.copy()
    base.go(seconds, read=False, turning=turning)
    base.read(1.0)  # it turns again at the end of the gap
    np.testing.assert_allclose(base.odometry.pose, base.pose, atol=1e-3)
    grown = np.sqrt(np.diag(base.odometry.covariance) - np.diag(previous))
    assert np.all(grown > 0.02 * seconds * np.array([0.9, 0.9, 0.5]))
    base.go(1.0)
    np.testing.assert_allclose(base.odometry.pose, base.pose, atol=2e-3)
    assert abs(base.odometry.gyro_bias) < 1e-3


def test_poses_from_within_a_gap_do_not_count() -> None:
    base = started()
    base.go(1.0, read=False)
    base.read(1.0)
    assert not base.odometry.correct(base.t - 0.5, base.pose + 1.0, 1e-4 * np.eye(3))
    assert base.odometry.correct(base.t, base.pose + [1e-3, 0.0, 0.0], 1e-4 * np.eye(3))


def test_a_clock_that_moves_changes_nothing() -> None:
    base, other = started(), started()
    other.odometry.move_clock(-123.0)
    other.t -= 123.0
    for one in (base, other):
        one.go(0.5)
        assert one.odometry.correct(one.t - 0.2, [0.3, 0.2, 1.0], np.eye(3))
    np.testing.assert_allclose(other.odometry.pose, base.odometry.pose, atol=1e-12)
    np.testing.assert_allclose(other.odometry.covariance, base.odometry.covariance, atol=1e-12)


def test_a_clock_that_jumps_back_loses_no_way_of_the_wheels() -> None:
    base = started()
    base.go(0.05, read=False)
    base.t -= 5.0
    base.odometry.bridge(base.t)
    base.read(1.0)
    np.testing.assert_allclose(base.odometry.pose, base.pose, atol=1e-3)
    assert base.odometry.covariance[0, 0] > 0.02**2


def test_encoders_that_count_from_zero_move_nobody() -> None:
    """A robot that was switched on again: its wheels say 0 after 300 rad."""
    base = started()
    base.wheel = base.wheel + 300.0
    base.odometry.restart_clock()
    base.read(0.0)
    previous = base.odometry.pose.copy()
    base.wheel = base.zero
    base.t += PERIOD
    base.read(0.0)
    np.testing.assert_allclose(base.odometry.pose, previous, atol=1e-9)
    assert np.all(np.diag(base.odometry.covariance)[:2] > 0.09**2)


def test_encoders_that_are_said_to_count_from_zero_move_nobody() -> None:
    """Whatever they say, and however long it took: the pose stays, and is as uncertain as it is said to be."""
    base = started()
    before = base.odometry.pose
    base.odometry.restart_encoders()
    base.wheel, base.t = base.zero, base.t + 5.0
    base.read(0.0)
    np.testing.assert_array_equal(base.odometry.pose, before)
    assert np.all(np.diag(base.odometry.covariance)[:2] > LEAP_STD**2) and not base.odometry.twist.any()
    base.pose = before
    base.go(0.5)
    np.testing.assert_allclose(base.odometry.pose, base.pose, atol=1e-3)


class Rolling:
    """An upright ball robot that rolls at a constant velocity [m/s] and turns [rad/s]; its sensors are nearly exact (one
    that repeats itself to the bit counts as broken)."""

    def __init__(self) -> None:
        base = load_robot("rezero").base
        geometry = BallGeometry(base.radius, base.wheel_torque_map().T, np.zeros(3))
        self.filter = BallFilter(geometry, [0.0, 0.0], np.eye(3), BallNoise(age=0.0))
        self.rng = np.random.default_rng(0)
        self.geometry, self.wheel, self.yaw, self.place = geometry, np.zeros(3), 0.0, np.zeros(2)
        self.filter.update(0.0, self.wheel, np.zeros(3), [0.0, 0.0, 9.81])

    def go(self, seconds: float, velocity: np.ndarray, rate: float, read: bool = True) -> None:
        """Rolling without slip: the ball turns by ẑ × way / radius, the base about the vertical."""
        for _ in range(round(seconds / PERIOD)):
            way, c, s = (
                velocity * PERIOD,
                np.cos(self.yaw + 0.5 * rate * PERIOD),
                np.sin(self.yaw + 0.5 * rate * PERIOD),
            )
            about = np.array([-way[1], way[0]]) / self.geometry.radius
            rolled = [c * about[0] + s * about[1], c * about[1] - s * about[0], -rate * PERIOD]
            self.wheel = self.wheel + self.geometry.turn @ rolled
            self.yaw, self.place = self.yaw + rate * PERIOD, self.place + way
            if read:
                gyro, accel = self.rng.normal(scale=1e-6, size=(2, 3)) + [[0.0, 0.0, rate], [0.0, 0.0, 9.81]]
                self.filter.update(PERIOD, self.wheel, gyro, accel)

    def wrong(self) -> np.ndarray:
        """Errors of x, y [m] and yaw [rad]."""
        yaw = lie.rotation_to_euler_zyx(self.filter.state.rotation)[0]
        return np.array([*(self.filter.state.position[:2] - self.place), yaw - self.yaw])


@pytest.mark.parametrize("seconds", [0.2, 2.0, 10.0])
def test_a_gap_of_the_ball_filter_is_what_the_wheels_did_over_it(seconds: float) -> None:
    """It stands, rolls off unheard without turning, or turning, and is heard again while it turns fast."""
    for rate in (0.0, 0.5 / seconds):
        robot, velocity = Rolling(), np.array([0.3, -0.1])
        robot.go(0.5, np.zeros(2), 0.0)
        robot.go(seconds, velocity, rate, read=False)
        robot.filter.update(seconds, robot.wheel, [0.0, 0.0, 2.0], [0.0, 0.0, 9.81])
        way = float(np.linalg.norm(velocity)) * seconds
        assert np.all(np.abs(robot.wrong()) < [0.02 * way + 1e-3, 0.02 * way + 1e-3, 1e-3]), robot.wrong()
        spread = np.sqrt(np.diag(robot.filter.covariance)[:2])
        np.testing.assert_allclose(spread, 0.2 * way + 0.05 * seconds, rtol=0.05)
        robot.go(1.0, velocity, 0.5)
        assert np.all(np.abs(robot.wrong()) < [0.02 * way + 5e-3, 0.02 * way + 5e-3, 1e-2]), robot.wrong()
        assert np.abs(robot.filter.state.velocity[:2] - velocity).max() < 0.01


def test_joints_after_a_gap_are_where_they_are_read() -> None:
    """0.5 rad farther after 2 s, at rest: nothing jumps, and the rate of before is gone."""
    tracker = JointTracker(np.zeros(2), 1e-4, 1e-3, 7e-4, speed=np.full(2, 2.0))
    for k in range(1, 200):
        tracker.update(PERIOD, np.array([0.5, -0.5]) * k * PERIOD)
    after = tracker.angle + [0.5, -0.3]
    tracker.update(2.0, after)
    np.testing.assert_array_equal(tracker.angle, after)
    np.testing.assert_array_equal(tracker.rate, np.zeros(2))
    for _ in range(100):
        tracker.update(PERIOD, after)
    assert not tracker.jumped.any() and np.abs(tracker.rate).max() < 0.01


def test_a_gap_alone_does_not_make_an_encoder_stand_still() -> None:
    """A joint of 2 rad/s whose reading is the same after 0.09 s: simulated time went on without physics, or something held it. Only
    three such readings in a row, 0.02 s by the rule of the class, are an encoder that stands."""
    speed, none = np.full(1, 2.0), np.zeros(1)
    monitor = EncoderMonitor(3, ["elbow"])
    read = lambda t, h, angle: monitor.update(BallReadings(t, h, np.array([angle]), speed, none, (), none))
    for k in range(20):
        assert not read(PERIOD * k, PERIOD, 2.0 * PERIOD * k)
    at, t = 2.0 * PERIOD * 19, PERIOD * 19
    assert not read(t + 0.09, 0.09, at) and not read(t + 0.18, 0.09, at) and not monitor.lost
    assert [str(f) for f in read(t + 0.27, 0.09, at)] and monitor.lost == "the encoder of elbow stands still"
    monitor = EncoderMonitor(3, ["elbow"])
    assert not read(0.0, PERIOD, 0.0)
    stands = [read(PERIOD * k, PERIOD, 0.0) for k in range(1, 9)]
    assert [bool(f) for f in stands] == [False] * 7 + [True]  # 0.02 s of messages that all came
