"""The search of settings with Optuna: trials on seeds of their own, kept as rows, and the best settings as a file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.study.database import check_trial, using_database
from wbmpc.study.definition import Definition, Search, Term, Tuning
from wbmpc.study.files import DATABASE
from wbmpc.study.plan import Run, check_inputs, combinations
from wbmpc.study.store import MISSING, Store
from wbmpc.study.work import ERROR, execute
from wbmpc.study.workers import Pool, Row

if TYPE_CHECKING:
    import optuna

#: Trials in a row whose settings the experiments may reject.
MAX_REJECTED = 100


def _optuna() -> Any:
    try:
        import optuna
    except ImportError as error:
        raise InputError(MISSING) from error
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


def value_of(term: Term, rows: list[Row]) -> float:
    """A term of the objective over the runs of a trial; see :class:`Term`. Raises :class:`InputError` if no run can have the metric."""
    mine = [row for row in rows if not term.experiment or row["experiment"] == term.experiment]
    if not term.experiment:
        having = {row["experiment"] for row in rows if term.metric in row.get("metrics", {})}
        mine = [row for row in mine if row["experiment"] in having] or mine
    known = [r for r in mine if r["outcome"] == "completed"]
    if known and not any(term.metric in row.get("metrics", {}) for row in known):
        names = ", ".join(known[0].get("metrics", {}))
        raise InputError(f"tune.minimize: '{term.metric}' is no metric of {known[0]['experiment']}; valid: {names}")
    return term.weight * float(np.mean([_bounded(term, row) for row in mine]))


def _bounded(term: Term, row: Row) -> float:
    """The metric of a run, up to the limit; from the limit to its double where a large one is good."""
    value = row.get("metrics", {}).get(term.metric, math.nan) if row["outcome"] == "completed" else math.nan
    if math.isnan(value):
        return 2.0 * term.limit if term.maximize else term.limit
    return 2.0 * term.limit - min(value, term.limit) if term.maximize else min(value, term.limit)


def broken(tuning: Tuning, rows: list[Row]) -> dict[str, float]:
    """By how much a trial breaks each constraint, above 0 where it does: of metrics, and ``outcome``: runs that did not complete.

    Raises :class:`InputError` for a metric that none of its runs has."""
    out = {}
    for metric, largest in tuning.constraints.items():
        values = [row["metrics"][metric] for row in rows if metric in row.get("metrics", {})]
        known = [row.get("metrics", {}) for row in rows if row["outcome"] == "completed"]
        if known and not values:
            names = ", ".join(dict.fromkeys(name for row in known for name in row))
            raise InputError(f"tune.constraints: no run has the metric '{metric}'; valid: {names}")
        by = max((v - largest for v in values), default=0.0)
        out[metric] = by if math.isfinite(by) else 1e9
    failed = sum(row["outcome"] != "completed" for row in rows)
    return out if tuning.allow_failures else {**out, "outcome": float(failed)}


def feasible(trial: optuna.trial.FrozenTrial) -> bool:
    """Whether it breaks no constraint."""
    return all(value <= 0.0 for value in trial.constraints.values())


@dataclass
class Trial:
    """A trial that goes on: its settings, runs that wait (by seed) and rows that there are."""

    trial: optuna.trial.Trial
    changes: dict[str, Any]
    waiting: list[list[Run]]
    going: int = 0
    rows: list[Row] = field(default_factory=list)


@dataclass
class Tuner:
    """Asks for settings, has them run, and reports how good they were. ``folder``: beside the study's file; ``out``: of results."""

    definition: Definition
    tuning: Tuning
    folder: Path
    out: Path
    where: str

    def __post_init__(self) -> None:
        self._check_own()
        self._found = self._open()

    def _check_own(self) -> None:
        """Find files that cannot be read before trials are counted as rejected for them; what is searched may add what settings lack."""
        try:
            own = combinations(self.definition, self.folder, self.where)
        except InputError:
            return
        check_inputs(own, self.where)

    def _open(self) -> optuna.Study:
        optuna, t = _optuna(), self.tuning
        self.out.mkdir(parents=True, exist_ok=True)
        makers: dict[str, Callable[[], Any]] = {
            "tpe": lambda: optuna.samplers.TPESampler(seed=t.sampler_seed, multivariate=True),
            "cmaes": lambda: optuna.samplers.CmaEsSampler(seed=t.sampler_seed),
            "nsga2": lambda: optuna.samplers.NSGAIISampler(seed=t.sampler_seed),
            "random": lambda: optuna.samplers.RandomSampler(seed=t.sampler_seed),
        }
        pruner = optuna.pruners.MedianPruner(n_startup_trials=10) if t.prune else optuna.pruners.NopPruner()
        address = t.storage or f"sqlite:///{(self.out / DATABASE).resolve()}"
        with self._database():
            found = optuna.create_study(
                storage=optuna.storages.get_storage(address), study_name=self.definition.title or "tune", sampler=makers[t.sampler](),
                pruner=pruner, load_if_exists=True, directions=["minimize"] * (len(t.minimize) if t.pareto else 1),
            )  # fmt: skip
            self._check_searched(found)
        return found

    def _database(self) -> AbstractContextManager[None]:
        """Whatever is wrong with the database is one message; around what Optuna does, and nothing else."""
        storage = self.tuning.storage
        return using_database(f"{self.where}: tune.storage: '{storage}'" if storage else str(self.out / DATABASE))

    def _check_searched(self, found: optuna.Study) -> None:
        """Trials of other ranges or seeds do not go with these."""
        what = self.tuning.model_dump(mode="json", by_alias=True, exclude={"trials", "storage"})
        what |= {"experiments": self.definition.experiments, "settings": self.definition.settings}
        was = found.user_attrs.get("search")
        if was is None:
            found.set_user_attr("search", json.loads(json.dumps(what)))
        elif was != json.loads(json.dumps(what)):
            known = was if isinstance(was, dict) else {}
            different = ", ".join(k for k in what if known.get(k) != json.loads(json.dumps(what[k])))
            raise InputError(
                f"{self.out}: its {len(found.trials)} trials are of another search ({different}); change the study back, or give "
                "another --out"
            )

    @property
    def left(self) -> int:
        return max(self.tuning.trials - len(self.finished), 0)

    @property
    def finished(self) -> list[optuna.trial.FrozenTrial]:
        """Trials that came to their end, or were pruned."""
        state = _optuna().trial.TrialState
        return self._ended_as(state.COMPLETE, state.PRUNED)

    def _ended_as(self, *states: optuna.trial.TrialState) -> list[optuna.trial.FrozenTrial]:
        with self._database():
            found = self._found.get_trials(deepcopy=False, states=states)
            for trial in found:
                check_trial(trial, self.tuning)
        return found

    def run(self, there: Pool, store: Store, progress: Callable[[float, str], None] | None) -> None:
        """Do the trials that are left, as many at a time as keep the pool at work."""
        self._requeue()
        going: dict[str, tuple[Trial, Run]] = {}
        begun, total = 0, self.left
        while True:
            while begun < total and len(going) < there.threads:
                begun += 1
                self._hand_over(self._begin(), there, going)
            if not going:
                return
            task, row = there.next()
            trial, run = going.pop(task["key"])
            row = {**self._about(trial, run), **row}
            if row["outcome"] == ERROR and not self.finished:  # the study is wrong, not these settings
                raise InputError(f"{self.where}: {row['experiment']}, seed {row['seed']}: {row['reason']}")
            store.add(row)
            trial.rows.append(row)
            trial.going -= 1
            if not trial.going and not self._ended(trial):
                self._hand_over(trial, there, going)
            if progress is not None:
                progress(len(self.finished) / self.tuning.trials, self._text())

    def _requeue(self) -> None:
        """Trials that were going on when a process was killed are restarted with their settings."""
        state = _optuna().trial.TrialState
        with self._database():
            for old in self._found.get_trials(deepcopy=False, states=(state.RUNNING,)):
                self._found.tell(old.number, state=state.FAIL)
                self._found.enqueue_trial(old.params)

    def _begin(self) -> Trial:
        """A trial of settings that the experiments take; some ranges allow others too."""
        for _ in range(MAX_REJECTED):
            with self._database():
                trial = self._found.ask()
                changes = {key: _suggested(trial, key, s) for key, s in self.tuning.search.items()}
            try:
                tried = combinations(with_settings(self.definition, changes), self.folder, self.where)
                check_inputs(tried, self.where)
            except InputError as error:
                rejected = error
                with self._database():
                    self._found.tell(trial, state=_optuna().trial.TrialState.FAIL)
                continue
            return Trial(trial, changes, [[Run(c, seed) for c in tried] for seed in self.tuning.seeds])
        raise rejected

    def _hand_over(self, trial: Trial, there: Pool, going: dict[str, tuple[Trial, Run]]) -> None:
        """All its runs; or where trials may be pruned, those of its next seed."""
        batch = trial.waiting[:1] if self.tuning.prune else trial.waiting
        trial.waiting = trial.waiting[len(batch) :]
        for run in (run for runs in batch for run in runs):
            key = f"{trial.trial.number}-{run.key}"
            going[key] = trial, run
            trial.going += 1
            c = run.combination
            there.submit(execute, {"key": key, "source": c.source, "changes": dict(c.changes), "seed": run.seed, "files": None,
                                   "keep": "none"})  # fmt: skip

    def _about(self, trial: Trial, run: Run) -> Row:
        c = run.combination
        return {
            "key": f"{trial.trial.number}-{run.key}", "experiment": c.experiment, "condition": c.condition, "robot": c.robot,
            "draw": trial.trial.number, "seed": run.seed, "varied": trial.changes, "changes": dict(c.changes),
        }  # fmt: skip

    def _ended(self, trial: Trial) -> bool:
        """Report a trial whose runs are done; false where those of the next seed shall follow."""
        values = [value_of(term, trial.rows) for term in self.tuning.minimize]
        breaks = {} if trial.waiting else broken(self.tuning, trial.rows)
        with self._database():
            if trial.waiting:
                trial.trial.report(sum(values), len(self.tuning.seeds) - len(trial.waiting))
                if not trial.trial.should_prune():
                    return False
                self._found.tell(trial.trial, state=_optuna().trial.TrialState.PRUNED)
                return True
            for name, value in breaks.items():
                trial.trial.set_constraint(name, value)
            self._found.tell(trial.trial, values if self.tuning.pareto else sum(values))
        return True

    def _text(self) -> str:
        best = "" if self.tuning.pareto or not (found := self.best()) else f", best {found[0].values[0]:.4g}"
        return f"{len(self.finished)} of {self.tuning.trials} trials{best}"

    def best(self) -> list[optuna.trial.FrozenTrial]:
        """The best trial that keeps the constraints; with ``pareto`` the front: those that no other beats in every objective, the least
        sum of the objectives first. Empty where none keeps them."""
        fine = [t for t in self._ended_as(_optuna().trial.TrialState.COMPLETE) if feasible(t)]
        if not self.tuning.pareto:
            return sorted(fine, key=lambda t: t.values[0])[:1]
        beaten = lambda t: any(all(a <= b for a, b in zip(o.values, t.values)) and o.values != t.values for o in fine)
        return sorted((t for t in fine if not beaten(t)), key=lambda t: sum(t.values))

    def trials(self) -> Iterator[dict[str, Any]]:
        """All finished trials as data."""
        pruned = _optuna().trial.TrialState.PRUNED
        for t in self.finished:
            whole = t.state != pruned
            yield {
                "trial": t.number, "values": list(t.values or ()) if whole else [], "settings": settings_of_trial(t, self.tuning),
                "pruned": not whole, "feasible": whole and feasible(t),
            }  # fmt: skip


