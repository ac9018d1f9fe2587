"""The calibration that is kept. Truth: what was made, bit by bit, and a count of how often it was made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wbmpc.estimation.wheel_calibration import WheelCalibration
from wbmpc.kernel import cache
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.simulation.perturbation import Perturbation
from wbmpc.studies.pankert2022.calibration_cache import kept
from wbmpc.studies.pankert2022.reference_drive import SwerveCalibrateSettings


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("swerve-ur10")


def test_a_drive_is_made_once_for_all_it_depends_on(
    robot: RobotModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WBMPC_CACHE_DIR", str(tmp_path))
    r, made = np.random.default_rng(1), list[WheelCalibration]()

    def make() -> WheelCalibration:
        root = r.normal(size=(8, 8))
        made.append(WheelCalibration(r.normal(size=4), np.zeros(4), r.uniform(0.1, 0.2, 4), root @ root.T))
        return made[-1]

    settings = SwerveCalibrateSettings(plant=Perturbation(encoder_counts=512))
    first, again = (kept(robot, settings, 3, make) for _ in range(2))
    assert len(made) == 1 and first is made[0]
    for name, values in vars(first).items():
        assert np.array_equal(getattr(again, name), values) and getattr(again, name).flags.writeable
    # everything else is another drive
    kept(robot, settings, 4, make)
    kept(robot, SwerveCalibrateSettings(), 3, make)
    kept(load_robot("swerve-ur10"), settings, 3, make)
    assert len(made) == 3
    fingerprint = cache.source_fingerprint
    monkeypatch.setattr(cache, "source_fingerprint", lambda rooms: fingerprint(rooms) + "changed")
    kept(robot, settings, 3, make)
    assert len(made) == 4
