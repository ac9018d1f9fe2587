"""Experiments: one file each; the registry maps their names to what the command line runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from wbmpc.result import RunResult
from wbmpc.studies.minniti2019 import circle as rezero_circle
from wbmpc.studies.minniti2019 import door as rezero_door
from wbmpc.studies.minniti2019 import frequency as rezero_frequency
from wbmpc.studies.minniti2019 import push as rezero_push
from wbmpc.studies.minniti2019 import steps as rezero_steps
from wbmpc.studies.minniti2019 import taskspace as rezero_taskspace
from wbmpc.studies.minniti2019 import wholebody as rezero_wholebody
from wbmpc.studies.pankert2022 import brakes as swerve_brakes
from wbmpc.studies.pankert2022 import calibrate as swerve_calibrate
from wbmpc.studies.pankert2022 import drive as swerve_drive
from wbmpc.studies.pankert2022 import fixed as swerve_fixed
from wbmpc.studies.pankert2022 import plaster as swerve_plaster
from wbmpc.studies.pankert2022 import stability as swerve_stability
from wbmpc.studies.pankert2022 import track as swerve_track
from wbmpc.studies.pankert2022 import unified as swerve_unified
from wbmpc.studies.pankert2022 import wobble as swerve_wobble


@dataclass(frozen=True)
class Experiment:
    """A name, a line about it, its settings and ``run(settings, seed, progress)``."""

    name: str
    summary: str
    config_type: type[BaseModel]
    run: Callable[[Any, int, Callable[[float, str], None] | None], RunResult]


def _of(module: Any, settings: type[BaseModel]) -> Experiment:
    return Experiment(module.NAME, module.SUMMARY, settings, module.run)


REGISTRY: dict[str, Experiment] = {
    e.name: e
    for e in (
        _of(swerve_track, swerve_track.SwerveTrackSettings),
        _of(swerve_fixed, swerve_fixed.SwerveFixedSettings),
        _of(swerve_calibrate, swerve_calibrate.SwerveCalibrateSettings),
        _of(swerve_brakes, swerve_brakes.SwerveBrakesSettings),
        _of(swerve_drive, swerve_drive.SwerveDriveSettings),
        _of(swerve_plaster, swerve_plaster.SwervePlasterSettings),
        _of(swerve_stability, swerve_stability.SwerveStabilitySettings),
        _of(swerve_unified, swerve_unified.SwerveUnifiedSettings),
        _of(swerve_wobble, swerve_wobble.SwerveWobbleSettings),
        _of(rezero_steps, rezero_steps.RezeroStepsSettings),
        _of(rezero_circle, rezero_circle.RezeroCircleSettings),
        _of(rezero_door, rezero_door.RezeroDoorSettings),
        _of(rezero_frequency, rezero_frequency.RezeroFrequencySettings),
        _of(rezero_taskspace, rezero_taskspace.RezeroTaskspaceSettings),
        _of(rezero_wholebody, rezero_wholebody.RezeroWholebodySettings),
        Experiment(
            rezero_push.BALL,
            rezero_push.SUMMARY.format("ball"),
            rezero_push.RezeroPushBallSettings,
            rezero_push.run_ball,
        ),
        Experiment(
            rezero_push.HAND,
            rezero_push.SUMMARY.format("hand"),
            rezero_push.RezeroPushHandSettings,
            rezero_push.run_hand,
        ),
    )
}
