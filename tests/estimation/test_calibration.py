"""Self-calibration of wheels. Truth: zeros and radii put into a base that moves by formula; chi-square bounds for what is
found over its covariance; weighted least squares on the whole record, by finite differences."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.optimize import least_squares
from scipy.stats import chi2
from wheels_on_paper import Drawn, ring

from effort import draws
from wbmpc.bases.swerve.calibration import calibrate, fit_wheels, replay
from wbmpc.bases.swerve.wheel_record import WheelRecord
from wbmpc.errors import InputError
from wbmpc.estimation.arm_calibration import load_arm_offset
from wbmpc.estimation.calibration_file import ARM_KEYS, module_keys
from wbmpc.estimation.odometry_filter import OdometryNoise
from wbmpc.estimation.wheel_calibration import WheelCalibration
from wbmpc.estimation.wheel_odometry import WheelOdometry

#: Modules that are not on one circle: every zero and every radius shows in some motion.
UNEVEN = ring(4)
UNEVEN.hinge[:] += [[0.3, 0.0], [0.0, 0.1], [-0.1, -0.2], [0.1, 0.0]]
CALM = OdometryNoise(along=1e-5, across=1e-5, gyro_bias=0.01)


def everywhere(t: float) -> np.ndarray:
    """Forwards, sideways and turning, one after the other, never at rest."""
    phase = 0.25 * t
    return np.array([0.3 * np.cos(phase), 0.3 * np.sin(phase), 0.3 * np.sin(0.6 * t) + 0.05])


def record(base: Drawn, std: tuple[float, float, float], every: int = 5) -> WheelRecord:
    """What a localization and the encoders of that base say."""
    messages = list(base)
    times, leg, steer, wheel, gyro = (np.array(part) for part in zip(*messages, strict=True))
    places = np.array(base.poses[::every])
    seen = places + np.array(std) * base.rng.normal(size=places.shape)
    return WheelRecord(times, leg, steer, wheel, times[::every], seen, np.tile(std, (len(seen), 1)), gyro)


def drawn(seed: int, length: float = 30.0, **more: float) -> Drawn:
    return Drawn(UNEVEN, seed, zero=2e-3, radius=2e-3, motion=everywhere, length=length, period=0.04, **more)


def prior() -> WheelCalibration:
    return WheelCalibration.unknown(UNEVEN, 2e-3, 2e-3, 0.0)


def test_zeros_and_radii_are_found_within_their_covariance() -> None:
    """Over bases: errors over covariance are chi-square with 2n degrees, and much smaller than what was known before."""
    values, left = [], []
    for seed in range(draws(6, 20)):
        base = drawn(seed)
        found = calibrate(UNEVEN, record(base, (0.005, 0.005, 0.002)), prior=prior(), noise=CALM)
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
    found = calibrate(UNEVEN, data, prior=known, noise=OdometryNoise(along=1e-6, across=1e-6))
    std = found.std
    assert np.abs((found.steer_offset - fit[:4]) / std[0]).max() < 0.6
    assert np.abs((found.wheel_radius / UNEVEN.wheel_radius - 1.0 - fit[4:8]) / std[1]).max() < 0.6
    assert std[0].max() < 1.5e-3


def test_two_surveyed_poses_show_the_direction() -> None:
    """A straight stroke of 2 m between two poses known to 0.5 mm: the mean zero to a fraction of a mrad, not each zero."""
    base = Drawn(UNEVEN, 1, motion=lambda t: np.array([0.25, 0.0, 0.0]), length=8.0, zero=2e-3, gyro=0.0)
    data = record(base, (5e-4, 5e-4, 2e-4), every=400)
    assert len(data.places) == 2
    found = calibrate(UNEVEN, WheelRecord(*[getattr(data, f) for f in FIELDS]), prior=prior(), noise=CALM)
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
        found = calibrate(base.geometry, data, prior=nothing, noise=CALM)
        std = np.sqrt(HIDDEN @ found.covariance[:4, :4] @ HIDDEN)
        assert std < 0.4e-3
        apart.append(HIDDEN @ (found.steer_offset - base.zeros) / std)
    low, high = chi2.ppf([0.001, 0.999], len(apart))
    assert low < np.sum(np.square(apart)) < high, apart
    base, data = straight_on(0, 0.0)
    shut = calibrate(base.geometry, data, prior=nothing, noise=CALM)
    assert np.sqrt(HIDDEN @ shut.covariance[:4, :4] @ HIDDEN) > 0.99e-3  # 2 mrad / √4


@pytest.mark.parametrize("hanging", [0, 2])
def test_a_wheel_in_the_air_is_left_out(hanging: int, caplog: pytest.LogCaptureFixture) -> None:
    """It turns and rolls by numbers that have nothing to do with the base: the others are found as without it, it stays as uncertain as it
    was. One whose zero alone is far off is no such wheel."""
    base, rest = drawn(5, length=20.0), np.arange(4) != hanging
    data = record(base, (0.005, 0.005, 0.002))
    steer, wheel, t = data.steer.copy(), data.wheel.copy(), data.times
    turned = WheelRecord(**{**vars(data), "steer": steer + 0.05 * ~rest})
    found = calibrate(UNEVEN, turned, prior=WheelCalibration.unknown(UNEVEN, 0.05, 2e-3, 0.0), noise=CALM)
    error = found.steer_offset[hanging] - base.zeros[hanging] - 0.05
    assert not caplog.records and abs(error) < 4.0 * found.std[0][hanging] < 0.1
    steer[:, hanging] += 0.05 * np.sin(1.3 * t)
    wheel[:, hanging] += 0.05 * np.cumsum(np.sign(np.sin(0.7 * t)) * np.gradient(wheel[:, hanging]))
    found = calibrate(UNEVEN, WheelRecord(**{**vars(data), "steer": steer, "wheel": wheel}), prior=prior(), noise=CALM)
    assert f"wheel {hanging + 1} of 4" in caplog.text
    apart = [found.steer_offset - base.zeros, found.wheel_radius / UNEVEN.wheel_radius - base.factors]
    for error, std in zip(apart, found.std, strict=True):
        assert np.abs(error / std)[rest].max() < 4.0 and std[rest].max() < 3e-3 < 0.01 < std[hanging]


def test_calibrated_odometry_drifts_less() -> None:
    errors = {"before": [], "after": []}
    for seed in range(5):
        base = drawn(seed)
        found = calibrate(UNEVEN, record(base, (0.005, 0.005, 0.002)), prior=prior(), noise=CALM)
        again = drawn(seed, length=40.0)
        samples = list(again)
        np.testing.assert_array_equal(again.zeros, base.zeros)
        for name, known in (("before", WheelCalibration.exact(UNEVEN)), ("after", found)):
            odometry = WheelOdometry(
                UNEVEN, again.poses[0], wheel_radius=known.wheel_radius, steer_offset=known.steer_offset
            )
            for _, leg, steer, wheel, _ in samples:
                odometry.update(leg, steer, wheel)
            errors[name].append(np.hypot(*(odometry.pose - again.poses[-1])[:2]))
    assert np.median(errors["after"]) < 0.5 * np.median(errors["before"])
    assert np.median(errors["before"]) > 5e-3


# ---------------------------------------------------------------------- files
NAMES = ["a", "b", "c", "d"]


def test_file_keeps_the_numbers(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    zeros, variances = 0.1 * rng.normal(size=(2, 4)), np.diag(0.05 * rng.uniform(size=8))
    saved = WheelCalibration(*zeros, 0.1 + 0.01 * rng.uniform(size=4), variances)
    saved.save(tmp_path / "c.yaml", NAMES)
    loaded = WheelCalibration.load(tmp_path / "c.yaml", UNEVEN, NAMES)
    for name in ("steer_offset", "leg_offset", "wheel_radius", "covariance"):
        np.testing.assert_allclose(getattr(loaded, name), getattr(saved, name), rtol=1e-12)


@pytest.mark.parametrize("known", [1.0, 0.0])  # a doubt that is 0 has no correlation
def test_file_keeps_what_is_known_of_sums(known: float, tmp_path: Path) -> None:
    """Truth: the covariance, formed as a product; in another order of the modules its rows are in that order too."""
    root = np.random.default_rng(1).normal(size=(8, 8)) * 1e-3
    root[5] *= known
    saved = replace(WheelCalibration.unknown(UNEVEN), covariance=root @ root.T)
    saved.save(tmp_path / "c.yaml", NAMES)
    np.testing.assert_allclose(
        WheelCalibration.load(tmp_path / "c.yaml", UNEVEN, NAMES).covariance, root @ root.T, atol=1e-18
    )
    turned = WheelCalibration.load(tmp_path / "c.yaml", UNEVEN, NAMES[::-1]).covariance
    order = [3, 2, 1, 0, 7, 6, 5, 4]
    np.testing.assert_allclose(turned, (root @ root.T)[np.ix_(order, order)], atol=1e-18)


def test_a_file_without_correlation_says_that_errors_are_independent(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(
        "modules: {a: {steer_offset_std: 0.002}, b: {wheel_radius_std: 0.001}, c: {}, d: {}}"
    )
    loaded = WheelCalibration.load(tmp_path / "c.yaml", UNEVEN, NAMES)
    np.testing.assert_allclose(loaded.covariance, np.diag([4e-6, 0, 0, 0, 0, 1e-6, 0, 0]))


ROWS = "{a: {}, b: {}, c: {}, d: {}}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wheels: {}", "unknown key 'wheels'"),
        ("robot: toy", "one key 'modules'"),
        ("modules: {a: {}}", "no entry for b, c, d"),
        ("modules: {aa: {}, b: {}, c: {}, d: {}}", "did you mean 'a'"),
        ("modules: {a: {steer_offsets: 1}, b: {}, c: {}, d: {}}", "did you mean 'modules.a.steer_offset'|steer_offset"),
        ("modules: {a: {steer_offset: x}, b: {}, c: {}, d: {}}", "modules.a.steer_offset': a finite number"),
        ("modules: {a: {steer_offset: .nan}, b: {}, c: {}, d: {}}", "a finite number"),
        ("modules: {a: {wheel_radius: -0.1}, b: {}, c: {}, d: {}}", "from 0.07 to 0.13 m"),
        ("modules: {a: 3, b: {}, c: {}, d: {}}", "a mapping is needed"),
        ("modules: [", "not valid YAML"),
        (f"modules: {ROWS}\ncorrelations: []", "did you mean 'correlation'"),
        (f"modules: {ROWS}\ncorrelation: [[1.0]]", "8 rows of 8"),
        (
            f"modules: {ROWS}\ncorrelation: {np.ones((8, 8)).tolist()}".replace("1.0]]", "-3.0]]"),
            "a correlation matrix",
        ),
        (f"modules: {ROWS}\ncorrelation: {(2 * np.eye(8) - 1).tolist()}", "a correlation matrix"),
        (f"modules: {ROWS}\ncorrelation: {np.eye(8).astype(int).astype(str).tolist()}", "8 rows of 8 numbers"),
        (f"modules: {ROWS}\ncorrelation: {np.eye(8, dtype=bool).tolist()}", "8 rows of 8 numbers"),
    ],
)
def test_bad_files_are_rejected_in_one_message(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        WheelCalibration.load(path, UNEVEN, NAMES)
    assert "c.yaml" in str(error.value)


HOSTILE = [1e3, -1e3, 1e300, math.nan, math.inf, 10**400, True, "x", None, [0.1], {}]
VALID = {**{f"modules.a.{k}": v for k, v in module_keys(UNEVEN.wheel_radius).items()},
         **{f"arm.a.{k}": v for k, v in ARM_KEYS.items()}}  # fmt: skip


@pytest.mark.parametrize("key", VALID)
def test_every_number_of_a_file_is_one_that_the_described_robot_can_have(key: str, tmp_path: Path) -> None:
    """Truth: no encoder is mounted a radian off, no tire made to half the radius; what is just outside of the range is out."""
    path, valid = tmp_path / "c.yaml", VALID[key]
    least, width = valid.lower, valid.upper - valid.lower
    assert (
        least >= -1.0 and valid.upper <= 1.0 and (not key.endswith("radius") or (least > 0.05 and valid.upper < 0.15))
    )

    def read(value: object) -> None:
        section, name, entry = key.split(".")
        rows = {"modules": {n: {} for n in NAMES}, "arm": {n: {} for n in NAMES}}
        rows[section][name] = {entry: value}
        path.write_text(yaml.safe_dump(rows))
        WheelCalibration.load(path, UNEVEN, NAMES)
        load_arm_offset(path, NAMES)

    for value in (least, valid.upper, least + 0.5 * width):
        read(value)
    for value in (*HOSTILE, least - 0.01 * width, valid.upper + 0.01 * width):
        with pytest.raises(InputError, match=rf"c\.yaml: .*key '{key}.*: (a finite number from .* to|.* characters)"):
            read(value)


def test_a_file_of_another_robot_is_rejected(tmp_path: Path) -> None:
    """Robots of one make have modules and joints of the same names."""
    WheelCalibration.unknown(UNEVEN).save(tmp_path / "c.yaml", NAMES, arm={"a": {"offset": 0.1}}, robot="one")
    assert WheelCalibration.load(tmp_path / "c.yaml", UNEVEN, NAMES, "one").modules == 4
    assert load_arm_offset(tmp_path / "c.yaml", NAMES, "one") == pytest.approx([0.1, 0.0, 0.0, 0.0])
    for read in (
        lambda: WheelCalibration.load(tmp_path / "c.yaml", UNEVEN, NAMES, "other"),
        lambda: load_arm_offset(tmp_path / "c.yaml", NAMES, "other"),
    ):
        with pytest.raises(InputError, match=r"c\.yaml: key 'robot': this is a calibration of 'one'; one of 'other'"):
            read()


def test_what_no_file_is_read_with_is_not_found_either() -> None:
    odd = replace(WheelCalibration.unknown(UNEVEN), steer_offset=np.array([0.0, 0.0, 1.0, 0.0]))
    with pytest.raises(InputError, match=r"log: 'steer_offset' of c: a finite number from -0.6 to 0.6 rad"):
        odd.check("log", UNEVEN, NAMES)
    WheelCalibration.unknown(UNEVEN).check("log", UNEVEN, NAMES)


def test_keys_that_are_left_out_are_the_descriptions(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(f"modules: {ROWS}")
    loaded = WheelCalibration.load(tmp_path / "c.yaml", UNEVEN, NAMES)
    np.testing.assert_array_equal(loaded.wheel_radius, 0.1)
    with pytest.raises(InputError, match="wbmpc calibrate"):
        WheelCalibration.load(tmp_path / "none.yaml", UNEVEN, NAMES)


@pytest.mark.parametrize(("drop", "message"), [("place", "no channel 'place'"), ("wheel.time", "no channel 'wheel'")])
def test_a_log_without_the_channels_is_rejected(drop: str, message: str) -> None:
    times = np.arange(5.0)
    channels = {"steer": np.zeros((5, 4)), "wheel": np.zeros((5, 4)), "place": np.ones((5, 6))}
    channels |= {f"{name}.time": times for name in tuple(channels)}
    assert len(WheelRecord.of(channels).times) == 5
    del channels[drop]
    with pytest.raises(InputError, match=message):
        WheelRecord.of(channels)


TIMES = 0.1 * np.arange(11.0)
SOUND = {
    "steer": np.zeros((11, 4)),
    "wheel": np.zeros((11, 4)),
    "leg": np.zeros((11, 4)),
    "gyro": np.zeros(11),
    "place": np.tile([0.0, 0.0, 0.0, 1e-3, 1e-3, 1e-3], (3, 1)),
    **{f"{name}.time": TIMES for name in ("steer", "wheel", "leg", "gyro")},
    "place.time": np.array([0.0, 0.5, 1.0]),
}
ROLLING = np.tile(np.linspace(0.0, 1.0, 11)[:, None], (1, 4))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"place": np.zeros((3, 3))}, "standard deviations are needed"),
        ({"place": np.zeros((3, 6))}, "standard deviations must be positive"),
        ({"place.time": np.array([0.0, 0.5])}, "each with its time"),
        ({"place.time": np.array([0.0, np.nan, 1.0])}, "'place.time': finite numbers"),
        ({"wheel": np.zeros((4, 4))}, "same times"),
        ({"wheel": np.full((11, 4), np.nan)}, "'wheel': finite numbers"),
        ({"leg": np.zeros((11, 2))}, "'leg' must have .* got .11, 2."),
        ({"gyro": np.zeros((11, 3))}, "'gyro' must have"),
        ({"brake": np.zeros((5, 4))}, "'brake' must have the same times as 'steer'"),
        ({"brake": np.full((11, 4), np.nan)}, "'brake': finite numbers"),
        ({"steer": np.zeros(11)}, "'steer': one row"),
        ({"steer": np.array([["a"] * 4] * 11)}, "'steer': finite numbers"),
        ({"steer.time": TIMES[::-1]}, "'steer.time'"),
        ({"wheel.time": TIMES + 0.5}, "'wheel.time' must be the same as 'steer.time', and is up to 0.5 s beside it"),
        ({"leg.time": TIMES + 0.01 * (TIMES == 0.5)}, "'leg.time' must be .* up to 0.01 s beside"),
        ({"gyro.time": TIMES[1:]}, "'gyro.time' must be the same .* 11 times, got .10,."),
        ({"brake": np.zeros((11, 4)), "brake.time": -TIMES}, "'brake.time' must be the same"),
        # a survey long before or after, and one beside a record whose wheels turn
        ({"place.time": np.array([-2.5, 0.5, 1.0])}, "1 of 3 global poses are before .* 2.5 s, more than 2 s"),
        ({"place.time": np.array([0.0, 1.02, 1.03]), "wheel": ROLLING}, "2 of 3 global poses are after .* moves"),
    ],
)
def test_records_that_make_no_sense_are_rejected(changed: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(InputError, match=f"there.npz: .*{message}") as error:
        WheelRecord.of({**SOUND, **changed}, "there.npz")
    assert "\n" not in str(error.value)


def test_another_base_and_poses_that_do_not_fit_are_rejected() -> None:
    three = {name: SOUND[name][:, :3] for name in ("steer", "wheel", "leg")}
    with pytest.raises(InputError, match="4 modules"):
        calibrate(UNEVEN, WheelRecord.of({**SOUND, **three}))
    far = SOUND["place"] + np.array([[0.0] * 6, [3.0] + [0.0] * 5, [5.0] + [0.0] * 5])
    with pytest.raises(InputError, match="1 of 3 global poses fit"):
        calibrate(UNEVEN, WheelRecord.of({**SOUND, "place": far}))


def test_times_that_differ_by_rounding_are_the_same() -> None:
    assert (
        len(
            WheelRecord.of(
                {**SOUND, "wheel.time": np.float32(TIMES + 500.0), "steer.time": TIMES + 500.0, **LATER}
            ).times
        )
        == 11
    )


LATER = {f"{name}.time": SOUND[f"{name}.time"] + 500.0 for name in ("leg", "gyro", "place")}


@pytest.mark.parametrize(
    ("hinged", "changed", "message"),
    [
        (False, {"leg": ROLLING}, "legs are fixed, and those of the channel 'leg' turn by 1 rad"),
        (False, {"brake": np.ones((11, 4))}, "legs are fixed, and those of the channel 'brake' have open brakes"),
        (True, {"leg": np.zeros((11, 0))}, "legs have hinges, and there is no channel 'leg'"),
    ],
)
def test_a_log_of_a_robot_with_other_legs_is_rejected(
    hinged: bool, changed: dict[str, np.ndarray], message: str
) -> None:
    """The same number of modules is not the same base; legs that stand, as encoders say it, may be fixed ones."""
    geometry = ring(4, hinged=hinged)
    with pytest.raises(InputError, match=message):
        replay(geometry, WheelRecord.of({**SOUND, **changed}))
    standing = 3e-4 * (np.arange(44).reshape(11, 4) % 3 == 0)
    assert replay(geometry, WheelRecord.of({**SOUND, "leg": standing})).taken == 3


def test_a_survey_before_and_after_the_drive_counts_as_one_within() -> None:
    """The base stands for 0.4 s at both ends; poses stamped 1 s outside, and in any order, give what those at the ends give."""
    base = Drawn(UNEVEN, 1, motion=lambda t: np.array([0.25, 0.0, 0.0]), length=3.2, zero=2e-3, gyro=0.0)
    base.legs = lambda t: (np.zeros(4), np.zeros(4))  # type: ignore[method-assign]
    data = record(base, (5e-4, 5e-4, 2e-4), every=400)
    stood = lambda rows: np.concatenate([np.tile(rows[:1], (20, 1)), rows, np.tile(rows[-1:], (20, 1))])
    channels = {"steer": stood(data.steer), "wheel": stood(data.wheel), "leg": stood(data.leg)}
    times = 0.02 * np.arange(len(channels["steer"]))
    channels |= {f"{name}.time": times for name in tuple(channels)}
    two = np.concatenate([[base.poses[0], base.poses[-1]], np.tile([5e-4, 5e-4, 2e-4], (2, 1))], axis=1)
    ends = times[[0, -1]]
    zeros = []
    for at, order in ((ends, [0, 1]), (ends + [-1.0, 1.0], [0, 1]), (ends + [-0.02, 0.02], [1, 0])):
        there = WheelRecord.of({**channels, "place": two[order], "place.time": at[order]})
        found = replay(UNEVEN, there, prior=prior())
        assert found.taken == 2
        zeros.append(found.calibration.steer_offset)
    np.testing.assert_allclose(zeros[1:], [zeros[0]] * 2, atol=1e-15)
    known = found.calibration.covariance[:4, :4].mean() ** 0.5  # 0.5 mm at both ends of 0.8 m; 1 mrad before
    assert abs(zeros[0].mean() - base.zeros.mean()) < 3.0 * known and known < 0.7e-3


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
