"""The page of a study: figures with intervals, failures, comparisons; distributions, paired plots, heat maps, scatter."""

from __future__ import annotations

import html
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from wbmpc.experiment import Definitions, definition_of
from wbmpc.plots.figures import COLORS
from wbmpc.report import document, goal_text, named, table, template
from wbmpc.result import Metric
from wbmpc.study.statistics import Paired, Rate
from wbmpc.study.summary import Cell, Summary
from wbmpc.units import Scale, scale, with_unit

#: Plots of one experiment, combinations of one plot, and runs that the list of failures shows, at most.
MAX_PLOTS, MAX_SHOWN, MAX_FAILURES = 24, 40, 200
#: Combinations that a paired plot compares, at most.
MAX_PAIRED = 8
_BLUE = COLORS[0]
#: Columns of a metric's table: see :func:`metric_rows`.
HEADS = [
    "settings", "runs", "failed", "median [95 %]", "difference [95 %]", "better in", "goal", "", "5 %", "95 %", "worst",
]  # fmt: skip


def study_page(summary: Summary, beside: Path, definitions: Mapping[str, Definitions] | None = None) -> str:
    """One HTML page that needs no network; links to runs are relative to ``beside``. ``definitions`` of metrics by experiment."""
    failed = sum(c.failures.failed for c in summary.cells)
    sources = "; ".join(f"{k} {', '.join(v)}" for k, v in summary.sources.items() if v and k != "code")
    about = f"{summary.finished} of {summary.planned} runs; {failed} of them did not complete. {sources}."
    note = (
        "A run that did not complete counts as infinitely bad in every figure, and one without a figure in those with a goal. "
        "Intervals: bootstrap of the median, Wilson for failures, 95 %. Differences are paired: median over equal seeds, against the "
        "first row or the named condition."
    )
    several = len(summary.sources.get("code", ())) > 1
    warning = '<div class="card summary bad">The runs are of different states of the code.</div>' if several else ""
    lost = "".join(f"<p>{n} without a result: {html.escape(why)}</p>" for why, n in summary.lost.items())
    sections = "".join(_experiment(summary, name, beside, (definitions or {}).get(name, {})) for name in summary.shown)
    head = f'<h1 class="broad">{html.escape(summary.title)}</h1><p class="sub">{html.escape(about)}</p><p class="sub">{note}</p>'
    return document(summary.title, f"{head}{warning}{lost}{sections}")


def _experiment(summary: Summary, name: str, beside: Path, definitions: Definitions) -> str:
    cells = [c for c in summary.cells if c.experiment == name]
    metrics = summary.shown[name]
    heads = {m: named(m, definition_of(m, definitions)[1]) for m in metrics}
    tables = "".join(f"<h3>{heads[m]}</h3>{_table(summary, cells, m)}" for m in metrics)
    plots: list[tuple[str, str, bool]] = []
    left = list(metrics)
    while left and len(plots) < MAX_PLOTS:  # a plot takes longer than a table
        plots += _plots(summary, cells, left.pop(0))
    cards = "".join(
        f'<div class="card{" wide" if wide else ""}"><h3>{html.escape(title)}</h3>{figure}</div>'
        for title, figure, wide in plots[:MAX_PLOTS]
    )
    more = (
        f"<p>The plots of {len(left)} more metrics are left out: 'metrics' in the study's file chooses.</p>"
        if left
        else ""
    )
    return f'<h2>{html.escape(name)}</h2>{tables}<div class="plots">{cards}</div>{more}{_failures(cells, beside)}'


def metric_scale(summary: Summary, cells: Sequence[Cell], metric: str) -> Scale:
    """The unit in which a metric of an experiment is shown."""
    medians = [summary.spread(c, metric).median for c in cells]
    targets = [value for c in cells for value in summary.target(c, metric).values()]
    return scale(summary.units.get(metric, "1"), *medians, *targets)


def metric_rows(summary: Summary, cells: Sequence[Cell], metric: str) -> list[list[str]]:
    """A metric's table as plain text: a row for each combination, cells as in the page."""
    shown, rows = metric_scale(summary, cells, metric), []
    for c in cells:
        s, target, compared = (summary.spread(c, metric), summary.target(c, metric), summary.comparison(c, metric))
        goal = goal_text(Metric(s.median, "", goal=target["goal"], least=target["least"]), shown)
        met = {True: "reached", False: "missed", None: ""}[summary.met(c, metric)]
        middle = with_interval(s.median, s.low, s.high, shown) if s.count else "not measured"
        runs = str(s.count) if s.count == len(c.outcomes) else f"{s.count} of {len(c.outcomes)}"
        ends = [shown.text(v) if s.count else "" for v in (s.p5, s.p95, s.worst)]
        rows.append(
            [c.label, runs, rate_text(c.failures), middle, *comparison_cells(compared, shown), goal, met, *ends]
        )
    return rows


