"""All runs below a directory: one table, and one page that sorts and filters it."""

from __future__ import annotations

import html
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from wbmpc.errors import InputError
from wbmpc.report import RECORDING, document
from wbmpc.result import Metric, metrics_of_interest
from wbmpc.run_files import flat, read_metrics
from wbmpc.units import Scale, scale, with_unit

#: Levels below the directory that are searched, and runs that are read, at most.
DEEPEST, MAX_RUNS = 5, 20_000
#: Settings that a run of a list is shown with, at most.
MOST_DIFFERENCES = 6
REPORT, METRICS = "report.html", "metrics.json"


@dataclass(frozen=True)
class Entry:
    """One run: its directory, metrics as in metrics.json with their ``targets``, and ``note``: why it did not complete or cannot be read.

    ``outcome``: as in metrics.json, or ``unreadable``. ``ended``: when its metrics were written.
    """

    directory: Path
    ended: datetime
    experiment: str = ""
    seed: int | None = None
    completed: bool = False
    outcome: str = ""
    metrics: dict[str, Metric] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    commit: str = ""
    note: str = ""

    @property
    def goals(self) -> tuple[int, int]:
        """Goals that are reached, and how many there are. A run that did not complete reaches none."""
        judged = [m.met for m in self.metrics.values() if m.met is not None]
        return (sum(judged) if self.completed else 0), len(judged)

    def to_json(self) -> dict[str, Any]:
        """The object that ``--json`` prints."""
        reached, judged = self.goals
        return {
            "directory": str(self.directory), "experiment": self.experiment, "seed": self.seed, "completed": self.completed,
            "outcome": self.outcome, "ended": self.ended.isoformat(timespec="seconds"), "commit": self.commit,
            "goals": {"reached": reached, "of": judged}, "settings": self.settings, "note": self.note,
            "metrics": {n: {"value": m.value if math.isfinite(m.value) else None, "unit": m.unit} for n, m in self.metrics.items()},
        }  # fmt: skip


def find_runs(root: Path) -> list[Entry]:
    """The runs below ``root``, the newest first. Links to directories are not followed; a damaged metrics.json is an entry with a note.

    Raises :class:`InputError` if ``root`` is no directory, or holds more than :data:`MAX_RUNS` runs.
    """
    if not root.is_dir():
        raise InputError(f"{root}: there is no such directory; runs are in 'runs' unless --out was given")
    found: list[Entry] = []
    for directory, files in folders(root):
        if METRICS not in files:
            continue
        if len(found) == MAX_RUNS:
            raise InputError(f"{root}: has more than {MAX_RUNS} runs; give a directory below it")
        found.append(_read(directory / METRICS))
    return sorted(found, key=lambda entry: (entry.ended, str(entry.directory)), reverse=True)


def folders(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """``root`` and the directories below it, :data:`DEEPEST` levels of them, each with the names of its files. Links to directories are
    not followed."""
    for name, below, files in os.walk(root):
        if len(Path(name).relative_to(root).parts) >= DEEPEST:
            below.clear()
        yield Path(name), files


def _read(path: Path) -> Entry:
    ended = datetime.fromtimestamp(0.0, UTC)
    try:
        ended = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        data = read_metrics(path)
        seed, commit = data.get("seed"), data["versions"].get("commit", "")
        metrics = {name: _metric(m, data["targets"].get(name, {})) for name, m in data["metrics"].items()}
    except OSError as error:  # a link that leads nowhere
        return Entry(path.parent, ended, outcome="unreadable", note=f"{path}: cannot be read ({error.strerror})")
    except (InputError, ValueError, OverflowError) as error:  # the latter of times of no calendar
        return Entry(path.parent, ended, outcome="unreadable", note=str(error))
    completed = data.get("completed") is True
    return Entry(
        path.parent, ended, data.get("experiment") or "", seed if isinstance(seed, int) else None, completed,
        data.get("outcome") or ("completed" if completed else "gave_up"), metrics, data["settings"], commit, data.get("reason") or "",
    )  # fmt: skip


def differing_settings(runs: Sequence[Entry]) -> list[str]:
    """For each run the settings in which the runs of its experiment differ, as ``mpc.rate=100``: the names of a study's runs
    say nothing. One that is left out (None) is none. Of more than :data:`MOST_DIFFERENCES` the first ones, in the order of the settings."""
    tables = [{key: _value_text(value) for key, value in flat(run.settings).items()} for run in runs]
    values: dict[tuple[str, str], set[str]] = {}
    for run, table in zip(runs, tables, strict=True):
        for key, value in table.items():
            values.setdefault((run.experiment, key), set()).add(value)
    out = []
    for run, table in zip(runs, tables, strict=True):
        differs = [f"{key}={value}" for key, value in table.items() if value and len(values[run.experiment, key]) > 1]
        out.append(", ".join(differs[:MOST_DIFFERENCES]) + (", …" if len(differs) > MOST_DIFFERENCES else ""))
    return out


def _value_text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:g}" if isinstance(value, float) else f"{value!s:.60}"


