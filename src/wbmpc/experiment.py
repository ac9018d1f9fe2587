"""What an experiment is, and the one way in which experiments are run, recorded and reported.

An experiment is data and a few lines. Its settings and a seed make a :class:`Scenario`: parts that are run one after another
(mostly one :class:`Loop` of plant, controller and MPC), what they record, and what is measured and drawn of the record::

    def build(settings: MySettings, seed: int) -> Scenario:
        ...
        log = Log()
        loop = Loop(plant, controller, mpc, timing, duration, record)
        return Scenario.single(log, loop.run, metrics, plots, IDEALIZATIONS)

    EXPERIMENT = Experiment.of("my-task", "what it shows", MySettings, build)
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import numpy as np
from pydantic import BaseModel

from wbmpc.control.protocols import RobotController
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.result import Drawing, Metric, MpcStatistics, OutcomeName, Plot, RunResult, Series
from wbmpc.simulation.contacts import Contacts
from wbmpc.simulation.lockstep import Ending, Progress, part, preparing, run_lockstep
from wbmpc.types import Plant, Timing

#: Unit and definition of metrics by name; ``*`` in a name stands for anything, and the first that fits counts.
Definitions = Mapping[str, tuple[str, str]]
#: What every experiment with a simulated robot reports.
COMMON: Definitions = {
    "contacts_unwanted": ("1", "how often parts of the robot touched each other or something that they should not"),
    "fell": ("1", "whether the robot fell: 1 if it did"),
    "clearance_min": ("m", "smallest distance of the robot's parts to obstacles and to each other, 1 m at most; not to the floor"),
}  # fmt: skip
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True)
class Experiment:
    """An experiment: ``name``, one-line ``summary``, type of its settings (``config_type``), ``run(settings, seed, progress)``, and
    ``definitions`` of its metrics (unit and text by name). The name is part of the run's directory: letters, digits, dots, dashes and
    underscores. Raises :class:`InputError` for
    another one, and for what is no model or no function.
    """

    name: str
    summary: str
    config_type: type[BaseModel]
    run: Callable[..., RunResult]
    definitions: Definitions = field(default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError(f"experiment '{self.name}': valid in a name: letters, digits, '.', '-' and '_'")
        if not isinstance(self.summary, str):
            raise InputError(f"experiment '{self.name}': a text is needed that says what it is about")
        if not (isinstance(self.config_type, type) and issubclass(self.config_type, BaseModel) and callable(self.run)):
            raise InputError(f"experiment '{self.name}': a pydantic model of its settings and a function are needed")

    @classmethod
    def of(
        cls, name: str, summary: str, config_type: type[BaseModel], build: Callable[[Any, int], Scenario],
        definitions: Definitions | None = None,
    ) -> Experiment:  # fmt: skip
        """An experiment whose settings and seed make a scenario."""
        known = definitions or {}
        return cls(name, summary, config_type, partial(run_scenario, name, build, definitions=known), known)


@dataclass(frozen=True)
class Outcome:
    """How a part ended, the faults that it found in its robot, its controller, and the MPC whose solves the report counts (None:
    they do not count, or there are none)."""

    ending: Ending = field(default_factory=Ending)
    faults: Sequence[str] = ()
    controller: RobotController | None = None
    mpc: MPC | None = None


@dataclass(frozen=True)
class Loop:
    """A closed loop in virtual time: ``plant``, ``controller`` and ``mpc`` (None: nothing plans) for ``duration`` [s], with the periods of
    ``timing``.

    ``record(t, command, plans)`` is called once per controller period, before the command acts; ``done()`` after it: whether the loop ends
    early, its task done.
    """

    plant: Plant[Any, Any]
    controller: RobotController
    mpc: MPC | None
    timing: Timing
    duration: float
    record: Callable[[float, Any, PolicyQueue], None]
    done: Callable[[], bool] | None = None

    def run(self, progress: Progress | None = None) -> Outcome:
        """Run it to its end, or as far as it gets."""
        ending = run_lockstep(
            self.plant, self.controller, self.mpc, self.timing, self.duration, self.record, progress, self.done
        )
        return Outcome(ending, list(map(str, self.controller.faults)), self.controller, self.mpc)


@dataclass(frozen=True)
class Part:
    """One part of an experiment: ``run(progress)`` makes what it needs and runs it. Its name stands before its faults.

    ``baseline``: its failure is reported as a fault and does not fail the run.
    """

    name: str
    run: Callable[[Progress | None], Outcome]
    baseline: bool = False


@dataclass
class Run:
    """What has been run so far: outcomes by part, how the whole ended, faults."""

    outcomes: dict[str, Outcome] = field(default_factory=dict)
    ending: Ending = field(default_factory=Ending)
    faults: list[str] = field(default_factory=list)
    contacts: list[Contacts] = field(default_factory=list)

    @property
    def collision(self) -> str:
        """The first unwanted contact of what was run (baselines apart), and how many there were; empty without any."""
        touches = [touch for contacts in self.contacts for touch in contacts.touches]
        return f"{touches[0]}; {len(touches)} unwanted contacts" if touches else ""

    @property
    def failure(self) -> OutcomeName:
        """What kind of failure it was if it was one."""
        if self.ending.fell or self.collision:
            return "fell" if self.ending.fell else "collided"
        if self.ending.declined:
            return "declined"
        return "stuck" if self.ending.stuck else "gave_up"


@dataclass(frozen=True)
class Scenario:
    """One run of an experiment, ready to start: parts that fill ``log``, and functions that make metrics and plots of it.

    ``idealizations``: what the simulation leaves out, as texts.

    ``metrics`` and ``plots`` are asked once, after all parts, and only if something was recorded. ``compared``: the parts do the
    same task in different ways, and all of them are run; without it they follow each other, and the first failure is the end.
    """

    log: Log
    parts: Sequence[Part]
    metrics: Callable[[Run], dict[str, Metric]]
    plots: Callable[[Run], Sequence[Plot | Drawing]]
    idealizations: Sequence[str]
    compared: bool = False

    @classmethod
    def single(
        cls, log: Log, run: Callable[[Progress | None], Outcome], metrics: Callable[[Run], dict[str, Metric]],
        plots: Callable[[Run], Sequence[Plot | Drawing]], idealizations: Sequence[str],
    ) -> Scenario:  # fmt: skip
        """One part, which needs no name."""
        return cls(log, (Part("", run),), metrics, plots, idealizations)


def run_scenario(
    name: str, build: Callable[[Any, int], Scenario], settings: Any, seed: int, progress: Progress | None = None,
    definitions: Definitions | None = None,
) -> RunResult:  # fmt: skip
    """Build a scenario, run its parts and report. A run that ended before its first record has neither metrics nor plots."""
    with preparing(progress):
        scenario = build(settings, seed)
        run = run_parts(scenario, progress)
    planners = [o.mpc for o in run.outcomes.values() if o.mpc is not None]
    statistics = _statistics(planners[-1]) if planners else None
    if progress is not None and statistics is None:
        progress(1.0, "")
    reason = run.ending.reason or (statistics.fault if statistics else "") or run.collision
    log = scenario.log
    metrics, plots = (scenario.metrics(run), list(scenario.plots(run))) if log.channels else ({}, [])
    if plots and planners and planners[-1].statistics.solve_times:
        plots.append(_solve_times(planners[-1]))
    return RunResult(
        name, seed, not reason, reason, defined(name, {**metrics, **_common(run, metrics)}, definitions), statistics, log, plots,
        list(scenario.idealizations), settings.model_dump(mode="json"), run.ending.interrupted, run.faults, run.failure,
    )  # fmt: skip


def _common(run: Run, metrics: Mapping[str, Metric]) -> dict[str, Metric]:
    """What every experiment with a simulated robot reports: unwanted contacts, the smallest clearance, whether it ``fell``."""
    if not metrics or not run.contacts:
        return {}
    fell = {} if any(n == "fell" or n.startswith("fell_") for n in metrics) else {"fell": float(run.ending.fell)}
    touches, nearest = sum(len(c.touches) for c in run.contacts), min(c.clearance for c in run.contacts)
    counts = {"contacts_unwanted": float(touches), **fell}
    found = {n: Metric(v, "1", goal=0.0) for n, v in counts.items()}
    return {**found, "clearance_min": Metric(nearest, "m", larger_is_better=True)}


def defined(name: str, metrics: Mapping[str, Metric], definitions: Definitions | None = None) -> dict[str, Metric]:
    """Metrics of the experiment ``name`` with their definitions. Warns of those that an experiment with ``definitions`` lacks."""
    found = {
        n: m if m.definition else replace(m, definition=definition_of(n, definitions or {})[1]) for n, m in metrics.items()
    }  # fmt: skip
    if definitions and (lacking := [n for n, m in found.items() if not m.definition]):
        warnings.warn(f"{name}: metrics without a definition: {', '.join(lacking)}", stacklevel=2)
    return found


def definition_of(metric: str, definitions: Definitions) -> tuple[str, str]:
    """Unit and definition of a metric by its name; two empty texts where there is none."""
    known = [*definitions.items(), *COMMON.items()]
    return next((about for pattern, about in known if fnmatchcase(metric, pattern)), ("", ""))


def _statistics(mpc: MPC) -> MpcStatistics:
    m = mpc.statistics
    return MpcStatistics.of(mpc.rate, m.solve_times, m.solves, m.failures, m.no_step)


def _solve_times(mpc: MPC) -> Plot:
    """How long each solve took on this machine beside the period: in virtual time a late plan is no later than the computation delay
    of the settings."""
    solve = 1e3 * np.array(mpc.statistics.solve_times)
    t = np.arange(1, solve.size + 1) / mpc.rate  # the first update's time is not counted
    period = np.full(2, 1e3 / mpc.rate)
    return Plot("Solve times", "time [s]", "time [ms]", [
        Series("solve", t, solve), Series("period", t[[0, -1]], period, dashed=True),
    ])  # fmt: skip


def run_parts(scenario: Scenario, progress: Progress | None = None) -> Run:
    """Run the parts in their order, until the user ends one, or one that is not compared with the others fails."""
    run, parts = Run(), scenario.parts
    for k, p in enumerate(parts):
        outcome = run.outcomes[p.name] = p.run(part(progress, k, len(parts), p.name) if p.name else progress)
        label, end = f"{p.name}: " if p.name else "", outcome.ending
        run.faults += [f"{label}{fault}" for fault in outcome.faults]
        if p.baseline:
            run.faults += [f"{label}{touch}" for contacts in end.contacts for touch in contacts.touches]
        else:
            run.contacts += end.contacts
        if end.reason and p.baseline and not end.interrupted:
            run.faults.append(f"{label}{end.reason}; nothing is compared with it")
        elif end.reason and (end.interrupted or not run.ending.reason):
            run.ending = replace(end, reason=f"{label}{end.reason}") if scenario.compared else end
        if run.ending.interrupted or (run.ending.reason and not scenario.compared):
            break
    return run
