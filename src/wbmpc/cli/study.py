"""`wbmpc study` and `wbmpc tune`: many runs, and what they say."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wbmpc import plugins
from wbmpc.cli.directories import AsJson, resumed_directory
from wbmpc.cli.terminal import INTERRUPTED, console, printable, progress_bar, table
from wbmpc.errors import InputError, unknown_name

if TYPE_CHECKING:
    from wbmpc.study.study import Study
    from wbmpc.study.summary import Summary

GROUP = "wbmpc.study_files"


def built_in_studies() -> dict[str, Path]:
    """The studies that installed packages offer, by name: files one folder below a module of the entry-point group ``wbmpc.study_files``."""
    folders: list[str] = []
    for module in plugins.offered(GROUP).values():
        with suppress(InputError), plugins.mistakes_of(module):  # importing a package in which it would be
            spec = find_spec(module)
            folders += [] if spec is None else spec.submodule_search_locations or []
    return {path.stem: path for folder in folders for path in sorted(Path(folder).glob("*/*.yaml"))}


def _names(incomplete: str) -> list[str]:
    return [name for name in built_in_studies() if name.startswith(incomplete)]


File = Annotated[
    str,
    typer.Argument(metavar="STUDY", help="A YAML file, or the name of a study of this package.", autocompletion=_names),
]
Out = Annotated[
    Path | None, typer.Option(help="Directory of the results (default: runs/NAME); finished runs there are kept.")
]
Workers = Annotated[
    int | None,
    typer.Option(min=0, help="Worker processes (default: one per core; 0: run in this process, for a debugger)."),
]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler whose workers do the runs, as tcp://host:8786.")
]


@contextmanager
def _opened(name: str, out: Path | None) -> Iterator[Study]:
    """The study of a file, or of a name."""
    from wbmpc.study.files import OWN
    from wbmpc.study.study import Study

    path, known = Path(name), built_in_studies()
    if not path.is_file():
        if path.suffix in (".yaml", ".yml") or name not in known:
            raise unknown_name("study", name, known)
        path = known[name]
    study = Study.load(path, out)
    with resumed_directory("--out", study.out, OWN):
        yield study


@contextmanager
def _progress(study: Study, title: str, verbose: bool) -> Iterator[Callable[[float, str], None]]:
    """A bar on a terminal; in a pipe every run that ends is a line, for hours go by. Ctrl-C says what is kept."""
    with progress_bar(title, verbose) as bar:
        try:
            yield bar or (lambda _, note: typer.echo(note, err=True) if verbose else None)
        except KeyboardInterrupt:
            typer.echo(f"wbmpc: interrupted: finished runs are in {study.out}; the same command continues", err=True)
            raise typer.Exit(INTERRUPTED) from None


def study(
    context: typer.Context,
    name: File,
    out: Out = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    report: Annotated[
        bool, typer.Option("--report", help="Run nothing; write tables and page of the finished runs.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Run an experiment over settings, seeds and robots; one row per run, statistics and a page."""
    talks = not (as_json or context.obj.quiet)
    with _opened(name, out) as opened, _progress(opened, opened.definition.title, talks) as progress:
        found = opened.report() if report else opened.run(workers, scheduler, progress)
    useless = _warn(opened, found)
    if as_json:
        typer.echo(json.dumps({**found.to_json(), "files": _files(opened)}, allow_nan=False))
    else:
        _print(found)
        typer.echo(f"the page is {opened.out / 'index.html'}")
    if found.lost or useless:
        raise typer.Exit(1)


def tune(
    context: typer.Context, name: File, out: Out = None, workers: Workers = None, scheduler: Scheduler = None,
    as_json: AsJson = False,
) -> None:  # fmt: skip
    """Search settings on tuning seeds; write the best for --config, and the reporting seeds before and after."""
    talks = not (as_json or context.obj.quiet)
    with _opened(name, out) as opened, _progress(opened, opened.definition.title, talks) as progress:
        found = opened.tune(workers, scheduler, progress)
    best = opened.out / "best.yaml"
    if as_json:
        files = {"best": str(best) if found.settings else None, "page": str(opened.out / "index.html")}
        typer.echo(json.dumps({**found.to_json(), "files": files}, allow_nan=False))
    else:
        if found.report is not None:
            _print(found.report)
        if len(found.front) > 1:
            typer.echo(f"{len(found.front)} trials that none beats in every objective; of the one with the least sum:")
        for key, value in found.settings.items():
            typer.echo(printable(f"{key}: {value}"))
        typer.echo(f"the best settings are in {best}" if found.settings else "no trial keeps the constraints")
        typer.echo(f"the page is {opened.out / 'index.html'}")
    if not found.settings:
        raise typer.Exit(1)


def _warn(study: Study, found: Summary) -> bool:
    """Say which settings runs rejected, and which metrics no run has. Whether no run took its settings."""
    runs = [(outcome, why) for c in found.cells for outcome, why in zip(c.outcomes, c.reasons, strict=True)]
    rejected = Counter(why for outcome, why in runs if outcome == "rejected")
    for why, count in rejected.items():
        typer.echo(printable(f"wbmpc: {count} runs rejected their settings: {why}"), err=True)
    strange = [name for name in study.definition.metrics if found.units and name not in found.units]
    if strange:
        known = ", ".join(found.units)
        typer.echo(printable(f"wbmpc: {study.path}: metrics: no run has '{strange[0]}'; valid: {known}"), err=True)
    return bool(runs) and rejected.total() == len(runs)


def _files(study: Study) -> dict[str, str]:
    return {
        k: str(study.out / f)
        for k, f in (("rows", "runs.parquet"), ("statistics", "statistics.json"), ("page", "index.html"))
    }


def _print(found: Summary) -> None:
    """A table for each metric of each experiment."""
    from wbmpc.study.page import HEADS, metric_rows

    for experiment, metrics in found.shown.items():
        cells = [c for c in found.cells if c.experiment == experiment]
        for metric in metrics:
            shown = table()
            for head in HEADS:
                shown.add_column(head)
            for row in metric_rows(found, cells, metric):
                shown.add_row(*map(printable, row))
            typer.echo(printable(f"{experiment}: {metric}"))
            console().print(shown)
    for why, count in found.lost.items():
        typer.echo(f"{count} runs without a result: {printable(why)}")
    typer.echo(f"{found.finished} of {found.planned} runs")
