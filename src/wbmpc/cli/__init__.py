"""The command line: list, run, demo, bench; other commands in files beside it."""

from __future__ import annotations

import json
import logging
import os
import shlex
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wbmpc import __version__
from wbmpc.cli.calibration import calibrate
from wbmpc.cli.directories import RECORD_LIMIT, RecordLimit, run_directory, size_of
from wbmpc.cli.doctor import doctor
from wbmpc.cli.exporting import export
from wbmpc.cli.new import new
from wbmpc.cli.recordings import compare, log
from wbmpc.cli.reproduction import reproduce
from wbmpc.cli.results import show_results
from wbmpc.cli.ros2 import ros2
from wbmpc.cli.runs import runs
from wbmpc.cli.stability import stability
from wbmpc.cli.terminal import (
    ABORTED,
    BAD_INPUT,
    COMPLETED,
    INTERRUPTED,
    TERMINATED,
    experiment_names,
    interrupted,
    logged,
    printable,
    progress_bar,
    silent,
    terminable,
    unread_allowed,
)
from wbmpc.cli.views import LOCAL, Host, NoToken, Port, open_view, render, replay, view
from wbmpc.errors import EndedByUser, InputError, NotWritten, RunAborted, WbmpcError, unknown_name

if TYPE_CHECKING:
    from pydantic import BaseModel

    from wbmpc.experiment import Experiment
    from wbmpc.result import RunResult
    from wbmpc.view.live import View

_LOG = logging.getLogger("wbmpc")
#: What is said of a run that somebody has steered.
STEERED = (
    "goals, weights, legs or forces were changed by hand in the view: the figures are of that, not of the experiment"
)

app = typer.Typer(
    name="wbmpc", pretty_exceptions_enable=False,
    help="Whole-body model predictive control for mobile manipulators.",
)  # fmt: skip
app.add_typer(log)
app.add_typer(ros2)
for _command in (new, doctor, stability, calibrate, view, replay, render, runs, compare, reproduce, export):
    app.command()(_command)


@dataclass(frozen=True)
class _Session:
    """What :func:`main` hands to the commands; without a registry the library's own one is loaded when it is needed."""

    own_registry: Mapping[str, Experiment] | None = None
    quiet: bool = False

    @property
    def registry(self) -> Mapping[str, Experiment]:
        if self.own_registry is not None:
            return self.own_registry
        from wbmpc.registry import REGISTRY

        return REGISTRY

    def open(self, name: str) -> Experiment:
        """The experiment of a name, or of a Python file that a user wrote."""
        if name.endswith(".py"):
            from wbmpc.registry import load_file

            return load_file(Path(name))
        return self.find(name)

    def find(self, name: str) -> Experiment:
        """The experiment of a name."""
        if name not in self.registry:
            raise unknown_name("experiment", name, self.registry)
        return self.registry[name]


def _version(requested: bool) -> None:
    if requested:
        typer.echo(__version__)
        raise typer.Exit


@app.callback(invoke_without_command=True)
def options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors; with --json the object.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Say what is done, on standard error.")] = False,
) -> None:
    """Options for all commands, before or after their names; --json too."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


#: What is understood anywhere on the line; at the end of every command's help.
EVERYWHERE = (
    "With every command, before or after its name: --quiet, --verbose, --debug; where a command has it, --json."
)
for _group in (app, log, ros2):
    _group.info.epilog = EVERYWHERE


def _rearranged(arguments: list[str]) -> list[str]:
    """The line without what :func:`main` has understood; ``--json`` before a command's name goes behind it."""
    rest = [a for a in arguments if a not in ("--debug", "--quiet", "--verbose")]
    command = next((i for i, a in enumerate(rest) if not a.startswith("-")), len(rest))
    front, behind = [a for a in rest[:command] if a != "--json"], rest[command:]
    if len(front) < command and behind:
        end = behind.index("--") if "--" in behind else len(behind)
        behind.insert(end, "--json")
    return [*front, *behind]


