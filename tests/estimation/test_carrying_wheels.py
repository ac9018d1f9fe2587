"""Bases that stand on two wheels of four. Truth: the base's way, which only those two show, by formula and in MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2
from wheels_on_paper import Drawn, fit_twist, record

from effort import draws
from toys import robot
from wbmpc import lie
from wbmpc.bases.swerve.calibration import fit_wheels
from wbmpc.bases.swerve.estimator import known_weights
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.odometry_filter import OdometryNoise
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.bases.swerve.wheel_record import WheelRecord
from wbmpc.log import Log
from wbmpc.settings import ControlSettings
from wbmpc.studies.pankert2022.reference_drive import SwerveCalibrateSettings, drive
from wbmpc.studies.pankert2022.wheel_log import record_of

STD = (0.005, 0.005, 0.002)
ROBOT = robot("swerve-fixed-ur10")
FOUR = swerve_base(ROBOT).geometry
PRIOR = WheelCalibration.unknown(FOUR, 2e-3, 2e-3, 0.0)
CALM = OdometryNoise(along=1e-5, across=1e-5, gyro_bias=0.01)


#: Length [s] of each stroke; speeds of the body on them.
STROKE = 12.0
STROKES = np.array(
    [[0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [-0.3, 0.0, 0.0], [0.0, -0.3, 0.0], [0.0, 0.0, 0.3], [0.0, 0.0, -0.3]]
)


def strokes(t: float) -> np.ndarray:
    return STROKES[int(t / STROKE) % 6]


def steered_aside(seed: int, weights: np.ndarray) -> tuple[Drawn, WheelRecord]:
    """A base that goes where its wheels go, by their ``weights``; on each stroke another one is steered 10 mrad off its direction."""
    base = Drawn(FOUR, seed, zero=2e-3, radius=2e-3, motion=strokes, length=24 * STROKE, period=0.08)
    data = record(base, STD, every=1)
    stroke = (data.times / STROKE).astype(int)
    steer = data.steer + 0.01 * (np.arange(4) == ((stroke + stroke // 6) % 4)[:, None])
    radius, samples = FOUR.wheel_radius * base.factors, zip(data.leg, steer - base.zeros, data.wheel, strict=True)
    poses, rates = [base.poses[0]], [0.0]
    for previous, now in pairwise(samples):
        twist = fit_twist(FOUR, radius, previous, now, weights).twist
        poses.append(lie.se2_step(poses[-1], twist))
        rates.append(twist[2] / base.period)
    gyro = np.array(rates) + base.drift + base.gyro / np.sqrt(base.period) * base.rng.normal(size=len(rates))
    places = np.array(poses) + np.array(STD) * base.rng.normal(size=(len(poses), 3))
    return base, replace(data, steer=steer, gyro=gyro, places=places)


@pytest.mark.parametrize("carry", [(0, 3), (1, 2)])
@pytest.mark.parametrize("seed", range(draws(1, 4)))
def test_the_wheels_that_carry_a_base_are_found(carry: tuple[int, int], seed: int) -> None:
    both, others = list(carry), [k for k in range(4) if k not in carry]
    base, data = steered_aside(seed, np.where(np.isin(range(4), carry), 1.0, 1e-6))
    fit = fit_wheels(FOUR, data, prior=PRIOR, noise=CALM)
    found, (zero, radius) = fit.calibration, fit.calibration.std
    assert fit.count[both].all() and not fit.count[others].any()
    assert np.abs((found.steer_offset - base.zeros)[both] / zero[both]).max() < 4.0
    assert np.abs((found.wheel_radius / FOUR.wheel_radius - base.factors)[both] / radius[both]).max() < 4.0
    assert zero[both].max() < 0.5e-3 and zero[others].min() > 0.03
    weights = known_weights(found)
    assert weights is not None and np.argmax(weights) in carry and weights[others].max() < 0.05


@pytest.mark.parametrize("seed", range(draws(2, 6)))
def test_wheels_that_carry_alike_all_count(seed: int) -> None:
    base, data = steered_aside(seed, np.ones(4))
    fit = fit_wheels(FOUR, data, prior=PRIOR, noise=CALM)
    error = np.concatenate(
        [fit.calibration.steer_offset - base.zeros, fit.calibration.wheel_radius / 0.1 - base.factors]
    )
    assert fit.count.all() and known_weights(fit.calibration) is None
    assert error @ np.linalg.solve(fit.calibration.covariance, error) < chi2.ppf(0.9999, 8)


def test_a_simulated_base_on_a_diagonal_is_calibrated_by_its_loaded_wheels() -> None:
    """In MuJoCo, whose contacts say what wheels carry: their zeros to 0.5 mrad, of 3 mrad drawn; the others are left open."""
    settings = SwerveCalibrateSettings(
        robot="swerve-fixed-ur10", stroke=2.0, turn=1.5, settle_time=2.0, pause=0.2, control=ControlSettings(rate=200.0)
    )
    log = Log()
    _, plant, reason = drive(ROBOT, settings, 2, log, odometry=False)
    loaded = np.sort(np.argsort(plant.truth().wheel_force)[2:])
    assert not reason and loaded.tolist() == [0, 3] and plant.truth().wheel_force[loaded].min() > 400.0
    found = fit_wheels(FOUR, record_of(log)).calibration
    assert np.abs(found.steer_offset - plant.offsets["steer"])[loaded].max() < 0.5e-3 < found.std[0][[1, 2]].min()
