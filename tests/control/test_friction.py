"""What drives make of commands. Truth: drives of first order with dry friction, integrated here; positions by formula."""

from __future__ import annotations

import numpy as np
import pytest

from toys import made
from wbmpc.studies.pankert2022.track_control import LEARNED_IN, MAXIMUM, DryFriction, Smoothing

PERIOD, LAG = 0.0025, 0.02


def drive(friction: DryFriction, lost: np.ndarray, target, seconds: float, seed: int = 0) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Speeds (k, n) of drives that lose ``lost`` (n) [rad/s] while they turn; messages are up to 2 ms old."""
    rng, n = np.random.default_rng(seed), lost.size
    rate, angle, seen, speeds = np.zeros(n), np.zeros(n), np.zeros(n), []
    for k in range(round(seconds / PERIOD)):
        speed = np.sign(rate) * np.maximum(np.abs(rate) - lost, 0.0)
        angle = angle + PERIOD * speed
        speeds.append(speed)
        now = angle - rng.uniform(0.0, 0.002) * speed
        friction.learn(now - seen, PERIOD)
        seen = now
        reported = friction.command(target(k * PERIOD), np.inf, np.inf)
        rate = rate + (1.0 - np.exp(-PERIOD / LAG)) * (reported - rate)
    return np.array(speeds)


def test_drives_turn_as_wanted_in_both_directions() -> None:
    lost = np.array([0.02, 0.0, 0.05])
    friction = DryFriction(3, PERIOD, LAG)
    sign = lambda t: 1.0 if t < 6.0 else -1.0
    speeds = drive(friction, lost, lambda t: sign(t) * np.array([2.0, 0.3, 0.4]), 7.0)
    np.testing.assert_allclose(friction.droop, lost, atol=3e-3)
    np.testing.assert_allclose(speeds[2200:2400].mean(axis=0), [2.0, 0.3, 0.4], atol=3e-3)
    np.testing.assert_allclose(speeds[-200:].mean(axis=0), [-2.0, -0.3, -0.4], atol=3e-3)


def test_a_drive_that_stands_learns_nothing_and_gets_nothing() -> None:
    """One that sticks turns by nothing of what it is reported: that is no measure of its friction."""
    friction = DryFriction(2, PERIOD, LAG)
    drive(friction, np.array([0.04, 0.04]), lambda t: np.array([0.0, 0.01]), 2.0)
    np.testing.assert_array_equal(friction.droop, 0.0)
    friction.droop = np.array([0.04, 0.04])
    np.testing.assert_array_equal(friction.command(np.zeros(2), 1.0, 1.0), 0.0)


def test_a_blocked_drive_is_not_pushed_beyond_reason() -> None:
    friction = DryFriction(1, PERIOD, LAG)
    drive(friction, np.array([9.0]), lambda t: np.array([1.0]), 5.0 * LEARNED_IN)
    assert friction.droop == pytest.approx(MAXIMUM)


def test_commands_stay_within_speed_and_step() -> None:
    friction = DryFriction(2, PERIOD, LAG)
    friction.droop = np.array([0.05, 0.05])
    reported = [friction.command(np.array([1.0, -0.5]), 1.0, np.array([0.3, 0.1])) for _ in range(8)]
    assert np.abs(np.diff(reported, axis=0, prepend=0.0)).max(axis=0) == pytest.approx([0.3, 0.1])
    np.testing.assert_allclose(reported[-1], [1.0, -0.55])


def test_smoothing_leaves_a_fifth_of_the_jitter_and_no_delay() -> None:
    """x = 0.2 t + 0.1 sin t, seen up to 2 ms late; the drives are said to go 0.2 % faster than they do."""
    rng, smoothing = np.random.default_rng(1), Smoothing(0.025, 0.001, 1)
    at, speed = (lambda t: 0.2 * t + 0.1 * np.sin(t)), (lambda t: 0.2 + 0.1 * np.cos(t))
    raw, smooth = [], []
    for k in range(2000):
        t = k * PERIOD
        seen = at(t - rng.uniform(0.0, 0.002))
        v = np.array([1.002 * speed(t - 0.5 * PERIOD)])
        value = smoothing.update(np.array([seen]), v, PERIOD if k else 0.0)
        raw.append(seen - at(t))
        smooth.append(value[0] - at(t))
    assert np.std(smooth[100:]) < 0.3 * np.std(raw[100:])
    assert abs(np.mean(smooth[100:])) < 0.1 * abs(np.mean(raw[100:]))


def test_smoothing_is_that_of_its_formula_in_both_back_ends() -> None:
    """Truth: the recursion in NumPy; the first message, and one of the same time, only start and stay."""
    rng, age, time, value = np.random.default_rng(2), 0.001, 0.025, None
    both = [made(backend, Smoothing, time, age, 3) for backend in ("compiled", "interpreted")]
    assert both[0].value is None
    for k in range(20):
        read, rates, h = rng.normal(size=3), rng.normal(size=3), 0.0 if k in (0, 5) else rng.uniform(1e-3, 4e-3)
        now = read + age * rates
        if value is None:
            value = now
        elif h > 0.0:
            value = value + h * rates + (1.0 - np.exp(-h / time)) * (now - value - h * rates)
        for smoothing in both:
            np.testing.assert_allclose(smoothing.update(read, rates, h), value, rtol=1e-12)
