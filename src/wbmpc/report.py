"""A run on disk: metrics.json, log.npz and report.html, one self-contained page."""

from __future__ import annotations

import html
import json
import math
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.result import Metric, Plot, RunResult

#: More points than this per line are thinned out (min and max of each bin are kept).
MOST_POINTS = 1500
_COLOURS = ["#1f5fa8", "#d1495b", "#2a9d6f", "#8a5fbf", "#c98a1b", "#4aa3c7", "#7a7a7a", "#b0467f"]
_STYLE = """
:root { color-scheme: light; --ink: #1d2733; --soft: #5c6b7a; --line: #dfe5ea; --good: #1d7a4f; --bad: #b3362b; }
body { margin: 0; background: #f5f7f9; color: var(--ink); font: 16px/1.5 system-ui, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1060px; margin: 0 auto; padding: 32px 20px 64px; }
h1 { font-size: 30px; margin: 0; } h2 { font-size: 20px; margin: 40px 0 12px; }
p.sub { color: var(--soft); margin: 4px 0 0; } .verdict { margin: 20px 0; padding: 12px 18px; border-radius: 8px;
  background: #fff; border-left: 5px solid var(--good); } .verdict.bad { border-color: var(--bad); }
table { border-collapse: collapse; width: 100%; background: #fff; border: 1px solid var(--line); border-radius: 8px; }
th, td { text-align: left; padding: 8px 14px; border-bottom: 1px solid var(--line); } th { color: var(--soft); font-weight: 600; }
td.n { text-align: right; font-variant-numeric: tabular-nums; } .met { color: var(--good); } .missed { color: var(--bad); }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(460px, 1fr)); gap: 16px; }
.plots > div { background: #fff; border: 1px solid var(--line); border-radius: 8px; padding: 8px; min-width: 0; }
.plots > div.wide { grid-column: 1 / -1; } ul { padding-left: 20px; } details { background: #fff; border: 1px solid
  var(--line); border-radius: 8px; padding: 10px 16px; } pre { overflow-x: auto; font-size: 13px; }
@media (max-width: 560px) { .plots { grid-template-columns: 1fr; } }
"""


def number(value: float) -> str:
    """A figure with four significant digits."""
    if not math.isfinite(value):
        return "inf" if value > 0 else "not a number"
    return f"{value:.4g}"


def to_json(result: RunResult, files: dict[str, str]) -> dict[str, Any]:
    """The object that ``--json`` prints. A figure that is not finite is null."""
    clean = lambda v: v if math.isfinite(v) else None  # noqa: E731
    return {
        "experiment": result.experiment,
        "seed": result.seed,
        "completed": result.completed,
        "reason": result.reason,
        "metrics": {k: {"value": clean(m.value), "unit": m.unit} for k, m in result.metrics.items()},
        "mpc": {
            "rate_hz": result.mpc.rate_hz,
            "solve_ms": {k: clean(round(v, 4)) for k, v in result.mpc.solve_ms.items()},
            "deadline_misses": result.mpc.deadline_misses,
        },
        "files": files,
    }


def versions() -> dict[str, str]:
    """What ran: versions of this library and of what it stands on, and the processor."""
    out = {"python": platform.python_version(), "machine": platform.machine(), "cpu": _processor()}
    for name in ("wbmpc", "casadi", "mujoco", "numba", "llvmlite", "numpy", "scipy"):
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "not installed as a package"
    return out


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor())


def write_run(result: RunResult, directory: Path) -> dict[str, str]:
    """Write all files of a run into ``directory`` (made if missing); returns their paths by kind."""
    directory.mkdir(parents=True, exist_ok=True)
    files = {n: str(directory / f) for n, f in (("metrics", "metrics.json"), ("log", "log.npz"), ("report", "report.html"))}
    more = {"settings": result.settings, "idealisations": result.idealisations, "versions": versions()}
    Path(files["metrics"]).write_text(json.dumps({**to_json(result, files), **more}, indent=2) + "\n")
    result.log.save(Path(files["log"]))
    Path(files["report"]).write_text(page(result))
    return files


