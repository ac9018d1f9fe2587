"""`wbmpc runs`: what has been run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wbmpc.cli.directories import AsJson, Force, new_file
from wbmpc.cli.terminal import console
from wbmpc.cli.terminal import table as plain_table
from wbmpc.errors import printable

if TYPE_CHECKING:
    from wbmpc.run_index import Entry
    from wbmpc.study.index import StudyEntry


def runs(
    directory: Annotated[Path, typer.Argument(help="Directory to search, with its subdirectories.")] = Path("runs"),
    page: Annotated[Path | None, typer.Option(help="Write a page that sorts and filters the runs.")] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """List runs and studies, the newest first: experiment, seed, outcome, how many metrics reach their goals."""
    from wbmpc.output_file import write_text
    from wbmpc.run_index import find_runs
    from wbmpc.run_index import page as page_of
    from wbmpc.study.index import find_studies, section

    target = None if page is None else new_file("--page", page, page, force)
    found, studies = find_runs(directory), find_studies(directory)
    if target is not None:
        write_text(target, page_of(found, target.parent, section(studies, target.parent)))
    if as_json:
        output = {
            "runs": [run.to_json() for run in found],
            "studies": [s.to_json() for s in studies],
            "page": None if target is None else str(target),
        }
        typer.echo(json.dumps(output, allow_nan=False, default=str))
        return
    _print_studies(studies)
    _print(found)
    notes = [(s.directory, s.note) for s in studies] + [(run.directory, run.note) for run in found]
    for directory, note in notes:
        if note:
            typer.echo(printable(f"{directory}: {note}"))
    counted = f"{len(found)} {'run' if len(found) == 1 else 'runs'}"
    if studies:
        counted += f", {len(studies)} {'study' if len(studies) == 1 else 'studies'}"
    typer.echo(f"the page is {target}" if target else f"{counted}; --page FILE makes a page of them")


def _print(found: list[Entry]) -> None:
    from wbmpc.run_index import differing_settings

    rows = []
    for run, differs in zip(found, differing_settings(found), strict=True):
        reached, judged = run.goals
        rows.append((run.directory, run.experiment, "" if run.seed is None else run.seed, f"{reached} of {judged}" if judged else "",
                     f"{run.ended.astimezone():%Y-%m-%d %H:%M}", run.outcome, differs))  # fmt: skip
    _print_table(("run", "experiment", "seed", "metrics at goal", "ended", "outcome", "settings"), rows)


def _print_studies(found: list[StudyEntry]) -> None:
    rows = [
        (s.directory, ", ".join(s.experiments), s.runs, "" if s.trials is not None else s.failed, s.at_goal,
         f"{s.ended.astimezone():%Y-%m-%d %H:%M}") for s in found
    ]  # fmt: skip
    _print_table(("study", "experiments", "runs", "not completed", "at goal", "written"), rows)


def _print_table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Nothing without rows."""
    if not rows:
        return
    table = plain_table()
    right = ("seed", "metrics at goal", "runs", "not completed", "at goal")
    for head in heads:
        table.add_column(head, justify="right" if head in right else "left", overflow="fold")
    for row in rows:
        table.add_row(*(printable(str(cell)) for cell in row))
    console().print(table)
