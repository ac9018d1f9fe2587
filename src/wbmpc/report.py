"""A run on disk: metrics.json, log.npz and report.html, one self-contained page."""

from __future__ import annotations

import html
import json
import math
import platform
import subprocess
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc import __version__
from wbmpc.errors import NotWritten
from wbmpc.output_file import write_text
from wbmpc.result import Drawing, Metric, MpcStatistics, Plot, RunResult, Series
from wbmpc.units import Scale, number, scale

#: Name of the recording in a run's directory.
RECORDING = "run.mcap"
#: All files of a run.
RUN_FILES = ("metrics.json", "log.npz", "report.html", RECORDING, "run-1.mcap")
#: More points than this per line are thinned out (min and max of each bin are kept).
MAX_POINTS = 1500
#: Width of a legend in the narrowest card [pixels], of an entry's mark, and of a letter, about.
_LEGEND, _MARK, _LETTER = 360, 45, 6.3
_COLOURS = ["#1f5fa8", "#d1495b", "#2a9d6f", "#8a5fbf", "#c98a1b", "#4aa3c7", "#7a7a7a", "#b0467f"]
#: What a line's name says in every plot, by its colour; and what may stand behind a signal's name, whose colour it then has.
_MEANINGS = {"world": 0, "true": 0, "estimated frame": 1, "odometry": 1, "reference": 6, "period": 6}
_KINDS = ("reference", "commanded", "planned", "estimated", "measured", "world", "estimated frame")
_GRID = "rgba(128, 140, 152, 0.25)"
_STYLE = """
:root { color-scheme: light dark; --ink: #1d2733; --soft: #5c6b7a; --line: #dfe5ea; --page: #f5f7f9; --card: #fff;
  --good: #1d7a4f; --fair: #b7791f; --bad: #b3362b; --link: #1f5fa8; }
@media (prefers-color-scheme: dark) { :root { --ink: #dde4ea; --soft: #94a3b2; --line: #33404d; --page: #12181f; --card: #1b232c;
  --good: #4fbf8b; --fair: #d9a441; --bad: #ef7b6f; --link: #7db4ee; }
  .plots .card:has(> svg) { background: #fff; color: #1d2733; } }
* { box-sizing: border-box; } a { color: var(--link); } p.sub + .card { margin-top: 10px; }
body { margin: 0; background: var(--page); color: var(--ink); font: 16px/1.5 system-ui, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1060px; margin: 0 auto; padding: 32px 20px 64px; }
h1 { font-size: 30px; line-height: 1.2; margin: 0; } h2 { font-size: 20px; margin: 40px 0 12px; }
.sub { color: var(--soft); margin: 8px 0 0; font-size: 15px; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 8px; }
.summary { margin: 20px 0; padding: 12px 18px; border-left: 5px solid var(--good); }
.summary.fair { border-left-color: var(--fair); } .summary.bad { border-left-color: var(--bad); }
.scroll { overflow-x: auto; } table { border-collapse: collapse; width: 100%; }
th, td { text-align: left; padding: 7px 12px; white-space: nowrap; } tr + tr > * { border-top: 1px solid var(--line); }
th { color: var(--soft); font-weight: 600; } .n { text-align: right; font-variant-numeric: tabular-nums; }
.met { color: var(--good); } .missed { color: var(--bad); font-weight: 600; }
.plots { display: grid; grid-auto-flow: dense; grid-template-columns: repeat(auto-fill, minmax(min(440px, 100%), 1fr)); gap: 16px; }
.plots > div { padding: 8px; min-width: 0; }
h3 { font-size: 16px; font-weight: 600; margin: 6px 8px 0; }
.plots > div > svg { display: block; max-width: 100%; height: auto; margin: 0 auto; }
.plots > div.wide { grid-column: 1 / -1; }
ul { margin: 0; padding: 12px 18px 12px 36px; } details { padding: 10px 16px; margin-bottom: 12px; }
summary { cursor: pointer; } pre { overflow-x: auto; font-size: 13px; margin: 8px 0 0; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 2px 16px; margin: 8px 0 0; font-size: 14px; }
dt { color: var(--soft); } dd { margin: 0; }
@media print { body { background: #fff; } .plots > div { break-inside: avoid; } }
"""


