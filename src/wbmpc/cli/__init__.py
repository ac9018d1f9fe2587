"""The command line: list, run, demo, bench; other commands in files beside it."""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wbmpc import __version__, plugins
from wbmpc.cli.calibration import calibrate
from wbmpc.cli.directories import RECORD_LIMIT, AsJson, RecordLimit, run_directory
from wbmpc.cli.doctor import doctor
from wbmpc.cli.exporting import export
from wbmpc.cli.new import new
from wbmpc.cli.recordings import compare, log
from wbmpc.cli.reproduction import reproduce
from wbmpc.cli.results import show_results
from wbmpc.cli.ros2 import ros2
from wbmpc.cli.running import execute, show_settings
from wbmpc.cli.runs import runs
from wbmpc.cli.stability import stability
from wbmpc.cli.study import study, tune
from wbmpc.cli.terminal import (
    ABORTED,
    BAD_INPUT,
    COMPLETED,
    INTERRUPTED,
    experiment_names,
    logged,
    open_streams,
    progress_bar,
    silent,
    unread_allowed,
)
from wbmpc.cli.views import LOCAL, Host, NoToken, Port, open_view, render, replay, view
from wbmpc.errors import InputError, RunAborted, WbmpcError, printable, text_of, unknown_name
from wbmpc.interrupts import act_on_waiting, ended_by_signal, exits_seen, interrupted, terminable

if TYPE_CHECKING:
    from wbmpc.experiment import Experiment

app = typer.Typer(
    name="wbmpc", pretty_exceptions_enable=False,
    help="Whole-body model predictive control for mobile manipulators.",
)  # fmt: skip
app.add_typer(log)
app.add_typer(ros2)
_COMMANDS = (new, doctor, stability, calibrate, view, replay, render, runs, compare, reproduce, study, tune, export)
for _command in _COMMANDS:
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
    verbose: Annotated[bool, typer.Option("--verbose", help="Log what is done to standard error.")] = False,
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


@app.command("list")
def list_experiments(
    context: typer.Context,
    as_json: AsJson = False,
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
        typer.echo(printable(f"  {n:{max(map(len, registry))}s}  {summary}"))
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
    config: Annotated[Path | None, typer.Option(help="A YAML file of settings; --set overrides it.")] = None,
    list_settings: Annotated[
        bool, typer.Option("--settings", help="List the settings, with values, units and ranges; run nothing.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Directory for the files (default: a fresh runs/NAME-seedN).")
    ] = None,
    as_json: AsJson = False,
    show: Annotated[bool, typer.Option("--view", help="Show the run in a browser, in real time.")] = False,
    host: Host = LOCAL,
    port: Port = 8080,
    no_token: NoToken = False,
    record_limit: RecordLimit = RECORD_LIMIT,
) -> None:
    """Run an experiment; write metrics.json, log.npz, report.html and run.mcap."""
    if list_settings:
        from wbmpc.configuration import configure

        model, given = context.obj.open(name).config_type, bool(assignments or config)
        show_settings(model, name, as_json, configure(model, assignments or [], name, config) if given else None)
        return
    shown = open_view(f"{name}, seed {seed}", host, port, no_token) if show else None
    show_results(
        [execute(context.obj, name, seed, assignments or [], out, not as_json, shown, record_limit, config)], as_json
    )


@app.command()
def demo(
    context: typer.Context,
    seed: Annotated[int, typer.Option(help="Seed of the plants and of all noise.")] = 200,
    as_json: AsJson = False,
) -> None:
    """Run both main experiments and print one table."""
    from wbmpc.registry import demonstrated

    results = []
    for name in demonstrated():
        if not (as_json or context.obj.quiet):
            typer.echo(f"running {name} …", err=True)
        results.append(execute(context.obj, name, seed, [], None, not as_json))
        if results[-1][0].interrupted:
            break
    show_results(results, as_json)


@app.command()
def bench(
    context: typer.Context,
    as_json: AsJson = False,
    out: Annotated[Path | None, typer.Option(help="Directory for race.json and race.txt.")] = None,
    repeat: Annotated[int, typer.Option(min=1, help="Timed iterations per problem.")] = 200,
) -> None:
    """Time the solver against others on the same discretized problems, on one core."""
    from wbmpc.benchmark import run_benchmark
    from wbmpc.benchmark.table import FILES, text, write

    verbose = not (as_json or context.obj.quiet)
    with nullcontext() if out is None else run_directory(out, "bench", 0, FILES) as directory:
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


@cache
def _command_line() -> Any:
    """The commands as typer makes them of all signatures: once for a process that calls :func:`main` often."""
    return typer.main.get_command(app)


def _complain(error: BaseException, debug: bool) -> None:
    """One message on standard error, whatever the message looked like; the traceback only on request."""
    if debug:
        traceback.print_exception(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: cannot be opened or made ({error.strerror})" if error.filename else error.strerror
    else:
        text = text_of(error)
        if hasattr(error, "format_message"):
            text = f"{error.format_message().rstrip('.')}; see 'wbmpc --help' and 'wbmpc COMMAND --help'"
    typer.echo(f"wbmpc: {printable(' '.join(text.split()))}", err=True)


def main(arguments: list[str] | None = None, registry: Mapping[str, Experiment] | None = None) -> int:
    """Entry point; returns the exit status. Bad input is one message and status 2; whatever a signal asked to end, and however
    it came to its end then, has the signal's status.

    ``registry``: experiments to use in place of the library's.
    """
    # One thread: linear algebra of this size only loses time by waking others (stalls of 40 ms were seen).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    words = sys.argv[1:] if arguments is None else arguments
    debug, quiet, verbose = ("--debug" in words, "--quiet" in words, "--verbose" in words)
    words = _rearranged(words)
    open_streams()
    with unread_allowed(), terminable():
        status = _run(words, debug, quiet, verbose, registry)
        return ended_by_signal() or status


def _reject_empty(arguments: list[str]) -> None:
    """Raise :class:`InputError` for an argument that is empty, as a shell's variable that is not set: as a path it would be the
    current directory, as a host every address of the machine."""
    for previous, word in zip(["", *arguments], arguments, strict=False):
        option, sign, value = word.partition("=")
        if not word.strip():
            after = f" after '{previous}'" if previous else ""
            raise InputError(f"an argument{after} is empty; is a variable of the shell not set?")
        if option.startswith("--") and sign and not value.strip():
            raise InputError(f"{option}: its value is empty; is a variable of the shell not set?")


def _run(
    arguments: list[str], debug: bool, quiet: bool, verbose: bool, registry: Mapping[str, Experiment] | None
) -> int:
    """One command; what goes wrong as an exit status."""
    try:
        plugins.forget_uses()
        with logged(verbose, debug), silent(quiet and "--json" not in arguments), exits_seen():
            _reject_empty(arguments)
            obj = _Session(registry, quiet)
            status = _command_line()(args=arguments, prog_name="wbmpc", standalone_mode=False, obj=obj)
            act_on_waiting()
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
    except (Exception, SystemExit) as error:
        if interrupted(error):
            typer.echo("wbmpc: interrupted", err=True)
            return INTERRUPTED
        # mistakes on the command line itself; their base class is typer's or click's, by typer's version
        mistake = error if hasattr(error, "format_message") else plugins.mistake_in_use(error)
        if mistake is None:
            raise
        mistake.__cause__ = error if mistake is not error else None
        _complain(mistake, debug)
        return BAD_INPUT
