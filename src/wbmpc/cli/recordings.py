"""Commands on recordings: ``wbmpc log info``, ``plot``, ``export``, ``layout``; ``wbmpc compare``."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from wbmpc.cli.directories import (
    AsJson,
    Force,
    new_directory,
    new_file,
    reject_existing,
    reject_links,
    writable_directory,
)
from wbmpc.errors import printable
from wbmpc.output_file import write_text

if TYPE_CHECKING:
    from wbmpc.recording.reader import Recording

log = typer.Typer(name="log", help="Inspect, plot and export the recording of a run.")

File = Annotated[Path, typer.Argument(help="The recording (run.mcap), or the directory of the run.")]
Topics = Annotated[list[str] | None, typer.Argument(help="Topics (default: all that fit).")]
#: Lines about settings, at most, that are printed.
MAX_SETTINGS = 20


@log.callback(invoke_without_command=True)
def log_options(context: typer.Context) -> None:
    """Inspect, plot and export the recording of a run."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _summary(recording: Recording) -> dict[str, Any]:
    topics = {
        name: {"type": topic.kind, "messages": len(topic.times), "first": topic.times[0], "last": topic.times[-1]}
        for name, topic in recording.topics.items()
        if topic.times
    }
    head = {"file": str(recording.path), "complete": recording.complete, "start": recording.start, "end": recording.end}
    head |= {"damage": recording.damage, "unknown": recording.unknown}
    return {**head, "metadata": recording.metadata, "topics": topics}


@log.command()
def info(file: File, as_json: AsJson = False) -> None:
    """Show the topics, times and metadata of a recording."""
    from wbmpc.recording.reader import read_recording

    recording = read_recording(file)
    summary = _summary(recording)
    if as_json:
        typer.echo(json.dumps(summary))
        return
    run, result = recording.metadata.get("run", {}), recording.metadata.get("result", {})
    # a damaged one has been reported by a warning
    end = "" if recording.complete or recording.damage else "; it ends in the middle: the run was killed"
    times = f"{recording.start:.2f} to {recording.end:.2f} s"
    started = f", started {run.get('started', 'unknown')}" if run else "; not recorded by wbmpc"
    typer.echo(printable(f"{recording.title}, {times}{started}{end}"))
    if recording.earlier:
        typer.echo(printable(recording.earlier))
    if result.get("reason"):
        typer.echo(printable(f"did not complete: {result['reason']}"))
    width = max(map(len, summary["topics"]), default=0)
    for name, t in summary["topics"].items():
        span = t["last"] - t["first"]
        rate = f"{(t['messages'] - 1) / span:7.1f} Hz" if span > 0.0 else ""
        typer.echo(printable(f"  {name:{width}}  {t['type']:30} {t['messages']:7d}  {rate}".rstrip()))
    if recording.unknown:
        typer.echo(printable(f"not read, for their types are not known here: {recording.unread}"))