def _plain(value: Any) -> Any:
    """What JSON can hold: a figure that is not finite is null."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_json(result: RunResult, files: dict[str, str]) -> dict[str, Any]:
    """The object that ``--json`` prints. A figure that is not finite is null."""
    return {
        "experiment": result.experiment,
        "seed": result.seed,
        "outcome": result.outcome,
        "completed": result.completed,
        "reason": result.reason,
        "metrics": {k: {"value": _plain(m.value), "unit": m.unit} for k, m in result.metrics.items()},
        "mpc": None if result.mpc is None else _mpc(result.mpc),
        "files": files,
    }


def _mpc(mpc: MpcStatistics) -> dict[str, Any]:
    return {
        "rate_hz": mpc.rate_hz,
        "solve_ms": {k: _plain(round(v, 4)) for k, v in mpc.solve_ms.items()},
        "deadline_misses": mpc.deadline_misses,
        "solves": mpc.solves,
        "failures": mpc.failures,
        "no_step": mpc.no_step,
        "failed_share": round(mpc.failed_share, 6),
    }


def metric_cells(result: RunResult, name: str) -> list[str]:
    """A metric's unit, figure, paper's figure and goal as cells of a table, all in the unit that reads best."""
    m = result.metrics[name]
    shown = scale(m.unit, m.value, m.paper, m.goal, m.least)
    # a run that the user ended may have had no time for a figure
    missing = result.interrupted and not math.isfinite(m.value)
    return [shown.unit, "not measured" if missing else shown.text(m.value), shown.text(m.paper), goal_text(m, shown)]


def goal_text(metric: Metric, shown: Scale) -> str:
    """The goal as a cell of a table: a largest value, a range, or a smallest value."""
    goal, least = shown.text(metric.goal), shown.text(metric.least)
    if not least:
        return f"≤ {goal}" if goal else ""
    return f"{least} to {goal}" if goal else f"≥ {least}"


def versions() -> dict[str, str]:
    """What ran: versions of this library and of what it stands on, and the processor."""
    out = {
        "wbmpc": __version__,
        "commit": commit(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cpu": _processor(),
    }
    for name in ("casadi", "mujoco", "llvmlite", "numpy", "scipy"):
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "unknown"
    return out


@cache
def commit() -> str:
    """The commit of this checkout, short, with ``+`` behind it if files differ from it; ``""`` for an installed package.

    It is looked up once per process: documents name the commit that a figure is of.
    """
    source = Path(__file__).parent
    try:
        revision, changed = (
            subprocess.run(
                ["git", "--no-optional-locks", "-C", str(source), *words],
                capture_output=True,
                text=True,
                check=True,
                timeout=10,
            ).stdout.strip()
            for words in (("rev-parse", "--short=10", "HEAD"), ("status", "--porcelain", "--untracked-files=no", "."))
        )
        tracked = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(source), "ls-files", "--error-unmatch", Path(__file__).name],
            capture_output=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return "" if tracked.returncode else revision + "+" * bool(changed)


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor()
    )


def about_run(experiment: str, seed: int, settings: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What a recording says about its run before it begins: tables by name."""
    started = datetime.now(UTC).isoformat(timespec="seconds")
    run = {"experiment": experiment, "seed": seed, "started": started, "settings": json.dumps(_plain(settings))}
    return {"run": run, "versions": versions()}


def outcome(result: RunResult) -> dict[str, Any]:
    """What a recording says at its end."""
    figures = {name: m.value for name, m in result.metrics.items()}
    about = {"outcome": result.outcome, "completed": str(result.completed).lower(), "reason": result.reason}
    return {**about, "metrics": json.dumps(_plain(figures))}


