"""The rows of a study by combination: figures, failures, comparisons; as data, and as tables."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.result import metrics_of_interest
from wbmpc.study.statistics import Paired, Rate, Spread, failure_rate, paired, spread
from wbmpc.study.store import LARGER, Targets, combination_of, targets_of

if TYPE_CHECKING:
    import pyarrow

    from wbmpc.study.plan import Combination

_NONE: dict[str, float | None] = {"paper": None, "goal": None, "least": None}


@dataclass(frozen=True)
class Cell:
    """Runs of one combination, by its ``key``: ``seeds`` (n,), figures by metric (n,), nan where a run has none; ``accept``: outcomes that count
    as success beside ``completed``."""

    key: str
    experiment: str
    label: str
    condition: str
    robot: str
    varied: Mapping[str, Any]
    seeds: np.ndarray
    outcomes: tuple[str, ...]
    figures: Mapping[str, np.ndarray] = field(repr=False)
    reasons: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    accept: tuple[str, ...] = ()

    @property
    def accepted(self) -> np.ndarray:
        """Whether (n,) each run is a success."""
        return np.array([outcome in ("completed", *self.accept) for outcome in self.outcomes])

    @property
    def failures(self) -> Rate:
        """Runs that are no success."""
        return failure_rate(int((~self.accepted).sum()), len(self.outcomes))

    def judged(self, metric: str, largest_is_worst: bool = True, needed: bool = True) -> np.ndarray:
        """The metric's values (n,); a run that is no success is infinitely bad, and so is one without a figure that is ``needed``. Of
        another one it has nan."""
        values = self.figures.get(metric, np.full(self.seeds.size, np.nan))
        bad = ~self.accepted | (np.isnan(values) & needed)
        return np.where(bad, np.inf if largest_is_worst else -np.inf, values)


@dataclass(frozen=True)
class Summary:
    """What a study's runs say. ``shown``: metrics by experiment; ``targets``: goals and papers' figures by combination; ``lost``: runs without a
    result; ``sources``: versions, commits and hashes of the code that rows are of."""

    title: str
    cells: tuple[Cell, ...]
    units: Mapping[str, str]
    targets: Targets
    shown: Mapping[str, tuple[str, ...]]
    planned: int
    lost: Mapping[str, int]
    sources: Mapping[str, tuple[str, ...]]
    compare_with: str = ""
    larger_is_better: tuple[str, ...] = ()
    _spreads: dict[tuple[str, str], Spread] = field(default_factory=dict, init=False, repr=False, compare=False)
    _compared: dict[tuple[str, str], Paired | None] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def finished(self) -> int:
        return sum(len(cell.outcomes) for cell in self.cells)

    def target(self, cell: Cell, metric: str) -> dict[str, float | None]:
        return self.targets.get(cell.key, {}).get(metric, _NONE)

    def large_is_bad(self, cell: Cell, metric: str) -> bool:
        """Whether large values are bad: not those of ``larger_is_better``, nor those whose only goal is a minimum."""
        target = self.target(cell, metric)
        return metric not in self.larger_is_better and (target["least"] is None or target["goal"] is not None)

    def _judged(self, cell: Cell, metric: str) -> np.ndarray:
        """Values (n,) of a metric; nan where a run that is a success has none, and no goal asks for it: an arm has no base."""
        target = self.target(cell, metric)
        needed = target["goal"] is not None or target["least"] is not None
        return cell.judged(metric, self.large_is_bad(cell, metric), needed)

    def spread(self, cell: Cell, metric: str) -> Spread:
        """Computed once: tables, pages and plots ask for it again."""
        if (cell.key, metric) not in self._spreads:
            self._spreads[cell.key, metric] = self._spread(cell, metric)
        return self._spreads[cell.key, metric]

    def _spread(self, cell: Cell, metric: str) -> Spread:
        values = self._judged(cell, metric)
        return spread(values[~np.isnan(values)], self.large_is_bad(cell, metric))

    def met(self, cell: Cell, metric: str) -> bool | None:
        """Whether the 95 % value reaches the goal (the 5 % value, a smallest one); None without a goal."""
        target, found = self.target(cell, metric), self.spread(cell, metric)
        if target["goal"] is None and target["least"] is None:
            return None
        return (target["goal"] is None or found.p95 <= target["goal"]) and (
            target["least"] is None or found.p5 >= target["least"]
        )

    def reference(self, cell: Cell) -> Cell | None:
        """What a cell is compared with: the same settings under the condition ``compare_with``, or else the experiment's first."""
        same = [c for c in self.cells if c.experiment == cell.experiment and c.robot == cell.robot]
        several = len({c.condition for c in same}) > 1
        under = [c for c in same if several and c.condition == self.compare_with and c.varied == cell.varied]
        found = (under or same)[0]
        return None if found is cell else found

    def comparison(self, cell: Cell, metric: str) -> Paired | None:
        """With its reference on the seeds for which both have a figure; None without a reference, or such seeds."""
        if (cell.key, metric) not in self._compared:
            self._compared[cell.key, metric] = self._comparison(cell, metric)
        return self._compared[cell.key, metric]

    def _comparison(self, cell: Cell, metric: str) -> Paired | None:
        other = self.reference(cell)
        if other is None:
            return None
        _, mine, its = np.intersect1d(cell.seeds, other.seeds, assume_unique=True, return_indices=True)
        these, others = self._judged(cell, metric)[mine], self._judged(other, metric)[its]
        both = ~np.isnan(these) & ~np.isnan(others)
        return paired(these[both], others[both], self.large_is_bad(cell, metric)) if both.any() else None

    def to_json(self) -> dict[str, Any]:
        """The object that ``--json`` prints; figures that are not finite are null."""
        cells = [
            {
                "experiment": c.experiment, "combination": c.label, "condition": c.condition, "robot": c.robot, "varied": dict(c.varied),
                "seeds": c.seeds.tolist(), "outcomes": dict(Counter(c.outcomes)), "failures": asdict(c.failures),
                "metrics": {m: self._figures(c, m) for m in self.shown[c.experiment]},
            }
            for c in self.cells
        ]  # fmt: skip
        about = {"title": self.title, "planned": self.planned, "finished": self.finished, "lost": dict(self.lost)}
        found: dict[str, Any] = _finite({**about, **{k: list(v) for k, v in self.sources.items()}, "cells": cells})
        return found

    def _figures(self, cell: Cell, metric: str) -> dict[str, Any]:
        other, reference = self.comparison(cell, metric), self.reference(cell)
        compared = None if other is None or reference is None else {"with": reference.label, **asdict(other)}
        return {
            "unit": self.units.get(metric, "1"), **asdict(self.spread(cell, metric)), **self.target(cell, metric),
            "met": self.met(cell, metric), "compared": compared,
        }  # fmt: skip


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def summarize(
    title: str, combinations: Sequence[Combination], table: pyarrow.Table, planned: int, metrics: Sequence[str] = (),
    compare_with: str = "", larger_is_better: Sequence[str] = (),
) -> Summary:  # fmt: skip
    """Of a study's table. ``metrics``: those that are shown (when empty: those of interest). ``larger_is_better``: beside those that
    say so themselves."""
    columns = [name for name in table.column_names if name.startswith("metric.")]
    fields = {n.removeprefix("metric."): table.schema.field(n) for n in columns}
    units = {n: _metadata(field).get("unit", "1") for n, field in fields.items()}
    keys, outcomes = table["key"].to_pylist(), np.array(table["outcome"].to_pylist(), dtype=object)
    groups: dict[str, list[int]] = {}
    for k, key in enumerate(keys):
        if outcomes[k] not in ("error", "lost"):
            groups.setdefault(combination_of(key), []).append(k)
    figures = {n.removeprefix("metric."): _numbers(table[n]) for n in columns}
    texts = {n: np.array(table[n].to_pylist(), dtype=object) for n in ("reason", "files")}
    seeds, cells = table["seed"].to_numpy(), []
    for c in combinations:
        rows = np.array(groups.get(c.key, []), int)
        if rows.size:
            rows = rows[np.argsort(seeds[rows])]
            values = {n: v[rows] for n, v in figures.items() if not np.isnan(v[rows]).all()}
            found = (tuple(outcomes[rows]), values, tuple(texts["reason"][rows]), tuple(texts["files"][rows]))
            about = (c.key, c.experiment, c.label, c.condition, c.robot, c.varied, seeds[rows])
            cells.append(Cell(*about, *found, c.accept))
    targets = targets_of(table.schema)
    bad = [k for k in range(len(keys)) if outcomes[k] in ("error", "lost")]
    lost = Counter(f"{outcomes[k]}: {texts['reason'][k]}" for k in bad)
    sources = {n: tuple(dict.fromkeys(t for t in table[n].to_pylist() if t)) for n in ("version", "commit", "code")}
    shown = {
        e: _shown([c for c in cells if c.experiment == e], targets, units, metrics)
        for e in dict.fromkeys(c.experiment for c in cells)
    }
    first = next(iter(dict.fromkeys(c.condition for c in cells)), "")
    return Summary(
        title, tuple(cells), units, targets, shown, planned, lost, sources, compare_with or first,
        (*larger_is_better, *(n for n, field in fields.items() if LARGER.items() <= _metadata(field).items())),
    )  # fmt: skip


def _shown(cells: Sequence[Cell], targets: Targets, units: Mapping[str, str], chosen: Sequence[str]) -> tuple[str, ...]:
    """Metrics of an experiment's cells that tables show."""
    there = list(dict.fromkeys(m for c in cells for m in c.figures))
    if chosen:
        return tuple(m for m in chosen if m in there)
    known = [targets.get(c.key, {}) for c in cells]
    judged = {m: units[m] for m in there if any(v is not None for of in known for v in of.get(m, {}).values())}
    return tuple(metrics_of_interest(there, judged))


def _metadata(column: Any) -> dict[str, str]:
    return {key.decode(): value.decode() for key, value in (column.metadata or {}).items()}


def _numbers(column: Any) -> np.ndarray:
    """A column (n,) with nan where there is nothing."""
    return np.array([np.nan if v is None else v for v in column.to_pylist()], float)
