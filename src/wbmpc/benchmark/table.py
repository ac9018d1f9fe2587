"""The figures of the race as tables of text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from io import StringIO
from typing import Any

from rich.console import Console
from rich.table import Table

from wbmpc.benchmark.scaling import slope


def _number(value: Any, digits: int = 3) -> str:
    if value is None:
        return "–"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def _table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], left: int = 2) -> Table:
    table = Table(title=title, title_justify="left")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right", overflow="fold")
    last = ""
    for row in rows:
        cells = [c if isinstance(c, str) else _number(c) for c in row]
        first, cells[0] = cells[0], "" if cells[0] == last else cells[0]
        last = first
        table.add_row(*cells)
    return table


def _ending(row: dict[str, Any]) -> str:
    if row.get("success"):
        return _number(row.get("total_ms"))
    return str(row.get("error", "not converged"))


def _race(rows: list[dict[str, Any]]) -> Table:
    columns = (
        "problem",
        "solver",
        "ms / iteration",
        "iterations",
        "ms to convergence",
        "residual",
        "ms to 1e-6",
        "difference",
    )
    keys = ("problem", "solver", "iteration_ms", "iterations")
    last = ("residual", "equal_ms", "difference")
    cells = [[*(r.get(k) for k in keys), _ending(r), *(r.get(k) for k in last)] for r in rows]
    return _table("Same discretised problem, same Hessian, one core", columns, cells)


def _quadratic(rows: list[dict[str, Any]]) -> Table:
    ending = lambda r: r.get("error") or ("yes" if r["success"] else "no")
    cells = [[r["problem"], r["solver"], r.get("step_ms"), r.get("difference"), ending(r)] for r in rows]
    columns = ("problem", "solver", "ms", "difference", "right to 1e-6")
    return _table("The quadratic problem of one step, without linearisation", columns, cells)


def _sizes(rows: list[dict[str, Any]]) -> Table:
    size = lambda r: f"{r['nx']}/{r['nu']}/{r['intervals']}"
    cells = [[r["problem"], size(r), r["iteration_ms"], r["ocs2_ms"], r["ratio"], r["goal"]] for r in rows]
    columns = ("problem", "nx/nu/N", "ms / iteration", "OCS2's constant", "times faster", "goal")
    return _table(
        "Problems of the size of OCS2's published figures (constants of a Zen 5, not run here)", columns, cells
    )


def _floor(profiles: list[dict[str, Any]]) -> Table:
    cells = []
    for p in profiles:
        for name, part in p["parts"].items():
            rate = part["operations"] / part["ms"] / 1e6 if part["ms"] > 0 and part["operations"] else None
            share = f"{100 * part['ms'] / p['iteration_ms']:.0f} %"
            cells.append([p["problem"], name, part["operations"], part["ms"], share, rate])
        whole = f"all: {p['ratio']:.1f} times the floor of {p['floor_ms']:.3g} ms"
        cells.append(
            [p["problem"], whole, p["operations"], p["iteration_ms"], "", p["operations"] / p["iteration_ms"] / 1e6]
        )
    columns = ("problem", "part of an iteration", "operations", "ms", "share", "GFLOP/s")
    return _table("Where an iteration's time goes", columns, cells)


def _yardstick(rows: list[dict[str, Any]]) -> Table:
    keys = ("ours_ms", "c_ms", "ratio", "ours_riccati_ms", "c_riccati_ms", "riccati_ratio", "difference")
    cells = [[r["problem"], *([r[k] for k in keys] if r["success"] else [r["error"], *[None] * 6])] for r in rows]
    columns = ("problem", "ours [ms]", "C [ms]", "ratio", "Riccati, ours", "Riccati, C", "ratio", "difference")
    return _table("Against a C build of the same functions and algorithm", columns, cells, 1)


def _scaling(title: str, rows: list[dict[str, Any]], key: str) -> Table:
    cells = [[f"{r['problem']}", r["solver"], r.get(key), r.get("iteration_ms"), r.get("error", "")] for r in rows]
    return _table(title, ("problem", "solver", key, "ms / iteration", ""), cells)


def _closed_loop(rows: list[dict[str, Any]]) -> Table:
    cells = [
        [
            r["solver"],
            r.get("budget_ms"),
            r.get("iterations"),
            r.get("late"),
            r.get("cost"),
            r.get("error") or r.get("fell"),
        ]
        for r in rows
    ]
    columns = ("solver", "ms per period", "iterations", "periods late", "cost per second", "falls")
    return _table("Closed loop of the ball robot at equal processor time per period of 20 ms", columns, cells, 1)


def _goals(rows: list[dict[str, Any]]) -> Table:
    verdict = {True: "reached", False: "missed", None: "not measured"}
    cells = [[r["what"], r["value"], r["goal"], verdict[r["met"]]] for r in rows]
    return _table("Goals", ("what", "value", "goal", ""), cells, 1)


def tables(figures: dict[str, Any]) -> list[Table]:
    """All tables that the figures have something for."""
    out = [_race(figures["rows"]), _sizes(figures["sizes"])]
    limits = [[name, v["unlimited_ms"], v["hard_ms"], v["ratio"]] for name, v in figures["limits"].items()]
    out.append(_table("Hard limits", ("problem", "unlimited [ms]", "hard-limited [ms]", "ratio"), limits, 1))
    if "crocoddyl" in figures:
        columns = ("problem", "solver", "ms / iteration", "iterations", "ms to convergence")
        rows = figures["crocoddyl"]
        cells = [[r["problem"], r["solver"], r.get("iteration_ms"), r.get("iterations"), _ending(r)] for r in rows]
        out.append(_table("crocoddyl on the nearest problems", columns, cells))
    for key, make in (("quadratic", _quadratic), ("yardstick", _yardstick), ("floor", _floor)):
        if key in figures:
            out.append(make(figures[key]))
    if "scaling" in figures:
        s = figures["scaling"]
        exponent = slope(s["intervals"], "intervals", problem="torque arm")
        out.append(
            _scaling(f"Time over intervals; ours grows with the power {_number(exponent)}", s["intervals"], "intervals")
        )
        out.append(_scaling("Time over joints", s["joints"], "joints"))
        out.append(_scaling("Time over hard limits per node", s["limits"], "limits"))
    if "closed_loop" in figures:
        out.append(_closed_loop(figures["closed_loop"]))
    return [*out, _goals(figures["goals"])]


NOTES = (
    "Processor time, least of many, for others may use the machine. wbmpc: warm iterations, trial point included. IPOPT and "
    "Fatrop: the least of five solves without CasADi's set-up, divided by the iterations; the difference is to their solution "
    "from a guess 1e-3 beside ours. Residual: of every solver's solution by one measure (violation, Lagrangian's gradient and "
    "complementarity with multipliers of least squares); the time to 1e-6 of it is without CasADi's set-up."
)


def text(figures: dict[str, Any], width: int = 118) -> str:
    """Tables, notes and the machine, as text."""
    console = Console(file=StringIO(), width=width)
    for table in tables(figures):
        console.print(table)
    console.print(NOTES, highlight=False)
    compiler = figures["compiler"] or "no C compiler: the peers' functions are interpreted"
    speeds = f"{figures['reference_kernel_gflops']:.0f} GFLOP/s on 512 x 512 products (NumPy), {figures['peak_gflops']:.0f} on "
    console.print(f"{figures['versions']['cpu']}; {speeds}small ones (our kernel); {compiler}", highlight=False)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()
