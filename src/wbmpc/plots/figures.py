"""Plots as Plotly draws them: colors by meaning, limits, thinning."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Series:
    """One line of a plot: its ``name``, ``x`` (n) and ``y`` (n) in the units of the plot's labels, whether it is ``dashed``.

    Lines of the same ``color`` (a number) look alike; left out: each has its own, the same in all plots of a page, and "NAME, reference",
    "NAME, planned" and the like have that of "NAME". ``signal``: what the line is of, where that is not in its name: lines of one signal
    share an entry of the legend. ``limits``: lowest and highest value that ``y`` may have (infinite: none), drawn dotted.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    dashed: bool = False
    color: int | None = None
    limits: tuple[float, float] | None = None
    signal: str = ""


@dataclass(frozen=True)
class Plot:
    """A plot of the report: its ``title``, the labels of its axes with their units (``x_label``, ``y_label``) and its lines (``series``);
    ``equal_axes``: a length is the same along both axes. Plots over "time [s]" share zoom and cursor."""

    title: str
    x_label: str
    y_label: str
    series: list[Series]
    equal_axes: bool = False


@dataclass(frozen=True)
class Drawing:
    """A picture of the report that is no plot, as SVG text."""

    title: str
    svg: str
    equal_axes = False


#: More points than this per line are thinned out (min and max of each bin are kept).
MAX_POINTS = 1500
#: Width of a legend in the narrowest card [pixels], of an entry's mark, and of a letter, about.
_LEGEND, _MARK, _LETTER = 360, 45, 6.3
#: Of lines that mean nothing else.
COLORS = ["#1f5fa8", "#d1495b", "#2a9d6f", "#8a5fbf", "#c98a1b", "#4aa3c7", "#7a7a7a", "#b0467f"]
#: What a line's name says in every plot, by its color; and what may stand behind a signal's name, whose color it then has.
_MEANINGS = {"world": 0, "true": 0, "estimated frame": 1, "odometry": 1, "reference": 6, "period": 6}
_KINDS = ("reference", "commanded", "planned", "estimated", "measured", "world", "estimated frame")
_GRID, _GRAY = "rgba(128, 140, 152, 0.25)", "#7b8894"
#: Limits are in the picture at first if it then is at most so many times as high as without them.
_FAR = 6.0