@log.command()
def plot(
    file: File,
    topics: Topics = None,
    out: Annotated[Path | None, typer.Option(help="The page (default: a new plots.html beside the recording).")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Plot topics, or an overview, on one HTML page."""
    from wbmpc.recording.plots import of_topics, overview
    from wbmpc.recording.reader import read_recording
    from wbmpc.report import plots_page

    recording = read_recording(file)
    path = new_file("--out", out, recording.path.with_name("plots.html"), force)
    plots = of_topics(recording, topics) if topics else overview(recording)
    write_text(path, plots_page(recording.title, str(recording.path), plots), follow=out is not None)
    typer.echo(json.dumps({"page": str(path)}) if as_json else f"the plots are in {path}")


@log.command()
def export(
    file: File,
    topics: Topics = None,
    to: Annotated[str, typer.Option("--to", help="csv, npz or parquet.")] = "csv",
    out: Annotated[Path | None, typer.Option(help="Directory (default: a new export beside the recording).")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Write topics as tables for other tools."""
    from wbmpc.recording.export import export as write
    from wbmpc.recording.reader import read_recording

    recording = read_recording(file)
    directory = new_directory("--out", out, recording.path.with_name("export"), force)

    with ExitStack() as made:

        def check(files: list[Path]) -> None:
            reject_links("--out", files)
            reject_existing("--out", files, force)
            made.enter_context(writable_directory("--out", directory))

        paths = write(recording, to, directory, topics or (), check)
    if as_json:
        typer.echo(json.dumps({"files": [str(p) for p in paths]}))
    else:
        typer.echo(
            f"{len(paths)} {'file' if len(paths) == 1 else 'files'} in {paths[0].parent}"
            if paths
            else "nothing to write"
        )


@log.command()
def layout(
    file: File,
    out: Annotated[
        Path | None, typer.Option(help="The file (default: a new foxglove.json beside the recording).")
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Write a Foxglove layout for the recording: the robot, its paths, plots."""
    from wbmpc.recording.layout import layout as made
    from wbmpc.recording.reader import read_recording

    recording = read_recording(file)
    path = new_file("--out", out, recording.path.with_name("foxglove.json"), force)
    write_text(path, json.dumps(made(recording), indent=1) + "\n", follow=out is not None)
    typer.echo(json.dumps({"layout": str(path)}) if as_json else f"the layout is {path}: import it in Foxglove")


def compare(
    paths: Annotated[
        list[Path], typer.Argument(metavar="RUN RUN...", help="Directories of runs, or their recordings.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="The page with the runs' signals (default: a new compare.html; with --json none)."),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Compare runs: their metrics in a table, their signals overlaid on a page."""
    from wbmpc.compare import (
        differences,
        experiments,
        figures_table,
        load_all,
        outcomes,
        overlay,
        settings_table,
        table,
    )
    from wbmpc.report import plots_page

    target = None if as_json and out is None else new_file("--out", out, Path("compare.html"), force)
    runs = load_all(paths)
    figures = [run.figures for run in runs]
    rows, changed = table(figures), differences(figures)
    names = [path.name or str(path) for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    if len(set(names)) < len(names):
        names = [f"{name} ({k})" for k, name in enumerate(names, 1)]
    notes = [f"{run.path} {run.note}" for run in runs if run.note]
    notes = [note for note in (experiments(figures), *notes) if note]
    shown = f"{paths[0]} (solid) and {paths[1]} (dashed)" if len(paths) == 2 else ", ".join(map(str, paths))
    about, title = "; ".join([shown, *notes]), f"{', '.join(names[:-1])} and {names[-1]}"
    plots = overlay(runs, names)
    if target is not None:
        before = f"<h2>Figures</h2>{figures_table(rows, names, outcomes(figures))}" if rows else ""
        before += "" if experiments(figures) else settings_table(changed, names)
        write_text(target, plots_page(title, about, plots, before), follow=out is not None)
    if as_json:
        output = {"runs": [str(path) for path in paths], "outcomes": outcomes(figures), "metrics": rows}
        output |= {"settings": changed, "notes": notes, "page": None if target is None else str(target)}
        typer.echo(json.dumps(output))
        return
    if rows:
        _compare_table(rows, names, outcomes(figures))
    _print_differences(figures, changed)
    for note in notes:
        typer.echo(printable(note))
    typer.echo(f"the signals are in {target}" if plots else f"the runs share no signals; {target} is without plots")


def _print_differences(figures: list[dict[str, Any]], changed: dict[str, list[Any]]) -> None:
    """The settings that differ; those of different experiments by their number, and not more than fit on a screen."""
    from wbmpc.compare import experiments

    shown = {} if experiments(figures) else dict(list(changed.items())[:MAX_SETTINGS])
    for key, values in shown.items():
        typer.echo(printable(f"{key}: {' and '.join(map(str, values))}"))
    left = len(changed) - len(shown)
    if left:
        typer.echo(f"{left} {'more ' if shown else ''}settings differ: --json names them")


def _compare_table(rows: list[dict[str, Any]], names: list[str], ended: list[str | None]) -> None:
    from wbmpc.cli.terminal import console, table
    from wbmpc.compare import difference_text
    from wbmpc.units import scale

    shown = table()
    for column in ("metric", "unit"):
        shown.add_column(column)
    first, *others = map(printable, names)
    headings = [
        first, *(text for name in others for text in (name, "difference")), *(["spread"] if len(names) > 2 else []),
    ]  # fmt: skip
    for column in headings:
        shown.add_column(column, justify="right", no_wrap=True)
    ends = [printable(end or "") for end in ended]
    shown.add_row("outcome", "", ends[0], *(text for end in ends[1:] for text in (end, "")))
    for row in rows:
        unit = scale(row["unit"], *row["values"])
        values = [unit.text(v) for v in row["values"]]
        changes = [difference_text(d, row["values"][0], unit) for d in row["differences"][1:]]
        cells = [text for pair in zip(values[1:], changes, strict=True) for text in pair]
        spread = [unit.text(row["spread"])] if len(names) > 2 else []
        shown.add_row(printable(row["metric"]), printable(unit.unit), values[0], *cells, *spread)
    console().print(shown)
