"""The filter over wheels, gyro and global poses. Truth: bases moved by formula (rigid-body motion, exact on SE(2)),
chi-square bounds for the error over the covariance, finite differences, batch least squares for the linear case."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.estimation import FusedOdometry, OdometryNoise, WheelCalibration
from wbmpc.estimation.odometry import fit_twist
from wheels_on_paper import Drawn, ring

FOUR = ring(4)


def calm(**changes: float) -> OdometryNoise:
    return OdometryNoise(**{"along": 0.0, "across": 0.0, **changes})


def filtered(base: Drawn, noise: OdometryNoise | None = None, known: WheelCalibration | None = None, lidar=None, **more):  # type: ignore[no-untyped-def]
    """The filter after the whole way; ``lidar``: (period in messages, messages late, standard deviations (3))."""
    doubt = WheelCalibration.unknown(base.geometry, base.zero, base.radius, 0.0)
    noise = noise or calm(gyro=base.gyro, gyro_bias=base.bias)
    odometry = FusedOdometry(base.geometry, [0.4, -0.3, 0.2], calibration=known or doubt, noise=noise, **more)
    for k, (t, leg, steer, wheel, gyro) in enumerate(base):
        odometry.update(t, leg, steer, wheel, gyro if base.gyro else None)
        if lidar and k >= lidar[1] and (k - lidar[1]) % lidar[0] == 0:
            seen = base.poses[k - lidar[1]] + np.array(lidar[2]) * base.rng.normal(size=3)
            odometry.correct(t - lidar[1] * base.period, seen, np.diag(np.square(lidar[2])))
    return odometry


def squared(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def consistent(values: list[float], degrees: int, level: float = 0.998) -> bool:
    """Whether the sum of normalised errors squared lies within its two-sided chi-square bounds."""
    low, high = chi2.ppf([(1 - level) / 2, (1 + level) / 2], degrees * len(values))
    return bool(low < sum(values) < high)


# ---------------------------------------------------------------------- derivatives
@pytest.mark.parametrize("geometry", [FOUR, ring(2), ring(3, hinged=False), ring(6)], ids=["4", "2", "3 fixed", "6"])
def test_derivatives_of_the_twist_are_finite_differences(geometry) -> None:  # type: ignore[no-untyped-def]
    rng, n = np.random.default_rng(1), geometry.modules
    before = tuple(rng.normal(size=(3, n)))
    now = tuple(b + 0.05 * rng.normal(size=n) for b in before)
    radius = geometry.wheel_radius * (1.0 + 0.01 * rng.normal(size=n))
    moved = fit_twist(geometry, radius, before, now)
    zeros, factors = np.empty((3, n)), np.empty((3, n))
    for i, unit in enumerate(1e-6 * np.eye(n)):
        at = lambda s, u=unit: fit_twist(geometry, radius, (before[0], before[1] - s * u, before[2]), (now[0], now[1] - s * u, now[2])).twist
        zeros[:, i] = (at(1) - at(-1)) / 2e-6
        of = lambda s, u=unit: fit_twist(geometry, radius * (1 + s * u), before, now).twist
        factors[:, i] = (of(1) - of(-1)) / 2e-6
    np.testing.assert_allclose(moved.by_steer_zero(), zeros, atol=1e-10)
    np.testing.assert_allclose(moved.by_radius(), factors, atol=1e-10)
    assert np.abs(moved.twist).max() > 1e-3


# ---------------------------------------------------------------------- consistency
LEVELS = {
    "slip of 0.2 mm/√s": {"slip": 2e-4},
    "slip of 2 mm/√s": {"slip": 2e-3},
    "slip of 6 mm/√s": {"slip": 6e-3},
    "no gyro": {"slip": 2e-3, "gyro": 0.0},
    "zeros of 3 mrad": {"slip": 5e-4, "zero": 3e-3},
    "radii of 0.3 %": {"slip": 5e-4, "radius": 0.003},
    "a bad gyro": {"slip": 2e-3, "gyro": 5e-3, "bias": 0.1},
    "everything": {"slip": 3e-3, "zero": 3e-3, "radius": 0.003, "gyro": 5e-4},
}


@pytest.mark.parametrize("level", LEVELS)
def test_covariance_fits_the_errors(level: str) -> None:
    """Slip is found from the wheels' contradiction alone: the filter is told nothing of its size."""
    pose, bias, wheels = [], [], []
    for seed in range(40):
        base = Drawn(FOUR, seed, **LEVELS[level])
        odometry = filtered(base)
        pose.append(squared(base.poses[-1] - odometry.pose, odometry.covariance))
        if base.gyro:
            bias.append((odometry.gyro_bias - base.drift) ** 2 / odometry._state.p[3, 3])
    assert consistent(pose, 3), np.mean(pose)
    assert not bias or consistent(bias, 1), np.mean(bias)
