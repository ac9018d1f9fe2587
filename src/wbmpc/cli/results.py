"""Results of runs on standard output: a table of metrics against goals, or JSON."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import typer

from wbmpc.cli.terminal import ABORTED, INTERRUPTED, console
from wbmpc.cli.terminal import table as plain_table
from wbmpc.errors import printable

if TYPE_CHECKING:
    from wbmpc.result import MpcStatistics, RunResult


def _table(results: list[RunResult]) -> None:
    from wbmpc.report import exact, goal_notes, metric_cells
    from wbmpc.units import number

    models = [exact(r) for r in results]
    paper = any(m.paper is not None for r in results for m in r.metrics.values())
    own, physics = "Simulated by the planner's own model", "Simulated in MuJoCo, plant perturbed"
    title = own if all(models) else f"{own} or in MuJoCo, plant perturbed" if any(models) else physics
    title += "; the paper's figures are of the real robot." if paper else "."
    table = plain_table(title)
    for column in ("experiment", "metric"):
        table.add_column(column, overflow="fold")
    table.add_column("unit", no_wrap=True)
    for column in ("this run", *(["paper"] if paper else []), "goal"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for result in results:
        for k, name in enumerate(result.metrics):
            outcome = {True: "reached", False: "missed", None: ""}[result.reached(name)]
            unit, figure, published, goal = metric_cells(result, name)
            cells = [figure, *([published] if paper else []), goal]
            table.add_row(result.experiment if k == 0 else "", printable(name), printable(unit), *cells, outcome)
        mpc = result.mpc
        if mpc is not None:
            table.add_row("", "MPC rate", "Hz", f"{mpc.rate_hz:g}")
            for kind, milliseconds in mpc.solve_ms.items():
                table.add_row("", f"MPC solve time, {kind}", "ms", number(milliseconds))
            for kind, how_many in _counts(mpc).items():
                table.add_row("", f"MPC {kind}", f"of {mpc.solves}", str(how_many))
        table.add_section()
    out = console()
    out.print(table)
    for result in results:
        for note in goal_notes(result):
            out.print(printable(f"{result.experiment}, {note}"), highlight=False)


def _counts(mpc: MpcStatistics) -> dict[str, int]:
    return {"deadline misses": mpc.deadline_misses, "solves that failed": mpc.failures + mpc.no_step}


def show_results(results: list[tuple[RunResult, dict[str, str]]], as_json: bool) -> None:
    """Print results with the files of each run, as a table or as JSON, and raise :class:`typer.Exit` unless all completed."""
    from wbmpc.report import to_json

    if as_json:
        objects = [to_json(r, f) for r, f in results]
        typer.echo(json.dumps(objects[0] if len(objects) == 1 else {"runs": objects}, allow_nan=False))
    else:
        _table([r for r, _ in results])
        for result, files in results:
            if not result.completed:
                judged = any(result.reached(name) is not None for name in result.metrics)
                goals = "; a run that does not complete reaches no goal" if judged else ""
                said = f"{result.experiment} did not complete: {result.reason} (outcome: {result.outcome}{goals})"
                typer.echo(printable(said))
            typer.echo(f"{result.experiment}: the report page is {files['report']}")
    if any(r.interrupted for r, _ in results):
        raise typer.Exit(INTERRUPTED)
    if not all(r.completed for r, _ in results):
        raise typer.Exit(ABORTED)
