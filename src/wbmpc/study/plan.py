"""Which runs a study has: every combination of its experiments, conditions, robots and settings, over its seeds."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment
from wbmpc.registry import load, load_file
from wbmpc.settings import ReadBy
from wbmpc.study.definition import MAX_COMBINATIONS, MAX_RUNS, Condition, Definition, Random, Range


@dataclass(frozen=True)
class Combination:
    """Settings of runs that differ in their seeds alone.

    ``source``: the experiment's name, or the absolute path of its Python file. ``varied``: what distinguishes it from others of the
    experiment and condition, by key; ``changes``: all settings that are not the experiment's default. ``key``: a hash of condition
    and complete settings. ``accept``: outcomes that count as success beside ``completed``.
    """

    experiment: str
    source: str
    condition: str
    robot: str
    varied: Mapping[str, Any]
    changes: Mapping[str, Any]
    settings: Mapping[str, Any] = field(repr=False)
    draw: int = 0
    inputs: tuple[tuple[Callable[[Any], object], Any], ...] = field(default=(), repr=False)
    accept: tuple[str, ...] = ()

    @cached_property
    def key(self) -> str:
        identity = [self.experiment, self.condition, self.settings]
        return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def label(self) -> str:
        """What tables call it."""
        parts = [self.condition, self.robot, *(f"{key}={_shown(value)}" for key, value in self.varied.items())]
        return ", ".join(part for part in parts if part) or "default"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else value if isinstance(value, str) else json.dumps(value)


@dataclass(frozen=True)
class Run:
    """One run of a study."""

    combination: Combination
    seed: int

    @property
    def key(self) -> str:
        return f"{self.combination.key}-{self.seed}"


def open_experiment(source: str) -> Experiment:
    """By its name, or from a Python file. Raises :class:`InputError`."""
    return load_file(Path(source)) if source.endswith(".py") else load(source)


def assignments(changes: Mapping[str, Any]) -> list[str]:
    """Settings as ``key=value`` with values as in YAML."""
    return [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in changes.items()]


def settings_of(experiment: Experiment, changes: Mapping[str, Any], where: str) -> Any:
    """The experiment's settings with ``changes``. Raises :class:`InputError` that begins with ``where``."""
    try:
        return configure(experiment.config_type, assignments(changes), where)
    except InputError as error:
        raise InputError(str(error).replace(": --set: ", ": ", 1).replace(": --set ", ": ", 1)) from error


def combinations(definition: Definition, folder: Path, where: str) -> list[Combination]:
    """All combinations of a study, each checked. Python files and robots' files are looked up from ``folder``.

    Raises :class:`InputError` naming ``where`` (the file), the experiment, the condition and the key.
    """
    conditions: dict[str, Condition | None] = {**definition.conditions} or {"": None}
    count = len(definition.experiments) * len(conditions) * max(len(definition.robots), 1) * definition.draws
    count *= math.prod(map(len, _grid(definition).values()))
    if count > MAX_COMBINATIONS:
        raise InputError(f"{where}: {count} combinations of settings; at most {MAX_COMBINATIONS} are run")
    if (runs := count * len(definition.seeds)) > MAX_RUNS:
        raise InputError(f"{where}: {runs} runs; at most {MAX_RUNS} are planned")
    points = [(draw, varied) for draw in range(definition.draws) for varied in _points(definition, draw)]
    found = [
        _combination(definition, folder, where, name, condition, robot, draw, varied)
        for name in definition.experiments
        for condition, about in conditions.items()
        if about is None or not about.experiments or name in about.experiments
        for robot in definition.robots or ("",)
        for draw, varied in points
    ]
    known: set[str] = set()
    for c in found:
        if c.key in known:
            raise InputError(f"{where}: experiment '{c.experiment}': {c.label}: these settings appear twice")
        known.add(c.key)
    return found


def _grid(definition: Definition) -> dict[str, Any]:
    vary = {key: axis for key, axis in definition.vary.items() if not isinstance(axis, Random)}
    return {key: axis.values() if isinstance(axis, Range) else axis for key, axis in vary.items()}


def _points(definition: Definition, draw: int) -> Iterator[dict[str, Any]]:
    """Varied settings of one draw: the grid, with random ones the same all over it."""
    rng = np.random.default_rng([definition.draw_seed, draw])
    drawn = {key: axis.draw(rng) for key, axis in definition.vary.items() if isinstance(axis, Random)}
    grid = _grid(definition)
    for values in itertools.product(*grid.values()):
        at = dict(zip(grid, values, strict=True))
        yield {key: drawn[key] if key in drawn else at[key] for key in definition.vary}


def _combination(
    definition: Definition, folder: Path, where: str, name: str, condition: str, robot: str, draw: int, varied: dict[str, Any]
) -> Combination:  # fmt: skip
    source = str((folder / name).resolve()) if name.endswith(".py") else name
    about = definition.conditions.get(condition)
    layers = (definition.settings, definition.experiments[name], about.settings if about else {}, varied)
    changes = {key: value for layer in layers for key, value in layer.items()}
    if robot:
        changes["robot"] = str((folder / robot).resolve()) if (folder / robot).is_file() else robot
    try:
        experiment = open_experiment(source)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    model = settings_of(experiment, changes, _place(where, name, condition))
    settings, inputs = model.model_dump(mode="json"), tuple(ReadBy.named(model))
    accept = about.accept if about else ()
    return Combination(experiment.name, source, condition, robot, varied, changes, settings, draw, inputs, accept)


def check_inputs(found: list[Combination], where: str) -> None:
    """Read the robots and files of all combinations, so that nothing is started for what cannot run.

    Raises :class:`InputError` naming ``where`` (the study's file), the experiment and the condition.
    """
    known: set[tuple[Callable[[Any], object], Any]] = set()
    for c in found:
        try:
            for read, value in (named for named in c.inputs if named not in known):
                read(value)
        except InputError as error:
            raise InputError(f"{_place(where, c.experiment, c.condition)}: {error}") from error
        known |= {*c.inputs}


def _place(where: str, experiment: str, condition: str) -> str:
    return f"{where}: experiment '{experiment}'" + (f", condition '{condition}'" if condition else "")


def runs(found: list[Combination], seeds: tuple[int, ...]) -> Iterator[Run]:
    """All runs, seed by seed, so that every combination has something to show early."""
    return (Run(combination, seed) for seed in seeds for combination in found)
