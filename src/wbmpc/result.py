"""What a run gives back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from wbmpc.log import Log
from wbmpc.plots.figures import Drawing as Drawing
from wbmpc.plots.figures import Plot as Plot
from wbmpc.plots.figures import Series as Series
from wbmpc.plots.motion import Motion
from wbmpc.plots.notebook import figure, html_table
from wbmpc.units import scale

#: How a run ended: in one word. Only the first is a success. ``declined``: the robot reported that it does not get through before it entered;
#: ``rejected``: it did not start.
OutcomeName = Literal["completed", "gave_up", "stuck", "declined", "fell", "collided", "rejected", "interrupted"]
#: A run in which a larger share of the solves gave no new plan was not controlled by the MPC: it is not completed.
MAX_FAILED = 0.1


@dataclass(frozen=True)
class Metric:
    """A figure: its ``value`` in SI units, the ``unit`` as text, the ``paper``'s figure and the ``goal`` (a largest value) where there is
    one.

    ``least``: a smallest value, alone or with ``goal``. ``goal_note``: what a reader must know about the goal when one run
    misses it. ``definition``: what is measured, in a few words; reports show it beside the name. ``larger_is_better``: a small value is the
    bad one (a distance to obstacles); not needed for one whose only goal is a smallest value.
    """

    value: float
    unit: str
    paper: float | None = None
    goal: float | None = None
    goal_note: str = ""
    least: float | None = None
    definition: str = ""
    larger_is_better: bool = False

    @property
    def met(self) -> bool | None:
        """Whether the goal is reached; None without a goal."""
        if self.goal is None and self.least is None:
            return None
        return bool((self.goal is None or self.value <= self.goal) and (self.least is None or self.value >= self.least))


def metrics_of_interest(names: Sequence[str], judged: Mapping[str, str]) -> list[str]:
    """What tables of runs show of the metrics ``names`` when nobody says: those that are ``judged`` by a goal or a paper's figure, by name
    with their units; all, where these only count something (falls, contacts)."""
    return list(dict.fromkeys(judged if any(unit not in ("", "1") for unit in judged.values()) else names))


@dataclass(frozen=True)
class MpcStatistics:
    """Rate [Hz], solve times [ms] (median, p95, max) and how many took longer than the period.

    Of ``solves`` solves ``failures`` gave no usable plan, and ``no_step`` found no step, so that the old plan went on.
    """

    rate_hz: float
    solve_ms: dict[str, float]
    deadline_misses: int
    solves: int = 0
    failures: int = 0
    no_step: int = 0

    @classmethod
    def of(
        cls, rate: float, seconds: list[float], solves: int = 0, failures: int = 0, no_step: int = 0
    ) -> MpcStatistics:
        """Statistics of solve times [s] and of failures."""
        ms = 1e3 * np.array(seconds if seconds else [np.nan])
        figures = {"median": float(np.median(ms)), "p95": float(np.percentile(ms, 95)), "max": float(ms.max())}
        return cls(rate, figures, int(np.sum(ms > 1e3 / rate)), solves, failures, no_step)

    @property
    def failed_share(self) -> float:
        """Solves that gave no new plan over all solves (0 without any)."""
        return (self.failures + self.no_step) / max(self.solves, 1)

    @property
    def fault(self) -> str:
        """Why a run with these statistics does not count as completed; empty when it does."""
        if self.failed_share <= MAX_FAILED:
            return ""
        return (
            f"{100 * self.failed_share:.0f} % of the MPC's {self.solves} solves gave no new plan "
            f"({self.failures} failed, {self.no_step} without a step); at most {100 * MAX_FAILED:.0f} % may"
        )


@dataclass
class RunResult:
    """The result of a run of an ``experiment`` by name with a ``seed``; ``completed``: whether it ran to its end; ``metrics`` by name;
    ``log``: its signals; ``plots`` of its report; ``idealizations``: what the simulation leaves out, as texts; ``settings`` as plain
    values; ``reason`` says why it did not complete; ``interrupted``: by Ctrl-C; ``mpc`` is None in
    experiments without one; ``faults``: what the run found out about its robot (a stalled encoder), as messages; ``failure``: the
    ``outcome`` of a run that neither completed nor was interrupted; ``command`` repeats the run, and ``wall_time`` [s] is how long it
    took, both of runs of the command line; ``motion``: what the report's replay shows, of runs that are recorded."""

    experiment: str
    seed: int
    completed: bool
    reason: str
    metrics: dict[str, Metric]
    mpc: MpcStatistics | None
    log: Log
    plots: Sequence[Plot | Drawing] = field(default_factory=list)
    idealizations: list[str] = field(default_factory=list)
    settings: dict[str, Any] = field(default_factory=dict)
    interrupted: bool = False
    faults: list[str] = field(default_factory=list)
    failure: OutcomeName = "gave_up"
    command: str = ""
    wall_time: float | None = None
    motion: Motion | None = None

    @property
    def outcome(self) -> OutcomeName:
        """How the run ended: completed, interrupted, or its failure."""
        if self.interrupted:
            return "interrupted"
        return "completed" if self.completed else self.failure

    def __repr__(self) -> str:
        reason = f": {self.reason}" if self.reason else ""
        return f"RunResult({self.experiment}, seed {self.seed}, {self.outcome}{reason}; {len(self.metrics)} metrics)"

    def _repr_html_(self) -> str:
        rows = []
        for name, m in self.metrics.items():
            shown, met = scale(m.unit, m.value, m.paper, m.goal, m.least), self.reached(name)
            bounds = [f"{sign} {shown.text(b)}" for sign, b in (("≥", m.least), ("≤", m.goal)) if b is not None]
            said = {True: "reached", False: "missed", None: ""}[met]
            rows.append([name, shown.text(m.value), shown.unit, " and ".join(bounds), said, m.definition])
        return html_table(repr(self), ["metric", "this run", "unit", "goal", "", "definition"], rows)

    def plot(self) -> Any:
        """The plots of the report as one Plotly figure (drawings are left out)."""
        return figure([plot for plot in self.plots if isinstance(plot, Plot)])

    def reached(self, name: str) -> bool | None:
        """Whether the goal of a metric is reached; None without a goal, and where the user ended the run: it says nothing about
        goals. Another run that did not complete reaches none."""
        met = None if self.interrupted else self.metrics[name].met
        return met if met is None else met and self.completed

    @classmethod
    def aborted(
        cls, experiment: str, seed: int, reason: str, settings: dict[str, Any], interrupted: bool = False
    ) -> RunResult:
        """The result of a run that ended before its first tick."""
        mpc = MpcStatistics.of(1.0, [])
        return cls(experiment, seed, False, reason, {}, mpc, Log(), settings=settings, interrupted=interrupted)