def write_run(result: RunResult, directory: Path) -> dict[str, str]:
    """Write all files of a run into ``directory`` (made if missing); returns their paths by kind.

    metrics.json comes last and as a whole: where it is, all that it names is there. Raises :class:`NotWritten` naming a file that
    cannot be written; metrics.json is then in a directory for temporary files, or the message says what would be in it.
    """
    directory.mkdir(parents=True, exist_ok=True)
    files = {
        n: str(directory / f) for n, f in (("metrics", "metrics.json"), ("log", "log.npz"), ("report", "report.html"))
    }
    if (directory / RECORDING).exists():
        files["recording"] = str(directory / RECORDING)
    targets = {
        n: {"paper": _plain(m.paper), "goal": _plain(m.goal), "least": _plain(m.least)}
        for n, m in result.metrics.items()
    }
    more = {
        "targets": targets,
        "settings": _plain(result.settings),
        "idealisations": result.idealisations,
        "faults": result.faults,
        "versions": versions(),
        "command": result.command,
        "wall_time": _plain(result.wall_time),
    }
    text = json.dumps({**to_json(result, files), **more}, indent=2, allow_nan=False) + "\n"
    try:
        result.log.save(Path(files["log"]))
        write_text(Path(files["report"]), page(result))
        write_text(Path(files["metrics"]), text)
    except NotWritten as error:
        raise NotWritten(f"{error}; {_elsewhere(result, text)}") from error
    return files


def _elsewhere(result: RunResult, text: str) -> str:
    """Put the figures where there may be room; says where they are, or what they are."""
    try:
        path = Path(tempfile.mkdtemp(prefix=f"wbmpc-{result.experiment}-")) / "metrics.json"
        path.write_text(text)
        return f"the figures of the run are in {path}"
    except OSError:
        figures = {name: _plain(m.value) for name, m in result.metrics.items()}
        return f"the figures of the run are {json.dumps(figures)}"


# ---------------------------------------------------------------------- the page
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
    axis = {"gridcolor": _GRID, "zerolinecolor": _GRID, "linecolor": _GRID, "automargin": True}
    layout = {"xaxis": axis, "yaxis": axis, "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)"}
    layout["modebar"] = {"bgcolor": "rgba(0,0,0,0)", "color": "#9aa7b3", "activecolor": "#5c6b7a"}
    layout["hovermode"] = "x unified"
    return {"layout": {**layout, "font": {"color": "#7b8894"}}}


def _colours(lines: Sequence[Series]) -> list[str]:
    """A colour for each line: what a name means keeps its colour in all plots, and "x, reference" has that of "x"."""
    kinds = [line.name.rpartition(", ") for line in lines]
    signals = [
        signal if signal and kind in _KINDS else line.name for line, (signal, _, kind) in zip(lines, kinds, strict=True)
    ]
    free = (c for c in range(len(_COLOURS)) if c not in _MEANINGS.values() or not set(signals) & set(_MEANINGS))
    chosen = {name: line.colour for name, line in zip(signals, lines, strict=True) if line.colour is not None}
    for name in dict.fromkeys(signals):
        if name not in chosen:
            chosen[name] = _MEANINGS[name] if name in _MEANINGS else next(free, len(chosen))
    return [
        _COLOURS[(chosen[name] if line.colour is None else line.colour) % len(_COLOURS)]
        for name, line in zip(signals, lines, strict=True)
    ]


def _figure(plot: Plot | Drawing) -> str:
    if isinstance(plot, Drawing):
        return plot.svg
    from plotly.io import to_html

    options = {"displaylogo": False, "responsive": True, "displayModeBar": "hover"}
    # plain dictionaries, not checked: checking takes ten times as long as writing
    return str(to_html(plotly_figure(plot), full_html=False, include_plotlyjs=False, config=options, validate=False))


