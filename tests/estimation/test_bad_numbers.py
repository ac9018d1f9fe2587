"""What estimators reject. Truth: a twin that is given the good messages alone has the same estimate afterwards, to the bit."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from wheels_on_paper import ring

from toys import robot
from wbmpc.bases.ball.disturbance import DisturbanceObserver
from wbmpc.bases.ball.estimator import HISTORY, BallEstimator
from wbmpc.bases.ball.filter import BallFilter
from wbmpc.bases.ball.filter_state import BallGeometry, BallNoise
from wbmpc.bases.ball.joint_tracker import JointTracker
from wbmpc.bases.ball.push import PushEstimator
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.fused_odometry import FusedOdometry
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry
from wbmpc.errors import InputError, NotFinite
from wbmpc.estimation.payload import ArmScale
from wbmpc.studies.minniti2019.contact import ContactDetector
from wbmpc.studies.minniti2019.door_filter import DoorFilter, DoorNoise
from wbmpc.studies.minniti2019.momentum import MomentumObserver
from wbmpc.studies.pankert2022.release_odometry import ReleaseOdometry
from wbmpc.studies.pankert2022.rocking import rockings
from wbmpc.types import POSE_AHEAD

H, NAN = 0.0025, float("nan")
ROBOT, SWERVE = robot("rezero"), robot("swerve-ur10")
FOUR = ring(4)
KNOWN = WheelCalibration.unknown(FOUR)
HOME, _ = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])
MOVING = np.concatenate([HOME[:8], np.ones(8)])
ARM, UP, ZERO = HOME[ROBOT.state["arm"]], np.array([0.0, 0.0, 9.81]), np.zeros(3)


def contact() -> tuple[Callable[..., Any], Callable[[], Any]]:
    monitor = ContactDetector(debounce=0.0)
    return monitor.update, lambda: [monitor.touching]


def momentum() -> tuple[Callable[..., Any], Callable[[], Any]]:
    observer = MomentumObserver(lambda q: 2.0 * np.eye(2), lambda q, v: np.zeros(2))
    return observer.update, lambda: observer.residual


def door() -> tuple[Callable[..., Any], Callable[[], Any]]:
    filter_ = DoorFilter([2.5, 12.0, 3.5])
    return filter_.update, lambda: filter_.state


def disturbance() -> tuple[Callable[..., Any], Callable[[], Any]]:
    observer = DisturbanceObserver(lambda x, u, h: x, lambda q: np.eye(5), 5, gate=np.full(5, np.inf))
    return observer.update, lambda: observer.force


def ball() -> tuple[Callable[..., Any], Callable[[], Any]]:
    filter_ = BallFilter(BallGeometry(0.125, ROBOT.base.wheel_torque_map().T, ZERO), [0, 0], np.eye(3), BallNoise())
    return filter_.update, lambda: filter_.state.wheel


def joints() -> tuple[Callable[..., Any], Callable[[], Any]]:
    tracker = JointTracker([0.0], 1e-5, 1e-3, 7e-4)
    return tracker.update, lambda: [tracker.angle, tracker.rate]


def rezero() -> tuple[Callable[..., Any], Callable[[], Any]]:
    estimator = BallEstimator(ROBOT, HOME)
    return estimator.update, lambda: estimator.state


def scale() -> tuple[Callable[..., Any], Callable[[], Any]]:
    weighing = ArmScale(SWERVE)
    return weighing.update, lambda: [weighing.mass, weighing.deviation]


@cache
def felt() -> PushEstimator:
    return PushEstimator(ROBOT, ARM, 0.3)


def push() -> tuple[Callable[..., Any], Callable[[], Any]]:
    estimator = copy(felt())
    return lambda x, h: estimator.update(x, np.zeros(6), h, lambda x, u, h: x), lambda: estimator.drift


def stood() -> BallEstimator:
    """It stands for 0.1 s, in a place that is known within 0.1 m."""
    estimator = BallEstimator(ROBOT, HOME, BallNoise(start=0.1))
    for k in range(40):
        estimator.update(k * H, *rolling(k, 0.0))
    return estimator


def place() -> tuple[Callable[..., Any], Callable[[], Any]]:
    estimator = stood()
    return estimator.correct, lambda: np.concatenate([estimator.state, estimator.filter.covariance.ravel()])


def lean() -> tuple[Callable[..., Any], Callable[[], Any]]:
    filter_ = stood().filter
    return filter_.correct_lean, lambda: np.concatenate([filter_.state.rotation, filter_.covariance[6:9, 6:9]])


WHOLE, ONE = (0.1 * np.ones(10), np.zeros(3), H), np.ones(2)
STILL = SWERVE.home[SWERVE.state["arm"]]
WEIGHED = (0.05, STILL, np.full(6, 20.0), UP, ZERO)
WEIGHT, SURE = ROBOT.base.numeric.tool_weight(HOME[:8]), 1e-4 * np.eye(3)
#: Messages (one more is given before and after) and one of them made bad; the name that the error says.
CASES = [
    (contact, [(0.0, 3.0)], (0.01, NAN), "force"),
    (contact, [(0.0, 3.0)], (NAN, 3.0), "'t'"),
    (momentum, [(ZERO[:2], ONE, ONE, H), (ZERO[:2], 2 * ONE, ONE, H)], (ONE, ONE, ONE, 0.0), "interval"),
    (momentum, [(ZERO[:2], ONE, ONE, H), (ZERO[:2], 2 * ONE, ONE, H)], (ONE, ONE, NAN * ONE, H), "force"),
    (momentum, [(ZERO[:2], ONE, ONE, H), (ZERO[:2], 2 * ONE, ONE, H)], (ONE, ONE, np.ones(3), H), "force"),
    (door, [(H, 9.0, 0.1, 0.3)], (H, NAN, 0.1, 0.3), "torque"),
    (door, [(H, 9.0, 0.1, 0.3)], (-H, 9.0, 0.1, 0.3), "interval"),
    (door, [(H, 9.0, 0.1, 0.3)], (H, 9.0, 0.1, np.inf), "rate"),
    (disturbance, [(0.0, *WHOLE), (H, 0.2 * np.ones(10), np.zeros(3), H)], (H, NAN * WHOLE[0], ZERO, H), "state"),
    (disturbance, [(0.0, *WHOLE), (H, 0.2 * np.ones(10), np.zeros(3), H)], (H, WHOLE[0], ZERO, 0.0), "interval"),
    (disturbance, [(0.0, *WHOLE), (H, 0.2 * np.ones(10), np.zeros(3), H)], (H, WHOLE[0], NAN * ZERO, H), "input"),
    (ball, [(H, 0.01 * np.ones(3), ZERO, UP)], (NAN, ZERO, ZERO, UP), "interval"),
    (ball, [(H, 0.01 * np.ones(3), ZERO, UP)], (H, ZERO, ZERO, UP, NAN), "turning"),
    (joints, [(H, np.array([0.01]))], (0.0, np.array([0.02])), "interval"),
    (joints, [(H, np.array([0.01]))], (H, np.array([NAN])), "reading"),
    (rezero, [(0.0, ZERO, ARM, ZERO, UP), (H, ZERO, ARM, ZERO, UP)], (NAN, ZERO, ARM, ZERO, UP), "time"),
    (rezero, [(0.0, ZERO, ARM, ZERO, UP), (H, ZERO, ARM, ZERO, UP)], (0.1, ZERO, ARM[:2], ZERO, UP), "'arm' needs 3"),
    (rezero, [(0.0, ZERO, ARM, ZERO, UP), (H, ZERO, ARM, ZERO, UP)], (0.1, ZERO, NAN * ARM, ZERO, UP), "arm"),
    (rezero, [(0.0, ZERO, ARM, ZERO, UP), (H, ZERO, ARM, ZERO, UP)], (0.1, ZERO, ARM, NAN * UP, UP), "gyro"),
    (scale, [(0.0, *WEIGHED[1:]), WEIGHED], (NAN, *WEIGHED[1:]), "'t'"),
    (scale, [(0.0, *WEIGHED[1:]), WEIGHED], (0.1, NAN * STILL, *WEIGHED[2:]), "'arm'"),
    (scale, [(0.0, *WEIGHED[1:]), WEIGHED], (0.1, STILL, NAN * STILL, UP, ZERO), "'effort'"),
    (scale, [(0.0, *WEIGHED[1:]), WEIGHED], (0.1, STILL, np.full(6, np.inf), UP, ZERO), "'effort'"),
    (scale, [(0.0, *WEIGHED[1:]), WEIGHED], (0.1, STILL, np.ones(5), UP, ZERO), "'effort' needs 6"),
    (scale, [(0.0, *WEIGHED[1:]), WEIGHED], (0.1, STILL, STILL, NAN * UP, ZERO), "'accel'"),
    (scale, [(0.0, *WEIGHED[1:]), WEIGHED], (0.1, STILL, STILL, UP, NAN * UP), "'gyro'"),
    (push, [(HOME, H), (MOVING, H)], (NAN * HOME, H), "'state'"),
    (push, [(HOME, H), (MOVING, H)], (HOME, 0.0), "interval"),
    (place, [(0.09, [0.1, 0.0, 0.0], SURE)], (0.09, [0.1, 0.0], SURE), "'pose' needs 3"),
    (place, [(0.09, [0.1, 0.0, 0.0], SURE)], (0.09, [0.1, NAN, 0.0], SURE), "'pose' needs 3"),
    (place, [(0.09, [0.1, 0.0, 0.0], SURE)], (0.09, [0.1, 0.0, 0.0], -SURE), "negative"),
    (place, [(0.09, [0.1, 0.0, 0.0], SURE)], (0.09, [0.1, 0.0, 0.0], SURE[:2]), "3 by 3"),
    (lean, [([0.0, 0.02, 1.0], 0.03)], ([0.0, 0.0, 0.0], 0.03), "direction"),
    (lean, [([0.0, 0.02, 1.0], 0.03)], ([0.0, NAN, 1.0], 0.03), "'up'"),
    (lean, [([0.0, 0.02, 1.0], 0.03)], ([0.0, 0.0, 1.0], -0.03), "positive spread"),
]


@pytest.mark.parametrize(("make", "good", "bad", "name"), CASES)
def test_a_message_that_cannot_be_is_rejected_and_leaves_nothing(make: Any, good: Any, bad: Any, name: str) -> None:
    (update, estimate), (other, twin) = make(), make()
    kind = NotFinite if any(not np.isfinite(part).all() for part in bad) else InputError
    for previous in good[:-1]:
        update(*previous)
        other(*previous)
    for _ in range(2):
        with pytest.raises(kind, match=name):
            update(*bad)
    update(*good[-1])
    other(*good[-1])
    np.testing.assert_array_equal(estimate(), twin())
    assert np.isfinite(np.asarray(estimate(), float)).all() and np.any(estimate())


def rolling(k: int, speed: float = 0.2) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Readings of an upright robot that rolls along x with a steady speed [m/s], and whose first joint turns at 0.5 rad/s."""
    angle = ROBOT.base.wheel_torque_map().T @ np.array([0.0, speed / 0.125 * k * H, 0.0])
    alive = 1e-9 * (k % 2)
    return angle, ARM + [0.5 * k * H, 0.0, 0.0], np.full(3, alive), UP + alive


