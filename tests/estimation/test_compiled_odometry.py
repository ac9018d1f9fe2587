"""The compiled odometry against the same source as ordinary Python, and against NumPy's algebra."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from wheels_on_paper import fit_twist, ring

from toys import made
from wbmpc import lie
from wbmpc.bases.swerve.fused_odometry import FusedOdometry
from wbmpc.bases.swerve.odometry_filter import OdometryNoise
from wbmpc.bases.swerve.odometry_memory import OdometryMemory
from wbmpc.bases.swerve.odometry_step import BIAS, LATE, WHEELS, Interval

FOUR = ring(4)


@pytest.mark.parametrize("modules", [2, 4])
@pytest.mark.parametrize("seed", range(3))
def test_both_back_ends_say_the_same(modules: int, seed: int) -> None:
    """Random messages, with and without gyro and weights, a gap, a hinge that opens and a global pose; 1e-12 of each deviation."""
    rng, n = np.random.default_rng(seed), modules
    both = [made(b, FusedOdometry, ring(n), pose_std=(0.01, 0.01, 0.01)) for b in ("compiled", "interpreted")]
    leg, steer, wheel, t = np.zeros(n), rng.normal(size=n), rng.normal(size=n), 0.0
    for k in range(30):
        t += 0.3 if k == 12 else rng.uniform(1e-3, 2e-2)
        leg, steer, wheel = (a + 0.02 * rng.normal(size=n) for a in (leg, steer, wheel))
        gyro = None if k % 5 == 4 else 0.3 * rng.normal()
        weights = rng.uniform(0.01, 1.0, n) if k % 7 == 6 else None
        brake = np.arange(n) % 2 if k > 20 else None
        for odometry in both:
            odometry.update(t, leg, steer, wheel, gyro, brake, weights)
            if k == 25:
                assert odometry.correct(t - 0.02, odometry.pose + 0.01, 1e-4 * np.eye(3))
        a, b = (odometry._state for odometry in both)
        spread = np.sqrt(np.diag(b.p)) + 1e-9
        np.testing.assert_allclose(a.mean, b.mean, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(a.p / np.outer(spread, spread), b.p / np.outer(spread, spread), atol=1e-12)
        np.testing.assert_allclose(both[0].twist, both[1].twist, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(both[0].slip, both[1].slip, rtol=1e-12)


@pytest.mark.parametrize(("gyro", "freezes"), [(True, False), (True, True), (False, False)])
@pytest.mark.parametrize("seed", range(4))
def test_one_step_is_that_of_the_textbook(gyro: bool, freezes: bool, seed: int) -> None:
    """Truth: A P Aᵀ + Q and the gain of correlated noise, by matrices of NumPy, with a derivative by differences; where nothing is
    learned of bias and wheels, the covariance of any gain (Joseph's form), which has zeros there."""
    rng, noise = np.random.default_rng(seed), OdometryNoise()
    memory = OdometryMemory(FOUR, np.full(4, FOUR.wheel_radius), noise)
    a, size, h, turn = memory.arrays, WHEELS + 8, 0.01, 0.02
    root = rng.normal(size=(size, size))
    p, q = root @ root.T, np.diag(rng.uniform(0.1, 1.0, 3))
    a["mean"][:], a["p"][:], a["covariance"][:] = rng.normal(size=size), p.ravel(), q.ravel()
    for name in ("twist", "by_wheels", "correction"):
        a[name][:] = 0.3 * rng.normal(size=a[name].size)
    lost = (0.02, 0.0 if gyro else 0.03)
    a["interval"][:] = [h, turn, float(gyro), 1e-4, lost[0] / 0.5, lost[1] / 0.5, 0.5, float(freezes), 0.0]
    a["lasted"][:] = 0.7  # no longer than the wheels have slid: 0.5 s
    mean, by = a["mean"].copy(), a["by_wheels"].reshape(3, 8).copy()
    twist = a["twist"] + by @ (mean[WHEELS:] - a["correction"])
    memory.advance()

    moved = np.concatenate([lie.se2_step(mean[:3], twist), mean[3:]])
    way, yaw = moved[:2] - mean[:2], mean[2] + 0.5 * twist[2]
    g = np.array([[np.cos(yaw), -np.sin(yaw), -way[1] / 2], [np.sin(yaw), np.cos(yaw), way[0] / 2], [0, 0, 1.0]])
    f = np.eye(size)
    f[0, 2], f[1, 2], f[LATE, LATE], f[:3, WHEELS:] = -way[1], way[0], 0.0, g @ by
    rate = turn / h - mean[BIAS] if gyro else twist[2] / h
    late, behind = (rate * noise.age) ** 2 + a["interval"][Interval.COUNTS], rate * noise.mean_age
    after = f @ p @ f.T
    after[:3, :3] += g @ q @ g.T + np.diag([lost[0], *lost])
    after[BIAS, BIAS] += noise.gyro_walk**2 * h
    moved[LATE], after[LATE, LATE] = -behind, late
    if gyro:
        row = np.zeros(size)
        row[BIAS], row[LATE], row[WHEELS:] = h, 1.0, by[2]
        variance = row @ p @ row + q[2, 2] + late + noise.gyro**2 * h
        cross = f @ p @ row
        cross[:3] += g @ q[:, 2]
        cross[LATE] -= late
        gain = cross / variance
        if freezes:
            gain[BIAS], gain[WHEELS:] = 0.0, 0.0
        moved += gain * (turn - mean[BIAS] * h - mean[LATE] - behind - twist[2])
        after += np.outer(gain, gain) * variance - np.outer(gain, cross) - np.outer(cross, gain)
    np.testing.assert_allclose(a["mean"], moved, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(a["p"].reshape(size, size), after, rtol=1e-10, atol=1e-10 * np.abs(p).max())


@pytest.mark.parametrize("weighed", [False, True])
def test_the_fit_is_the_least_squares_solution(weighed: bool) -> None:
    """Truth: NumPy's lstsq of the rigid motion by the wheels' displacements."""
    rng = np.random.default_rng(5)
    before = tuple(rng.normal(size=(3, 4)))
    now = tuple(a + 0.1 * rng.normal(size=4) for a in before)
    radius, weights = np.full(4, 0.1), rng.uniform(0.1, 1.0, 4) if weighed else np.ones(4)
    found = fit_twist(FOUR, radius, before, now, weights if weighed else None)
    axes = [FOUR.steer_axes(sample[0]) for sample in (before, now)]
    path = found.rolled[:, None] * np.stack([np.cos(found.heading), np.sin(found.heading)], axis=1)
    moved, middle = path + axes[0] - axes[1], 0.5 * (axes[0] + axes[1])
    rows = np.zeros((4, 2, 3))
    rows[:, 0, 0], rows[:, 1, 1], rows[:, 0, 2], rows[:, 1, 2] = 1.0, 1.0, -middle[:, 1], middle[:, 0]
    root = np.repeat(np.sqrt(weights), 2)
    twist = np.linalg.lstsq(root[:, None] * rows.reshape(8, 3), root * moved.ravel())[0]
    np.testing.assert_allclose(found.twist, twist, rtol=1e-12)
    np.testing.assert_allclose(found.residual, moved - rows @ twist, atol=1e-14)
    np.testing.assert_allclose(found.fit.reshape(3, 8) @ moved.ravel(), twist, rtol=1e-12)


def test_a_copy_goes_its_own_way() -> None:
    odometry = FusedOdometry(FOUR)
    wheel = np.array([0.1, 0.3, -0.2, 0.4])
    for k in range(3):
        odometry.update(0.01 * k, np.zeros(4), np.zeros(4), k * wheel, 0.0)
    other, pose = deepcopy(odometry), odometry.pose
    other.update(0.03, np.zeros(4), np.zeros(4), 3.0 * wheel, 0.0)
    np.testing.assert_array_equal(odometry.pose, pose)
    odometry.update(0.03, np.zeros(4), np.zeros(4), 3.0 * wheel, 0.0)
    np.testing.assert_array_equal(odometry.pose, other.pose)
    assert np.abs(odometry.pose - pose).max() > 1e-3
