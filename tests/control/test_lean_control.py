"""LeanControl against forces that last. Truth: statics about the ball's contact with the floor."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.lean_control import MAXIMUM, LeanControl
from wbmpc.errors import DisturbanceTooLarge

ROBOT = robot("rezero")
ARM = ROBOT.home[ROBOT.state["arm"]]
LEAN = LeanControl(ROBOT, ARM, 0.6, 2.0)
HEIGHT = 0.2


def borne(force: np.ndarray) -> np.ndarray:
    """What the wheels bear (2) [m] of the reach."""
    return np.array(LEAN.leans(force, 0.0)[2:4])


def shift(force: np.ndarray) -> np.ndarray:
    return np.array(LEAN.leans(force, 0.0)[:2])


def center(force: np.ndarray, yaw: float = 0.0) -> np.ndarray:
    return np.array(LEAN.center(LEAN.leans(force, yaw), yaw))


def pushed(size: float, heading: float = 0.0) -> np.ndarray:
    """Generalized forces of a horizontal force along the heading, ``HEIGHT`` above the ball's center, of an upright base."""
    force = np.zeros(ROBOT.base.nq)
    force[:2] = size * np.array([np.cos(heading), np.sin(heading)])
    force[3] = size * HEIGHT
    return force


def stand(force: np.ndarray) -> np.ndarray:
    return np.asarray(LEAN.balance.stand @ force[:5])


def test_the_robot_stands_where_its_weight_answers_the_moment_about_the_floor() -> None:
    links, radius = ROBOT.base.tree.links, ROBOT.description.base.ball_radius
    load = sum(link.mass for i, link in enumerate(links) if i > 1)
    want = -40.0 * (HEIGHT + radius) / (load * 9.81)
    np.testing.assert_allclose(stand(pushed(40.0)), [want, 0.0], atol=1e-6)


def test_what_the_wheels_bear_is_the_force_at_the_contact() -> None:
    """The floor's friction answers the force: a moment of F r about the ball's center, whatever the height. A moment alone, as
    of a displaced center of mass, costs the wheels nothing: the robot stands with a lean, and the limit moves with it."""
    low, high = pushed(40.0), pushed(40.0)
    high[3] *= 2.0
    np.testing.assert_allclose(borne(low), borne(high), atol=1e-3)
    moment = np.zeros(ROBOT.base.nq)
    moment[3] = 2.0
    assert np.abs(borne(moment)).max() < 1e-3 < 5e-3 < np.abs(stand(moment)).max()
    np.testing.assert_allclose(center(moment), shift(moment) - borne(moment))


def test_the_limit_is_about_where_the_robot_stands_as_far_as_the_reach_allows() -> None:
    weak, strong = pushed(10.0), pushed(60.0)
    np.testing.assert_allclose(center(weak), -stand(weak), atol=1e-12)  # in the middle of the limit
    margin = 0.6 * LEAN.reach - np.abs(stand(strong) + center(strong))[0]
    left = MAXIMUM * LEAN.reach - np.abs(borne(strong))[0]
    assert margin == pytest.approx(left, abs=1e-9) and left > 0.0


def test_the_heading_turns_it_all() -> None:
    along = center(pushed(60.0))
    turned = center(pushed(60.0, 0.5 * np.pi), 0.5 * np.pi)
    np.testing.assert_allclose(turned, [-along[1], along[0]], atol=1e-12)


def test_a_force_that_pushes_the_robot_away_is_reported_and_ends_the_run(caplog: pytest.LogCaptureFixture) -> None:
    lean_control, x, n = LeanControl(ROBOT, ARM, 0.6, 2.0), ROBOT.home.copy(), ROBOT.base.nq
    x[n] = 1.9
    lean_control.check(1.0, pushed(20.0), x)
    x[n] = 0.5
    lean_control.check(1.0, pushed(50.0), x)
    assert not lean_control.push_fault and not caplog.records
    for t in (1.5, 1.6, 1.79, 1.8, 1.9):
        assert not lean_control.push_fault or t > 1.8
        lean_control.check(t, pushed(90.0), x)
    assert str(lean_control.push_fault) == "a force of at least 90 N that lasts pushes the robot away (1.80 s)"
    assert len(caplog.records) == 1
    x[n] = 2.1
    for force in (50.0, 20.0, 50.0):  # who is driven fast by a goal is not pushed away
        lean_control.check(2.0, pushed(force), x)
        lean_control.check(2.25, pushed(force), x)
    with pytest.raises(DisturbanceTooLarge, match=r"50 N .* faster than 2 m/s \(max_pushed_speed\); motors off"):
        lean_control.check(2.31, pushed(50.0), x)


def test_a_fast_ball_that_rolls_back_against_the_force_or_not_for_long_goes_on() -> None:
    lean_control, x, n = LeanControl(ROBOT, ARM, 0.6, 2.0), ROBOT.home.copy(), ROBOT.base.nq
    for t, speed in ((1.0, -3.0), (1.5, -2.5), (2.0, 2.5), (2.2, 2.5), (2.25, 1.9), (2.4, 2.5), (2.6, 2.5)):
        x[n] = speed
        lean_control.check(t, pushed(50.0), x)
    lean_control.reset()
    assert not lean_control.push_fault
    x[n] = 1.5
    for t in (0.1, 0.25, 0.5):
        lean_control.check(t, pushed(50.0), x)
        assert t > 0.4 or not lean_control.push_fault
    assert str(lean_control.push_fault).endswith("(0.50 s)")


def test_what_is_left_of_a_push_that_is_over_is_no_force_that_lasts() -> None:
    """The observer forgets a push of 0.2 s with its time constant of 0.3 s, while the ball still runs at 4 m/s."""
    lean_control, x, n = LeanControl(ROBOT, ARM, 0.6, 2.0), ROBOT.home.copy(), ROBOT.base.nq
    x[n] = 4.0
    for t in np.arange(0.0, 3.0, 0.0025):
        learned = 150.0 * min(t / 0.2, 1.0) if t < 0.2 else 150.0 * np.exp(-(t - 0.2) / 0.3)
        lean_control.check(float(t), pushed(float(learned)), x)
    assert not lean_control.push_fault