def _metric(figure: dict[str, Any], target: dict[str, Any]) -> Metric:
    """A metric with its targets; a figure that is not finite is null in the file: as bad as can be."""
    value = figure["value"]
    paper, goal, least = (None if target.get(k) is None else float(target[k]) for k in ("paper", "goal", "least"))
    about = target.get("definition")
    definition = about if isinstance(about, str) else ""
    return Metric(
        float("inf") if value is None else float(value), figure["unit"], paper, goal, least=least, definition=definition
    )


# ---------------------------------------------------------------------- the page
_SCRIPT = """<script>
const value = cell => { const v = cell.dataset.v; return v === undefined ? cell.textContent : v === "" ? Infinity : Number(v) };
for (const table of document.querySelectorAll("table")) table.rows[0].querySelectorAll("th").forEach((head, k) => {
  head.tabIndex = 0; head.style.cursor = "pointer"; let up = false;
  const sort = () => { up = !up;
    const rows = [...table.rows].slice(1).sort((a, b) => { const x = value(a.cells[k]), y = value(b.cells[k]);
      return (x < y ? -1 : x > y ? 1 : 0) * (up ? 1 : -1) });
    table.querySelectorAll("th").forEach(h => h.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", up ? "ascending" : "descending"); rows.forEach(row => row.parentNode.append(row)) };
  head.addEventListener("click", sort); head.addEventListener("keydown", e => { if (e.key === "Enter") sort() }) });
const filter = document.getElementById("filter");
filter.addEventListener("input", () => { const words = filter.value.toLowerCase().split(/\\s+/);
  for (const section of document.querySelectorAll("section")) { let shown = 0;
    for (const row of [...section.querySelectorAll("tr")].slice(1)) {
      const text = (section.id + " " + row.textContent).toLowerCase();
      row.hidden = !words.every(w => text.includes(w)); shown += !row.hidden }
    section.hidden = !shown } });
</script>
<style>th[aria-sort=ascending]::after { content: " ▲" } th[aria-sort=descending]::after { content: " ▼" }
#filter { width: 100%; padding: 10px 14px; font: inherit; color: inherit; border: 1px solid var(--line); border-radius: 8px; background: var(--card);
  margin: 20px 0 0 } th { white-space: normal; vertical-align: top } th.m { min-width: 84px }
.note, .differs { display: block; white-space: normal; min-width: 220px } .differs { color: var(--soft) } main { max-width: 1460px }
main :is(th, td) { padding: 6px; font-size: 14px }</style>"""


def page(runs: Sequence[Entry], beside: Path, studies: str = "") -> str:
    """The table as one HTML page that needs no network, with a section per experiment; links are relative to ``beside``. ``studies``:
    a section before them."""
    names = sorted({run.experiment for run in runs})
    sections = "".join(_section(name, [r for r in runs if r.experiment == name], beside) for name in names)
    failed = sum(not run.completed for run in runs)
    about = f"{len(runs)} {'run' if len(runs) == 1 else 'runs'}, {failed} not completed. A click on a heading sorts."
    search = '<input id="filter" type="search" placeholder="Filter: experiment, setting, seed, outcome, commit" aria-label="Filter">'
    return document("Runs", f'<h1>Runs</h1><p class="sub">{about}</p>{search}{studies}{sections}{_SCRIPT}', plots=False)


