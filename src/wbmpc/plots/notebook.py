"""What notebooks show of objects: a small table, a figure."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from wbmpc.plots.figures import Plot, Series, hint, palette, plotly_figure
from wbmpc.units import by_unit, with_unit

#: Height of a plot in a figure [pixels].
_HEIGHT = 260


def html_table(title: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    line = lambda tag, cells: (
        f"<tr>{''.join(f'<{tag} style=text-align:left>{html.escape(str(c))}</{tag}>' for c in cells)}</tr>"
    )
    head = line("th", header) if header else ""
    return f"<div><b>{html.escape(title)}</b><table>{head}{''.join(line('td', row) for row in rows)}</table></div>"


def trajectories(times: np.ndarray, x: np.ndarray, u: np.ndarray, dynamics: Any = None) -> list[Plot]:
    """States (N + 1, nx) and inputs (N, nu), held over each interval, at ``times`` (N + 1,) [s]: a plot for each unit.

    Names and units are those of ``dynamics``; numbers for None.
    """
    held, plots = np.repeat(times, 2)[1:-1], []
    for what, symbol, t, rows in (("state", "x", times, x.T), ("input", "u", held, np.repeat(u, 2, axis=0).T)):
        layout = None if dynamics is None else getattr(dynamics, what)
        names = [f"{symbol}[{i}]" for i in range(len(rows))] if layout is None else layout.names
        for unit, places in by_unit([""] * len(rows) if layout is None else layout.units).items():
            lines = [Series(names[i], t, rows[i]) for i in places]
            plots.append(Plot(f"{what.capitalize()}s", "time [s]", with_unit(what, unit), lines))
    return plots


def figure(plots: Sequence[Plot]) -> Any:
    """One figure of Plotly with the plots below each other, each with its own legend; those over time share their zoom."""
    from plotly.graph_objects import Figure
    from plotly.subplots import make_subplots

    titles = [
        f"{html.escape(p.title)}<br><sup>{html.escape(hint(p))}</sup>" if hint(p) else html.escape(p.title)
        for p in plots
    ]
    made: Figure = make_subplots(
        rows=max(len(plots), 1), cols=1, subplot_titles=titles, vertical_spacing=0.35 / max(len(plots), 1)
    )
    colors = palette(plots)
    for row, plot in enumerate(plots, start=1):
        drawn = plotly_figure(plot, colors)
        for line in drawn["data"]:
            group = f"{row}: {line.get('legendgroup', line['name'])}"
            made.add_trace({**line, "legend": f"legend{row if row > 1 else ''}", "legendgroup": group}, row=row, col=1)
        layout = drawn["layout"]
        axis = {"matches": "x"} if plot.x_label == plots[0].x_label and not plot.equal_axes else {}
        made.update_xaxes({**layout["xaxis"], **axis}, row=row, col=1)
        y = {k: v for k, v in layout["yaxis"].items() if k != "scaleanchor"}
        made.update_yaxes(
            {**y, **({"scaleanchor": f"x{row if row > 1 else ''}"} if plot.equal_axes else {})}, row=row, col=1
        )
        top = made.layout["yaxis" if row == 1 else f"yaxis{row}"].domain[1]
        made.update_layout({f"legend{row if row > 1 else ''}": {"y": top, "yanchor": "top", "x": 1.02}})
    return made.update_layout(height=_HEIGHT * max(len(plots), 1) + 80, hovermode="x unified", template="plotly_white")
