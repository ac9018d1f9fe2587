"""The report of a run as one self-contained page."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np

from wbmpc.plots.figures import figure, palette
from wbmpc.report.document import document, named, table
from wbmpc.report.provenance import commit, versions
from wbmpc.report.replay import replay
from wbmpc.result import Drawing, Metric, MpcStatistics, Plot, RunResult
from wbmpc.units import Scale, number, scale


def plain(value: Any) -> Any:
    """What JSON can hold: a figure that is not finite is null."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Real) and not isinstance(
        value, int | float
    ):  # a fraction; NumPy's longer floats are their own items
        value = float(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


#: What solve times are called, by their key in the statistics.
_SOLVE_TIMES = {"median solve": "median", "95 % below": "p95", "longest": "max"}


def metric_cells(result: RunResult, name: str) -> list[str]:
    """A metric's unit, figure, paper's figure and goal as cells of a table, all in the unit that reads best."""
    m = result.metrics[name]
    shown = scale(m.unit, m.value, m.paper, m.goal, m.least)
    # a run that the user ended may have had no time for a figure
    missing = result.interrupted and not math.isfinite(m.value)
    return [shown.unit, "not measured" if missing else shown.text(m.value), shown.text(m.paper), goal_text(m, shown)]


def exact(result: RunResult) -> bool:
    """Whether the planner's own model was simulated, without physics."""
    return bool(result.settings.get("plant", {}).get("kind") == "kinematic")


def goal_text(metric: Metric, shown: Scale) -> str:
    """The goal as a cell of a table: a largest value, a range, or a smallest value."""
    goal, least = shown.text(metric.goal), shown.text(metric.least)
    if not least:
        return f"≤ {goal}" if goal else ""
    return f"{least} to {goal}" if goal else f"≥ {least}"


def _metrics(result: RunResult) -> str:
    """The table of metrics, without the paper's column where no metric has a paper's figure."""
    words = {True: '<span class="met">reached</span>', False: '<span class="missed">missed</span>', None: ""}
    rows = [
        [
            named(name, result.metrics[name].definition),
            *map(html.escape, metric_cells(result, name)),
            words[result.reached(name)],
        ]
        for name in result.metrics
    ]
    paper = any(m.paper is not None for m in result.metrics.values())
    header = ["metric", "unit", "this run", "paper", "goal", ""]
    if not paper:
        header, rows = [h for h in header if h != "paper"], [row[:3] + row[4:] for row in rows]
    note = '<p class="sub">The paper\'s figures are of the real robot, ours of the simulation.</p>' if paper else ""
    return table(header, rows, {2, 3, 4} if paper else {2, 3}) + note


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
        text += f"; {len(judged) - len(missed)} of {len(judged)} metrics reach their goal"
    if judged and not result.completed:
        text += " (those of a run that does not complete do not)"
    elif missed:
        text += f", missed: {', '.join(missed)}"
    kind = "bad" if not result.completed else "fair" if missed else ""
    solving = "".join(f"<p>{html.escape(line)}</p>" for line in solve_lines(result))
    return f'<div class="card summary {kind}">{text}.{solving}</div>'


def solve_lines(result: RunResult) -> list[str]:
    """What became of the MPC's solves, and what late and failed ones mean for this run, which is in virtual time."""
    mpc = result.mpc
    if mpc is None or not mpc.solves:
        return []
    period, lines = f"{number(1e3 / mpc.rate_hz)} ms", []
    if mpc.failures:
        lines.append(f"{mpc.failures} of {mpc.solves} solves failed: the plan before them stayed active.")
    if mpc.no_step:
        lines.append(
            f"{mpc.no_step} of {mpc.solves} solves found no step: the plan before them, moved on in time, stayed active."
        )
    if mpc.deadline_misses:
        lines.append(
            f"{mpc.deadline_misses} of {mpc.solves} solves took longer than the period of {period} on this machine "
            f"({number(mpc.solve_ms['max'])} ms at most). In virtual time this changes nothing: every plan becomes active after the "
            f"same delay{_delay(result)}. In real time the plan before would have stayed active until then."
        )
    return lines or [f"All {mpc.solves} solves gave a plan, each within the period of {period}."]


def _delay(result: RunResult) -> str:
    mpc = result.settings.get("mpc")
    sections = (result.settings, mpc if isinstance(mpc, dict) else {})
    delay = next((s["computation_delay"] for s in sections if "computation_delay" in s), None)
    return f" of {number(1e3 * delay)} ms" if isinstance(delay, (int, float)) else ""


def _solve_times(mpc: MpcStatistics | None) -> str:
    if mpc is None:
        return ""
    known = {
        "rate": f"{mpc.rate_hz:g} Hz", "period": f"{number(1e3 / mpc.rate_hz)} ms",
        **{name: f"{number(mpc.solve_ms[k])} ms" for name, k in _SOLVE_TIMES.items()},
        "deadlines missed": mpc.deadline_misses, "solves": mpc.solves, "failed": mpc.failures, "without a step": mpc.no_step,
    }  # fmt: skip
    tiles = "".join(f"<div><span>{name}</span>{value}</div>" for name, value in known.items())
    return f'<h2>Model predictive control</h2><div class="card tiles">{tiles}</div>'


def page(result: RunResult) -> str:
    """The report as one HTML page that needs no network."""
    notes = "".join(f'<p class="sub">{html.escape(note)}.</p>' for note in goal_notes(result))
    ideal = "".join(f"<li>{html.escape(line)}</li>" for line in result.idealizations)
    settings = html.escape(json.dumps(plain(result.settings), indent=2))
    own, physics = (
        "by the planner's own model",
        "in MuJoCo; the plant differs from the planner's model as the settings say",
    )
    simulated = f"simulated {own if exact(result) else physics}"
    installed = "".join(f"<dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd>" for k, v in versions().items())
    return document(
        f"{result.experiment}, seed {result.seed}",
        f"""<h1>{html.escape(result.experiment)}</h1>
<p class="sub">Seed {result.seed}, {simulated}.</p>
{_summary(result)}
<h2>Figures</h2>{_metrics(result)}{notes}
{_solve_times(result.mpc)}
{replay(result.motion)}
<h2 id="plots">Plots</h2>{_plots(result.plots)}
<h2>What is idealized</h2><ul class="card">{ideal}</ul>
<h2>How it was made</h2>{_origin(result)}
<details class="card"><summary>Settings of this run</summary><pre>{settings}</pre></details>
<details class="card" open><summary>Versions and processor</summary><dl>{installed}</dl></details>
<p class="sub">The figures are in metrics.json and all signals in log.npz, beside this page.</p>""",
    )


def _origin(result: RunResult) -> str:
    """The command that repeats the run, its commit and how long it took, where they are known; times are of the clock and of the run."""
    known = {
        "command": f"<code>{html.escape(result.command)}</code>" if result.command else "",
        "commit": html.escape(commit()),
        "took": "" if result.wall_time is None else f"{number(result.wall_time)} s",
    }
    rows = "".join(f"<dt>{name}</dt><dd>{text}</dd>" for name, text in known.items() if text)
    return (
        f'<div class="card" style="padding: 2px 16px 10px; margin-bottom: 12px"><dl>{rows}</dl></div>' if rows else ""
    )


def plots_page(title: str, about: str, plots: Sequence[Plot], before: str = "") -> str:
    """Plots alone as one HTML page that needs no network; ``before``: HTML that stands above them."""
    head = f'<h1>{html.escape(title)}</h1><p class="sub">{html.escape(about)}</p>'
    return document(title, f"{head}{before}<h2>Plots</h2>{_plots(plots)}")


def _plots(plots: Sequence[Plot | Drawing]) -> str:
    colors = palette(plots)
    cards = (
        f'<div class="card {"wide" if p.equal_axes else ""}"><h3>{html.escape(p.title)}</h3>{figure(p, colors)}</div>'
        for p in plots
    )
    return f'<div class="plots">{"".join(cards)}</div>'
