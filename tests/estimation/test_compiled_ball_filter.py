"""The compiled ball filter against the same source as ordinary Python, and against NumPy's algebra."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from ball_states import error_between

from toys import made
from wbmpc import lie
from wbmpc.bases.ball.filter import BallFilter
from wbmpc.bases.ball.filter_solve import solve_robust
from wbmpc.bases.ball.filter_state import BallGeometry, BallNoise, BallState, rotation_of
from wbmpc.bases.ball.filter_step import linearize
from wbmpc.bases.ball.joint_tracker import JointTracker
from wbmpc.kernel.step import Step, bind

H, GRAVITY = 0.0025, np.array([0.0, 0.0, 9.81])


def geometry(rng: np.random.Generator) -> BallGeometry:
    return BallGeometry(0.12, rng.normal(size=(3, 3)), np.array([0.01, -0.02, 0.3]))


def filter_of(g: BallGeometry, noise: BallNoise) -> BallFilter:
    return BallFilter(g, np.zeros(2), np.eye(3), noise)


def step_of(filter: BallFilter, function: Callable[..., Any]) -> Step:
    g = filter.geometry
    return bind(function, filter.arrays, n=len(g.turn), radius=float(g.radius))


def rolling(g: BallGeometry, rng: np.random.Generator, count: int):  # type: ignore[no-untyped-def]
    """Messages of a ball that rolls ahead under a body that hardly turns."""
    wheel, speed = np.zeros(3), 0.0
    for _ in range(count):
        force = rng.normal()
        speed += H * force
        wheel = wheel + H * g.turn @ [0.0, speed / g.radius, 0.0]
        noise = rng.normal(size=(2, 3)) * [[0.004], [0.02]]
        yield wheel + 1e-5 * rng.normal(size=3), noise[0], GRAVITY + [force, 0.0, 0.0] + noise[1]


def test_both_back_ends_say_the_same() -> None:
    """Random messages; one wheel slips, one message of the inertial unit is a spike. The variances that are
    weighed against each other differ by 1e10, so rounding leaves 1e-7 of each deviation, in states and covariances."""
    rng = np.random.default_rng(0)
    g = geometry(rng)
    one, other = (made(b, BallFilter, g, np.zeros(2), np.eye(3), BallNoise()) for b in ("compiled", "interpreted"))
    seen = set()
    for k, (wheel, gyro, accel) in enumerate(rolling(g, rng, 8)):
        wheel = wheel + [0.05 * (k >= 4), 0.0, 0.0]
        accel = accel + [0.0, 300.0 * (k == 6), 0.0]
        for filter in (one, other):
            filter.update(H, wheel, gyro, accel, 0.3)
        assert one.faults == other.faults
        seen |= {*one.faults}
        deviation = np.sqrt(np.diag(other.covariance))
        assert np.abs(error_between(one.state, other.state) / deviation).max() < 1e-7
        np.testing.assert_allclose(
            one.covariance / np.outer(deviation, deviation),
            other.covariance / np.outer(deviation, deviation),
            atol=1e-7,
        )
        assert one.surprise == pytest.approx(other.surprise, rel=1e-6)
    assert {"wheel_0 slips", "imu exceeds"} <= seen


def test_messages_that_jump_are_judged_the_same() -> None:
    """A turn that comes and goes is a jump where it goes against the wheels; one that stays counts."""
    rng = np.random.default_rng(0)
    g = geometry(rng)
    one, other = (made(b, BallFilter, g, np.zeros(2), np.eye(3), BallNoise()) for b in ("compiled", "interpreted"))
    jumps = []
    for k, (wheel, gyro, accel) in enumerate(rolling(g, rng, 9)):
        gyro = gyro + 1.5 * (k == 4 or k > 6)
        for filter in (one, other):
            filter.update(H, wheel, gyro, accel)
        assert one.faults == other.faults
        np.testing.assert_allclose(one.rate, other.rate, atol=1e-9)
        jumps += [k] * ("imu jumps" in one.faults)
    assert jumps == [5, 6] and np.linalg.norm(one.rate) > 2.0


def residuals(g: BallGeometry, s: BallNoise, x: BallState, y: BallState, wheel, gyro, accel) -> np.ndarray:  # type: ignore[no-untyped-def]
    """As docs/explanation/ball-robot.md has them."""
    turned = lie.quaternion_log(lie.rotation_to_quaternion(x.rotation.T @ y.rotation))
    middle = x.rotation @ rotation_of(0.5 * turned)
    turning = turned - H * (gyro - x.gyro_bias)
    push = x.rotation @ rotation_of(0.5 * H * (gyro - x.gyro_bias)) @ (accel - x.accel_bias)
    push = y.velocity - x.velocity - H * (push - GRAVITY)
    mount = (y.rotation - x.rotation) @ g.mount
    shift = y.position - x.position - 0.5 * H * (x.velocity + y.velocity) + mount
    way = y.position - x.position
    ball = middle.T @ np.array([-way[1], way[0], 0.0]) / g.radius - turned
    roll = y.wheel - x.wheel - np.exp(-x.scale) * g.turn @ ball
    read = y.wheel - s.age * (y.wheel - x.wheel) / H - wheel
    walks = [*(y.gyro_bias - x.gyro_bias), *(y.accel_bias - x.accel_bias)]
    kept = np.exp(-H / s.scale_time)
    return np.array([*turning, *push, *shift, *walks, y.scale - kept * x.scale, *roll, *read, y.position[2]])


def test_slopes_are_the_derivatives_of_the_residuals() -> None:
    """Truth: central differences of the residuals of the documentation, about the guess, where those of motion are 0."""
    rng = np.random.default_rng(3)
    g, s = geometry(rng), BallNoise()
    x = BallState(
        *(0.1 * rng.normal(size=(2, 3))), rotation_of(0.3 * rng.normal(size=3)), *(0.01 * rng.normal(size=(3, 3))), 0.02
    )
    wheel, gyro, accel = x.wheel + 0.01, rng.normal(size=3), GRAVITY + rng.normal(size=3)
    memory = filter_of(g, s)
    memory.state = x
    a = memory.arrays
    a["wheel"][:], a["gyro"][:], a["accel"][:] = wheel, gyro, accel
    step_of(memory, linearize)(H, 0.4, 0.0, 0.0)
    memory.arrays["x"][:] = a["y"]
    y = memory.state
    memory.state = x
    r = residuals(g, s, x, y, wheel, gyro, accel)
    np.testing.assert_allclose(a["r"], r, atol=1e-14)
    np.testing.assert_allclose(r[[*range(9), 16, 17, 18]], 0.0, atol=1e-14)
    for name, at in (
        ("jx", lambda d: residuals(g, s, x.moved(d), y, wheel, gyro, accel)),
        ("jy", lambda d: residuals(g, s, x, y.moved(d), wheel, gyro, accel)),
    ):
        slope = np.stack([(at(d) - at(-d)) / 2e-5 for d in 1e-5 * np.eye(19)], axis=1)
        given = a[name].reshape(23, 19)
        # that a slope turns by h (gyro - bias) within the interval is left out
        np.testing.assert_allclose(given, slope, atol=3.0 * H)
    assert np.abs(a["jx"]).max() > 0.5


def test_the_older_state_is_marginalised() -> None:
    """Truth: least squares over both states with the prior, by NumPy's lstsq."""
    rng = np.random.default_rng(4)
    memory = filter_of(geometry(rng), BallNoise())
    a, m, size = memory.arrays, 23, 19
    jx, jy, r = rng.normal(size=(m, size)), rng.normal(size=(m, size)), rng.normal(size=m)
    q, p = np.diag(rng.uniform(0.5, 2.0, m)), np.diag(rng.uniform(0.5, 2.0, size))
    for name, value in (("jx", jx), ("jy", jy), ("r", r), ("q", q), ("p", p)):
        a[name][:] = value.ravel()
    choice, cost = step_of(memory, solve_robust)(np.inf)
    assert choice == 0
    rows = np.block(
        [[np.diag(np.diag(q) ** -0.5) @ np.hstack([jx, jy])], [np.diag(np.diag(p) ** -0.5), np.zeros((size, size))]]
    )
    right = -np.concatenate([np.diag(q) ** -0.5 * r, np.zeros(size)])
    both = np.linalg.lstsq(rows, right)[0]
    np.testing.assert_allclose(a["best_error"], both[size:], rtol=1e-9, atol=1e-10)
    covariance = np.linalg.inv(rows.T @ rows)[size:, size:]
    np.testing.assert_allclose(a["best_covariance"].reshape(size, size), covariance, rtol=1e-8, atol=1e-9)
    assert cost == pytest.approx(float(np.sum((rows @ both - right) ** 2)), rel=1e-9)