def settings_of_trial(trial: optuna.trial.FrozenTrial, tuning: Tuning) -> dict[str, Any]:
    """What a trial was run with."""
    return {key: _setting(search, trial.params[key]) for key, search in tuning.search.items()}


def with_settings(definition: Definition, changes: Mapping[str, Any]) -> Definition:
    """The study with other settings for all runs, whatever experiments or conditions say."""
    clean = {name: {k: v for k, v in own.items() if k not in changes} for name, own in definition.experiments.items()}
    return definition.model_copy(update={"settings": {**definition.settings, **changes}, "experiments": clean})


def _suggested(trial: optuna.trial.Trial, key: str, search: Any) -> Any:
    if not isinstance(search, Search):
        # Optuna keeps numbers, texts and truths, no lists
        return _setting(search, trial.suggest_categorical(key, [json.dumps(v) for v in search]))
    if search.whole:
        return _setting(search, trial.suggest_int(key, *search.ends, log=search.log))
    return _setting(search, trial.suggest_float(key, search.low, search.high, log=search.log))


def _setting(search: Any, suggested: Any) -> Any:
    """A setting as the experiment gets it: numbers to four digits, within their range."""
    if not isinstance(search, Search):
        return json.loads(suggested)
    return suggested if search.whole else min(max(float(f"{suggested:.4g}"), search.low), search.high)
