"""Wheels that do not go as the accelerometer says. Truth: the base's motion, from which wheels, gyro and accelerations are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from effort import draws
from toys import made
from wbmpc.bases.swerve.drives import ArmDrives, DriveModel
from wbmpc.bases.swerve.estimator import EstimatorSettings, SwerveEstimator
from wbmpc.bases.swerve.inertial_velocity import ACCELERATION_ZEROS, ANNOUNCED, FOLLOW, NEAR, InertialVelocity
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.slipping_wheels import OVER
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.kernel.step import Backend
from wbmpc.model.robot import load_robot

ROBOT, H, BIAS = load_robot("swerve-fixed-ur10"), 0.0025, np.array([0.01, -0.01])
GEOMETRY = ROBOT.base.geometry


def drive(slips: np.ndarray, inertial_unit: bool, calibration: WheelCalibration | None = None) -> float:
    """By how much [m] the odometry is off after 2 s of rest and 1 s ahead at up to 0.3 m/s, during the last 0.3 s of which wheels turn too
    fast by ``slips`` (4) [m/s]."""
    estimator = SwerveEstimator(
        ROBOT, np.zeros(3), EstimatorSettings(calibration), DriveModel(ROBOT, H, 0.0, True), ArmDrives(6, H, 0.0)
    )
    steer = -GEOMETRY.wheel_heading - GEOMETRY.leg_angles(np.zeros(4))
    wheel, way, v = np.zeros(4), 0.0, 0.0
    for k in range(1200):
        t = k * H
        a = 1.0 if 2.0 <= t < 2.3 else 0.0
        gravity = 9.81 if inertial_unit else 0.0
        accel = np.array([a + BIAS[0], BIAS[1], gravity]) if inertial_unit else np.zeros(3)
        estimator.process(SwerveMeasurement(t, np.zeros(0), steer, wheel.copy(), np.zeros(6), np.zeros(3), accel))
        wheel += H * (v + 0.5 * H * a + slips * (t >= 2.7)) / GEOMETRY.wheel_radius
        way, v = way + H * (v + 0.5 * H * a), v + H * a
    return float(np.hypot(estimator.odometry.pose[0] - way, estimator.odometry.pose[1]))


@pytest.mark.parametrize("unknown", [2, None])
def test_a_wheel_of_which_nothing_is_known_hardly_counts(unknown: int | None) -> None:
    """One of four wheels says 8 mm/s too much for 0.3 s, too little to be found. Truth: what the other three say, or the mean of all."""
    calibration, std = WheelCalibration.unknown(GEOMETRY, 1e-3, 1e-3, 0.0), np.full(8, 1e-3)
    if unknown is not None:
        std[[unknown, 4 + unknown]] = 0.03
    known = replace(calibration, covariance=np.diag(std**2))
    off = abs(drive(np.array([0.0, 0.0, 0.008, 0.0]), True, known) - drive(np.zeros(4), True, known))
    assert off < 3e-5 if unknown == 2 else off == pytest.approx(0.008 * 0.3 / 4.0, rel=0.1)


def test_one_wheel_that_grips_is_right_against_two_that_slip_alike() -> None:
    """Three of four wheels slip, two of them alike: the largest group that agrees is wrong, by 30 mm."""
    slips = np.array([0.1, 0.1, 0.25, 0.0])
    assert drive(slips, True) < 0.006
    assert drive(slips, False) > 0.02


def test_while_all_wheels_slip_the_way_is_the_accelerometers() -> None:
    """Without it the odometry is off by the mean slip, 50 mm."""
    slips = np.array([0.3, 0.15, -0.2, 0.4])
    assert drive(slips, True) < 0.022
    assert drive(slips, False) > 0.03


@pytest.mark.parametrize("inertial_unit", [True, False])
def test_sound_wheels_count_in_full(inertial_unit: bool) -> None:
    assert drive(np.zeros(4), inertial_unit) < 1e-4 + H * 0.3


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_the_step(backend: Backend) -> None:
    """Truth: NumPy's algebra for a gyro without tilts."""
    rng, seen, mount = np.random.default_rng(5), np.zeros(8), np.array([0.2, -0.1, 0.3])
    found = made(backend, InertialVelocity, seen, mount)
    v, average, zero = np.zeros(2), np.zeros(2), np.zeros(2)
    for _ in range(50):
        seen[:], accel, rate = 0.05 * rng.normal(size=8), rng.normal(size=2), float(rng.normal())
        known, calm = rng.uniform(size=4) < 0.3, bool(rng.uniform() < 0.5)
        assert found.update(H, np.array([0.0, 0.0, rate]), np.array([*accel, 9.81]), rate, known, calm)
        v = v + H * (accel - zero + rate * np.array([v[1], -v[0]]))
        origin = v - rate * np.array([-mount[1], mount[0]])
        average = average + (1.0 - np.exp(-H / OVER)) * (origin - average)
        off = seen.reshape(4, 2) - average
        weights = 1.0 / (1.0 + np.sum(off**2, axis=1) / NEAR**2)
        shares = np.where(known, ANNOUNCED, 1.0)
        step = H / FOLLOW * (shares @ off) / shares.sum() if calm else H / FOLLOW * (weights @ off) / 4.0
        v, average, zero = v + step, average + step, zero - calm * step / ACCELERATION_ZEROS
        np.testing.assert_allclose(found.weights, weights, rtol=1e-9)
        np.testing.assert_allclose(found.velocity, v - rate * np.array([-mount[1], mount[0]]), atol=1e-12)


