"""`wbmpc runs`: what has been run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wbmpc.cli.directories import Force, new_file
from wbmpc.cli.terminal import console
from wbmpc.cli.terminal import table as plain_table
from wbmpc.errors import printable

if TYPE_CHECKING:
    from wbmpc.run_index import Entry


def runs(
    directory: Annotated[Path, typer.Argument(help="Where to look, in folders below it too.")] = Path("runs"),
    page: Annotated[Path | None, typer.Option(help="Write a page that sorts and filters the runs.")] = None,
    force: Force = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """List runs, the newest first: experiment, seed, outcome, how many metrics reach their goals."""
    from wbmpc.output_file import write_text
    from wbmpc.run_index import find_runs
    from wbmpc.run_index import page as page_of

    target = None if page is None else new_file("--page", page, page, force)
    found = find_runs(directory)
    if target is not None:
        write_text(target, page_of(found, target.parent))
    if as_json:
        output = {"runs": [run.to_json() for run in found], "page": None if target is None else str(target)}
        typer.echo(json.dumps(output, allow_nan=False, default=str))
        return
    _print(found)
    for run in found:
        if run.note:
            typer.echo(printable(f"{run.directory}: {run.note}"))
    typer.echo(
        f"the page is {target}"
        if target
        else f"{len(found)} {'run' if len(found) == 1 else 'runs'}; --page FILE makes a page of them"
    )


def _print(found: list[Entry]) -> None:
    table = plain_table()
    for column in ("run", "experiment", "seed", "metrics at goal", "ended", "outcome"):
        table.add_column(column, justify="right" if column in ("seed", "metrics at goal") else "left", overflow="fold")
    for run in found:
        reached, judged = run.goals
        cells = (run.directory, run.experiment, "" if run.seed is None else run.seed, f"{reached} of {judged}" if judged else "",
                 f"{run.ended.astimezone():%Y-%m-%d %H:%M}", run.outcome)  # fmt: skip
        table.add_row(*(printable(str(cell)) for cell in cells))
    console().print(table, markup=False) if found else None
