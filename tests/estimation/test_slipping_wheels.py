"""Wheels that are not believed. Truth: the twist that the sound wheels were rolled by."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.bases.swerve.estimator import SLIP_WEIGHT
from wbmpc.bases.swerve.slipping_wheels import SlippingWheels
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry
from wbmpc.model.robot import load_robot
from wbmpc.studies.pankert2022.side_slip import FlipController

GEOMETRY = load_robot("swerve-fixed-ur10").base.geometry
H, ZEROS = 0.0025, np.zeros(4)


def found(speeds: np.ndarray, known: np.ndarray | None = None, turn: float | None = 0.0) -> np.ndarray:
    """Which wheels are odd after 0.1 s in which all point along one axis and roll at ``speeds`` (4) [m/s]; a gyro sees no turn."""
    steer = -GEOMETRY.wheel_heading - GEOMETRY.leg_angles(ZEROS)
    wheels, angle = WheelOdometry(GEOMETRY), np.zeros(4)
    slipping = SlippingWheels(GEOMETRY, wheels)
    for _ in range(40):
        wheels.update(ZEROS, steer, angle)
        slipping.update(H, ZEROS, turn, known)
        angle = angle + speeds * H / GEOMETRY.wheel_radius
    return slipping.odd > 0.0


def test_most_wheels_are_right() -> None:
    assert found(np.array([0.2, 0.2, 0.2, 0.4])).tolist() == [False, False, False, True]
    assert not found(np.full(4, 0.2)).any()


def test_without_a_gyro_one_wheel_is_found_and_of_two_none() -> None:
    assert found(np.array([0.2, 0.2, 0.2, 0.4]), turn=None).tolist() == [False, False, False, True]
    assert not found(np.array([0.2, 0.4, 0.2, 0.4]), turn=None).any()
    assert not found(np.array([0.2, 0.3, 0.1, 0.4]), turn=None).any()


def test_a_wheel_that_is_known_to_slip_has_no_say() -> None:
    """It rolls as one that slips does: two against two, of which the nearer pair would be believed."""
    speeds = np.array([0.2, 0.215, 0.4, 0.405])
    assert found(speeds).tolist() == [True, True, False, False]
    assert found(speeds, np.array([False, False, False, True]))[:2].tolist() == [False, False]


def test_what_is_known_counts_where_too_few_wheels_agree() -> None:
    """All four would count, the wheel that turns about with them, if the announcement were dropped too."""
    robot = load_robot("swerve-fixed-ur10")
    controller = FlipController(robot, np.zeros(3), H)
    estimator, announced = controller.estimator, controller.estimator.side_slip
    assert estimator._odd is not None and estimator._weights() is None
    announced.announce(np.array([0.0, 0.1, 0.0, 0.0]))
    estimator._odd.odd[:] = np.array([0.1, 0.0, 0.0, 0.1])
    assert estimator._weights() == pytest.approx([1.0, SLIP_WEIGHT, 1.0, 1.0])
    estimator._odd.odd[:] = np.array([0.1, 0.0, 0.0, 0.0])
    assert estimator._weights() == pytest.approx([SLIP_WEIGHT, SLIP_WEIGHT, 1.0, 1.0])
