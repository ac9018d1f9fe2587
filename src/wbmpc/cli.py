"""The command line: list, run, demo, bench."""

from __future__ import annotations

import gc
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wbmpc import __version__
from wbmpc.errors import InputError, RunAborted, WbmpcError, unknown_name

if TYPE_CHECKING:
    from wbmpc.experiments import Experiment
    from wbmpc.model import RobotModel
    from wbmpc.result import MpcStatistics, RunResult
    from wbmpc.ros2.settings import RosSettings

COMPLETED, ABORTED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

app = typer.Typer(
    name="wbmpc", add_completion=False, pretty_exceptions_enable=False,
    help="Whole-body model predictive control for mobile manipulators.",
)  # fmt: skip


@dataclass(frozen=True)
class _Session:
    """What :func:`main` hands to the commands; without a registry the library's own one is loaded when it is needed."""

    given: Mapping[str, Experiment] | None = None

    @property
    def registry(self) -> Mapping[str, Experiment]:
        if self.given is not None:
            return self.given
        from wbmpc.experiments import REGISTRY

        return REGISTRY

    def find(self, name: str) -> Experiment:
        if name not in self.registry:
            raise unknown_name("experiment", name, self.registry)
        return self.registry[name]


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback(invoke_without_command=True)
def options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """Options before the command."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


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


def _reserve(base: Path) -> Path:
    """Make ``base``, or ``base-2``, ``base-3`` … when it is there: a run never overwrites another one."""
    for k in count(1):
        path = base if k == 1 else base.with_name(f"{base.name}-{k}")
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        return path
    raise AssertionError("unreachable")


def _directory(out: Path | None, name: str, seed: int) -> Path:
    """Where the files go. Made before the run, so that a bad path is found at once and not after minutes."""
    if out is None:
        return _reserve(Path("runs") / f"{name}-seed{seed}")
    if out.exists() and not out.is_dir():
        raise InputError(f"--out: '{out}' is a file; give a directory")
    out.mkdir(parents=True, exist_ok=True)
    if not os.access(out, os.W_OK | os.X_OK):
        raise InputError(f"--out: cannot write into '{out}'")
    return out


def _execute(
    session: _Session, name: str, seed: int, assignments: list[str], out: Path | None, show: bool
) -> tuple[RunResult, dict[str, str]]:
    from wbmpc.configuration import configure
    from wbmpc.report import write_run
    from wbmpc.result import RunResult

    if seed < 0:
        raise InputError(f"--seed: must not be negative, got {seed}")
    experiment = session.find(name)
    settings = configure(experiment.config_type, assignments, name)
    ours = out is None or not out.exists()
    directory = _directory(out, name, seed)
    try:
        with _progress(name, show) as progress:
            try:
                result = experiment.run(settings, seed, progress)
            except RunAborted as error:
                result = RunResult.aborted(name, seed, str(error), settings.model_dump(mode="json"))
        return result, write_run(result, directory)
    finally:
        if ours:
            with suppress(OSError):
                directory.rmdir()  # succeeds only if nothing was written


def _table(results: list[RunResult]) -> None:
    from rich.console import Console
    from rich.table import Table

    from wbmpc.report import goal_notes, number

    table = Table(title="Ours: simulated in MuJoCo, plant perturbed. Paper: the real robot. Goals are largest values.")
    for column in ("experiment", "metric"):
        table.add_column(column, overflow="fold")
    table.add_column("unit", no_wrap=True)
    for column in ("ours", "paper", "goal"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for result in results:
        for k, (name, m) in enumerate(result.metrics.items()):
            figures = ["" if v is None else number(v) for v in (m.value, m.paper, m.goal)]
            verdict = {True: "reached", False: "missed", None: ""}[m.met]
            table.add_row(result.experiment if k == 0 else "", name, m.unit, *figures, verdict)
        mpc = result.mpc
        table.add_row("", "MPC rate", "Hz", f"{mpc.rate_hz:g}", "", "", "")
        for kind, milliseconds in mpc.solve_ms.items():
            table.add_row("", f"MPC solve time, {kind}", "ms", number(milliseconds), "", "", "")
        for kind, how_many in _counts(mpc).items():
            table.add_row("", f"MPC {kind}", f"of {mpc.solves}", str(how_many), "", "", "")
        table.add_section()
    console = Console(width=None if sys.stdout.isatty() else 120)
    console.print(table)
    for result in results:
        for note in goal_notes(result):
            console.print(f"{result.experiment}, {note}", highlight=False)


def _counts(mpc: MpcStatistics) -> dict[str, int]:
    return {"deadline misses": mpc.deadline_misses, "solves that failed": mpc.failures + mpc.no_step}


def _finish(results: list[tuple[RunResult, dict[str, str]]], as_json: bool) -> None:
    from wbmpc.report import to_json

    if as_json:
        objects = [to_json(r, f) for r, f in results]
        typer.echo(json.dumps(objects[0] if len(objects) == 1 else {"runs": objects}, allow_nan=False))
    else:
        _table([r for r, _ in results])
        for result, files in results:
            if not result.completed:
                typer.echo(f"{result.experiment} did not complete: {result.reason}")
            typer.echo(f"{result.experiment}: the report page is {files['report']}")
    if any(r.interrupted for r, _ in results):
        raise typer.Exit(INTERRUPTED)
    if not all(r.completed for r, _ in results):
        raise typer.Exit(ABORTED)


@app.command("list")
def list_experiments(
    context: typer.Context,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """List the experiments and the robots."""
    from wbmpc.robots import available_robots

    registry = context.obj.registry
    if as_json:
        names = [{"name": e.name, "summary": e.summary} for e in registry.values()]
        typer.echo(json.dumps({"experiments": names, "robots": available_robots()}))
        return
    typer.echo("experiments:")
    for e in registry.values():
        typer.echo(f"  {e.name:{max(map(len, registry))}s}  {e.summary}")
    typer.echo("robots:\n  " + "\n  ".join(available_robots()))


@app.command()
def run(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help="Name of the experiment (see 'wbmpc list').")],
    seed: Annotated[int, typer.Option(help="Seed of the plant and of all noise.")] = 200,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a setting, e.g. mpc.rate=100; may be repeated."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for the files (default: a fresh runs/NAME-seedN).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Run an experiment; write metrics.json, log.npz and report.html."""
    _finish([_execute(context.obj, name, seed, assignments or [], out, not as_json)], as_json)


