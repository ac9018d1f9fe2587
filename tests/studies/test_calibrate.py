"""From a reference drive to calibrated wheels, on the command line. Truth: the offsets that the simulated plant was built
with, and MuJoCo's true pose of the base."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from effort import thorough
from toys import robot
from wbmpc.bases.swerve.calibrator import steer_joints
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.cli import main
from wbmpc.estimation.arm_calibration import load_arm_offset
from wbmpc.registry import REGISTRY
from wbmpc.report import write_run
from wbmpc.robots.description import DATA
from wbmpc.settings import ControlSettings
from wbmpc.studies.pankert2022.reference_drive import OPENING, SwerveCalibrateSettings, _phases
from wbmpc.studies.pankert2022.track_references import SwerveTrackSettings

ROBOT, SEED = robot("swerve-ur10"), 5
SETTINGS = SwerveCalibrateSettings(
    stroke=1.0, turn=1.5, rounds=1, settle_time=2.0, tracked_poses=20, control=ControlSettings(rate=200.0)
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:  # type: ignore[no-untyped-def]
    """A run of the reference drive on disk."""
    result = REGISTRY["swerve-calibrate"].run(SETTINGS, SEED, None)
    assert result.completed, result.reason
    out = tmp_path_factory.mktemp("drive")
    write_run(result, out)
    return out


@pytest.fixture(scope="module")
def calibration(folder: Path) -> Path:
    assert main(["calibrate", str(folder), "--out", str(folder / "wheels.yaml")]) == 0
    return folder / "wheels.yaml"


def test_the_drive_knows_where_it_is(folder: Path) -> None:
    """10 Hz, 50 ms old, 5 mm, 2 mrad, fused with wheels and gyro: 10 mm rms in the world, on the way too."""
    with np.load(folder / "log.npz") as log:
        error = log["base_odometry"] - log["base"]
        assert np.ptp(log["base"][:, 0]) > 0.9 and np.ptp(log["base"][:, 1]) > 0.9 and np.ptp(log["base"][:, 2]) > 1.4
        seen, places = log["place"], log["place.time"]
        true = np.stack([np.interp(places, log["base.time"], log["base"][:, k]) for k in range(3)], axis=1)
    assert np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))) < 0.005
    assert np.abs(error[:, 2]).max() < 0.005
    late = seen[5:, :3] - true[5:]
    assert 0.003 < late[:, :2].std() < 0.007 and 0.0012 < late[:, 2].std() < 0.003


def test_what_the_odometry_needs_is_found(calibration: Path) -> None:
    """The mean zero, the two differences that turn the base, and the one that nothing but open legs shows: within 0.6 mrad."""
    found = WheelCalibration.load(calibration, ROBOT.base.geometry, steer_joints(ROBOT))
    plant = SwervePlant(ROBOT.description, ROBOT.state.split(ROBOT.home), SETTINGS.plant, SEED)
    # the wheel's heading has the sum of both encoders' zeros
    error = found.steer_offset - plant.offsets["steer"] - plant.offsets["leg"]
    for signs in ([1, 1, 1, 1], [1, 1, -1, -1], [1, -1, 1, -1], [1, -1, -1, 1]):
        assert abs(np.dot(signs, error)) / 4.0 < 0.6e-3, signs
    # tires sink in: the radius that counts is up to 0.1 % less than that of the wheel
    radius = found.wheel_radius / (0.1 * plant.draw.radius) - 1.0
    assert -2.0e-3 < radius.mean() < 1.0e-3


def test_radii_are_found_wheel_by_wheel(calibration: Path) -> None:
    """Beside what they have in common with the tires' sinking: nearer than a common factor would be."""
    found = WheelCalibration.load(calibration, ROBOT.base.geometry, steer_joints(ROBOT))
    plant = SwervePlant(ROBOT.description, ROBOT.state.split(ROBOT.home), SETTINGS.plant, SEED)
    drawn, radius = plant.draw.radius - 1.0, found.wheel_radius / 0.1 - 1.0
    apart = lambda r: np.sqrt(np.mean((r - r.mean()) ** 2))
    assert apart(drawn) > 0.5e-3
    assert apart(radius - drawn) < 0.7 * apart(drawn)


def test_zeros_of_the_arm_are_found(calibration: Path) -> None:
    """But for the last joint's, which turns the tool about its own axis."""
    joints = list(ROBOT.input.groups["arm"])
    found = load_arm_offset(calibration, joints)
    plant = SwervePlant(ROBOT.description, ROBOT.state.split(ROBOT.home), SETTINGS.plant, SEED)
    assert found is not None and np.abs(plant.offsets["arm"]).max() > 1e-3
    std = np.array([row["offset_std"] for row in yaml.safe_load(calibration.read_text())["arm"].values()])
    error = np.abs(found - plant.offsets["arm"])
    assert (error < 3.5 * std).all() and error[:5].max() < 0.6e-3 and std[:5].max() < 0.7e-3 < 1.9e-3 < std[5]
    settings = SwerveTrackSettings(calibration={"kind": "file", "file": calibration})
    known = settings.estimation(ROBOT, SEED)
    assert known.arm_offset == pytest.approx(found)


