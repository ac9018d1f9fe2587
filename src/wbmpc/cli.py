"""The command line: list, run, demo, bench."""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wbmpc import __version__
from wbmpc.errors import InputError, WbmpcError, unknown_name

if TYPE_CHECKING:
    from wbmpc.experiments import Experiment
    from wbmpc.result import RunResult

# One thread: linear algebra of this size only loses time by waking others (stalls of 40 ms were seen).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

app = typer.Typer(
    name="wbmpc", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
    help="Whole-body model predictive control for mobile manipulators.",
)  # fmt: skip
_debug = False


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Options before the command."""
    global _debug
    _debug = _debug or debug


def _experiments() -> dict[str, Experiment]:
    from wbmpc.experiments import REGISTRY

    return REGISTRY


def _find(name: str) -> Experiment:
    registry = _experiments()
    if name not in registry:
        raise unknown_name("experiment", name, registry)
    return registry[name]


@contextmanager
def _progress(title: str, show: bool) -> Iterator[Callable[[float, str], None] | None]:
    """A progress bar on a terminal; nothing in a pipe."""
    if not (show and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=1.0, note="")
        yield lambda fraction, note: bar.update(task, completed=fraction, note=note)


def _fresh(base: Path) -> Path:
    """``base``, or ``base-2``, ``base-3`` … when it is there: a run never overwrites another one."""
    path, k = base, 1
    while path.exists():
        k += 1
        path = base.with_name(f"{base.name}-{k}")
    return path


def _execute(name: str, seed: int, assignments: list[str], out: Path | None, show: bool) -> tuple[RunResult, dict[str, str]]:
    from wbmpc.configuration import configure
    from wbmpc.report import write_run

    if seed < 0:
        raise InputError(f"--seed: must not be negative, got {seed}")
    experiment = _find(name)
    settings = configure(experiment.config_type, assignments, name)
    directory = _fresh(Path("runs") / f"{name}-seed{seed}") if out is None else out
    if directory.exists() and not directory.is_dir():
        raise InputError(f"--out: {directory} is not a directory")
    with _progress(name, show) as progress:
        result = experiment.run(settings, seed, progress)
    return result, write_run(result, directory)


def _table(results: list[RunResult]) -> None:
    from rich.console import Console
    from rich.table import Table

    from wbmpc.report import number

    table = Table(title="Ours is simulated (MuJoCo, perturbed plant); the paper's figures are of the real robot")
    for column, justify in (("experiment", "left"), ("metric", "left"), ("ours", "right"), ("paper", "right"), ("goal", "right")):
        table.add_column(column, justify=justify)  # type: ignore[arg-type]
    table.add_column("")
    for result in results:
        for k, (name, m) in enumerate(result.metrics.items()):
            unit = "" if m.unit == "1" else f" {m.unit}"
            given = ["" if v is None else f"{number(v)}{unit}" for v in (m.paper, m.goal)]
            verdict = {True: "reached", False: "missed", None: ""}[m.met]
            table.add_row(result.experiment if k == 0 else "", name, f"{number(m.value)}{unit}", *given, verdict)
        solve = result.mpc.solve_ms
        mpc = f"{result.mpc.rate_hz:g} Hz, {number(solve['median'])} ms median, {number(solve['max'])} ms max"
        table.add_row("", "MPC rate and solve time", mpc, "", "", "", end_section=True)
    Console(width=None if sys.stdout.isatty() else 140).print(table)


def _finish(results: list[tuple[RunResult, dict[str, str]]], as_json: bool) -> None:
    from wbmpc.report import to_json

    if as_json:
        objects = [to_json(r, f) for r, f in results]
        typer.echo(json.dumps(objects[0] if len(objects) == 1 else objects))
    else:
        _table([r for r, _ in results])
        for result, files in results:
            if not result.completed:
                typer.echo(f"{result.experiment} ended early: {result.reason}")
            typer.echo(f"{result.experiment}: open {files['report']}")
    if not all(r.completed for r, _ in results):
        raise typer.Exit(1)


@app.command("list")
def list_experiments(as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False) -> None:
    """List the experiments and the robots."""
    from wbmpc.robots import available_robots

    registry = _experiments()
    if as_json:
        names = [{"name": e.name, "summary": e.summary} for e in registry.values()]
        typer.echo(json.dumps({"experiments": names, "robots": available_robots()}))
        return
    typer.echo("experiments:")
    for e in registry.values():
        typer.echo(f"  {e.name:14s} {e.summary}")
    typer.echo("robots:\n  " + "\n  ".join(available_robots()))


@app.command()
def run(
    name: Annotated[str, typer.Argument(help="Name of the experiment (see 'wbmpc list').")],
    seed: Annotated[int, typer.Option(help="Seed of the plant and of all noise.")] = 200,
    assignments: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a setting.")] = None,
    out: Annotated[Path | None, typer.Option(help="Directory for the files (default: runs/NAME-seedN).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Run an experiment; write metrics.json, log.npz and report.html."""
    _finish([_execute(name, seed, assignments or [], out, not as_json)], as_json)


@app.command()
def demo(
    seed: Annotated[int, typer.Option(help="Seed of the plants and of all noise.")] = 200,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON list and nothing else.")] = False,
) -> None:
    """Run both main experiments and print one table."""
    results = []
    for name in ("swerve-track", "rezero-steps"):
        if not as_json:
            typer.echo(f"running {name} ...", err=True)
        results.append(_execute(name, seed, [], None, not as_json))
    _finish(results, as_json)


@app.command()
def bench(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
    repeat: Annotated[int, typer.Option(min=1, help="Timed iterations per problem.")] = 200,
) -> None:
    """Time the solver against IPOPT and Fatrop on the same discretised problems."""
    from wbmpc.benchmark import print_table, run_benchmark

    with _progress("bench", not as_json) as progress:
        figures = run_benchmark(repeat, progress)
    typer.echo(json.dumps(figures)) if as_json else print_table(figures)


def main(arguments: list[str] | None = None) -> None:
    """Entry point: bad input is one sentence and exit status 2."""
    global _debug
    given = sys.argv[1:] if arguments is None else arguments
    _debug = "--debug" in given
    # --debug is understood anywhere on the line
    given = [a for a in given if a != "--debug"]
    try:
        app(args=given, prog_name="wbmpc", standalone_mode=True)
    except (WbmpcError, OSError) as error:
        if _debug:
            traceback.print_exc()
        typer.echo(f"wbmpc: {error}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        typer.echo("wbmpc: interrupted", err=True)
        sys.exit(130)


