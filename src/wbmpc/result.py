"""What a run gives back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wbmpc.log import Log


@dataclass(frozen=True)
class Metric:
    """A figure with its unit, the paper's figure and the goal (a largest value) where there is one."""

    value: float
    unit: str
    paper: float | None = None
    goal: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the goal is reached; None without a goal."""
        return None if self.goal is None else bool(self.value <= self.goal)


@dataclass(frozen=True)
class MpcStatistics:
    """Rate [Hz], solve times [ms] (median, p95, max) and how many took longer than the period."""

    rate_hz: float
    solve_ms: dict[str, float]
    deadline_misses: int

    @classmethod
    def of(cls, rate: float, seconds: list[float]) -> MpcStatistics:
        """Statistics of solve times [s]."""
        ms = 1e3 * np.array(seconds if seconds else [np.nan])
        figures = {"median": float(np.median(ms)), "p95": float(np.percentile(ms, 95)), "max": float(ms.max())}
        return cls(rate, figures, int(np.sum(ms > 1e3 / rate)))


@dataclass(frozen=True)
class Series:
    """One line of a plot."""

    name: str
    x: np.ndarray
    y: np.ndarray
    dashed: bool = False


@dataclass(frozen=True)
class Plot:
    """A plot of the report."""

    title: str
    x_label: str
    y_label: str
    series: list[Series]
    equal_axes: bool = False


@dataclass
class RunResult:
    """Everything a run leaves behind; ``reason`` says why it ended early (empty when completed)."""

    experiment: str
    seed: int
    completed: bool
    reason: str
    metrics: dict[str, Metric]
    mpc: MpcStatistics
    log: Log
    plots: list[Plot] = field(default_factory=list)
    idealisations: list[str] = field(default_factory=list)
    settings: dict[str, Any] = field(default_factory=dict)
