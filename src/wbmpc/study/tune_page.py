"""The page of a search: its trials over time and over every setting, and the table of the best."""

from __future__ import annotations

import html
from collections.abc import Sequence
from itertools import combinations
from typing import Any

from wbmpc.report import document, table
from wbmpc.study.definition import Tuning
from wbmpc.study.page import figure_html
from wbmpc.units import number

#: Trials of the table, at most: the best ones.
SHOWN = 50
Trials = Sequence[dict[str, Any]]


def tune_page(title: str, tune: Tuning, trials: Trials, front: Trials, reported: bool) -> str:
    """One HTML page that needs no network. ``trials``: as :meth:`wbmpc.study.tuning.Tuner.trials` gives them; ``front``: those of
    them that none beats in every objective, the one that is kept first (of one objective it alone; empty: none keeps the constraints)."""
    names = objectives(tune)
    whole = [t for t in trials if not t["pruned"]]
    feasible = sum(t["feasible"] for t in whole)
    link = ' <a href="report/index.html">Before and after on the reporting seeds.</a>' if reported else ""
    limits = ", ".join(f"{html.escape(name)} ≤ {number(most)}" for name, most in tune.constraints.items())
    done = "" if tune.allow_failures else f"{' and ' * bool(limits)}all runs complete"
    about = f"{len(trials)} trials on the seeds {', '.join(map(str, tune.seeds[:20]))}{', …' * (len(tune.seeds) > 20)}, which are not reported. "
    about += f"{len(trials) - len(whole)} pruned, {feasible} keep the constraints{f' ({limits}{done})' * bool(limits or done)}."
    about += " Values are in SI units; gray points break constraints, and a double click shows those outside of a plot."
    kind, several = "" if front else "bad", len(names) > 1
    # of several objectives there is no best over the trials
    plots = [] if several else [("Trials", _history(whole, names[0]))]
    plots += [
        (f"{b} against {a}", _against(whole, front, names, (i, j)))
        for (i, a), (j, b) in combinations(enumerate(names), 2)
    ]
    keys = list(whole[0]["settings"]) if whole else []
    plots += [
        (
            f"{name} over {key}" if several else key,
            _slice(whole, key, name, getattr(tune.search.get(key), "log", False), place),
        )
        for key in keys
        for place, name in enumerate(names)
    ]
    cards = (
        "".join(f'<div class="card"><h3>{html.escape(n)}</h3>{figure}</div>' for n, figure in plots) if whole else ""
    )
    others = sorted(whole, key=lambda t: (not t["feasible"], t["values"]))
    heads = ["trial", *map(html.escape, names), "", *map(html.escape, keys)]
    listed = (
        f"<h2>The front: {len(front)} trials</h2>{_table(heads, front)}<h2>Trials by {html.escape(names[0])}</h2>"
        if several
        else f"<h2>The best {len(others[:SHOWN])}</h2>"
    )
    body = f"""<h1>{html.escape(title)}</h1><p class="sub">{about}{link}</p><div class="card summary {kind}">{_found(front, names)}</div>
<h2>Trials</h2><div class="plots">{cards}</div>
{listed}{_table(heads, others)}"""

    return document(title, body)


def _found(front: Trials, names: Sequence[str]) -> str:
    """What came out of it."""
    if not front:
        return "No trial keeps the constraints."
    what = html.escape(" and ".join(names))
    kept = f"trial {front[0]['trial']}, {what}: {', '.join(number(v) for v in front[0]['values'])}."
    if len(names) == 1:
        return f"Best: {kept}"
    return f"{len(front)} trials that none beats in every objective. Kept, for the least sum of the objectives: {kept}"


def _table(heads: list[str], trials: Trials) -> str:
    """The first :data:`SHOWN` of them."""
    rows = [
        [str(t["trial"]), *map(number, t["values"]), "" if t["feasible"] else "breaks constraints",
         *(html.escape(_text(v)) for v in t["settings"].values())]
        for t in trials[:SHOWN]
    ]  # fmt: skip
    return table(heads, rows, {k for k, head in enumerate(heads) if head})


def objectives(tune: Tuning) -> list[str]:
    """What the values of a trial are: sums of metrics, or a metric each."""
    names = [f"{term.metric}, as large as possible" if term.maximize else term.metric for term in tune.minimize]
    return names if tune.pareto else [" + ".join(names)]


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
    return _framed(figure, trials, "trial", name)


def _slice(trials: Trials, key: str, name: str, log: bool, place: int) -> str:
    import plotly.graph_objects as go

    x = [t["settings"][key] for t in trials]
    figure = go.Figure(_points(trials, [str(v) if isinstance(v, list | dict | bool) else v for v in x], place))
    if log:
        figure.update_xaxes(type="log")
    return _framed(figure, trials, key, name, place)


def _against(trials: Trials, front: Trials, names: Sequence[str], places: tuple[int, int]) -> str:
    """An objective over another, and the front."""
    import plotly.graph_objects as go

    i, j = places
    figure = go.Figure(_points(trials, [t["values"][i] for t in trials], j))
    edge = sorted(front, key=lambda t: t["values"][i])
    figure.add_scatter(
        x=[t["values"][i] for t in edge], y=[t["values"][j] for t in edge], text=[f"trial {t['trial']}" for t in edge],
        mode="lines+markers" if len(names) == 2 else "markers", line={"color": "#d1495b", "width": 1}, marker={"size": 8},
    )  # fmt: skip
    return figure_html(figure, names[i], names[j])


def _framed(figure: Any, trials: Trials, x: str, y: str, place: int = 0) -> str:
    """With the values that keep the constraints in the picture: one that breaks them counts as its limit, which may be far away."""
    kept = [t["values"][place] for t in trials if t["feasible"]]
    if kept:
        edge = 0.08 * (max(kept) - min(kept)) or 0.08 * abs(kept[0]) or 1.0
        figure.update_yaxes(range=[min(kept) - edge, max(kept) + edge])
    return figure_html(figure, x, y)


def _points(trials: Trials, x: list[Any], place: int = 0) -> Any:
    import plotly.graph_objects as go

    colors = ["#1f5fa8" if t["feasible"] else "#b9c2cb" for t in trials]
    return go.Scatter(
        x=x, y=[t["values"][place] for t in trials], mode="markers", marker={"color": colors, "size": 5},
        text=[f"trial {t['trial']}" for t in trials],
    )  # fmt: skip
