"""A study as a file says it: experiments, what is varied, seeds, and what a search may change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator, model_validator

from wbmpc.configuration import describe
from wbmpc.errors import InputError, unknown_name
from wbmpc.reproduce import parse_seeds
from wbmpc.result import OutcomeName
from wbmpc.settings import LARGEST
from wbmpc.yaml_file import load_yaml

#: Combinations of settings of one study, seeds, and runs, at most.
MAX_COMBINATIONS, MAX_SEEDS, MAX_RUNS = 20_000, 1_000_000, 1_000_000


def _seeds(value: Any) -> Any:
    """``300-319``, ``3``, ``1,5-7`` or a list of such."""
    parts = value if isinstance(value, list) else [value]
    if not parts or any(isinstance(p, bool) or not isinstance(p, int | str) for p in parts):
        raise ValueError(f"seeds such as 300-319, 3 or 1,5-7 are needed, got {value!r:.60}")
    return tuple(parse_seeds(",".join(map(str, parts)), "seeds", MAX_SEEDS))


Seeds = Annotated[tuple[int, ...], BeforeValidator(_seeds)]


class Section(BaseModel):
    """A part of a study's file."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @model_validator(mode="before")
    @classmethod
    def _no_truths(cls, data: Any) -> Any:
        """Python takes true and false for 1 and 0."""
        for name, field in cls.model_fields.items() if isinstance(data, Mapping) else ():
            key = field.alias or name
            if field.annotation in (int, float) and isinstance(data.get(key), bool):
                raise ValueError(f"{key}: a number is needed, not true or false")
        return data


class _Bounds(Section):
    low: float = Field(alias="from")
    high: float = Field(alias="to")
    log: bool = False

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        low, high = self.low, self.high
        if not -LARGEST <= low < high <= LARGEST:  # of any setting; the difference of larger ones is no number
            raise ValueError(f"from={low:g} must be below to={high:g}, and both from {-LARGEST:g} to {LARGEST:g}")
        if self.log and low <= 0.0:
            raise ValueError(f"a log range needs from > 0, got {low:g}")
        return self


class Range(_Bounds):
    """``steps`` values from ``from`` to ``to``, evenly or, with ``log``, by equal factors."""

    steps: int = Field(ge=2, le=10_000)

    def values(self) -> tuple[float, ...]:
        """All of them, to twelve digits."""
        made = (np.geomspace if self.log else np.linspace)(self.low, self.high, self.steps)
        return tuple(float(f"{v:.12g}") for v in made)


class Random(_Bounds):
    """A value between ``from`` and ``to`` in each of the study's ``draws``, uniform or, with ``log``, uniform in its logarithm."""

    random: Literal[True]

    def draw(self, rng: np.random.Generator) -> float:
        """One value, to six digits."""
        if self.log:
            return float(f"{np.exp(rng.uniform(np.log(self.low), np.log(self.high))):.6g}")
        return float(f"{rng.uniform(self.low, self.high):.6g}")


class Search(_Bounds):
    """What a search may give a setting: a number between ``from`` and ``to``, with ``log`` on a logarithmic scale; ``whole``: whole
    numbers only."""

    whole: bool = False

    @property
    def ends(self) -> tuple[int, int]:
        """The least and the largest whole number of the range."""
        return math.ceil(self.low), math.floor(self.high)

    @model_validator(mode="after")
    def _some_are_whole(self) -> Self:
        if self.whole and self.ends[0] > self.ends[1]:
            raise ValueError(f"whole: there is no whole number from {self.low:g} to {self.high:g}")
        return self


def _axis(value: Any) -> Any:
    if isinstance(value, list):
        if not value:
            raise ValueError("a list needs at least one value")
        return tuple(value)
    if isinstance(value, Mapping):
        return Random.model_validate(value) if "random" in value else Range.model_validate(value)
    raise ValueError(f"a list, or a mapping with from, to and steps (or random: true) is needed, got {value!r:.60}")


def _searched(value: Any) -> Any:
    if isinstance(value, list):
        if len(value) < 2:
            raise ValueError("a list to choose from needs two values or more")
        return tuple(value)
    if isinstance(value, Mapping):
        return Search.model_validate(value)
    raise ValueError(f"a list, or a mapping with from and to is needed, got {value!r:.60}")


Axis = Annotated[Any, BeforeValidator(_axis)]
Searched = Annotated[Any, BeforeValidator(_searched)]


class Condition(Section):
    """Settings under a name; ``experiments``: those that it is of (all when left out); ``accept``: outcomes that count as success
    beside ``completed``: their figures count as they are."""

    settings: dict[str, Any] = {}
    experiments: tuple[str, ...] = ()
    accept: tuple[OutcomeName, ...] = ()


class Term(Section):
    """What a search makes small: ``weight`` · the mean over the runs of a ``metric`` (of one ``experiment``, or of all that have it),
    cut at ``limit``. A run that did not complete counts as ``limit``, and so does one without the metric.

    ``maximize``: what counts is 2 · ``limit`` − the metric, so that a large one is good.
    """

    metric: str
    limit: float = Field(gt=0, le=LARGEST)
    experiment: str = ""
    weight: float = Field(1.0, gt=0, le=LARGEST)
    maximize: bool = False


