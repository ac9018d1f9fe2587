"""A study that is run, and gone on with: :class:`Study` has its file, runs, rows, statistics and page."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from wbmpc.errors import InputError, NotWritten
from wbmpc.input_file import load_json
from wbmpc.output_file import write_text
from wbmpc.robots.robot_yaml import write_yaml
from wbmpc.run_files import flat
from wbmpc.study.definition import Condition, Definition, load_definition
from wbmpc.study.files import ABOUT, BEST, JOURNAL, PAGE, ROWS, STATISTICS, TRIAL_ROWS, TRIALS
from wbmpc.study.page import study_page
from wbmpc.study.plan import Combination, Run, check_inputs, combinations, open_experiment, runs
from wbmpc.study.store import Store, is_running
from wbmpc.study.summary import Summary, summarize
from wbmpc.study.tune_page import tune_page
from wbmpc.study.tuning import Tuner, settings_of_trial, with_settings
from wbmpc.study.work import ERROR, LOST, execute
from wbmpc.study.workers import Later, Pool, Row, Task, completed

if TYPE_CHECKING:
    import pyarrow

#: ``progress(share, note)``.
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Study:
    """A study: its ``definition``, the ``path`` of its file (relative names in it are resolved from there), and the directory ``out`` of
    its results::

        study = Study.load("rates.yaml", "runs/rates")
        summary = study.run(workers=2)      # what has no result yet
        rows = study.table()                # pyarrow: a row for each run
    """

    definition: Definition
    path: Path
    out: Path

    @classmethod
    def load(cls, path: str | Path, out: str | Path | None = None) -> Self:
        """The study of a YAML file; ``out`` left out: ``runs/NAME``. Raises :class:`InputError` naming file, key and valid choices."""
        file = Path(path)
        return cls(load_definition(file), file, Path("runs") / file.stem if out is None else Path(out))

    @cached_property
    def combinations(self) -> list[Combination]:
        """Settings of its runs, each checked. Raises :class:`InputError`."""
        return combinations(self.definition, self.path.resolve().parent, str(self.path))

    def runs(self) -> Iterator[Run]:
        """All its runs, seed by seed."""
        return runs(self.combinations, self.definition.seeds)

    @property
    def planned(self) -> int:
        """Number of runs."""
        return len(self.combinations) * len(self.definition.seeds)

    def run(
        self, workers: int | None = None, scheduler: str | None = None, progress: Progress | None = None
    ) -> Summary:
        """Run everything that has no result yet on ``workers`` processes (None: as many as there are cores; 0: in this one), or on the
        workers of the Dask scheduler at an address; write rows, statistics and page. What is interrupted goes on the next time.

        Raises :class:`InputError` for settings that do not exist, for robots and files that cannot be read, and where ``out`` has runs
        of other settings.
        """
        check_inputs(self.combinations, str(self.path))  # before any process starts
        with Later(workers, scheduler) as there:
            return self._run_in(there, progress)

    def _run_in(self, there: Pool, progress: Progress | None = None, replace: bool = False) -> Summary:
        """Do the runs in a pool that is there; see :meth:`run`. ``replace``: runs of other settings are removed from ``out``."""
        found = self.combinations
        with Store(self.out) as store:
            if replace:
                store.keep({c.key for c in found})
            reject_others(self.out, found, store.outcomes())
            remember(self.out, self.definition.title, found, self.planned)
            with store.finishing():
                self._run_missing(there, store, store.done(), progress)
        return self.report()

    def _run_missing(self, there: Pool, store: Store, done: set[str], progress: Progress | None) -> None:
        """Do the runs that are not ``done`` in a pool, and keep their rows."""
        going: dict[str, Run] = {}
        clock = Clock(self.runs(), done, store.outcomes())

        def tasks() -> Iterator[Task]:
            for run in self.runs():
                if run.key not in done:
                    going[run.key] = run
                    yield self._task(run)

        for task, row in completed(there, execute, tasks()):
            run = going.pop(task["key"])
            unwritten = row.pop("unwritten", False)
            store.add({**row_about(run), **row})
            if unwritten:  # all others would be simulated for nothing
                raise NotWritten(f"{row['reason']}; what was finished before is kept, the same command continues")
            clock.ended(run, row)
            if progress is not None:
                progress(clock.share, clock.text(there.threads))

    def tune(self, workers: int | None = None, scheduler: str | None = None, progress: Progress | None = None) -> Tuned:
        """Search the settings that ``tune`` in the file says, on its seeds; then run the study's own seeds before and after. Goes on
        where it was interrupted.

        Raises :class:`InputError` without ``tune``, and where ``out`` has another search.
        """
        if self.definition.tune is None:
            raise InputError(f"{self.path}: there is no 'tune', which says what to search")
        tuner = Tuner(self.definition, self.definition.tune, self.path.resolve().parent, self.out, str(self.path))
        with Later(workers, scheduler) as there:
            with Store(self.out / TRIAL_ROWS) as store, store.finishing():
                tuner.run(there, store, progress)
            trials, best = list(tuner.trials()), tuner.best()
            settings = settings_of_trial(best[0], self.definition.tune) if best else {}
            summary = self._before_and_after(settings, there, progress) if settings else None
        by_number = {t["trial"]: t for t in trials}
        tuned = Tuned(settings, tuple(by_number[t.number] for t in best), trials, summary)
        self._write_tuned(tuned)
        return tuned

    def _before_and_after(self, settings: Mapping[str, Any], there: Pool, progress: Progress | None) -> Summary:
        """The study's seeds with the settings as they were and as they were found, as conditions."""
        was = self.definition.conditions or {"": Condition()}
        join = lambda name, when: f"{name}, {when}" if name else when
        before = {join(n, "before"): c for n, c in was.items()}
        after = {
            join(n, "after"): c.model_copy(update={"settings": {**settings, **c.settings}}) for n, c in was.items()
        }
        more = {"conditions": {**before, **after}, "compare_with": next(iter(before)), "tune": None}
        compared = Study(self.definition.model_copy(update=more), self.path, self.out / "report")
        return compared._run_in(there, progress, replace=True)  # more trials may have found better settings

    def _write_tuned(self, tuned: Tuned) -> None:
        """best.yaml, trials.json, and the page."""
        tune, title = self.definition.tune, self.definition.title
        assert tune is not None
        if tuned.settings:
            about = f"{title}: the best of {len(tuned.trials)} trials on seeds {', '.join(map(str, tune.seeds))}"
            write_text(
                self.out / BEST,
                write_yaml(nested(self._shared(tuned.settings) | tuned.settings), {"": about}),
                follow=False,
            )
        write_text(self.out / TRIALS, json.dumps(tuned.trials, indent=1) + "\n", follow=False)
        write_text(
            self.out / PAGE, tune_page(title, tune, tuned.trials, tuned.front, tuned.report is not None), follow=False
        )

    def _shared(self, found: Mapping[str, Any]) -> dict[str, Any]:
        """What all experiments of the search were set to beside it: settings that are ``found`` may mean nothing without."""
        tuned = with_settings(self.definition, found)
        first, *rest = (flat(c.changes) for c in combinations(tuned, self.path.resolve().parent, str(self.path)))
        return {key: value for key, value in first.items() if all(key in c and c[key] == value for c in rest)}

    def _task(self, run: Run) -> Task:
        """What a worker gets: names and settings, some hundred bytes."""
        keep, c = self.definition.files, run.combination
        files = None if keep == "none" else str((self.out / "files" / run.key).resolve())
        return {
            "key": run.key, "source": c.source, "changes": dict(c.changes), "seed": run.seed, "files": files,
            "keep": keep,
        }  # fmt: skip

    def table(self, columns: list[str] | None = None) -> pyarrow.Table:
        """A row for each run; ``columns``: only those. Raises :class:`InputError` where nothing has been run."""
        if (self.out / JOURNAL).is_file() and not is_running(self.out):  # of a study that was killed
            with Store(self.out) as store:
                store.finish()
        if not (self.out / ROWS).is_file():
            raise InputError(f"{self.out}: there are no finished runs")
        return Store(self.out).table(columns)

    def report(self) -> Summary:
        """Statistics of what is finished, as data; ``statistics.json`` and the page ``index.html`` are rewritten."""
        d = self.definition
        found = summarize(
            d.title, self.combinations, self.table(), self.planned, d.metrics, d.compare_with, d.larger_is_better
        )
        definitions = {c.experiment: open_experiment(c.source).definitions for c in self.combinations}
        write_text(self.out / STATISTICS, json.dumps(found.to_json(), indent=1, allow_nan=False) + "\n", follow=False)
        write_text(self.out / PAGE, study_page(found, self.out, definitions), follow=False)
        return found