def plotly_figure(plot: Plot) -> dict[str, Any]:
    """A plot as Plotly's ``data`` and ``layout``."""
    data = []
    for line, colour in zip(plot.series, _colours(plot.series), strict=True):
        x, y = _thin(np.asarray(line.x, float), np.asarray(line.y, float), plot.equal_axes)
        style = {"width": 1.6, "color": colour, "dash": "dash" if line.dashed else "solid"}
        # plain lists: browsers draw them the same, and the page stays readable
        row = {"type": "scatter", "x": _short(x), "y": _short(y), "name": html.escape(line.name)}
        data.append({**row, "mode": "lines", "line": style})
    return {"data": data, "layout": _layout(plot)}


def _layout(plot: Plot) -> dict[str, Any]:
    axis = lambda label: {"title": {"text": html.escape(label)}}
    layout: dict[str, Any] = {
        "xaxis": axis(plot.x_label), "yaxis": axis(plot.y_label),
        "template": template(), "height": 320 + 20 * _legend_rows([line.name for line in plot.series]),
        "margin": {"l": 60, "r": 16, "t": 36, "b": 88},
        "legend": {"orientation": "h", "y": -0.25, "yanchor": "top"},
        "font": {"family": "system-ui, sans-serif", "size": 12},
    }  # fmt: skip
    if plot.equal_axes:
        layout["hovermode"] = "closest"
        layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": 1}
    return layout


