"""The least friction that holds a load. Truth: statics by hand; scenes whose contact loads are known or do not matter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from wbmpc.stability import Load, friction_needed, slope_gravity

WEIGHT = 800.0
SQUARE = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
#: An inscribed polygon of 64 corners is never too small, and too large by 1/cos(π/64) at most.
SAFE = 1.0 / math.cos(math.pi / 64)


def pressed(force: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0, at: tuple[float, float] = (0.0, 0.0)) -> Load:
    """A weight over ``at``, a force along the ground through its origin and a yaw moment."""
    return Load.gravity(WEIGHT / 9.81, (*at, 1.0)) + Load.wrench((*force, 0.0), (0.0, 0.0, yaw))


def assert_needs(least: float, feet: np.ndarray, load: Load) -> None:
    needed = friction_needed(feet, load)
    assert least * (1 - 1e-9) <= needed <= least * SAFE * (1 + 1e-9), (least, needed)


@pytest.mark.parametrize("moved", [(0.0, 0.0), (7.0, -3.0)])
def test_a_slope_needs_its_tangent(moved: tuple[float, float]) -> None:
    """Wherever the center of mass and the frame's origin are: no foot needs more than its load gives."""
    load = Load.gravity(80.0, (0.1 + moved[0], 0.2 + moved[1], 0.6), slope_gravity(0.3, 0.7))
    assert friction_needed(SQUARE + moved, load) == pytest.approx(math.tan(0.3), rel=1e-9)


def test_a_yaw_moment_on_a_square_needs_moment_over_weight_and_radius() -> None:
    """The weight is in the middle, so each foot holds its load times the radius, however they share it."""
    for yaw in (60.0, -60.0, 5000.0):
        assert_needs(abs(yaw) / (WEIGHT * math.sqrt(0.5)), SQUARE, pressed(yaw=yaw))


def test_on_three_feet_the_lightest_foot_decides() -> None:
    """Three feet have one way to carry the weight. The heavy foot holds any force and stays; the two light ones, as far from it,
    hold the moment with all their friction."""
    feet = np.array([[0.0, 0.0], [1.0, 0.1], [1.0, -0.1]])
    load = pressed(yaw=5.0, at=(0.1, 0.0))  # 5 % of the weight on each of the two
    assert_needs(5.0 / (0.1 * WEIGHT * math.hypot(1.0, 0.1)), feet, load)


def test_force_and_moment_add_up_on_two_far_pairs() -> None:
    """Feet close to two points, 1 m apart along x, half of the weight at each: a force F along y and a moment M about z load one of
    them with F/2 + M / 1 m."""
    feet = np.array([[0.5, 1e-4], [0.5, -1e-4], [-0.5, 1e-4], [-0.5, -1e-4]])
    force, yaw = 50.0, 30.0
    assert friction_needed(feet, pressed((0.0, force), yaw)) == pytest.approx(
        (force / 2 + yaw) / (WEIGHT / 2), rel=2e-3
    )


def test_nothing_and_none() -> None:
    assert friction_needed(SQUARE, pressed()) == 0.0
    assert math.isnan(friction_needed(SQUARE, pressed(at=(0.6, 0.0), yaw=1.0)))  # it tips over
    assert math.isnan(friction_needed(SQUARE, Load.wrench((1.0, 0.0, 5.0))))  # it lifts off