class Tuning(Section):
    """A search: ``search`` (ranges by key) on ``seeds`` of its own, ``trials`` with a ``sampler``. One objective is the sum of
    ``minimize``; with ``pareto`` each term is one. ``constraints``: largest values of metrics in every run; ``allow_failures``:
    runs that do not complete break no constraint. ``prune``: trials that are worse than the median are ended between seeds. ``storage``: address
    of Optuna's database (left out: SQLite beside the results)."""

    seeds: Seeds
    search: dict[str, Searched] = Field(min_length=1)
    minimize: tuple[Term, ...] = Field(min_length=1)
    constraints: dict[str, Annotated[float, Field(ge=-LARGEST, le=LARGEST)]] = {}
    allow_failures: bool = False
    trials: int = Field(200, ge=1, le=1_000_000)
    sampler: Literal["tpe", "cmaes", "random", "nsga2"] = "tpe"
    sampler_seed: int = Field(0, ge=0, le=2**32 - 1)
    pareto: bool = False
    prune: bool = False
    storage: str = ""

    @model_validator(mode="after")
    def _one_objective(self) -> Self:
        if self.pareto and len(self.minimize) < 2:
            raise ValueError("pareto: true needs two terms in minimize, or more")
        if self.pareto and (self.prune or self.sampler == "cmaes"):
            raise ValueError("pareto: true goes neither with prune nor with sampler: cmaes, which have one objective")
        if self.sampler == "cmaes" and any(isinstance(s, tuple) for s in self.search.values()):
            raise ValueError("sampler: cmaes searches numbers only; valid for lists: tpe, random, nsga2")
        return self


class Definition(Section):
    """A study: ``experiments`` (names or Python files, with settings of their own) × ``conditions`` × ``robots`` × ``vary`` ×
    ``draws`` × ``seeds``. ``settings``: of all runs. ``compare_with``: the condition with which the others are compared (the first
    when left out). ``metrics``: what tables and pages show (when left out: those that have a goal or a paper's figure; all, where these
    only count falls and contacts); of those in ``larger_is_better`` a small one is a bad one. ``files``: of which runs report and recording
    are kept."""

    title: str = ""
    experiments: dict[str, dict[str, Any]] = Field(min_length=1)
    seeds: Seeds
    robots: tuple[str, ...] = ()
    settings: dict[str, Any] = {}
    vary: dict[str, Axis] = {}
    draws: int = Field(1, ge=1, le=100_000)
    draw_seed: int = Field(0, ge=0, le=2**63 - 1)
    conditions: dict[str, Condition] = {}
    compare_with: str = ""
    metrics: tuple[str, ...] = ()
    larger_is_better: tuple[str, ...] = ()
    files: Literal["none", "failed", "all"] = "none"
    tune: Tuning | None = None

    @field_validator("experiments", mode="before")
    @classmethod
    def _names_alone(cls, value: Any) -> Any:
        if isinstance(value, str):
            return {value: {}}
        if isinstance(value, list) and all(isinstance(v, str) for v in value):
            return {v: {} for v in value}
        return {k: {} if v is None else v for k, v in value.items()} if isinstance(value, Mapping) else value

    @field_validator("conditions", mode="before")
    @classmethod
    def _empty_ones(cls, value: Any) -> Any:
        return {k: {} if v is None else v for k, v in value.items()} if isinstance(value, Mapping) else value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.compare_with and self.compare_with not in self.conditions:
            raise ValueError(str(unknown_name("condition", self.compare_with, self.conditions, "compare_with")))
        for name, condition in self.conditions.items():
            for experiment in condition.experiments:
                if experiment not in self.experiments:
                    where = f"conditions.{name}.experiments"
                    raise ValueError(str(unknown_name("experiment", experiment, self.experiments, where)))
        self._check_layers()
        drawn = [key for key, axis in self.vary.items() if isinstance(axis, Random)]
        if self.draws > 1 and not drawn:
            raise ValueError("draws: nothing is random; a setting in vary needs random: true")
        self._check_search()
        return self

    @property
    def _conditions(self) -> dict[str, dict[str, Any]]:
        """Settings of the conditions, by place in the file."""
        return {f"conditions.{name}.settings": c.settings for name, c in self.conditions.items()}

    def _check_layers(self) -> None:
        """A condition, or a robot, that says one thing would run with another: what wins is no layer under it."""
        robot = {"robot": ()} if self.robots else {}
        for winner, layer in (("robots", robot), ("vary", self.vary)):
            for place, below in {"vary": self.vary, **self._conditions}.items():
                if place != winner and (both := [key for key in layer if key in below]):
                    raise ValueError(
                        f"{place}: '{both[0]}' is given by {winner} too, which would win; it can be in one only"
                    )

    def _check_search(self) -> None:
        if self.tune is None:
            return
        if both := sorted({*self.seeds} & {*self.tune.seeds}):
            raise ValueError(
                f"tune.seeds: {', '.join(map(str, both[:5]))} are in 'seeds' too: what is tuned on a seed cannot be reported on it; "
                "give other tuning seeds"
            )
        for place, layer in {"vary": self.vary, **self._conditions}.items():
            if fixed := [key for key in self.tune.search if key in layer]:
                raise ValueError(f"tune.search: '{fixed[0]}' is in {place} too, which would win; it can be in one only")
        for term in self.tune.minimize:
            if term.experiment and term.experiment not in self.experiments:
                raise ValueError(str(unknown_name("experiment", term.experiment, self.experiments, "tune.minimize")))


def load_definition(path: Path) -> Definition:
    """The study of a YAML file. Raises :class:`InputError` naming the file, the key and the valid choices."""
    data = load_yaml(path)
    if not isinstance(data, dict):
        raise InputError(f"{path}: a mapping is needed; valid keys: {', '.join(Definition.model_fields)}")
    if unknown := [key for key in data if key not in Definition.model_fields]:
        raise unknown_name("key", str(unknown[0]), Definition.model_fields, str(path))
    try:
        found = Definition.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{path}: {describe(error, Definition)}") from error
    return found.model_copy(update={"title": found.title or path.stem})
