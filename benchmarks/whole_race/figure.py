"""The log-log plots of the race as one page that needs no network."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

from wbmpc.benchmark.table import write as write_small
from whole_race.tables import text

_AXES = {"intervals": "intervals", "joints": "joints", "limits": "hard limits per node (0 drawn at 6)"}


def _series(rows: list[dict[str, Any]], key: str) -> dict[str, list[tuple[float, float]]]:
    """(abscissa, milliseconds) by solver and kind of problem."""
    out: dict[str, list[tuple[float, float]]] = {}
    for r in rows:
        if r.get("iteration_ms"):
            kind = r.get("kind") or r["problem"].split(",")[0]
            out.setdefault(f"{r['solver']}: {kind}", []).append((float(r[key]) or 6.0, r["iteration_ms"]))
    return out


def scaling_figures(figures: dict[str, Any]) -> list[Any]:
    """One log-log figure per abscissa."""
    import plotly.graph_objects as go

    out = []
    for key, rows in figures["scaling"].items():
        figure = go.Figure()
        for name, points in _series(rows, key).items():
            x, y = zip(*sorted(points), strict=True)
            figure.add_scatter(x=list(x), y=list(y), name=html.escape(name), mode="lines+markers")
        figure.update_layout(template="plotly_white", height=480, legend={"font": {"size": 11}})
        figure.update_xaxes(type="log", title=_AXES[key], tickvals=sorted({float(r[key]) or 6.0 for r in rows}))
        figure.update_yaxes(type="log", title="ms per iteration")
        out.append(figure)
    return out


def write(figures: dict[str, Any], directory: Path) -> dict[str, str]:
    """``race.json``, ``race.txt`` and, when there is scaling to draw, ``race.html``: paths by kind."""
    table = text(figures)
    files = write_small(figures, directory, table)
    if "scaling" in figures:
        from plotly.offline import get_plotlyjs

        drawn = [f.to_html(full_html=False, include_plotlyjs=False) for f in scaling_figures(figures)]
        page = f"<script>{get_plotlyjs()}</script><h1>The race</h1>{''.join(drawn)}<pre>{html.escape(table)}</pre>"
        plots = directory / "race.html"
        plots.write_text(f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Race</title>{page}</html>')
        files["plots"] = str(plots)
    return files
