"""Experiments: one file each; the registry maps their names to what the command line runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from wbmpc.experiments import rezero_circle, rezero_steps, rezero_wholebody, swerve_track
from wbmpc.experiments import rezero_push as push
from wbmpc.result import RunResult


@dataclass(frozen=True)
class Experiment:
    """A name, a line about it, its settings and ``run(settings, seed, progress)``."""

    name: str
    summary: str
    config_type: type[BaseModel]
    run: Callable[[Any, int, Callable[[float, str], None] | None], RunResult]


REGISTRY: dict[str, Experiment] = {
    e.name: e
    for e in (
        Experiment(swerve_track.NAME, swerve_track.SUMMARY, swerve_track.SwerveTrackSettings, swerve_track.run),
        Experiment(rezero_steps.NAME, rezero_steps.SUMMARY, rezero_steps.RezeroStepsSettings, rezero_steps.run),
        Experiment(push.BALL, push.SUMMARY.format("ball"), push.RezeroPushBallSettings, push.run_ball),
        Experiment(push.HAND, push.SUMMARY.format("hand"), push.RezeroPushHandSettings, push.run_hand),
        Experiment(
            rezero_wholebody.NAME,
            rezero_wholebody.SUMMARY,
            rezero_wholebody.RezeroWholebodySettings,
            rezero_wholebody.run,
        ),
        Experiment(rezero_circle.NAME, rezero_circle.SUMMARY, rezero_circle.RezeroCircleSettings, rezero_circle.run),
    )
}