def row_about(run: Run) -> Row:
    """What the row of a run says of it before it is run."""
    c = run.combination
    return {
        "key": run.key, "experiment": c.experiment, "condition": c.condition, "robot": c.robot, "draw": c.draw, "seed": run.seed,
        "varied": dict(c.varied), "changes": dict(c.changes),
    }  # fmt: skip


@dataclass(frozen=True)
class Tuned:
    """What a search found: the ``settings`` of the ``best`` trial (empty, None: none keeps the constraints), the ``front`` of several
    objectives (of one the best trial alone), whose first trial is ``best``, all ``trials``, and the study's own seeds before and after
    with ``best`` (``report``)."""

    settings: dict[str, Any]
    front: tuple[dict[str, Any], ...]
    trials: list[dict[str, Any]]
    report: Summary | None

    @property
    def best(self) -> dict[str, Any] | None:
        """The trial whose settings are kept."""
        return self.front[0] if self.front else None

    def to_json(self) -> dict[str, Any]:
        """The object that ``--json`` prints."""
        report = None if self.report is None else self.report.to_json()
        return {
            "settings": self.settings, "best": self.best, "front": list(self.front), "trials": self.trials,
            "report": report,
        }  # fmt: skip


class Clock:
    """How far a study is, and how long the rest takes."""

    def __init__(self, all_runs: Iterator[Run], done: set[str], known: Mapping[str, Mapping[str, Any]]) -> None:
        self._total, self._left, self._bad = 0, Counter[str](), 0
        self._times: dict[str, list[float]] = {}
        for run in all_runs:
            self._total += 1
            self._left[run.combination.experiment] += run.key not in done
        for row in known.values():
            if row["outcome"] not in (ERROR, LOST):
                self._times.setdefault(row["experiment"], []).append(row["wall_time"])
        self._began = time.monotonic()

    def ended(self, run: Run, row: Row) -> None:
        self._left[run.combination.experiment] -= 1
        self._bad += row["outcome"] != "completed"
        if "wall_time" in row:
            self._times.setdefault(run.combination.experiment, []).append(row["wall_time"])

    @property
    def share(self) -> float:
        """Of runs that have ended."""
        return 1.0 - self._left.total() / max(self._total, 1)

    def left(self, threads: int) -> float:
        """Seconds that the rest takes on so many threads: by experiment, the mean of its last runs."""
        everything = [t for times in self._times.values() for t in times[-100:]]
        if not everything:
            return float("nan")
        mean = lambda times: sum(times) / len(times)
        return sum(n * mean(self._times.get(e, everything)[-100:]) for e, n in self._left.items()) / max(threads, 1)

    def text(self, threads: int) -> str:
        """``12 of 40 runs, 1 not completed, 3 min left``."""
        ended, left = self._total - self._left.total(), self.left(threads)
        bad = f", {self._bad} not completed" if self._bad else ""
        return f"{ended} of {self._total} runs{bad}" + (f", {duration(left)} left" if left > 0.0 else "")


