"""All kinds of generated cases."""

from __future__ import annotations

import random
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from fuzzing.case import Case
from fuzzing.file_paths import files
from fuzzing.programs import programs
from fuzzing.recorded import messages, recordings, scenes
from fuzzing.robot_files import models, robots
from fuzzing.run_files import buses, calibrations, runs
from fuzzing.setting_values import problems, settings
from fuzzing.study_files import folders, studies
from wbmpc.errors import EndedByUser
from wbmpc.experiment import Experiment
from wbmpc.registry import REGISTRY
from wbmpc.simulation.lockstep import Watch

#: By kind: how many of a thousand cases, and what makes one.
KINDS: dict[str, tuple[int, Callable[[random.Random, Path], Case]]] = {
    "settings": (294, settings), "robots": (100, robots), "models": (110, models), "files": (50, files),
    "recordings": (80, recordings), "messages": (150, messages), "scenes": (50, scenes), "runs": (50, runs),
    "calibrations": (50, calibrations), "buses": (60, buses), "problems": (6, problems), "studies": (30, studies),
    "folders": (30, folders), "programs": (20, programs),
}  # fmt: skip
#: After so many ticks the run of an experiment that was built is ended.
TICKS = 3


class Accepted(BaseException):
    """A stand-in for an experiment: its settings were accepted."""


def make(kind: str, seed: int, number: int, folder: Path) -> Case:
    """Case ``number`` of a kind: the same for the same seed. Its files go into ``folder``."""
    rng = random.Random(zlib.crc32(f"{kind} {seed} {number}".encode()))
    return KINDS[kind][1](rng, folder)


def stand_ins() -> dict[str, Experiment]:
    """The experiments, none of which runs."""

    def accept(*_: object) -> Any:
        raise Accepted

    return {name: Experiment(name, e.summary, e.config_type, accept) for name, e in REGISTRY.items()}


class _Few:
    """A watcher that ends a run after a few ticks."""

    def __init__(self) -> None:
        self._left = TICKS

    def begin(self, running: Any) -> None:
        """Nothing."""

    def tick(self, t: float, command: Any, plans: Any) -> None:
        """Count."""
        self._left -= 1
        if not self._left:
            raise EndedByUser("a few ticks are enough")

    def end(self, ending: Any) -> None:
        """Nothing."""


def short() -> dict[str, Experiment]:
    """The experiments, each of which runs for a few ticks."""

    def run(experiment: Experiment, settings: Any, seed: int, progress: Watch) -> Any:
        return experiment.run(settings, seed, replace(progress, watchers=(*progress.watchers, _Few())))

    return {name: replace(e, run=partial(run, e)) for name, e in REGISTRY.items()}