def _thin(x: np.ndarray, y: np.ndarray, path: bool) -> tuple[np.ndarray, np.ndarray]:
    """At most MAX_POINTS points: the extremes of every bin of a signal over time, or every n-th point of a path."""
    if x.size <= MAX_POINTS:
        return x, y
    if path:
        index = np.linspace(0, x.size - 1, MAX_POINTS).round().astype(int)
        return x[index], y[index]
    low, high = np.nan_to_num(y, nan=np.inf), np.nan_to_num(y, nan=-np.inf)
    keep = {0, x.size - 1}
    for part in np.array_split(np.arange(x.size), MAX_POINTS // 2 - 1):
        keep |= {int(part[np.argmin(low[part])]), int(part[np.argmax(high[part])])}
    index = np.array(sorted(keep))
    return x[index], y[index]


def _short(values: np.ndarray) -> list[float | None]:
    return [float(f"{v:.6g}") if math.isfinite(v) else None for v in values]


def template() -> dict[str, Any]:
    """Plots on the page's own ground, with inks that are seen on light and dark."""
    axis = {"gridcolor": _GRID, "zerolinecolor": _GRID, "linecolor": _GRID, "automargin": True, "hoverformat": ".4~g"}
    layout = {"xaxis": axis, "yaxis": axis, "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)"}
    layout["modebar"] = {"bgcolor": "rgba(0,0,0,0)", "color": "#9aa7b3", "activecolor": "#5c6b7a"}
    layout["hovermode"] = "x unified"
    return {"layout": {**layout, "font": {"color": _GRAY}}}


def _signal(line: Series) -> str:
    """What a line is of: "x" of "x, reference"."""
    if line.signal:
        return line.signal
    signal, _, kind = line.name.rpartition(", ")
    return signal if signal and kind in _KINDS else line.name


def palette(plots: Iterable[Plot | Drawing]) -> dict[str, int]:
    """A color, as a number, for each signal of a page: the same in all plots, other than those of its neighbors while there are enough."""
    chosen, beside = dict[str, int](), dict[str, set[str]]()
    for plot in plots:
        if isinstance(plot, Plot):
            keys = _keys(plot.series)
            chosen |= {k: line.color for k, line in zip(keys, plot.series, strict=True) if line.color is not None}
            for key in keys:
                beside.setdefault(key, set()).update(keys)
    chosen |= {key: _MEANINGS[key] for key in beside if key in _MEANINGS and key not in chosen}
    for key, neighbors in beside.items():
        if key not in chosen:
            taken = [chosen[k] % len(COLORS) for k in neighbors if k in chosen]
            chosen[key] = min(range(len(COLORS)), key=taken.count)
    return chosen


def _keys(lines: Sequence[Series]) -> list[str]:
    """By what lines of a plot have their colors: "x" of "base.x, reference", unless another part of it has an "x" too."""
    signals = [_signal(line) for line in lines]
    short = {signal: signal.rpartition(".")[2] or signal for signal in signals}
    return signals if len(set(short.values())) < len(short) else [short[signal] for signal in signals]


def _colors(lines: Sequence[Series], chosen: Mapping[str, int]) -> list[str]:
    """A color for each line, of those ``chosen`` for a page."""
    keys = _keys(lines)
    own = {key: line.color for key, line in zip(keys, lines, strict=True) if line.color is not None}
    return [
        COLORS[(own.get(key, chosen[key]) if line.color is None else line.color) % len(COLORS)]
        for key, line in zip(keys, lines, strict=True)
    ]


def figure(plot: Plot | Drawing, colors: Mapping[str, int] | None = None) -> str:
    """A plot as HTML that the page's plotting library draws, with a line about its dashed and dotted lines; a drawing as it is. ``colors``:
    the page's :func:`palette`."""
    if isinstance(plot, Drawing):
        return plot.svg
    from plotly.io import to_html

    options = {"displaylogo": False, "responsive": True, "displayModeBar": "hover"}
    # plain dictionaries, not checked: checking takes ten times as long as writing
    drawn = str(
        to_html(plotly_figure(plot, colors), full_html=False, include_plotlyjs=False, config=options, validate=False)
    )
    about = hint(plot)
    return f'<p class="hint">{html.escape(about)}</p>{drawn}' if about else drawn


def hint(plot: Plot) -> str:
    """What dashed and dotted lines of a plot mean where its legend does not say it."""
    behind = [line.name.rpartition(", ")[2] for line in plot.series if line.dashed and _signal(line) != line.name]
    parts = [f"dashed: {' and '.join(dict.fromkeys(behind))}"] if behind else []
    bounds = sorted({b for line in plot.series for b in _finite(line.limits)})
    if bounds:
        span = _range(plot)
        outside = [b for b in bounds if span and not span[0] <= b <= span[1]]
        parts.append(f"dotted: limits{_further(outside, plot.y_label) if outside else ''}")
    return "; ".join(parts)


def _further(outside: Sequence[float], label: str) -> str:
    unit = label.rpartition("[")[2].rstrip("]") if "[" in label else ""
    both = min(outside) < 0.0 < max(outside)
    nearest = f" ({abs(min(outside, key=abs)) if both else min(outside, key=abs):.4g} {unit}".rstrip()
    if len(outside) == 1:
        return f"{nearest} is outside of the picture: a double click shows it)"
    return f"{nearest} and further are outside of the picture: a double click shows them)"


def _finite(limits: tuple[float, float] | None) -> list[float]:
    return [] if limits is None else [float(b) for b in limits if math.isfinite(b)]


def plotly_figure(plot: Plot, chosen: Mapping[str, int] | None = None) -> dict[str, Any]:
    """A plot as Plotly's ``data`` and ``layout``; in the colors ``chosen`` for a page, or for itself."""
    data: list[dict[str, Any]] = []
    shown: set[str] = set()
    colors = _colors(plot.series, palette([plot]) if chosen is None else chosen)
    for line, color in zip(plot.series, colors, strict=True):
        x, y = _thin(np.asarray(line.x, float), np.asarray(line.y, float), plot.equal_axes)
        style = {"width": 1.6, "color": color, "dash": "dash" if line.dashed else "solid"}
        # plain lists: browsers draw them the same, and the page stays readable
        row = {"type": "scatter", "x": _short(x), "y": _short(y), "name": html.escape(line.name)}
        signal = _signal(line)
        data.append(
            {
                **row, "mode": "lines", "line": style, "legendgroup": html.escape(signal),
                "showlegend": signal not in shown,
            }
        )  # fmt: skip
        shown.add(signal)
    return {"data": data + list(_limit_lines(plot, colors)), "layout": _layout(plot)}


def _limit_lines(plot: Plot, colors: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Dotted lines: one for each limit, in its line's color, or in gray where several lines have it."""
    x = [np.asarray(line.x, float) for line in plot.series]
    ends = [float(f(v[np.isfinite(v)])) for f in (np.min, np.max) if (v := np.concatenate(x or [np.zeros(0)])).size]
    owners: dict[float, list[int]] = {}
    for k, line in enumerate(plot.series):
        for bound in _finite(line.limits) if ends else ():
            owners.setdefault(bound, []).append(k)
    for bound, lines in owners.items():
        signals = {_signal(plot.series[k]) for k in lines}
        style = {"width": 1.2, "color": colors[lines[0]] if len(signals) == 1 else _GRAY, "dash": "dot"}
        group = {"legendgroup": html.escape(signals.pop())} if len(signals) == 1 else {}
        yield {
            "type": "scatter", "x": ends, "y": [bound, bound], "name": "limit", "mode": "lines", "line": style,
            "showlegend": False, "hoverinfo": "skip", **group,
        }  # fmt: skip


def _range(plot: Plot) -> list[float] | None:
    """The heights that are shown at first, of a plot with limits: signals, and limits that are not far from them."""
    values = np.concatenate([np.asarray(line.y, float) for line in plot.series] or [np.zeros(0)])
    values, bounds = values[np.isfinite(values)], [b for line in plot.series for b in _finite(line.limits)]
    if not (values.size and bounds):
        return None
    low, high = float(values.min()), float(values.max())
    span = max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-9)
    for bound in sorted(bounds, key=lambda b: max(low - b, b - high)):
        if max(high, bound) - min(low, bound) <= _FAR * span:
            low, high = min(low, bound), max(high, bound)
    edge = 0.06 * max(high - low, span)
    return [low - edge, high + edge]


def _layout(plot: Plot) -> dict[str, Any]:
    axis = lambda label: {"title": {"text": html.escape(label)}}
    rows = _legend_rows(list(dict.fromkeys(_signal(line) for line in plot.series)))
    layout: dict[str, Any] = {
        "xaxis": axis(plot.x_label), "yaxis": axis(plot.y_label),
        "template": template(), "height": 320 + 20 * rows,
        "margin": {"l": 60, "r": 16, "t": 36, "b": 68 + 20 * rows},
        # from the lower edge: below the axis' title, however high the plot is
        "legend": {"orientation": "h", "yref": "container", "y": 0, "yanchor": "bottom"},
        "font": {"family": "system-ui, sans-serif", "size": 12},
    }  # fmt: skip
    if plot.equal_axes:
        layout["hovermode"] = "closest"
        layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
    elif (span := _range(plot)) is not None:
        layout["yaxis"]["range"] = span
    return layout


def _legend_rows(names: list[str]) -> int:
    """Rows of a legend, whose entries are all as wide as the widest: with less room it would be drawn over the axis' title."""
    longest = max(map(len, names), default=0)
    in_a_row = max(int(_LEGEND // (_MARK + _LETTER * longest)), 1)
    return max(math.ceil(len(names) / in_a_row), 1)
