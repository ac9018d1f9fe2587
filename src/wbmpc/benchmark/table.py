"""The figures of the race as tables of text."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from wbmpc.output_file import write_text

#: What :func:`write` writes.
FILES = ("race.json", "race.txt")


def number(value: Any, digits: int = 3) -> str:
    if value is None:
        return "–"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def table_of(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], left: int = 2) -> Table:
    table = Table(title=title, title_justify="left")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right", overflow="fold")
    last = ""
    for row in rows:
        cells = [c if isinstance(c, str) else number(c) for c in row]
        first, cells[0] = cells[0], "" if cells[0] == last else cells[0]
        last = first
        table.add_row(*cells)
    return table


def ending(row: dict[str, Any]) -> str:
    if row.get("success"):
        return number(row.get("total_ms"))
    return str(row.get("error", "not converged"))


def _race(rows: list[dict[str, Any]]) -> Table:
    columns = (
        "problem", "solver", "ms to 1e-6", "ms to convergence", "iterations", "ms / iteration", "residual",
        "difference",
    )  # fmt: skip
    last = ("iterations", "iteration_ms", "residual", "difference")
    cells = [
        [*(r.get(k) for k in ("problem", "solver", "equal_ms")), ending(r), *(r.get(k) for k in last)] for r in rows
    ]
    return table_of("Same discretized problem, same Hessian, one core", columns, cells)


def _sizes(rows: list[dict[str, Any]]) -> Table:
    size = lambda r: f"{r['nx']}/{r['nu']}/{r['intervals']}"
    cells = [[r["problem"], size(r), r["iteration_ms"], r["ocs2_ms"], r["ratio"], r["goal"]] for r in rows]
    columns = ("problem", "nx/nu/N", "ms / iteration", "OCS2's constant", "times faster", "goal")
    return table_of(
        "Problems of the size of OCS2's published figures (constants of a Zen 5, not run here)", columns, cells
    )


def _goals(rows: list[dict[str, Any]]) -> Table:
    outcome = {True: "reached", False: "missed", None: "not measured"}
    cells = [[r["what"], r["value"], r["goal"], outcome[r["met"]]] for r in rows]
    return table_of("Goals", ("what", "value", "goal", ""), cells, 1)


def tables(figures: dict[str, Any], more: Sequence[Table] = (), first: Sequence[Table] = ()) -> list[Table]:
    """Tables of the figures, ``first`` before them and ``more`` before that of the goals."""
    out = [*first, _race(figures["rows"]), _sizes(figures["sizes"])]
    limits = [[name, v["unlimited_ms"], v["hard_ms"], v["ratio"]] for name, v in figures["limits"].items()]
    out.append(table_of("Hard limits", ("problem", "unlimited [ms]", "hard-limited [ms]", "ratio"), limits, 1))
    return [*out, *more, _goals(figures["goals"])]


NOTES = (
    "Processor time, least of many, for others may use the machine. wbmpc: warm iterations, trial point included. IPOPT and "
    "Fatrop: the least of five solves without CasADi's set-up, divided by the iterations; the difference is to their solution "
    "from a guess 1e-3 beside ours. Residual: of every solver's solution by one measure (violation, Lagrangian's gradient and "
    "complementarity with multipliers of least squares); the time to 1e-6 of it is without CasADi's set-up."
)


def text(figures: dict[str, Any], width: int = 118, more: Sequence[Table] = (), first: Sequence[Table] = ()) -> str:
    console = Console(file=StringIO(), width=width)
    for table in tables(figures, more, first):
        console.print(table)
    console.print(NOTES, highlight=False)
    compiler = figures["compiler"] or "no C compiler: the peers' functions are interpreted"
    speeds = f"{figures['reference_kernel_gflops']:.0f} GFLOP/s on 512 x 512 products (NumPy), {figures['peak_gflops']:.0f} on "
    console.print(f"{figures['versions']['cpu']}; {speeds}small ones (our kernel); {compiler}", highlight=False)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


def write(figures: dict[str, Any], directory: Path, table: str) -> dict[str, str]:
    """:data:`FILES`, the second one with its ``table``: paths by kind."""
    files = {kind: directory / name for kind, name in zip(("json", "table"), FILES, strict=True)}
    write_text(files["json"], json.dumps(figures, indent=1), follow=False)
    write_text(files["table"], table, follow=False)
    return {kind: str(path) for kind, path in files.items()}