def _legend_rows(names: list[str]) -> int:
    """Rows of a legend, whose entries are all as wide as the widest: with less room it would be drawn over the axis' title."""
    longest = max(map(len, names), default=0)
    in_a_row = max(int(_LEGEND // (_MARK + _LETTER * longest)), 1)
    return max(math.ceil(len(names) / in_a_row), 1)


def table(header: list[str], rows: list[list[str]], numeric: set[int]) -> str:
    """A table of ready-made cells; the columns ``numeric`` are set right."""

    def line(tag: str, cells: list[str]) -> str:
        return (
            "<tr>"
            + "".join(f"<{tag}{' class=n' if i in numeric else ''}>{c}</{tag}>" for i, c in enumerate(cells))
            + "</tr>"
        )

    return f'<div class="card scroll"><table>{line("th", header)}{"".join(line("td", r) for r in rows)}</table></div>'


def _metric_rows(result: RunResult) -> list[list[str]]:
    verdicts = {True: '<span class="met">reached</span>', False: '<span class="missed">missed</span>', None: ""}
    return [
        [html.escape(name), *map(html.escape, metric_cells(result, name)), verdicts[result.reached(name)]]
        for name in result.metrics
    ]


def goal_notes(result: RunResult) -> list[str]:
    """What a reader must know about this run and the goals that it misses."""
    missed = [n for n, m in result.metrics.items() if m.met is False and result.reached(n) is False]
    found = [f"found in this run: {fault}" for fault in result.faults]
    return [*found, *(f"{name}: {note}" for name in missed if (note := result.metrics[name].goal_note))]


def _summary(result: RunResult) -> str:
    judged = {name: met for name in result.metrics if (met := result.reached(name)) is not None}
    missed = [html.escape(name) for name, met in judged.items() if not met]
    ended = f"The run did not complete: {html.escape(result.reason)} (outcome: {result.outcome})"
    text = "The run completed" if result.completed else ended
    if judged:
        text += f"; {len(judged) - len(missed)} of {len(judged)} goals reached"
    if missed:
        text += f", missed: {', '.join(missed)}"
    kind = "bad" if not result.completed else "fair" if missed else ""
    return f'<div class="card summary {kind}">{text}.</div>'


def _solve_times(mpc: MpcStatistics | None) -> str:
    if mpc is None:
        return ""
    row = [
        f"{mpc.rate_hz:g} Hz",
        f"{number(1e3 / mpc.rate_hz)} ms",
        *(f"{number(mpc.solve_ms[k])} ms" for k in ("median", "p95", "max")),
    ]
    header = ["rate", "period", "median solve", "95 % below", "longest", "deadlines missed"]
    counts = [mpc.deadline_misses, mpc.solves, mpc.failures, mpc.no_step]
    header += ["solves", "failed", "without a step"]
    rows = table(header, [[*row, *map(str, counts)]], set(range(len(header))))
    return f"<h2>Model predictive control</h2>{rows}"


def page(result: RunResult) -> str:
    """The report as one HTML page that needs no network."""
    notes = "".join(f'<p class="sub">{html.escape(note)}.</p>' for note in goal_notes(result))
    ideal = "".join(f"<li>{html.escape(line)}</li>" for line in result.idealisations)
    settings = html.escape(json.dumps(_plain(result.settings), indent=2))
    installed = "".join(f"<dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd>" for k, v in versions().items())
    metrics = table(["metric", "unit", "this run", "paper", "goal", ""], _metric_rows(result), {2, 3, 4})
    return document(
        f"{result.experiment}, seed {result.seed}",
        f"""<h1>{html.escape(result.experiment)}</h1>
<p class="sub">Seed {result.seed}, simulated in MuJoCo; the plant differs from the planner's model as the settings say.</p>
{_summary(result)}
<h2>Figures</h2>{metrics}
<p class="sub">The paper's figures are of the real robot, ours of the simulation.</p>{notes}
{_solve_times(result.mpc)}
<h2 id="plots">Plots</h2>{_plots(result.plots)}
<h2>What is idealised</h2><ul class="card">{ideal}</ul>
<h2>How it was made</h2>{_origin(result)}
<details class="card"><summary>Settings of this run</summary><pre>{settings}</pre></details>
<details class="card" open><summary>Versions and processor</summary><dl>{installed}</dl></details>
<p class="sub">The figures are in metrics.json and all signals in log.npz, beside this page.</p>""",
    )


def _origin(result: RunResult) -> str:
    """The command that repeats the run, its commit and how long it took, where they are known."""
    known = {
        "command": f"<code>{html.escape(result.command)}</code>" if result.command else "",
        "commit": html.escape(commit()),
        "took": "" if result.wall_time is None else f"{number(result.wall_time)} s",
    }
    rows = "".join(f"<dt>{name}</dt><dd>{text}</dd>" for name, text in known.items() if text)
    return (
        f'<div class="card" style="padding: 2px 16px 10px; margin-bottom: 12px"><dl>{rows}</dl></div>' if rows else ""
    )


def plots_page(title: str, about: str, plots: list[Plot]) -> str:
    """Plots alone as one HTML page that needs no network."""
    return document(
        title, f'<h1>{html.escape(title)}</h1><p class="sub">{html.escape(about)}</p><h2>Plots</h2>{_plots(plots)}'
    )


def _plots(plots: Sequence[Plot | Drawing]) -> str:
    cards = (
        f'<div class="card {"wide" if p.equal_axes else ""}"><h3>{html.escape(p.title)}</h3>{_figure(p)}</div>'
        for p in plots
    )
    return f'<div class="plots">{"".join(cards)}</div>'


def document(title: str, body: str, plots: bool = True) -> str:
    """A page, with the plotting library in it if there are ``plots``.

    A plot is drawn as soon as it is read. The grid keeps its columns while it fills (``auto-fill``), and plots are fitted
    once more at the end, when a scroll bar may have come: else they would be wider than their cards.
    """
    library = ""
    if plots:
        from plotly.offline import get_plotlyjs

        library = f"<script>{get_plotlyjs()}</script>"
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(title)}</title><style>{_STYLE}</style>
{library}</head><body><main>
{body}
</main><script>addEventListener("load", () => dispatchEvent(new Event("resize")))</script></body></html>
"""
