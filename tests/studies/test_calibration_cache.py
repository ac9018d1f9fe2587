"""The calibration that is kept. Truth: what was made, bit by bit, and a count of how often it was made."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.kernel import cache
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.simulation.kept_calibration import kept
from wbmpc.studies.pankert2022.reference_drive import SwerveCalibrateSettings


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("swerve-ur10")


def test_a_drive_is_made_once_for_all_it_depends_on(
    robot: RobotModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path))
    r, made = np.random.default_rng(1), list[dict[str, np.ndarray]]()

    def make() -> dict[str, np.ndarray]:
        made.append({"radius": r.uniform(0.1, 0.2, 4), "covariance": r.normal(size=(8, 8))})
        return made[-1]

    settings = SwerveCalibrateSettings(plant=SwervePerturbation(encoder_counts=512))
    first, again = (kept(robot, settings, 3, make) for _ in range(2))
    assert len(made) == 1 and again.keys() == made[0].keys()
    for name, values in made[0].items():
        assert np.array_equal(first[name], values) and np.array_equal(again[name], values)
    # everything else is another drive
    kept(robot, settings, 4, make)
    kept(robot, SwerveCalibrateSettings(), 3, make)
    kept(load_robot("swerve-ur10"), settings, 3, make)
    assert len(made) == 3
    fingerprint = cache.source_fingerprint
    monkeypatch.setattr(cache, "source_fingerprint", lambda rooms: fingerprint(rooms) + "changed")
    kept(robot, settings, 3, make)
    assert len(made) == 4


def _npz() -> bytes:
    file = BytesIO()
    np.savez_compressed(file, radius=np.arange(1000.0))
    return file.getvalue()


def _npy() -> bytes:
    file = BytesIO()
    np.save(file, np.arange(3.0))
    return file.getvalue()


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04", b"no archive", _npy(), _npz()[:-60], _npz()[:300] + b"x" * 400 + _npz()[700:]]
)
def test_an_entry_that_is_no_calibration_is_made_anew(
    content: bytes, robot: RobotModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A whole entry with the right hash, written by a program that was wrong."""
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path))
    make = lambda: {"radius": np.array([0.25])}
    kept(robot, SwerveCalibrateSettings(), 5, make)
    (entry,) = tmp_path.glob("*.bin")
    cache.save(entry.stem, content, {"calibration": "x", "seed": 5})
    for warned in (True, False):
        caplog.clear()
        assert kept(robot, SwerveCalibrateSettings(), 5, make)["radius"] == [0.25]
        assert (f"{entry} is damaged" in caplog.text) is warned