def with_interval(value: float, low: float, high: float, shown: Scale) -> str:
    """``12.1 [11.8, 12.9] mm``; without the interval where there is none."""
    between = "" if math.isnan(low) else f"[{shown.text(low)}, {shown.text(high)}]"
    return " ".join(part for part in (shown.text(value), between, shown.unit) if part)


def rate_text(rate: Rate) -> str:
    """``1 (0.2 to 24 %)``."""
    return f"{rate.failed} ({100 * rate.low:.2g} to {100 * rate.high:.3g} %)"


def comparison_cells(found: Paired | None, shown: Scale) -> list[str]:
    if found is None:
        return ["", ""]
    difference = with_interval(found.difference, found.low, found.high, shown)
    return [difference, f"{found.wins} of {found.count}: {found.text}"]


def _table(summary: Summary, cells: Sequence[Cell], metric: str) -> str:
    kinds = {"reached": "met", "missed": "missed"}
    rows = [
        [f'<span class="{kinds[c]}">{c}</span>' if c in kinds else html.escape(c) for c in row]
        for row in metric_rows(summary, cells, metric)
    ]
    return table(HEADS, rows, {1, 2, 3, 4, 6, 8, 9, 10})


def _failures(cells: Sequence[Cell], beside: Path) -> str:
    """Runs that did not complete, and those with files, with links to their reports."""
    rows = []
    for c in cells:
        for seed, how, why, files in zip(c.seeds, c.outcomes, c.reasons, c.files, strict=True):
            if how != "completed" or files:
                link = quote(os.fsencode(os.path.relpath(Path(files) / "report.html", beside))) if files else ""
                name = f"{html.escape(c.label)}, seed {seed}"
                rows.append([f'<a href="{link}">{name}</a>' if link else name, html.escape(how), html.escape(why)])
    more = f"<p>and {len(rows) - MAX_FAILURES} more</p>" if len(rows) > MAX_FAILURES else ""
    if not rows:
        return ""
    listed = table(["run", "outcome", ""], rows[:MAX_FAILURES], set())
    return f"<details><summary>Runs that did not complete, and reports</summary>{listed}{more}</details>"


# ---------------------------------------------------------------------- plots
def _plots(summary: Summary, cells: Sequence[Cell], metric: str) -> list[tuple[str, str, bool]]:
    """Those that the data allow: title, figure, and whether it is as wide as the page."""
    shown, cells = metric_scale(summary, cells, metric), cells[:MAX_SHOWN]
    values = [
        shown.factor * np.where(c.accepted, c.figures.get(metric, np.full(c.seeds.size, np.nan)), np.nan) for c in cells
    ]
    together = np.concatenate(values)
    if np.unique(together[np.isfinite(together)]).size < 2:
        return []  # nothing was measured, or nothing differs
    label = with_unit(metric, shown.unit)
    goals = {goal for c in cells if (goal := summary.target(c, metric)["goal"]) is not None}
    few = len(cells) <= MAX_PAIRED
    drawn = [(metric, _distribution(cells, values, label, [shown.factor * goal for goal in sorted(goals)]), not few)]
    if few and len(cells) > 1 and any(v.size > 1 for v in values):
        drawn.append((f"{metric}, seed by seed", _pairs(cells, values, label), False))
    numeric = [
        k for k in cells[0].varied if len({_number(c.varied.get(k)) for c in cells}) > 1 and _is_numeric(cells, k)
    ]
    if len(numeric) >= 2 and len(cells) >= 4:
        drawn += [
            (f"{label}, medians{f': {n}' if n else ''}", f, False) for n, f in _heat_maps(cells, values, numeric[:2])
        ]
    elif len(numeric) == 1 and len(cells) > 2:
        drawn.append((f"{metric} over {numeric[0]}", _scatter(cells, values, numeric[0], label), False))
    return drawn


def _is_numeric(cells: Sequence[Cell], key: str) -> bool:
    return all(isinstance(c.varied.get(key), int | float) for c in cells)


def _number(value: Any) -> Any:
    return value if isinstance(value, int | float | str) else str(value)


def _others(cell: Cell, keys: Sequence[str]) -> str:
    """What of a combination is not in ``keys``: its condition, robot and other settings; empty where there is nothing else."""
    left = {k: v for k, v in cell.varied.items() if k not in keys}
    return ", ".join([part for part in (cell.condition, cell.robot) if part] + [f"{k}={v}" for k, v in left.items()])


def _broken(label: str) -> str:
    """A combination's name as HTML, a line for each setting."""
    return html.escape(label).replace(", ", "<br>")


def figure_html(figure: Any, x: str, y: str, height: int = 360, legend: bool = False) -> str:
    """A figure on the page's ground, with titles of its axes."""
    figure.update_layout(
        template=template(), height=height, margin={"l": 60, "r": 16, "t": 12, "b": 60}, xaxis_title=html.escape(x), yaxis_title=html.escape(y),
        hovermode="closest", showlegend=legend, font={"family": "system-ui, sans-serif", "size": 12},
        legend={"orientation": "h", "y": -0.2, "yanchor": "top"},
    )  # fmt: skip
    options = {"displaylogo": False, "responsive": True, "displayModeBar": "hover"}
    return str(figure.to_html(full_html=False, include_plotlyjs=False, config=options))


