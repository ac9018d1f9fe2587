"""What odometry says of itself while wheels contradict each other for long, as under a second publisher's commands. Truth: MuJoCo's pose of a
base whose wheels point anywhere; by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.fused_odometry import FusedOdometry
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.odometry_step import Interval
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.model.robot import RobotModel, load_robot

PERIOD, REST = 0.0025, 800
GEOMETRY = load_robot("swerve-fixed-ur10").base.geometry


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("swerve-ur10")


@pytest.mark.parametrize("wheel", [(6, -6, 6, -6), (8, 8, 8, -8), (5, 5, 5, 0), (6, 6, 6, 6)])
@pytest.mark.parametrize("inertial", [True, False])
def test_the_stated_deviation_is_that_of_a_base_whose_wheels_slide(
    robot: RobotModel, wheel: tuple[float, ...], inertial: bool
) -> None:
    """For 5 s. With an inertial unit the odometry is 0.15 to 0.25 m off, by the wheels alone up to 2.3 m."""
    plant = SwervePlant(robot.description, robot.home, seed=3)
    settings = EstimatorSettings(reject_slipping_wheels=inertial)
    estimator = SwerveController(robot, np.zeros(3), PERIOD, estimation=settings).estimator
    for k in range(REST + round(5.0 / PERIOD)):
        estimator.process(plant.measure())
        rates = np.array(wheel, float) * (k >= REST)
        plant.step(SwerveCommand(rates, np.zeros(4), np.zeros(6), np.zeros(4)), round(PERIOD / plant.timestep))
    error = (estimator.odometry.pose - plant.truth().pose)[:2]
    covariance = estimator.odometry.covariance[:2, :2]
    assert np.hypot(*error) > 0.1
    assert error @ np.linalg.solve(covariance, error) / 2.0 < 3.0
    assert np.sqrt(np.trace(covariance)) < (1.0 if inertial else 3.0)
    assert not inertial or np.sqrt(np.diag(estimator.odometry.twist_covariance)[:2]).max() < 1.0


AHEAD = -GEOMETRY.wheel_heading - GEOMETRY.leg_angles(np.zeros(4))


def driven(speeds: ArrayLike, weights: np.ndarray | None = None, period: float = PERIOD) -> FusedOdometry:
    """After 3 s in which wheels that all point ahead roll at ``speeds`` (4) [m/s]; a gyro sees no turn."""
    wheel, odometry = np.zeros(4), FusedOdometry(GEOMETRY)
    for k in range(round(3.0 / period) + 1):
        odometry.update(k * period, np.zeros(4), AHEAD, wheel, 0.0, weights=weights)
        wheel = wheel + np.array(speeds) * period / GEOMETRY.wheel_radius
    return odometry


def test_wheels_that_agree_and_one_that_does_not_count_add_nothing() -> None:
    one = np.array([1.0, 1.0, 1.0, 1e-3])
    for speeds, weights in (((0.5, 0.5, 0.5, 0.5), None), ((0.5, 0.52, 0.5, 0.5), None), ((0.5, 0.5, 0.5, -0.5), one)):
        odometry = driven(speeds, weights)
        assert odometry._memory.arrays["interval"][Interval.LOST] == 0.0
        assert np.sqrt(odometry.covariance[0, 0]) < 0.01


@pytest.mark.parametrize(
    ("speeds", "low", "high"), [((0.5, 0.5, 0.5, 0.5), 0.1, 0.3), ((0.5, 0.5, -0.5, -0.4), 0.5, 2.0)]
)
def test_a_gap_in_which_wheels_contradicted_each_other_counts_their_contradiction(
    speeds: tuple[float, ...], low: float, high: float
) -> None:
    """One gap of 3 s: of wheels that agree a tenth of their way, 1.5 m, counts."""
    assert low < np.sqrt(driven(speeds, period=3.0).covariance[0, 0]) < high


SLIDING, ORDINARY = (0.5, 0.5, -0.5, -0.4), (0.5, 0.53, 0.5, 0.5)


class Driven:
    """Wheels that all point ahead; a gyro sees no turn."""

    def __init__(self) -> None:
        self.odometry, self.wheel, self.count = FusedOdometry(GEOMETRY), np.zeros(4), 0

    @property
    def time(self) -> float:
        return self.count * 0.01

    def roll(self, speeds: ArrayLike, seconds: float) -> None:
        """At ``speeds`` (4) [m/s]."""
        for _ in range(round(seconds / 0.01)):
            self.odometry.update(self.time, np.zeros(4), AHEAD, self.wheel, 0.0)
            self.wheel, self.count = self.wheel + np.array(speeds) * 0.01 / GEOMETRY.wheel_radius, self.count + 1

    def spread(self) -> float:
        """Stated deviation [m] of the position along x."""
        return float(np.sqrt(self.odometry.covariance[0, 0]))


def test_after_wheels_have_slid_ordinary_contradictions_add_nothing() -> None:
    """Beyond half a second; wheels that slide again after it begin anew. A pause of 0.4 s ends nothing."""
    base = Driven()
    base.roll(SLIDING, 60.0)
    base.roll(ORDINARY, 0.3)
    assert base.odometry._memory.arrays["interval"][Interval.LOST] == 0.0
    base.roll(ORDINARY, 0.7)
    before = base.spread()
    base.roll(ORDINARY, 20.0)
    np.testing.assert_allclose(base.spread(), before, rtol=1e-3)
    base.roll(SLIDING, 0.4)
    np.testing.assert_allclose(base.spread(), before, rtol=1e-3)

    with_pause, without = Driven(), Driven()
    for seconds, speeds in ((3.0, SLIDING), (0.4, ORDINARY), (3.0, SLIDING)):
        with_pause.roll(speeds, seconds)
    without.roll(SLIDING, 6.0)
    np.testing.assert_allclose(with_pause.spread(), without.spread(), rtol=0.1)


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_between_global_poses_the_deviation_is_that_of_the_time_since_the_last(late: float) -> None:
    """By hand: wheels off by ±0.475 m/s along x, of 8 components of which 6 are free, leave 0.7 · 0.39 m/s, over 0.5 s (and as long as the
    pose is late); slip that is noise of each interval adds a part."""
    base, spreads = Driven(), []
    for k in range(60):
        base.roll(SLIDING, 0.5)
        spreads.append(base.spread())
        assert base.odometry.correct(base.time - 0.01 - late, base.odometry.pose, 1e-4 * np.eye(3)) or not k
    alone = 0.7 * np.sqrt(4 * 0.475**2 / 6) * (0.5 + late)
    assert alone < spreads[10] < 1.5 * alone
    np.testing.assert_allclose(spreads[-1], spreads[10], rtol=0.02)


def test_a_late_global_pose_makes_of_wheels_that_slide_what_one_in_time_does() -> None:
    """Truth: the same pose taken at once."""
    late, at_once = Driven(), Driven()
    for base in (late, at_once):
        base.roll(SLIDING, 5.0)
    then, pose, covariance = at_once.time - 0.01, at_once.odometry.pose, 0.01 * np.eye(3)
    assert at_once.odometry.correct(then, pose, covariance)
    for base in (late, at_once):
        base.roll(SLIDING, 0.4)
    assert late.odometry.correct(then, pose, covariance)
    np.testing.assert_allclose(late.odometry.covariance, at_once.odometry.covariance, rtol=1e-6, atol=1e-12)
    for base in (late, at_once):
        base.roll(SLIDING, 2.0)
    np.testing.assert_allclose(late.odometry.covariance, at_once.odometry.covariance, rtol=1e-3, atol=1e-9)


def test_a_coarse_global_pose_ends_little_of_what_wheels_that_slide_have_made() -> None:
    """A pose of 30 m each 0.1 s: without it the deviation grows like the time."""
    coarse, without = Driven(), Driven()
    for _ in range(50):
        for base in (coarse, without):
            base.roll(SLIDING, 0.1)
        assert coarse.odometry.correct(coarse.time - 0.01, coarse.odometry.pose, 900.0 * np.eye(3))
    np.testing.assert_allclose(coarse.spread(), without.spread(), rtol=0.1)


@pytest.mark.parametrize("how", ["restart_encoders", "place", "bridge", "gap"])
def test_a_restart_a_place_and_a_gap_begin_anew(how: str) -> None:
    """What wheels that slide on for 0.4 s add is noise of each interval alone, 0.1 m; an error that had lasted for 10 s would add 0.8 m."""
    base = Driven()
    base.roll(SLIDING, 10.0)
    if how == "restart_encoders":
        base.odometry.restart_encoders()
        base.count, base.wheel = 0, np.zeros(4)
    elif how == "place":
        base.odometry.place(np.zeros(3))
    elif how == "bridge":
        base.odometry.bridge(base.time)
    else:
        base.count += 100
    base.roll(SLIDING, 0.02)
    before = base.spread()
    base.roll(SLIDING, 0.4)
    assert np.sqrt(base.spread() ** 2 - before**2) < 0.2
    assert base.odometry._memory.arrays["interval"][Interval.LOST] == 0.0