def test_an_older_message_is_ignored_whole() -> None:
    """Each second message is followed by the one before once more: with it the speed is that of a twin without, to the bit."""
    late, twin = (BallEstimator(ROBOT, HOME) for _ in range(2))
    for k in range(40):
        for estimator in (late, twin):
            estimator.update(k * H, *rolling(k))
        if k % 2:
            previous = late.state
            np.testing.assert_array_equal(late.update((k - 1) * H, *rolling(k - 1)), previous)
    np.testing.assert_array_equal(late.state, twin.state)
    assert late.state[13] > 0.1  # its first joint turns, and so does the estimate


@pytest.mark.parametrize(
    ("late", "counts"), [(HISTORY + 0.01, False), (0.09, True), (-0.9 * POSE_AHEAD, True), (-3600.0, False)]
)
def test_poses_of_a_past_that_is_forgotten_and_of_a_future_do_not_count(late: float, counts: bool) -> None:
    """``late`` [s] before the last message; they were taken for poses of the nearest update."""
    estimator, twin = stood(), stood()
    after = estimator.correct(39 * H - late, [0.5, 0.0, 0.0], SURE)
    assert (abs(after[0] - twin.state[0]) > 0.4) == counts
    np.testing.assert_array_equal(twin.correct(39 * H - late, [0.5, 0.0, 0.0], SURE), after)


