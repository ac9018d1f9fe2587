"""Self-calibration of wheels. Truth: zeros and radii put into a base that moves by formula; chi-square bounds for what is
found over its covariance; weighted least squares on the whole record, by finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2
from wheels_on_paper import UNEVEN, Drawn, prior, record, ring

from effort import draws
from wbmpc.bases.swerve.calibration import fit_wheels
from wbmpc.bases.swerve.odometry_filter import OdometryNoise
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry
from wbmpc.bases.swerve.wheel_record import WheelRecord
from wbmpc.errors import InputError

CALM = OdometryNoise(along=1e-5, across=1e-5, gyro_bias=0.01)


def everywhere(t: float) -> np.ndarray:
    """Forwards, sideways and turning, one after the other, never at rest."""
    phase = 0.25 * t
    return np.array([0.3 * np.cos(phase), 0.3 * np.sin(phase), 0.3 * np.sin(0.6 * t) + 0.05])


def drawn(seed: int, length: float = 30.0, **more: float) -> Drawn:
    return Drawn(UNEVEN, seed, zero=2e-3, radius=2e-3, motion=everywhere, length=length, period=0.04, **more)


def test_zeros_and_radii_are_found_within_their_covariance() -> None:
    """Over bases: errors over covariance are chi-square with 2n degrees, and much smaller than what was known before."""
    values, left = [], []
    for seed in range(draws(6, 20)):
        base = drawn(seed)
        found = fit_wheels(UNEVEN, record(base, (0.005, 0.005, 0.002)), prior=prior(), noise=CALM).calibration
        error = np.concatenate(
            [found.steer_offset - base.zeros, found.wheel_radius / UNEVEN.wheel_radius - base.factors]
        )
        values.append(error @ np.linalg.solve(found.covariance, error))
        left.append(error[:4].mean())
    low, high = chi2.ppf([0.001, 0.999], 8 * len(values))
    assert low < sum(values) < high, np.mean(values)
    assert np.sqrt(np.mean(np.square(left))) < 0.4 * 2e-3 / 2.0  # the mean zero was uncertain by 2 mrad / √4


def test_it_is_the_least_squares_fit_of_the_whole_record() -> None:
    """Without slip the filter's answer is that of a fit of (zeros, radii) to all poses at once, to a part of its std: the
    filter takes what wrong radii make wheels contradict each other for slip."""
    base = drawn(3, length=20.0, gyro=0.0)
    data = record(base, (0.002, 0.002, 0.001))
    known = prior()

    def apart(parameters: np.ndarray) -> np.ndarray:
        zeros, factors, start = parameters[:4], parameters[4:8], parameters[8:]
        odometry = WheelOdometry(UNEVEN, start, wheel_radius=UNEVEN.wheel_radius * (1.0 + factors), steer_offset=zeros)
        poses = [odometry.update(*sample) for sample in zip(data.leg, data.steer, data.wheel, strict=True)]
        at = np.array(poses)[::5]
        std = np.sqrt(np.diag(known.covariance))
        return np.concatenate([((at - data.places) / data.place_std).ravel(), parameters[:8] / std])

    fit = least_squares(apart, np.concatenate([np.zeros(8), data.places[0]])).x
    data = WheelRecord(data.times, data.leg, data.steer, data.wheel, data.place_times, data.places, data.place_std)
    found = fit_wheels(UNEVEN, data, prior=known, noise=OdometryNoise(along=1e-6, across=1e-6)).calibration
    std = found.std
    assert np.abs((found.steer_offset - fit[:4]) / std[0]).max() < 0.6
    assert np.abs((found.wheel_radius / UNEVEN.wheel_radius - 1.0 - fit[4:8]) / std[1]).max() < 0.6
    assert std[0].max() < 1.5e-3


def test_two_surveyed_poses_show_the_direction() -> None:
    """A straight stroke of 2 m between two poses known to 0.5 mm: the mean zero to a fraction of a mrad, not each zero."""
    base = Drawn(UNEVEN, 1, motion=lambda t: np.array([0.25, 0.0, 0.0]), length=8.0, zero=2e-3, gyro=0.0)
    data = record(base, (5e-4, 5e-4, 2e-4), every=400)
    assert len(data.places) == 2
    found = fit_wheels(UNEVEN, WheelRecord(*[getattr(data, f) for f in FIELDS]), prior=prior(), noise=CALM).calibration
    assert abs(found.steer_offset.mean() - base.zeros.mean()) < 1e-3
    assert found.covariance[:4, :4].mean() ** 0.5 < 0.5e-3 < 2e-3 / 2.0
    assert found.std[0].max() > 1e-3  # what the drive did not show stays uncertain


FIELDS = ("times", "leg", "steer", "wheel", "place_times", "places", "place_std")


#: Of the zeros of four modules on a circle the one combination that moves nothing while the legs stand.
HIDDEN = np.array([1.0, -1.0, 1.0, -1.0]) / 4.0


def straight_on(seed: int, brake: float) -> tuple[Drawn, WheelRecord]:
    """Four modules on a circle driven forwards, then sideways; wheels that point where they go leave their legs where they are."""
    there = lambda t: np.array([0.3, 0.0, 0.0]) if t < 3.0 else np.array([0.0, 0.3, 0.0])
    base = Drawn(ring(4), seed, slip=3e-4, zero=2e-3, motion=there, length=6.0, period=0.04)
    base.legs = lambda t: (np.zeros(4), np.zeros(4))  # type: ignore[method-assign]
    data = record(base, (0.005, 0.005, 0.002))
    return base, replace(data, brake=np.full((len(data.times), 4), brake))


def test_open_legs_show_every_zero() -> None:
    """Closed brakes leave one combination as uncertain as it was; with open ones it is found, within its own std over bases."""
    apart, nothing = [], WheelCalibration.unknown(ring(4), 2e-3, 0.0, 0.0)
    for seed in range(draws(4, 8)):
        base, data = straight_on(seed, 1.0)
        found = fit_wheels(base.geometry, data, prior=nothing, noise=CALM).calibration
        std = np.sqrt(HIDDEN @ found.covariance[:4, :4] @ HIDDEN)
        assert std < 0.4e-3
        apart.append(HIDDEN @ (found.steer_offset - base.zeros) / std)
    low, high = chi2.ppf([0.001, 0.999], len(apart))
    assert low < np.sum(np.square(apart)) < high, apart
    base, data = straight_on(0, 0.0)
    shut = fit_wheels(base.geometry, data, prior=nothing, noise=CALM).calibration
    assert np.sqrt(HIDDEN @ shut.covariance[:4, :4] @ HIDDEN) > 0.99e-3  # 2 mrad / √4


@pytest.mark.parametrize("hanging", [0, 2])
def test_a_wheel_in_the_air_is_left_out(hanging: int, caplog: pytest.LogCaptureFixture) -> None:
    """It turns and rolls by numbers that have nothing to do with the base: the others are found as without it, of it nothing is
    known. One whose zero alone is far off is no such wheel."""
    base, rest = drawn(5, length=20.0), np.arange(4) != hanging
    data = record(base, (0.005, 0.005, 0.002))
    steer, wheel, t = data.steer.copy(), data.wheel.copy(), data.times
    turned = WheelRecord(**{**vars(data), "steer": steer + 0.05 * ~rest})
    found = fit_wheels(UNEVEN, turned, prior=WheelCalibration.unknown(UNEVEN, 0.05, 2e-3, 0.0), noise=CALM).calibration
    error = found.steer_offset[hanging] - base.zeros[hanging] - 0.05
    assert not caplog.records and abs(error) < 4.0 * found.std[0][hanging] < 0.1
    steer[:, hanging] += 0.05 * np.sin(1.3 * t)
    wheel[:, hanging] += 0.05 * np.cumsum(np.sign(np.sin(0.7 * t)) * np.gradient(wheel[:, hanging]))
    found = fit_wheels(
        UNEVEN, WheelRecord(**{**vars(data), "steer": steer, "wheel": wheel}), prior=prior(), noise=CALM
    ).calibration
    assert f"wheel {hanging + 1} of 4" in caplog.text
    apart = [found.steer_offset - base.zeros, found.wheel_radius / UNEVEN.wheel_radius - base.factors]
    for error, std in zip(apart, found.std, strict=True):
        assert np.abs(error / std)[rest].max() < 4.0 and std[rest].max() < 3e-3 < 0.01 < std[hanging]


def test_calibrated_odometry_drifts_less() -> None:
    errors = {"before": [], "after": []}
    for seed in range(5):
        base = drawn(seed)
        found = fit_wheels(UNEVEN, record(base, (0.005, 0.005, 0.002)), prior=prior(), noise=CALM).calibration
        again = drawn(seed, length=40.0)
        samples = list(again)
        np.testing.assert_array_equal(again.zeros, base.zeros)
        for name, known in (("before", WheelCalibration.unknown(UNEVEN, 0.0, 0.0, 0.0)), ("after", found)):
            odometry = WheelOdometry(
                UNEVEN, again.poses[0], wheel_radius=known.wheel_radius, steer_offset=known.steer_offset
            )
            for _, leg, steer, wheel, _ in samples:
                odometry.update(leg, steer, wheel)
            errors[name].append(np.hypot(*(odometry.pose - again.poses[-1])[:2]))
    assert np.median(errors["after"]) < 0.5 * np.median(errors["before"])
    assert np.median(errors["before"]) > 5e-3


# ---------------------------------------------------------------------- wheels that are far off
def far_off(seed: int, maximum: float, length: float = 12.0) -> tuple[Drawn, WheelRecord]:
    """A base whose zeros are up to ``maximum`` [rad] off and whose radii up to 2 %, on paper."""
    base = Drawn(ring(4, hinged=False), seed, motion=everywhere, length=length, period=0.04)
    base.zeros, base.factors = base.rng.uniform(-maximum, maximum, 4), 1.0 + base.rng.uniform(-0.02, 0.02, 4)
    return base, record(base, (0.005, 0.005, 0.002))


def test_wheels_far_beyond_what_was_believed_are_found_with_an_honest_std() -> None:
    """Zeros up to 50 mrad and radii up to 2 %, believed to 2 mrad and 0.2 %: errors squared over covariance, over bases."""
    values = []
    for seed in range(3):
        base, data = far_off(seed, 0.05)
        found = fit_wheels(base.geometry, data, noise=CALM).calibration
        error = np.concatenate([found.steer_offset - base.zeros, found.wheel_radius / 0.1 - base.factors])
        values.append(error @ np.linalg.solve(found.covariance, error))
        assert abs(error[:4].mean()) < 4e-3
    assert sum(values) < chi2.ppf(0.999, 8 * len(values)), values


@pytest.mark.parametrize(("zero", "radius"), [(0.02, 0.0), (0.06, 0.0), (0.0, 0.02)])
def test_a_survey_of_two_poses_shows_errors_that_nobody_expected(zero: float, radius: float) -> None:
    """A straight stroke between two poses: exact kinematics say by how much the second lies aside or farther."""
    base = Drawn(
        ring(4, hinged=False), 0, motion=lambda t: np.array([0.3, 0.0, 0.0]), length=8.0, period=0.04, gyro=0.0
    )
    base.zeros, base.factors = np.full(4, zero), np.full(4, 1.0 + radius)
    fit = fit_wheels(base.geometry, record(base, (1e-3, 1e-3, 1e-3), every=200), noise=CALM)
    assert fit.used == fit.given == 2
    found, std = fit.calibration, fit.calibration.covariance[:4, :4].mean() ** 0.5
    assert abs(found.steer_offset.mean() - zero) < 3.0 * std < 6e-3
    assert found.wheel_radius.mean() / 0.1 - 1.0 == pytest.approx(radius, abs=3e-3)
    # of four zeros a straight stroke shows the sum and what turns the base: two stay as they were, and are named
    weights, left = fit.hidden()["steer zeros"]
    assert len(left) >= 2
    np.testing.assert_allclose(weights.sum(axis=1), 0.0, atol=0.05)
    np.testing.assert_allclose(left, fit.previous.std[0].max(), rtol=0.06)


@pytest.mark.parametrize("factor", [-1.0, 180.0 / np.pi])
def test_a_gyro_that_contradicts_the_rest_is_named(factor: float) -> None:
    """With the sign reversed, or in degrees: nothing is wrong with angles or poses."""
    base, data = far_off(1, 2e-3, 6.0)
    with pytest.raises(InputError, match=r"channel 'gyro' contradicts .* in rad/s"):
        fit_wheels(base.geometry, replace(data, gyro=factor * data.gyro))


def test_records_that_no_wheels_explain_are_rejected() -> None:
    base, data = far_off(1, 2e-3, 6.0)
    with pytest.raises(InputError, match="in radians"):
        fit_wheels(base.geometry, replace(data, steer=np.degrees(data.steer)))
    elsewhere = data.places + 0.5 * base.rng.normal(size=data.places.shape)
    with pytest.raises(InputError, match=r"global poses fit what wheels and gyro say, .*check units"):
        fit_wheels(base.geometry, replace(data, places=elsewhere))
    stood = replace(
        data, wheel=0.0 * data.wheel, gyro=0.0 * data.gyro, places=np.tile(data.places[:1], (len(data.places), 1))
    )
    with pytest.raises(InputError, match="shows nothing of the wheels"):
        fit_wheels(base.geometry, stood)
