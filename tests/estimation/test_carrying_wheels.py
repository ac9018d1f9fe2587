"""Bases that stand on two wheels of four. Truth: the base's way, which only those two show, by formula and in MuJoCo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from wheels_on_paper import UNEVEN, Drawn, prior, record

from toys import robot
from wbmpc.bases.swerve.calibration import fit_wheels
from wbmpc.bases.swerve.estimator import known_weights
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.odometry_filter import OdometryNoise
from wbmpc.log import Log
from wbmpc.settings import ControlSettings
from wbmpc.studies.pankert2022.reference_drive import SwerveCalibrateSettings, drive
from wbmpc.studies.pankert2022.wheel_log import record_of

CALM = OdometryNoise(along=1e-5, across=1e-5, gyro_bias=0.01)


def everywhere(t: float) -> np.ndarray:
    """Forwards, sideways and turning, one after the other, never at rest."""
    phase = 0.25 * t
    return np.array([0.3 * np.cos(phase), 0.3 * np.sin(phase), 0.3 * np.sin(0.6 * t) + 0.05])


@pytest.mark.parametrize("carry", [(0, 2), (1, 3)])
def test_wheels_that_the_base_does_not_follow_are_left_out(carry: tuple[int, int]) -> None:
    """The others are turned aside now and then, and the base goes on as before."""
    base = Drawn(UNEVEN, 1, zero=2e-3, radius=2e-3, motion=everywhere, length=120.0, period=0.04)
    data = record(base, (0.005, 0.005, 0.002))
    slide, steer = [k for k in range(4) if k not in carry], data.steer.copy()
    steer[:, slide] += 0.01 * (np.sin(np.outer(data.times, [0.6, 0.9])) > 0.0)
    found = fit_wheels(UNEVEN, replace(data, steer=steer), prior=prior(), noise=CALM).calibration
    zero, radius = found.std
    both = list(carry)
    assert np.abs((found.steer_offset - base.zeros)[both] / zero[both]).max() < 4.0
    assert np.abs((found.wheel_radius / UNEVEN.wheel_radius - base.factors)[both] / radius[both]).max() < 4.0
    assert zero[both].max() < 0.5e-3 and zero[slide].min() > 0.03
    weights = known_weights(found)
    assert weights is not None and np.argmax(weights) in carry and weights[slide].max() < 0.05


def test_wheels_that_carry_alike_all_count() -> None:
    """The base follows a wheel that is turned aside as far as the fit of all wheels says."""
    base = Drawn(UNEVEN, 1, zero=2e-3, radius=2e-3, motion=everywhere, length=40.0, period=0.04)
    found = fit_wheels(UNEVEN, record(base, (0.005, 0.005, 0.002)), prior=prior(), noise=CALM).calibration
    assert found.std[0].max() < 1.5e-3 and known_weights(found) is None


def test_a_simulated_base_on_a_diagonal_is_calibrated_by_its_loaded_wheels() -> None:
    """In MuJoCo, whose contacts say what wheels carry: their zeros to 0.5 mrad, of 3 mrad drawn; the others are left open."""
    name = "swerve-fixed-ur10"
    settings = SwerveCalibrateSettings(
        robot=name, stroke=1.0, turn=1.5, settle_time=2.0, pause=0.2, control=ControlSettings(rate=200.0)
    )
    log = Log()
    _, plant, reason = drive(robot(name), settings, 2, log, odometry=False)
    loaded = np.sort(np.argsort(plant.truth().wheel_force)[2:])
    assert not reason and loaded.tolist() == [0, 3] and plant.truth().wheel_force[loaded].min() > 400.0
    found = fit_wheels(swerve_base(robot(name)).geometry, record_of(log)).calibration
    assert np.abs(found.steer_offset - plant.offsets["steer"])[loaded].max() < 0.5e-3 < found.std[0][[1, 2]].min()