def _execute(
    session: _Session,
    name: str,
    seed: int,
    assignments: list[str],
    out: Path | None,
    show: bool,
    view: View | None = None,
    record_limit: str = RECORD_LIMIT,
) -> tuple[RunResult, dict[str, str]]:
    """A run and its files. Begun anew in the view, it is another run with files of its own; the last one is returned."""
    from wbmpc.configuration import configure

    if seed < 0:
        raise InputError(f"--seed: must not be negative, got {seed}")
    experiment = session.open(name)
    changes = [word for assignment in assignments for word in ("--set", assignment)]
    command = shlex.join(["wbmpc", "run", name, "--seed", str(seed), *changes])
    name = experiment.name if name.endswith(".py") else name  # a file is known by the name of its experiment
    settings, limit = configure(experiment.config_type, assignments, name), size_of("--record-limit", record_limit)
    try:
        while True:
            result, files = _attempt(
                name, experiment, settings, seed, out, show and not session.quiet, view, limit, command
            )
            if view is None or not view.wants_reset:
                return result, files
            view.restart()
            typer.echo(f"begun anew; the run until then is in {Path(files['report']).parent}", err=True)
    finally:
        if view is not None:
            view.close()


def _attempt(
    name: str,
    experiment: Experiment,
    settings: BaseModel,
    seed: int,
    out: Path | None,
    show: bool,
    view: View | None,
    limit: int,
    command: str,
) -> tuple[RunResult, dict[str, str]]:
    from wbmpc.recording.recorder import Recorder
    from wbmpc.report import RECORDING, about_run, outcome, write_run
    from wbmpc.result import RunResult
    from wbmpc.simulation.lockstep import Watch, interrupt_noted

    plain = settings.model_dump(mode="json")
    with run_directory(out, name, seed) as directory:
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
                if view is not None and view.steered:
                    result.idealisations = [*result.idealisations, STEERED]
                result.command = command
                recorder.close(outcome(result))
                files = write_run(result, directory)
                if recorder.failure:
                    raise NotWritten(f"{recorder.failure}; the run's other files are in {directory}")
            if pressed():
                raise KeyboardInterrupt
        finally:
            recorder.close({"completed": "false", "reason": "an error of the program"})
    for kind, path in files.items():
        _LOG.info("%s: %s, %d kB", kind, path, Path(path).stat().st_size // 1000)
    return result, files


@app.command("list")
def list_experiments(
    context: typer.Context,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """List the experiments and the robots."""
    from wbmpc.robots import available_robots

    registry = context.obj.registry
    if as_json:
        names = [{"name": n, "summary": summary} for n, summary in _summaries(registry)]
        typer.echo(json.dumps({"experiments": names, "robots": available_robots()}))
        return
    typer.echo("experiments:")
    for n, summary in _summaries(registry):
        typer.echo(f"  {n:{max(map(len, registry))}s}  {summary}")
    typer.echo("robots:\n  " + "\n  ".join(available_robots()))


def _summaries(registry: Mapping[str, Experiment]) -> Iterator[tuple[str, str]]:
    """Name and summary of each; one of another package that cannot be imported does not hide the others."""
    for name in registry:
        try:
            yield name, registry[name].summary
        except InputError as error:
            yield name, f"({error})"


@app.command()
def run(
    context: typer.Context,
    name: Annotated[
        str,
        typer.Argument(
            help="Name of the experiment (see 'wbmpc list'), or a Python file.", autocompletion=experiment_names
        ),
    ],
    seed: Annotated[int, typer.Option(help="Seed of the plant and of all noise.")] = 200,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a setting, e.g. mpc.rate=100; may be repeated."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for the files (default: a fresh runs/NAME-seedN).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
    show: Annotated[bool, typer.Option("--view", help="Show the run in a browser, in real time.")] = False,
    host: Host = LOCAL,
    port: Port = 8080,
    no_token: NoToken = False,
    record_limit: RecordLimit = RECORD_LIMIT,
) -> None:
    """Run an experiment; write metrics.json, log.npz, report.html and run.mcap."""
    shown = open_view(f"{name}, seed {seed}", host, port, no_token) if show else None
    show_results([_execute(context.obj, name, seed, assignments or [], out, not as_json, shown, record_limit)], as_json)


@app.command()
def demo(
    context: typer.Context,
    seed: Annotated[int, typer.Option(help="Seed of the plants and of all noise.")] = 200,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Run both main experiments and print one table."""
    from wbmpc.registry import demonstrated

    results = []
    for name in demonstrated():
        if not (as_json or context.obj.quiet):
            typer.echo(f"running {name} …", err=True)
        results.append(_execute(context.obj, name, seed, [], None, not as_json))
        if results[-1][0].interrupted:
            break
    show_results(results, as_json)


@app.command()
def bench(
    context: typer.Context,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
    out: Annotated[Path | None, typer.Option(help="Directory for race.json and race.txt.")] = None,
    repeat: Annotated[int, typer.Option(min=1, help="Timed iterations per problem.")] = 200,
) -> None:
    """Time the solver against others on the same discretised problems, on one core."""
    from wbmpc.benchmark import run_benchmark
    from wbmpc.benchmark.table import text, write

    verbose = not (as_json or context.obj.quiet)
    with nullcontext() if out is None else run_directory(out, "bench", 0) as directory:
        with progress_bar("bench", verbose) as bar:
            show = bar or (lambda _, note: typer.echo(note, err=True) if verbose else None)
            figures = run_benchmark(repeat, show)
        if directory is not None:
            figures["files"] = write(figures, directory, text(figures))
    if as_json:
        typer.echo(json.dumps(figures, allow_nan=False))
    else:
        typer.echo(text(figures))


def _interruptible(command: Callable[..., Any]) -> Callable[..., Any]:
    """Ctrl-C that a command leaves to :func:`main`: typer would end without a word."""

    @wraps(command)
    def call(*arguments: Any, **options: Any) -> Any:
        try:
            return command(*arguments, **options)
        except KeyboardInterrupt as error:
            raise typer.Abort from error

    return call


for _info in (*app.registered_commands, *log.registered_commands, *ros2.registered_commands):
    _info.epilog = EVERYWHERE
    assert _info.callback is not None
    _info.callback = _interruptible(_info.callback)


def _complain(error: Exception, debug: bool) -> None:
    """One message on standard error, whatever the message looked like; the traceback only on request."""
    if debug:
        traceback.print_exception(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: cannot be opened or made ({error.strerror})" if error.filename else error.strerror
    else:
        text = str(error)
        if hasattr(error, "format_message"):
            text = f"{error.format_message().rstrip('.')}; see 'wbmpc --help' and 'wbmpc COMMAND --help'"
    typer.echo(f"wbmpc: {printable(' '.join(text.split()))}", err=True)


def main(arguments: list[str] | None = None, registry: Mapping[str, Experiment] | None = None) -> int:
    """Entry point; returns the exit status. Bad input is one message and status 2.

    ``registry``: experiments to use in place of the library's.
    """
    # One thread: linear algebra of this size only loses time by waking others (stalls of 40 ms were seen).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    words = sys.argv[1:] if arguments is None else arguments
    debug, quiet, verbose = ("--debug" in words, "--quiet" in words, "--verbose" in words)
    words = _rearranged(words)
    with unread_allowed(), terminable() as termination:
        status = _run(words, debug, quiet, verbose, registry)
    return TERMINATED if termination.came and status == INTERRUPTED else status


def _run(
    arguments: list[str], debug: bool, quiet: bool, verbose: bool, registry: Mapping[str, Experiment] | None
) -> int:
    """One command; what goes wrong as an exit status."""
    try:
        with logged(verbose, debug), silent(quiet and "--json" not in arguments):
            status = app(args=arguments, prog_name="wbmpc", standalone_mode=False, obj=_Session(registry, quiet))
        return status if isinstance(status, int) else COMPLETED
    except RunAborted as error:
        _complain(error, debug)
        return ABORTED
    except (WbmpcError, OSError) as error:
        _complain(error, debug)
        return BAD_INPUT
    except (KeyboardInterrupt, typer.Abort):
        typer.echo("wbmpc: interrupted", err=True)
        return INTERRUPTED
    except Exception as error:
        if interrupted(error):
            typer.echo("wbmpc: interrupted", err=True)
            return INTERRUPTED
        # mistakes on the command line itself; their base class is typer's or click's, by typer's version
        if not hasattr(error, "format_message"):
            raise
        _complain(error, debug)
        return BAD_INPUT