def _distribution(cells: Sequence[Cell], values: Sequence[np.ndarray], label: str, goals: Sequence[float]) -> str:
    """Every run a point on its box, from the first combination down; the goals dashed."""
    import plotly.graph_objects as go

    figure, names = go.Figure(), [(_broken if len(cells) <= MAX_PAIRED else html.escape)(c.label) for c in cells]
    for c, v, name in zip(cells, values, names, strict=True):
        keep = np.isfinite(v)
        figure.add_box(
            x=v[keep].tolist(), name=name, boxpoints="all", jitter=0.5, pointpos=0, line={"width": 1.2},
            marker={"color": _BLUE, "size": 4}, text=[f"seed {s}" for s in c.seeds[keep]],
        )  # fmt: skip
    for goal in goals:
        figure.add_vline(x=goal, line={"dash": "dash", "width": 1, "color": "#7a7a7a"})
    figure.update_yaxes(autorange="reversed")
    return figure_html(figure, label, "", _height(names))


def _height(names: Sequence[str]) -> int:
    """Of a figure with a row for each of the ``names`` [pixels]."""
    lines = max(1 + name.count("<br>") for name in names)
    return max(360, 100 + (8 + 15 * lines) * len(names))


def _pairs(cells: Sequence[Cell], values: Sequence[np.ndarray], label: str) -> str:
    import plotly.graph_objects as go

    names = [_broken(c.label) for c in cells]
    by_seed: dict[int, list[float | None]] = {}
    for k, (c, v) in enumerate(zip(cells, values, strict=True)):
        for seed, value in zip(c.seeds.tolist(), v.tolist(), strict=True):
            by_seed.setdefault(seed, [None] * len(cells))[k] = value if math.isfinite(value) else None
    figure = go.Figure()
    for seed, line in list(by_seed.items())[:MAX_FAILURES]:
        figure.add_scatter(
            x=line, y=names, name=f"seed {seed}", mode="lines+markers", opacity=0.55,
            line={"width": 1, "color": _BLUE}, marker={"size": 4},
        )  # fmt: skip
    figure.update_yaxes(autorange="reversed")
    return figure_html(figure, label, "", _height(names))


def _heat_maps(cells: Sequence[Cell], values: Sequence[np.ndarray], keys: Sequence[str]) -> list[tuple[str, str]]:
    """Medians over two settings: name and map of each of what else there is (conditions, robots, other settings), in the same colors."""
    medians = [float(np.nanmedian(v)) if np.isfinite(v).any() else None for v in values]
    known = [m for m in medians if m is not None]
    groups = dict.fromkeys(_others(c, keys) for c in cells)
    found = []
    for name in groups:
        mine = [(c, m) for c, m in zip(cells, medians, strict=True) if _others(c, keys) == name]
        found.append((name, _heat_map(mine, keys, (min(known), max(known)))))
    return found


def _heat_map(medians: Sequence[tuple[Cell, float | None]], keys: Sequence[str], span: tuple[float, float]) -> str:
    import plotly.graph_objects as go

    x, y = (sorted({c.varied[key] for c, _ in medians}) for key in keys)
    at = {(c.varied[keys[0]], c.varied[keys[1]]): m for c, m in medians}
    z = [[at.get((left, below)) for left in x] for below in y]
    names = [[f"{v:g}" for v in axis] for axis in (x, y)]
    figure = go.Figure(
        go.Heatmap(
            x=names[0], y=names[1], z=z, zmin=span[0], zmax=span[1], colorscale="Viridis", texttemplate="%{z:.3~g}"
        )
    )
    figure.update_xaxes(type="category")
    figure.update_yaxes(type="category")
    return figure_html(figure, keys[0], keys[1])


def _scatter(cells: Sequence[Cell], values: Sequence[np.ndarray], key: str, label: str) -> str:
    """Every run over a setting, in a color for each of what else there is."""
    import plotly.graph_objects as go

    figure, lowest, highest = go.Figure(), math.inf, -math.inf
    groups = dict.fromkeys(_others(c, [key]) for c in cells)
    for k, name in enumerate(groups):
        mine = [(c, v) for c, v in zip(cells, values, strict=True) if _others(c, [key]) == name]
        x = [float(c.varied[key]) for c, v in mine for _ in v]
        y = [value if math.isfinite(value) else None for _, v in mine for value in v.tolist()]
        seeds = [f"seed {s}" for c, _ in mine for s in c.seeds]
        color = COLORS[k % len(COLORS)]
        figure.add_scatter(
            x=x, y=y, mode="markers", text=seeds, name=html.escape(name), marker={"color": color, "size": 6}
        )
        lowest, highest = min(lowest, *x), max(highest, *x)
    if lowest > 0.0 and highest > 50.0 * lowest:
        figure.update_xaxes(type="log")
    return figure_html(figure, key, label, legend=len(groups) > 1)
