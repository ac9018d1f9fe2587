"""`hold`: the end effector of any robot stays where it is at home."""

from __future__ import annotations

from pydantic import Field

from wbmpc.experiment import Experiment, Scenario
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.loop import closed_loop
from wbmpc.tasks.settings import TaskSettings


class HoldSettings(TaskSettings):
    """``duration`` [s] of the task."""

    duration: float = Field(5.0, gt=0, le=3600)


def build(settings: HoldSettings, seed: int) -> Scenario:
    """One run."""
    robot, mpc = settings.prepare()
    return closed_loop(
        robot, mpc, settings.settle_time + settings.duration, seed, settings, since=settings.settle_time, reshape=True
    )


EXPERIMENT = Experiment.of("hold", "the end effector of any robot stays where it is", HoldSettings, build, DEFINITIONS)
