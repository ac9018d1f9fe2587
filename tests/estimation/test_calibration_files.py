"""Files of calibrations, and records that make no sense. Truth: what was written."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from wheels_on_paper import UNEVEN, Drawn, prior, record, ring

from wbmpc.bases.swerve.calibration import fit_wheels, replay
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration, module_keys
from wbmpc.bases.swerve.wheel_record import WheelRecord
from wbmpc.errors import InputError
from wbmpc.estimation.arm_calibration import load_arm_offset
from wbmpc.estimation.calibration_file import ARM_KEYS

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
        fit_wheels(UNEVEN, WheelRecord.of({**SOUND, **three}))
    far = SOUND["place"] + np.array([[0.0] * 6, [3.0] + [0.0] * 5, [5.0] + [0.0] * 5])
    with pytest.raises(InputError, match="1 of 3 global poses fit"):
        fit_wheels(UNEVEN, WheelRecord.of({**SOUND, "place": far}))


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
    assert replay(geometry, WheelRecord.of({**SOUND, "leg": standing})).global_poses.taken == 3


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
        assert found.global_poses.taken == 2
        zeros.append(found.calibration.steer_offset)
    np.testing.assert_allclose(zeros[1:], [zeros[0]] * 2, atol=1e-15)
    known = found.calibration.covariance[:4, :4].mean() ** 0.5  # 0.5 mm at both ends of 0.8 m; 1 mrad before
    assert abs(zeros[0].mean() - base.zeros.mean()) < 3.0 * known and known < 0.7e-3


def test_a_calibration_replaces_a_link_that_is_not_to_be_followed(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").symlink_to("mine")
    (tmp_path / "mine").write_text("mine")
    WheelCalibration.unknown(UNEVEN).save(tmp_path / "c.yaml", NAMES, follow=False)
    assert (tmp_path / "mine").read_text() == "mine" and "modules" in (tmp_path / "c.yaml").read_text()
