"""The figures against acados as tables: of the race, and in Markdown."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from wbmpc.benchmark.table import number, table_of

COLUMNS = (
    "figure",
    "problem",
    "this solver [ms]",
    "acados [ms]",
    "times faster",
    "iterations, ours : acados",
    "acados' settings",
)


def rows(figures: dict[str, Any]) -> list[list[Any]]:
    """One row per figure: what, of which problem, both times, their ratio, iterations, settings."""
    out: list[list[Any]] = []
    for r in figures.get("cold", []):
        out.append(
            ["cold start to a residual of 1e-6", r["problem"], *_times(r, "ms"), r["ratio"], _counts(r, "iterations")]
        )
        out[-1].append(r["acados"].get("settings", ""))
    for kind in ("worst", "median"):
        for r in figures.get("ticks", []):
            missed = [f"{name} misses {r[name]['missed']}" for name in ("ours", "acados") if r[name]["missed"]]
            what = f"{kind} warm tick, first input within {100 * r['error']:g} %"
            counts = "; ".join([_counts(r, f"iterations_{kind}"), *missed])
            out.append([what, r["scenario"], *_times(r, f"{kind}_ms"), r[f"{kind}_ratio"], counts])
            out[-1].append(r["acados"]["settings_worst" if kind == "worst" else "settings"])
    for r in figures.get("iteration", []):
        out.append(["one real-time iteration at the solution", r["problem"], *_times(r, "ms"), r["ratio"], "1 : 1"])
        out[-1].append(r["acados"].get("settings", ""))
    return out


def _times(row: dict[str, Any], key: str) -> list[Any]:
    return [row["ours"].get(key), row["acados"].get(key)]


def _counts(row: dict[str, Any], key: str) -> str:
    return " : ".join(number(row[name].get(key)) for name in ("ours", "acados"))


def _quadratic(figures: dict[str, Any]) -> list[list[Any]]:
    """HPIPM of acados' build on the QP alone."""
    found = figures.get("quadratic", [])
    own = {r["problem"]: r for r in found if r["solver"].startswith("wbmpc")}
    out: list[list[Any]] = []
    for r in found:
        if r["solver"] == "hpipm" and r.get("step_ms"):
            ours = own[r["problem"]]["step_ms"]
            counts = f"1 : {number(r.get('iterations'))}" + (
                "" if r["success"] else f"; differs by {number(r['difference'])}"
            )
            row = ["the QP alone (HPIPM)", r["problem"], ours, r["step_ms"], r["step_ms"] / ours, counts]
            out.append([*row, r.get("settings", "")])
    return out


def about(figures: dict[str, Any]) -> str:
    """Build, versions and flags in a line."""
    build = figures["build"]
    flags = ", ".join(f"{k}={v}" for k, v in build.items() if k != "commit")
    return f"acados {build['commit']} ({flags})"


def markdown(figures: dict[str, Any]) -> str:
    """The table of docs/explanation/solver.md, or why there is none."""
    if "error" in figures:
        return f"acados: {figures['error']}"
    versions, lines = figures["versions"], []
    lines.append(
        f"`python benchmarks/acados.py --docs`, commit {versions['commit']}, {versions['cpu']}; {about(figures)}:\n"
    )
    lines += [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    for row in [*rows(figures), *_quadratic(figures)]:
        lines.append(f"| {' | '.join(c if isinstance(c, str) else number(c) for c in row)} |")
    failed = [f"{e['problem']}: {e['error']}" for e in figures.get("errors", [])]
    return "\n".join([*lines, *failed])


def acados_tables(figures: dict[str, Any]) -> list[Table]:
    """The table of the race."""
    found = figures.get("acados")
    if found is None:
        return []
    if "error" in found:
        return [table_of(f"acados: {found['error']}", ("",), [])]
    return [table_of(about(found), COLUMNS, rows(found), 2)]
