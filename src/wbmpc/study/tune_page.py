"""The page of a search: its trials over time and over every setting, and the table of the best."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

from wbmpc.report import document, table
from wbmpc.study.definition import Tuning
from wbmpc.study.page import figure_html
from wbmpc.units import number

#: Trials of the table, at most: the best ones.
SHOWN = 50
Trials = Sequence[dict[str, Any]]


def tune_page(title: str, tune: Tuning, trials: Trials, best: dict[str, Any] | None, reported: bool) -> str:
    """One HTML page that needs no network. ``trials``: as :meth:`wbmpc.study.tuning.Tuner.trials` gives them."""
    names = objectives(tune)
    whole = [t for t in trials if not t["pruned"]]
    feasible = sum(t["feasible"] for t in whole)
    link = ' <a href="report/index.html">Before and after on the reporting seeds.</a>' if reported else ""
    about = f"{len(trials)} trials, {len(trials) - len(whole)} pruned, {feasible} keep the constraints."
    found = (
        "No trial keeps the constraints."
        if best is None
        else f"Best: trial {best['trial']}, {html.escape(' and '.join(names))}: {_values(best)}."
    )
    kind = "bad" if best is None else ""
    plots = [("Trials", _history(whole, names[0]))]
    if len(names) > 1:
        plots.append((f"{names[1]} against {names[0]}", _against(whole, names)))
    keys = list(whole[0]["settings"]) if whole else []
    plots += [(key, _slice(whole, key, names[0], getattr(tune.search.get(key), "log", False))) for key in keys]
    cards = (
        "".join(f'<div class="card"><h3>{html.escape(n)}</h3>{figure}</div>' for n, figure in plots) if whole else ""
    )
    rows = [
        [str(t["trial"]), *map(number, t["values"]), "" if t["feasible"] else "breaks constraints",
         *(html.escape(_text(v)) for v in t["settings"].values())]
        for t in sorted(whole, key=lambda t: (not t["feasible"], t["values"]))[:SHOWN]
    ]  # fmt: skip
    numeric = {k for k in range(2 + len(names) + len(keys)) if k != 1 + len(names)}
    body = f"""<h1>{html.escape(title)}</h1><p class="sub">{about}{link}</p><div class="card summary {kind}">{found}</div>
<h2>Trials</h2><div class="plots">{cards}</div>
<h2>The best {len(rows)}</h2>{table(["trial", *map(html.escape, names), "", *map(html.escape, keys)], rows, numeric)}"""

    return document(title, body)


def objectives(tune: Tuning) -> list[str]:
    """What the values of a trial are: sums of metrics, or a metric each."""
    names = [f"{term.metric}, as large as possible" if term.maximize else term.metric for term in tune.minimize]
    return names if tune.pareto else [" + ".join(names)]


def _values(trial: dict[str, Any]) -> str:
    return ", ".join(number(v) for v in trial["values"])


def _text(value: Any) -> str:
    return number(value) if isinstance(value, float) else str(value)


def _history(trials: Trials, name: str) -> str:
    """The first objective of every trial, and the best so far."""
    import plotly.graph_objects as go

    best, line = float("inf"), []
    for t in trials:
        best = min(best, t["values"][0]) if t["feasible"] else best
        line.append(best if best < float("inf") else None)
    figure = go.Figure(_points(trials, [t["trial"] for t in trials]))
    figure.add_scatter(x=[t["trial"] for t in trials], y=line, mode="lines", line={"color": "#d1495b", "shape": "hv"})
    return figure_html(figure, "trial", name)


def _slice(trials: Trials, key: str, name: str, log: bool) -> str:
    """The first objective over a setting."""
    import plotly.graph_objects as go

    x = [t["settings"][key] for t in trials]
    figure = go.Figure(_points(trials, [str(v) if isinstance(v, list | dict | bool) else v for v in x]))
    if log:
        figure.update_xaxes(type="log")
    return figure_html(figure, key, name)


def _against(trials: Trials, names: Sequence[str]) -> str:
    """The second objective over the first: the best are at the lower left edge."""
    import plotly.graph_objects as go

    figure = go.Figure(_points(trials, [t["values"][0] for t in trials], 1))
    return figure_html(figure, names[0], names[1])


def _points(trials: Trials, x: list[Any], place: int = 0) -> Any:
    import plotly.graph_objects as go

    colors = ["#1f5fa8" if t["feasible"] else "#b9c2cb" for t in trials]
    return go.Scatter(
        x=x, y=[t["values"][place] for t in trials], mode="markers", marker={"color": colors, "size": 5},
        text=[f"trial {t['trial']}" for t in trials],
    )  # fmt: skip