def test_brakes_take_turns_and_bases_without_them_drive_as_they_did() -> None:
    """Straight strokes: all brakes but one are open, each stays closed once; turns, and fixed legs: all are closed."""
    strokes = [p for p in _phases(ROBOT, SETTINGS) if p.ramp > 0.0]
    opened = np.array([p.brake for p in strokes])
    np.testing.assert_array_equal(opened, np.concatenate([1.0 - np.eye(4), np.zeros((2, 4))]))
    shut = [
        _phases(robot("swerve-fixed-ur10"), SETTINGS),
        _phases(ROBOT, SETTINGS.model_copy(update={"open_brakes": False})),
    ]
    for phases in shut:
        assert not any(p.brake.any() for p in phases)
        assert sum(p.length for p in phases) == pytest.approx(
            sum(p.length for p in _phases(ROBOT, SETTINGS)) - 4 * OPENING
        )


@thorough
def test_the_file_improves_the_odometry_of_a_run(calibration: Path) -> None:
    drift = {}
    for how in ({"kind": "none"}, {"kind": "file", "file": calibration}):
        settings = SwerveTrackSettings(periods=1, settle_time=2.0, calibration=how)
        result = REGISTRY["swerve-track"].run(settings, SEED, None)
        assert result.completed
        drift[how["kind"]] = result.metrics["odometry_drift_ratio_wheels"].value
    assert drift["file"] < 0.6 * drift["none"]


@thorough
def test_a_run_with_global_poses_stays_where_it_should(calibration: Path) -> None:
    known = {"kind": "file", "file": calibration}
    settings = SwerveTrackSettings(periods=1, settle_time=2.0, calibration=known, localization="lidar")
    result = REGISTRY["swerve-track"].run(settings, SEED, None)
    assert result.metrics["base_error_rms_world"].value < 0.005
    assert result.metrics["hand_error_mean_world"].value < 0.010


def test_command_prints_and_writes(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(folder / "log.npz"), "--out", str(tmp_path / "c.yaml"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["file"] == str(tmp_path / "c.yaml")
    assert list(printed["modules"]) == steer_joints(ROBOT)
    assert printed["poses"]["used"] > 0.9 * printed["poses"]["given"] > 50
    assert main(["calibrate", str(folder), "--robot", "swerve-ur10"]) == 0
    text = capsys.readouterr().out
    assert (
        (folder / "calibration.yaml").is_file()
        and "mrad" in text
        and "global poses used" in text
        and "--set calibration.file=" in text
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "there is no such file"),
        (["{text}"], "not the log of a run"),
        (["{log}"], "--robot: is needed"),
        (["{log}", "--robot", "rezero"], "valid: swerve"),
        (["{log}", "--robot", "swerve-ur10"], "no channel 'steer'"),
    ],
)
def test_bad_input_is_one_message(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "text").write_text("no archive")
    np.savez(tmp_path / "log.npz", end_effector=np.zeros(3))
    paths = {"text": tmp_path / "text", "log": tmp_path / "log.npz"}
    assert main(["calibrate", *[a.format(**paths) for a in arguments]]) == 2
    out = capsys.readouterr()
    assert out.out == "" and message in out.err and len(out.err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "message"), [("swerve-fixed-ur10", "this was 'swerve-ur10', whose base"), ("own", "steer")]
)
def test_a_robot_with_another_base_than_that_of_the_run_is_rejected(
    name: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file of one's own with the same base is taken: the next thing that is wrong is the log."""
    np.savez(tmp_path / "log.npz", end_effector=np.zeros(3))
    (tmp_path / "metrics.json").write_text(json.dumps({"settings": {"robot": "swerve-ur10"}}))
    own = tmp_path / "own.yaml"
    data = yaml.safe_load((DATA / "swerve-ur10.yaml").read_text())
    data["base"]["wheel_radius"] *= 1.004
    own.write_text(yaml.safe_dump({**data, "model": str(DATA / data["model"])}))
    assert main(["calibrate", str(tmp_path), "--robot", str(own) if name == "own" else name]) == 2
    err = capsys.readouterr().err
    assert message in err and len(err.strip().splitlines()) == 1 and not (tmp_path / "calibration.yaml").exists()


def test_unknown_file_as_a_setting(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", "swerve-track", "--set", "calibration=file", "--set", "calibration.file=wheels.yaml"]) == 2
    assert "wbmpc calibrate" in capsys.readouterr().err