@app.command()
def demo(
    context: typer.Context,
    seed: Annotated[int, typer.Option(help="Seed of the plants and of all noise.")] = 200,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Run both main experiments and print one table."""
    results = []
    for name in ("swerve-track", "rezero-steps"):
        if not as_json:
            typer.echo(f"running {name} …", err=True)
        results.append(_execute(context.obj, name, seed, [], None, not as_json))
        if results[-1][0].interrupted:
            break
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


ros2 = typer.Typer()
app.add_typer(ros2, name="ros2", help="ROS 2: the controller, a simulated robot, a check of a robot's bus.")
Robot = Annotated[str, typer.Argument(help="Name of the robot (see 'wbmpc list') or its YAML file.")]
Config = Annotated[Path | None, typer.Option("--config", help="YAML file: topics, frames, joints, rates.")]
BackEnd = Annotated[str, typer.Option("--backend", help="auto, rclpy or dds.")]


@ros2.callback(invoke_without_command=True)
def ros2_options(context: typer.Context) -> None:
    """ROS 2: the controller, a simulated robot, a check of a robot's bus."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _on_bus(robot: str, config: Path | None, backend: str, suffix: str) -> tuple[Any, RobotModel, RosSettings]:
    """A node for a command that runs until it is interrupted or told to end."""
    import logging

    from wbmpc.model import load_robot
    from wbmpc.ros2.bus import open_node
    from wbmpc.ros2.settings import load_settings, need_swerve

    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s", force=True)
    model = load_robot(robot)
    need_swerve(model)
    settings = load_settings(config, model)
    return open_node(f"{settings.node}{suffix}", backend), model, settings


@contextmanager
def _until_told() -> Iterator[Callable[[], bool]]:
    """Gives a function that says whether Ctrl-C or the signal to end has come; a second one acts at once."""
    told: list[int] = []

    def note(number: int, frame: Any) -> None:
        if told:
            raise KeyboardInterrupt
        told.append(number)

    before = {n: signal.signal(n, note) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(told)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@ros2.command("control")
def ros2_control(
    robot: Robot,
    config: Config = None,
    backend: BackEnd = "auto",
    use_sim_time: Annotated[bool, typer.Option("--use-sim-time", help="Time is what /clock says.")] = False,
) -> None:
    """Run the controller as a node; it waits for joint states and a goal."""
    node, model, settings = _on_bus(robot, config, backend, "")
    from wbmpc.ros2.control import ControlNode

    gc.collect()
    gc.freeze()  # what is there now stays: later collections look at little and take no time from a tick
    # a thread that waits for the interpreter gets it after this time [s]: the control thread's ticks take less
    sys.setswitchinterval(5e-5)
    if use_sim_time:
        settings = settings.model_copy(update={"use_sim_time": True})
    try:
        with _until_told() as ended:
            ControlNode(node, model, settings).spin(ended)
    finally:
        node.close()


@ros2.command("sim")
def ros2_sim(
    robot: Robot,
    config: Config = None,
    backend: BackEnd = "auto",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the plant and of all noise.")] = 200,
    factor: Annotated[float, typer.Option(min=0.01, help="How much faster than real time.")] = 1.0,
    lockstep: Annotated[bool, typer.Option("--lockstep", help="Wait for the commands to every state.")] = False,
    seconds: Annotated[float, typer.Option(min=0.1, help="Simulated time after which it ends.")] = 1e9,
) -> None:
    """Simulate the robot as a node: joint states, inertial unit, clock; takes the controllers' commands."""
    node, model, settings = _on_bus(robot, config, backend, "_sim")
    from wbmpc.ros2.sim import SimNode

    try:
        with _until_told() as ended:
            sim = SimNode(node, model, settings, seed, lockstep=lockstep, factor=factor)
            typer.echo(f"the simulated robot is on the bus ({node.backend})", err=True)
            typer.echo(f"{sim.spin(ended, seconds)}; too slow {sim.behind} times", err=True)
    finally:
        node.close()


@ros2.command("check")
def ros2_check(
    robot: Robot,
    config: Config = None,
    backend: BackEnd = "auto",
    seconds: Annotated[float, typer.Option(min=0.5, help="How long it listens.")] = 3.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Say what is missing, mistyped, too slow or wrong on a robot's bus. Sends nothing; status 1 if there is an error."""
    node, model, settings = _on_bus(robot, config, backend, "_check")
    from wbmpc.ros2.check import ERROR, check

    try:
        found = check(node, model, settings, seconds)
    finally:
        node.close()
    if as_json:
        typer.echo(json.dumps({"findings": [vars(f) for f in found]}))
    else:
        for f in found:
            typer.echo(f"{f.level:8s}{f.topic:34s}{f.text}")
    if any(f.level == ERROR for f in found):
        raise typer.Exit(ABORTED)


def _complain(error: Exception, debug: bool) -> None:
    """One sentence on standard error, whatever the message looked like; the traceback only on request."""
    if debug:
        traceback.print_exception(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    else:
        text = str(error)
        if hasattr(error, "format_message"):
            text = f"{error.format_message().rstrip('.')}; see 'wbmpc --help' and 'wbmpc COMMAND --help'"
    typer.echo(f"wbmpc: {' '.join(text.split())}", err=True)


def main(arguments: list[str] | None = None, registry: Mapping[str, Experiment] | None = None) -> int:
    """Entry point; returns the exit status. Bad input is one sentence and status 2.

    ``registry``: experiments to use in place of the library's.
    """
    # One thread: linear algebra of this size only loses time by waking others (stalls of 40 ms were seen).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    given = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in given
    given = [a for a in given if a != "--debug"]  # understood anywhere on the line
    try:
        status = app(args=given, prog_name="wbmpc", standalone_mode=False, obj=_Session(registry))
        return status if isinstance(status, int) else COMPLETED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the reader has gone: let Python flush into nothing
        return ABORTED
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
        # mistakes on the command line itself; their base class is typer's or click's, by typer's version
        if not hasattr(error, "format_message"):
            raise
        _complain(error, debug)
        return BAD_INPUT
