"""Tables of the whole race: those of the small one and more."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from wbmpc.benchmark.table import ending, number, table_of
from wbmpc.benchmark.table import text as small_text
from whole_race.acados_tables import acados_tables
from whole_race.scaling import slope


def _quadratic(rows: list[dict[str, Any]]) -> Table:
    ending = lambda r: r.get("error") or ("yes" if r["success"] else "no")
    cells = [[r["problem"], r["solver"], r.get("step_ms"), r.get("difference"), ending(r)] for r in rows]
    columns = ("problem", "solver", "ms", "difference", "right to 1e-6")
    return table_of("The quadratic problem of one step, without linearization", columns, cells)


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
    return table_of("Where an iteration's time goes", columns, cells)


def _yardstick(rows: list[dict[str, Any]]) -> Table:
    keys = ("ours_ms", "c_ms", "ratio", "ours_riccati_ms", "c_riccati_ms", "riccati_ratio", "difference")
    cells = [[r["problem"], *([r[k] for k in keys] if r["success"] else [r["error"], *[None] * 6])] for r in rows]
    columns = ("problem", "ours [ms]", "C [ms]", "ratio", "Riccati, ours", "Riccati, C", "ratio", "difference")
    return table_of("Against a C build of the same functions and algorithm", columns, cells, 1)


def _scaling(title: str, rows: list[dict[str, Any]], key: str) -> Table:
    cells = [[f"{r['problem']}", r["solver"], r.get(key), r.get("iteration_ms"), r.get("error", "")] for r in rows]
    return table_of(title, ("problem", "solver", key, "ms / iteration", ""), cells)


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
    return table_of("Closed loop of the ball robot at equal processor time per period of 20 ms", columns, cells, 1)


def more_tables(figures: dict[str, Any]) -> list[Table]:
    """All tables beyond the small race's that the figures have something for."""
    out: list[Table] = []
    if "crocoddyl" in figures:
        columns = ("problem", "solver", "ms / iteration", "iterations", "ms to convergence")
        rows = figures["crocoddyl"]
        cells = [[r["problem"], r["solver"], r.get("iteration_ms"), r.get("iterations"), ending(r)] for r in rows]
        out.append(table_of("crocoddyl on the nearest problems", columns, cells))
    for key, make in (("quadratic", _quadratic), ("yardstick", _yardstick), ("floor", _floor)):
        if key in figures:
            out.append(make(figures[key]))
    if "scaling" in figures:
        s = figures["scaling"]
        exponent = slope(s["intervals"], "intervals", problem="torque arm")
        out.append(
            _scaling(f"Time over intervals; ours grows with the power {number(exponent)}", s["intervals"], "intervals")
        )
        out.append(_scaling("Time over joints", s["joints"], "joints"))
        out.append(_scaling("Time over hard limits per node", s["limits"], "limits"))
    if "closed_loop" in figures:
        out.append(_closed_loop(figures["closed_loop"]))
    return out


def text(figures: dict[str, Any], width: int = 118) -> str:
    """Tables, notes and the machine, as text."""
    return small_text(figures, width, more_tables(figures), acados_tables(figures))