def test_no_solution_is_said() -> None:
    memory = filter_of(geometry(np.random.default_rng(0)), BallNoise())
    memory.arrays["p"][:] = np.nan
    assert step_of(memory, solve_robust)(1.0)[0] == -1


def test_a_copy_goes_its_own_way() -> None:
    rng = np.random.default_rng(2)
    g = geometry(rng)
    filter = BallFilter(g, np.zeros(2), np.eye(3), BallNoise())
    messages = list(rolling(g, rng, 6))
    for message in messages[:4]:
        filter.update(H, *message)
    other, position = deepcopy(filter), filter.state.position.copy()
    other.update(H, *messages[4])
    np.testing.assert_array_equal(filter.state.position, position)
    filter.update(H, *messages[4])
    np.testing.assert_array_equal(filter.state.position, other.state.position)
    assert np.abs(filter.state.position - position).max() > 0.0


def test_joints_are_followed_the_same_by_both_back_ends() -> None:
    """Random motions with jumps that are undone, arms that are flung and a gap; what counted is the same to the bit."""
    rng = np.random.default_rng(6)
    speed, angle = np.array([2.0, np.inf, 0.5]), rng.normal(size=3)
    one, other = (made(b, JointTracker, angle, 1e-5, 1e-3, 7e-4, speed=speed) for b in ("compiled", "interpreted"))
    jumps = 0
    for k in range(80):
        angle = angle + 0.003 * rng.normal(size=3) + 0.3 * (rng.random(3) < 0.02)
        reading = angle + rng.normal(size=3) * (rng.random(3) < 0.05)
        for tracker in (one, other):
            tracker.update(0.2 if k == 40 else H, reading)
        np.testing.assert_array_equal(one.jumped, other.jumped)
        np.testing.assert_array_equal(one.surprised, other.surprised)
        np.testing.assert_array_equal(one.arrays["reading"], other.arrays["reading"])
        np.testing.assert_allclose(one.angle, other.angle, atol=1e-9)
        np.testing.assert_allclose(one.rate, other.rate, atol=1e-7)
        jumps += int(one.jumped.sum())
    assert 3 < jumps < 200