# ---------------------------------------------------------------------- the page
def _thin(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At most MOST_POINTS points that keep the extremes of every bin."""
    if x.size <= MOST_POINTS:
        return x, y
    keep = {0, x.size - 1}
    for part in np.array_split(np.arange(x.size), MOST_POINTS // 2):
        keep |= {int(part[np.argmin(y[part])]), int(part[np.argmax(y[part])])}
    index = np.array(sorted(keep))
    return x[index], y[index]


def _figure(plot: Plot) -> str:
    import plotly.graph_objects as go

    figure = go.Figure()
    for k, line in enumerate(plot.series):
        x, y = np.asarray(line.x, float), np.asarray(line.y, float)
        x, y = (x[:: max(1, x.size // MOST_POINTS)], y[:: max(1, x.size // MOST_POINTS)]) if plot.equal_axes else _thin(x, y)
        style = {"width": 1.6, "color": _COLOURS[k % len(_COLOURS)], "dash": "dash" if line.dashed else "solid"}
        # plain lists: browsers draw them the same, and the page stays readable
        figure.add_scatter(x=[float(f"{v:.6g}") for v in x], y=[float(f"{v:.6g}") for v in y], name=line.name, mode="lines", line=style)
    figure.update_layout(
        title={"text": plot.title, "font": {"size": 16}}, xaxis_title=plot.x_label, yaxis_title=plot.y_label,
        template="plotly_white", height=360, margin={"l": 60, "r": 16, "t": 48, "b": 88},
        legend={"orientation": "h", "y": -0.25}, font={"family": "system-ui, sans-serif", "size": 12},
    )  # fmt: skip
    if plot.equal_axes:
        figure.update_yaxes(scaleanchor="x", scaleratio=1)
    options = {"displaylogo": False, "responsive": True}
    return str(figure.to_html(full_html=False, include_plotlyjs=False, config=options))


def _row(name: str, m: Metric) -> str:
    verdict = ""
    if m.met is not None:
        verdict = '<span class="met">reached</span>' if m.met else '<span class="missed">missed</span>'
    cells = [number(m.value), html.escape(m.unit), *(("" if v is None else number(v)) for v in (m.paper, m.goal))]
    body = "".join(f'<td class="{"" if i == 1 else "n"}">{c}</td>' for i, c in enumerate(cells))
    return f"<tr><td>{html.escape(name)}</td>{body}<td>{verdict}</td></tr>"


def page(result: RunResult) -> str:
    """The report as one HTML page that needs no network."""
    from plotly.offline import get_plotlyjs

    goals = [m.met for m in result.metrics.values() if m.met is not None]
    good = result.completed and all(goals)
    ending = "The run completed" if result.completed else f"The run ended early: {html.escape(result.reason)}"
    solve = result.mpc.solve_ms
    rows = "".join(_row(k, m) for k, m in result.metrics.items())
    plots = "".join(f'<div class="{"wide" if p.equal_axes else ""}">{_figure(p)}</div>' for p in result.plots)
    ideal = "".join(f"<li>{html.escape(line)}</li>" for line in result.idealisations)
    settings = html.escape(json.dumps(result.settings, indent=2))
    installed = ", ".join(f"{html.escape(k)} {html.escape(v)}" for k, v in versions().items())
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(result.experiment)}, seed {result.seed}</title><style>{_STYLE}</style>
<script>{get_plotlyjs()}</script></head><body><main>
<h1>{html.escape(result.experiment)}</h1><p class="sub">seed {result.seed}, in MuJoCo physics; the plant is not the planner's model</p>
<div class="verdict {"" if good else "bad"}">{ending}; {sum(goals)} of {len(goals)} goals reached.</div>
<h2>Figures</h2><table><tr><th>metric</th><th>ours</th><th>unit</th><th>paper</th><th>goal (at most)</th><th></th></tr>{rows}</table>
<p class="sub">MPC at {result.mpc.rate_hz:g} Hz: solve time median {number(solve["median"])} ms, 95 % below {number(solve["p95"])} ms,
largest {number(solve["max"])} ms; {result.mpc.deadline_misses} longer than the period. The paper's figures are of the real robot.</p>
<h2>Plots</h2><div class="plots">{plots}</div>
<h2>What is idealised</h2><ul>{ideal}</ul>
<h2>Settings</h2><details><summary>all settings of this run</summary><pre>{settings}</pre></details>
<p class="sub">{installed}</p></main></body></html>
"""
