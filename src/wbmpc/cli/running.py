"""A run of an experiment on the command line, and its files."""

from __future__ import annotations

import json
import logging
import shlex
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import typer

from wbmpc.cli.directories import RECORD_LIMIT, run_directory, size_of
from wbmpc.cli.terminal import console, progress_bar, table
from wbmpc.errors import EndedByUser, InputError, NotWritten, RunAborted

if TYPE_CHECKING:
    from pydantic import BaseModel

    from wbmpc.experiment import Experiment
    from wbmpc.result import RunResult
    from wbmpc.view.live import View


def show_settings(model: type[BaseModel], name: str, as_json: bool, values: BaseModel | None = None) -> None:
    """Every setting of an experiment; ``values``: in place of the defaults."""
    from wbmpc.configuration import mistakes_of_model
    from wbmpc.settings_table import rows

    with mistakes_of_model(model, name):
        found = list(rows(model, values=values))
    if as_json:
        typer.echo(json.dumps({"experiment": name, "settings": [asdict(row) for row in found]}))
        return
    shown = table(f"settings of {name} (--set KEY=VALUE, or a YAML file with --config)")
    of = {"of": "choice"} if any(row.choice for row in found) else {}
    value = "default" if values is None else "value"
    columns = {"setting": "key", **of, value: "default", "unit": "unit", "type and range": "kind", "meaning": "help"}
    for title in columns:
        shown.add_column(title)
    for row in found:
        shown.add_row(*(getattr(row, field).replace("`", "") for field in columns.values()))
    console().print(shown)


#: The file of a run in which weights were moved.
WEIGHTS = "weights.yaml"


def write_weights(factors: Mapping[str, float], before: Mapping[str, float], directory: Path) -> dict[str, str]:
    """A settings file of the weights' ``factors`` by cost, in place of those ``before`` the run, if any was moved; its path by "weights"."""
    if not factors:
        return {}
    from wbmpc.output_file import write_text
    from wbmpc.robots.robot_yaml import write_yaml

    path = directory / WEIGHTS
    text = "Factors of the costs' weights as the sliders were left: wbmpc run NAME --config weights.yaml"
    write_text(path, write_yaml({"weights": {**before, **factors}}, {"": text}), follow=False)
    return {"weights": str(path)}


_LOG = logging.getLogger("wbmpc")
#: What is said of a run that a user has steered.
STEERED = (
    "goals, weights, brakes or forces were changed by hand in the view: the figures are of that, not of the experiment"
)


class Session(Protocol):
    """What a command line knows: whether it is ``quiet``, and experiments by name."""

    @property
    def quiet(self) -> bool: ...
    def open(self, name: str) -> Experiment: ...


def execute(
    session: Session, name: str, seed: int, assignments: list[str], out: Path | None, show: bool,
    view: View | None = None, record_limit: str = RECORD_LIMIT, config: Path | None = None,
) -> tuple[RunResult, dict[str, str]]:  # fmt: skip
    """A run and its files. Restarted in the view, it is another run with files of its own; the last one is returned."""
    from wbmpc.configuration import configure

    if seed < 0:
        raise InputError(f"--seed: must not be negative, got {seed}")
    experiment = session.open(name)
    read = [] if config is None else ["--config", str(config)]
    changes = [word for assignment in assignments for word in ("--set", assignment)]
    command = shlex.join(["wbmpc", "run", name, "--seed", str(seed), *read, *changes])
    name = experiment.name if name.endswith(".py") else name  # a file is known by the name of its experiment
    limit, settings = (
        size_of("--record-limit", record_limit),
        configure(experiment.config_type, assignments, name, config),
    )
    try:
        while True:
            result, files = _attempt(
                name, experiment, settings, seed, out, show and not session.quiet, view, limit, command
            )
            if view is None or not view.wants_reset:
                return result, files
            view.restart()
            typer.echo(f"restarted; the run until then is in {Path(files['report']).parent}", err=True)
    finally:
        if view is not None:
            view.close()


def _attempt(
    name: str, experiment: Experiment, settings: BaseModel, seed: int, out: Path | None, show: bool, view: View | None,
    limit: int, command: str,
) -> tuple[RunResult, dict[str, str]]:  # fmt: skip
    from wbmpc.recording.recorder import Recorder
    from wbmpc.report import RECORDING, about_run, outcome, write_run
    from wbmpc.result import RunResult
    from wbmpc.simulation.lockstep import Watch, interrupt_noted

    plain = settings.model_dump(mode="json")
    with run_directory(out, name, seed, (WEIGHTS,)) as directory:
        _LOG.info("%s, seed %d: files go into %s", name, seed, directory)
        _LOG.info("settings: %s", json.dumps(plain))
        recorder = Recorder(directory / RECORDING, about_run(name, seed, plain), limit)
        # the view first: if it cannot open, nothing has been written
        watchers = (recorder,) if view is None else (view, recorder)
        try:
            try:
                began = time.perf_counter()
                with progress_bar(name, show) as progress:
                    result = experiment.run(settings, seed, Watch(progress, watchers))
                result.wall_time = time.perf_counter() - began
            except (EndedByUser, KeyboardInterrupt) as error:
                result = RunResult.aborted(name, seed, str(error) or "interrupted", plain, interrupted=True)
            except RunAborted as error:
                result = RunResult.aborted(name, seed, str(error), plain)
            with interrupt_noted() as pressed:  # now it waits for the files; once more, and it acts at once
                if view is not None and view.commanded:
                    result.idealizations = [*result.idealizations, STEERED]
                result.command = command
                recorder.close(outcome(result))
                result.motion = recorder.motion
                files = write_run(result, directory)
                if view is not None and "weights" in type(settings).model_fields:
                    files |= write_weights(view.factors, plain["weights"], directory)
                if recorder.failure:
                    raise NotWritten(f"{recorder.failure}; the run's other files are in {directory}")
            if pressed():
                raise KeyboardInterrupt
        finally:
            recorder.close({"completed": "false", "reason": "an error of the program"})
    for kind, path in files.items():
        _LOG.info("%s: %s, %d kB", kind, path, Path(path).stat().st_size // 1000)
    return result, files
