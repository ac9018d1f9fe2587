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