def duration(seconds: float) -> str:
    """``40 s``, ``12 min``, ``3.5 h``."""
    return (
        f"{seconds:.0f} s"
        if seconds < 100
        else f"{seconds / 60:.0f} min"
        if seconds < 6000
        else f"{seconds / 3600:.1f} h"
    )


def remember(out: Path, title: str, found: list[Combination], planned: int) -> None:
    """Write down what the study in a folder is, and how many runs it has."""
    about = {
        c.key: {"experiment": c.experiment, "condition": c.condition, "label": c.label, "settings": c.settings}
        for c in found
    }
    write_text(
        out / ABOUT,
        json.dumps({"title": title, "planned": planned, "combinations": about}, indent=1) + "\n",
        follow=False,
    )


def reject_others(out: Path, found: list[Combination], known: Mapping[str, Any]) -> None:
    """Raise :class:`InputError` if a folder has runs of other settings, with the first that is different."""
    keys = {c.key for c in found}
    others = Counter(key.rpartition("-")[0] for key in known)
    count = sum(n for key, n in others.items() if key not in keys)
    if not count:
        return
    first = next(key for key in others if key not in keys)
    raise InputError(
        f"{out}: {count} of its {len(known)} runs are of other settings than this study's: {_difference(out, first, _without(found, others))}; "
        "change the study back, or give another --out"
    )


def _without(found: list[Combination], known: Mapping[str, int]) -> list[Combination]:
    """The combinations that a folder has no runs of: what one of its own became is among them. All, if there are none."""
    return [c for c in found if c.key not in known] or found


def _difference(out: Path, key: str, found: list[Combination]) -> str:
    """What was different in a combination that the folder has runs of."""
    path = out / ABOUT
    was = load_json(path).get("combinations", {}).get(key) if path.is_file() else None
    if was is None:
        return f"a combination that {path} does not have"
    same = [c for c in found if c.experiment == was["experiment"]]
    alike = [c for c in same if c.condition == was["condition"]] or same
    name = f"{was['experiment']}, {was['label']}"
    if not alike:
        return f"{name} is not in it"
    before = flat(was["settings"])
    changed = min((_changed(before, flat(c.settings)) for c in alike), key=len)
    shown = [f"{k} was {json.dumps(a)}, is {json.dumps(b)}" for k, (a, b) in list(changed.items())[:3]]
    return f"{name}: {', '.join(shown) or 'its condition has another name'}"


def _changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    return {k: (before.get(k), after.get(k)) for k in {**before, **after} if before.get(k) != after.get(k)}


def nested(settings: Mapping[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in settings.items():
        *sections, last = key.split(".")
        inner = out
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[last] = value
    return out