def _section(name: str, runs: list[Entry], beside: Path) -> str:
    """A table with the metrics of interest, each in one unit."""
    judged = {n: m.unit for run in runs for n, m in run.metrics.items() if (m.goal, m.least, m.paper) != (None,) * 3}
    shown = metrics_of_interest([n for run in runs for n in run.metrics], judged)
    scales = {n: _scale([run.metrics[n] for run in runs if n in run.metrics]) for n in shown}
    heads = "".join(
        _head(with_unit(n, scales[n].unit), [run.metrics[n] for run in runs if n in run.metrics]) for n in shown
    )
    differs = differing_settings(runs)
    rows = "".join(_row(run, about, shown, scales, beside) for run, about in zip(runs, differs, strict=True))
    title = html.escape(name) or "Unreadable"
    return f"""<section id="{title}"><h2>{title}</h2><div class="card scroll"><table>
<tr><th>run</th><th class=n>seed</th><th>outcome</th>
<th class=n>metrics at goal</th>{heads}<th>ended</th><th>commit</th></tr>{rows}</table></div></section>"""


def _head(text: str, metrics: Sequence[Metric]) -> str:
    """The heading of a metric, with its definition under the pointer."""
    about = next((m.definition for m in metrics if m.definition), "")
    tip = f' data-about="{html.escape(about)}"' if about else ""
    return f"<th class='n m'{tip}>{html.escape(text).replace('_', '_<wbr>')}</th>"


def _scale(metrics: Sequence[Metric]) -> Scale:
    return scale(metrics[0].unit, *(m.value for m in metrics), metrics[0].goal, metrics[0].paper)


def _row(run: Entry, differs: str, shown: Sequence[str], scales: dict[str, Scale], beside: Path) -> str:
    reached, judged = run.goals
    kind = "met" if run.completed else "missed"
    seed = "" if run.seed is None else run.seed
    note = f'<span class="note">{html.escape(run.note)}</span>' if run.note else ""
    settings = f'<span class="differs">{html.escape(differs)}</span>' if differs else ""
    cells = [
        f"<td>{_links(run, beside)}{settings}</td>", f'<td class=n data-v="{seed}">{seed}</td>',
        f'<td><span class="{kind}">{html.escape(run.outcome)}</span>{note}</td>',
        f'<td class=n data-v="{reached / judged if judged else ""}">{f"{reached} of {judged}" if judged else ""}</td>',
        *(_cell(run.metrics.get(n), scales[n], run.completed) for n in shown),
        f"<td>{run.ended:%Y-%m-%d %H:%M:%S}</td>", f"<td>{html.escape(run.commit)}</td>",
    ]  # fmt: skip
    return f"<tr>{''.join(cells)}</tr>"


def _cell(metric: Metric | None, shown: Scale, completed: bool) -> str:
    """A figure; green only of a run that completed: another one reaches no goal."""
    if metric is None:
        return '<td class=n data-v=""></td>'
    kind = {True: "met" if completed else "", False: "missed", None: ""}[metric.met]
    return f'<td class=n data-v="{metric.value}"><span class="{kind}">{shown.text(metric.value)}</span></td>'


def _links(run: Entry, beside: Path) -> str:
    """The run's name as a link to its report, and those to its replay and recording, where they are there."""
    path = os.path.relpath(run.directory, beside)
    link = lambda file, text: f'<a href="{html.escape(quote(os.fsencode(f"{path}/{file}")))}">{html.escape(text)}</a>'
    reported = (run.directory / REPORT).is_file()
    name = link(REPORT, path) if reported else html.escape(path)
    if not (run.directory / RECORDING).is_file():
        return name
    replay = f'<a href="{html.escape(quote(os.fsencode(f"{path}/{REPORT}")))}#replay">replay</a>, ' if reported else ""
    return f"{name} ({replay}{link(RECORDING, 'recording')})"