@given(
    mount=st.tuples(*[st.floats(-0.5, 0.5)] * 2), speed=st.floats(-1.5, 1.5), rate=st.floats(-1.5, 1.5), pace=st.floats(0.5, 4.0)
)  # fmt: skip
@settings(max_examples=draws(20, 200), deadline=None)
def test_wheels_that_roll_count_in_full_wherever_the_inertial_unit_is(
    mount: tuple[float, float], speed: float, rate: float, pace: float
) -> None:
    """Truth: rigid-body kinematics of a base that drives and turns, whose wheels all roll."""
    seen, place = np.zeros(8), np.array([*mount, 0.1])
    found, least = InertialVelocity(seen, place), 1.0
    for k in range(1, 800):
        t = (k - 0.5) * H
        v, a = speed * np.sin(pace * t), speed * pace * np.cos(pace * t)
        w, change = rate * np.sin(0.7 * pace * t), 0.7 * pace * rate * np.cos(0.7 * pace * t)
        accel = np.array([a, w * v, 9.81]) + np.cross([0, 0, change], place)
        accel += np.cross([0, 0, w], np.cross([0, 0, w], place))
        seen += (1.0 - np.exp(-H / OVER)) * (np.tile([v + 0.5 * H * a, 0.0], 4) - seen)
        found.update(H, np.array([0.0, 0.0, w]), accel, w, None)
        least = min(least, float(found.weights.min()))
    assert least > 0.8
    assert found.velocity == pytest.approx([v, 0.0], abs=0.01)


def test_an_inertial_unit_on_the_arm_has_no_place_on_the_base() -> None:
    """Truth: the model's frames. The unit of this robot is 0.249 m ahead of its base."""
    tree, body = ROBOT.tree, ROBOT.description.base.body
    assert tree.place_on(body, "imu")[0] == pytest.approx([0.24875, 0.0, -0.06])
    assert tree.place_on(body, body)[0] == pytest.approx(np.zeros(3))
    assert tree.place_on(body, ROBOT.tool) is None
    assert tree.place_on(body, "no such frame") is None


def test_without_gravity_there_is_no_inertial_unit_and_gaps_restart() -> None:
    seen = np.tile([0.3, 0.1], 4)
    found = InertialVelocity(seen)
    up = np.array([0.0, 0.0, 9.81])
    for bad in (np.zeros(3), np.full(3, np.nan), np.full(3, np.inf)):
        assert not found.update(H, np.zeros(3), bad, 0.0, None)
        assert not found.update(H, bad + np.inf, up, 0.0, None)
    assert not found.update(5.0, np.zeros(3), up, 0.0, None)
    assert found.velocity == pytest.approx([0.3, 0.1])
    assert found.update(H, np.zeros(3), up, 0.0, None)
    assert (found.weights > 0.99).all()