def test_the_past_is_kept_as_long_as_poses_may_be_late() -> None:
    estimator = BallEstimator(ROBOT, HOME)
    for k in range(8):
        estimator.update(0.11 * k, *rolling(k, 0.0))
    assert [t for t, _ in estimator._places] == pytest.approx([0.11 * k for k in range(2, 8)])


def test_a_model_without_an_answer_leaves_the_drift_as_it_was() -> None:
    estimator = copy(felt())
    estimator.update(HOME, np.zeros(6), H, lambda x, u, h: x)
    with pytest.raises(NotFinite, match="drift of the lean"):
        estimator.update(HOME, np.zeros(6), H, lambda x, u, h: NAN * x)
    estimator.update(MOVING, np.zeros(6), H, lambda x, u, h: x)
    assert np.isfinite(estimator.drift).all() and estimator.drift.any()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: BallEstimator(ROBOT, NAN * HOME), "'start' needs 16"),
        (lambda: BallEstimator(ROBOT, HOME[:5]), "'start' needs 16"),
        (lambda: WheelOdometry(FOUR, wheel_radius=NAN), "'wheel_radius' needs 4 finite"),
        (lambda: WheelOdometry(FOUR, wheel_radius=[0.1, 0.1]), "'wheel_radius' needs 4 finite"),
        (lambda: WheelOdometry(FOUR, wheel_radius=-1.0), "'wheel_radius' must be positive"),
        (lambda: WheelOdometry(FOUR, steer_offset=NAN), "'steer_offset' needs 4 finite"),
        (lambda: WheelOdometry(FOUR, leg_offset="a"), "'leg_offset' needs 4 finite"),
        (lambda: WheelOdometry(FOUR, [0.0, 0.0]), "'pose0' needs 3 finite"),
        (lambda: ReleaseOdometry(FOUR, [0.0, 0.0, 0.0], 0.0), "'period' must be positive"),
        (lambda: ReleaseOdometry(FOUR, [0.0, NAN, 0.0], 0.01), "'pose0' needs 3 finite"),
        (lambda: WheelCalibration.unknown(FOUR, NAN), "'zero' must be finite"),
        (lambda: WheelCalibration.unknown(FOUR, -1e-3), "must not be negative"),
        (lambda: replace(KNOWN, wheel_radius=np.zeros(4)), "'wheel_radius' must be positive"),
        (lambda: replace(KNOWN, steer_offset=np.full(4, NAN)), "'steer_offset' needs 4 finite"),
        (lambda: replace(KNOWN, leg_offset=np.zeros(3)), "'leg_offset' needs 4 finite"),
        (lambda: replace(KNOWN, covariance=-KNOWN.covariance), "no variance of it may be negative"),
        (lambda: replace(KNOWN, covariance=np.ones((4, 16))), "8 rows of 8"),
        (lambda: FusedOdometry(FOUR, calibration=WheelCalibration.unknown(ring(3))), "of 3 modules, the base has 4"),
        (
            lambda: BrakeControl(robot("swerve-ur10"), start="abc"),
            r"4 numbers, 0 \(closed\) or 1 \(open\), are needed, got 'abc'",
        ),
        (lambda: BallNoise(gyro=-1.0), "'gyro' is too small"),
        (lambda: BallNoise(encoder=NAN), "'encoder' must be finite"),
        (lambda: BallNoise(scale_time=0.0), "'scale_time' is too small"),
        (lambda: BallEstimator(ROBOT, HOME, balance=NAN), "'balance' must be finite"),
        (lambda: BallEstimator(ROBOT, HOME, balance=0.0), "'balance' must be positive"),
        (
            lambda: DisturbanceObserver(lambda x, u, h: x, ROBOT.base.numeric.mass_matrix, 8, np.ones(5), calm=(0, 0)),
            "'calm' needs positive",
        ),
        (
            lambda: DisturbanceObserver(lambda x, u, h: x, ROBOT.base.numeric.mass_matrix, 8, np.ones(5), calm=(1,)),
            "'calm' needs 2",
        ),  # type: ignore[arg-type]
        (
            lambda: DisturbanceObserver(lambda x, u, h: x, ROBOT.base.numeric.mass_matrix, 8, gate=np.array([NAN])),
            "'gate' needs",
        ),
        (
            lambda: DisturbanceObserver(lambda x, u, h: x, ROBOT.base.numeric.mass_matrix, 8, np.ones(5), hold=-1.0),
            "'hold' must not be negative",
        ),
        (lambda: DoorNoise(rate=NAN), "door filter's noise: 'rate' must be finite"),
        (lambda: DoorNoise(walk=-1.0), "door filter's noise: 'walk' must not be negative"),
        (lambda: PushEstimator(ROBOT, ARM, NAN), "push estimator: 'expected_push_time' must be finite"),
        (lambda: PushEstimator(ROBOT, ARM[:2], 0.3), "push estimator: 'arm' needs 3"),
        (lambda: JointTracker([0.0], -1e-5, 1e-3, 7e-4), "joint tracker: 'encoder' must not be negative"),
        (lambda: JointTracker([NAN], 1e-5, 1e-3, 7e-4), "joint tracker: 'angles' needs 1"),
        (lambda: JointTracker([0.0], 1e-5, 1e-3, 7e-4, speed=0.0), "joint tracker: 'speed' needs positive"),
        (lambda: ContactDetector(on=np.inf), "contact: 'on' must be finite"),
        (lambda: BallGeometry(0.0, np.eye(3), ZERO), "ball filter: 'radius' must be positive"),
        (
            lambda: BallFilter(BallGeometry(0.1, np.eye(3), ZERO), [0, NAN], np.eye(3), BallNoise()),
            "'position' needs 2",
        ),
        (lambda: rockings([0.0, 0.1], [0.0, 0.0], fast=0.0), "rocking: 'fast' must be positive"),
        (
            lambda: MomentumObserver(ROBOT.base.numeric.mass_matrix, lambda q, v: ZERO).force(
                np.zeros((3, 8)), np.ones(8)
            ),
            "first update",
        ),
        (lambda: MomentumObserver(ROBOT.base.numeric.mass_matrix, lambda q, v: ZERO).zero(), "first update"),
    ],
)
def test_what_no_estimator_can_be_made_of_is_rejected(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


def test_weights_of_wheels_may_be_a_list() -> None:
    """Of four the last is left out: as with an array, to the bit."""
    poses = []
    for weights in ([1, 1, 1, 0], np.array([1.0, 1.0, 1.0, 0.0])):
        odometry = FusedOdometry(FOUR)
        odometry.update(0.0, *np.zeros((3, 4)))
        poses.append(odometry.update(0.01, np.zeros(4), np.zeros(4), [0.01, 0.02, 0.03, 0.5], weights=weights))
    np.testing.assert_array_equal(*poses)
    assert np.any(poses[0])


def test_a_force_needs_a_jacobian_of_all_coordinates() -> None:
    observer = MomentumObserver(lambda q: np.eye(2), lambda q, v: np.zeros(2))
    observer.update(ONE, ONE, ONE, H)
    for jacobian, weight in ((np.ones((3, 3)), ONE), (NAN * np.ones((3, 2)), ONE), (np.ones((3, 2)), NAN * ONE)):
        with pytest.raises(InputError, match=r"momentum observer: '(jacobian|weight)' needs"):
            observer.force(jacobian, weight)
