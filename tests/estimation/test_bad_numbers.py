"""What estimators refuse. Truth: a twin that is given the good messages alone has the same estimate afterwards, to the bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from toys import robot
from wbmpc.errors import InputError, NotFinite
from wbmpc.estimation import (
    BallFilter,
    BallGeometry,
    BallNoise,
    ContactMonitor,
    DisturbanceObserver,
    DoorFilter,
    JointTracker,
    MomentumObserver,
    RezeroEstimator,
)

H, NAN = 0.0025, float("nan")
ROBOT = robot("rezero")
HOME, _ = ROBOT.equilibrium(ROBOT.home[ROBOT.state["arm"]])
ARM, UP, ZERO = HOME[ROBOT.state["arm"]], np.array([0.0, 0.0, 9.81]), np.zeros(3)


def contact() -> tuple[Callable[..., Any], Callable[[], Any]]:
    monitor = ContactMonitor(debounce=0.0)
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
    estimator = RezeroEstimator(ROBOT, HOME)
    return estimator.update, lambda: estimator.state


WHOLE, ONE = (0.1 * np.ones(10), np.zeros(3), H), np.ones(2)
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
]


@pytest.mark.parametrize(("make", "good", "bad", "name"), CASES)
def test_a_message_that_cannot_be_is_refused_and_leaves_nothing(make: Any, good: Any, bad: Any, name: str) -> None:
    (update, estimate), (other, twin) = make(), make()
    kind = NotFinite if any(not np.isfinite(part).all() for part in bad) else InputError
    for before in good[:-1]:
        update(*before)
        other(*before)
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
    late, twin = (RezeroEstimator(ROBOT, HOME) for _ in range(2))
    for k in range(40):
        for estimator in (late, twin):
            estimator.update(k * H, *rolling(k))
        if k % 2:
            before = late.state
            np.testing.assert_array_equal(late.update((k - 1) * H, *rolling(k - 1)), before)
    np.testing.assert_array_equal(late.state, twin.state)
    assert late.state[8] > 0.0
