"""Experiments: one file each; the registry maps their names to what the command line runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from wbmpc.experiments import (
    rezero_steps,
    swerve_brakes,
    swerve_drive,
    swerve_stability,
    swerve_track,
    swerve_unified,
    swerve_wobble,
)
from wbmpc.result import RunResult


@dataclass(frozen=True)
class Experiment:
    """A name, a line about it, its settings and ``run(settings, seed, progress)``."""

    name: str
    summary: str
    config_type: type[BaseModel]
    run: Callable[[Any, int, Callable[[float, str], None] | None], RunResult]


REGISTRY: dict[str, Experiment] = {
    m.NAME: Experiment(m.NAME, m.SUMMARY, settings, m.run)  # type: ignore[attr-defined]
    for m, settings in (
        (swerve_track, swerve_track.SwerveTrackSettings),
        (rezero_steps, rezero_steps.RezeroStepsSettings),
        (swerve_brakes, swerve_brakes.SwerveBrakesSettings),
        (swerve_drive, swerve_drive.SwerveDriveSettings),
        (swerve_stability, swerve_stability.SwerveStabilitySettings),
        (swerve_unified, swerve_unified.SwerveUnifiedSettings),
        (swerve_wobble, swerve_wobble.SwerveWobbleSettings),
    )
}
