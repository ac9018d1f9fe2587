"""Runs side by side: their figures in a table, their signals over each other."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.input_file import parse_json
from wbmpc.log import TEXTS
from wbmpc.recording.quantities import Columns, channel_unit
from wbmpc.recording.reader import read_recording, recording_file
from wbmpc.report import RECORDING, named
from wbmpc.report import table as html_table
from wbmpc.result import Plot, Series
from wbmpc.run_files import check_amount, check_metric, definition_in, flat, read_log, read_metrics
from wbmpc.units import Scale, by_unit, scale, with_unit

#: Runs that are compared at once.
MAX_RUNS = 8
#: Components of a channel, at most, that are drawn: as many as there are colors.
MAX_LINES = 8
#: What the components of channels whose log has no names for them are called, and their units, by a word in the channel's name and
#: their number; the first that fits is taken.
_PLACES = (
    ("quaternion", ("qw", "qx", "qy", "qz"), "1111"), ("base", ("x", "y", "yaw"), ("m", "m", "rad")),
    ("odometry", ("x", "y", "yaw"), ("m", "m", "rad")), ("hand", ("x", "y", "z"), "mmm"), ("end_effector", ("x", "y", "z"), "mmm"),
    ("force", ("x", "y", "z"), "NNN"),
)  # fmt: skip
#: Topics whose numbers are compared where a run left no log.
_SIGNALS = (
    "/end_effector_pose", "/end_effector_reference", "/ground_truth/", "/odom", "/command/", "/joint_states", "/mpc/",
)  # fmt: skip

#: Differences that are a smaller share of the figure are of its last digits.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Run:
    """What there is of a run at a ``path``: ``figures`` as in metrics.json, signals by channel, ``note``: what is missing, and why.

    ``labels`` and ``units``: names and units of a channel's components, where log or recording have them.
    """

    path: Path
    figures: dict[str, Any]
    log: dict[str, np.ndarray]
    note: str = ""
    labels: dict[str, tuple[str, ...]] = field(default_factory=dict)
    units: dict[str, tuple[str, ...]] = field(default_factory=dict)


def load_all(paths: Sequence[Path]) -> list[Run]:
    """Runs with signals that can be laid over each other: logs, or recordings where one of them left no log."""
    if not 2 <= len(paths) <= MAX_RUNS:
        raise InputError(f"compare: two to {MAX_RUNS} runs are needed, got {len(paths)}")
    runs = [load(path) for path in paths]
    return runs if all(run.log for run in runs) else [_from_recording(run) for run in runs]


def load(path: Path) -> Run:
    """A run by its directory or its recording: metrics.json and log.npz; without these what the recording says (no signals yet).

    Raises :class:`InputError` if there is neither.
    """
    if not path.exists():
        raise InputError(f"{path}: there is no such run; give its directory or its recording ({RECORDING})")
    directory = path.parent if path.name == RECORDING else path
    missing = [name for name in ("metrics.json", "log.npz") if not (directory / name).is_file()]
    if missing and recording_file(path).is_file():
        return _recorded(path)
    if missing:
        raise InputError(f"{path}: is not the directory of a run: there is no {missing[0]} and no {RECORDING}")
    figures, arrays = _files(directory)
    labels, units = (
        {name.removesuffix(end): tuple(map(str, a)) for name, a in arrays.items() if name.endswith(end)}
        for end in TEXTS
    )
    log = {name: array for name, array in arrays.items() if not name.endswith(TEXTS)}
    reason = "" if figures.get("completed", True) else f"did not complete: {figures.get('reason', 'unknown')}"
    return Run(path, figures, log, reason, labels, units)


def _files(directory: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    return read_metrics(directory / "metrics.json"), read_log(directory / "log.npz")


def _recorded(path: Path) -> Run:
    """What a recording alone says. That of a run that ended holds its figures, without their units."""
    recording = read_recording(path)
    about, result = recording.metadata.get("run", {}), recording.metadata.get("result", {})
    where = f"{recording.path}: what it says of its run"
    settings, values = (parse_json(text, where) for text in (about.get("settings", "{}"), result.get("metrics", "{}")))
    seed = about.get("seed", "")
    if not isinstance(settings, dict) or not isinstance(values, dict) or not re.fullmatch(r"-?[0-9]{0,18}", seed):
        raise InputError(f"{where} cannot be read: settings and metrics must be objects, the seed a whole number")
    check_amount(where, [settings, values])
    metrics = {name: {"value": value, "unit": ""} for name, value in values.items()}
    for name, metric in metrics.items():
        check_metric(f"{where}: metric '{name}'", metric)
    figures = {
        "experiment": about.get("experiment"), "seed": int(seed) if seed.strip("-") else None, "settings": settings,
        "metrics": metrics, "outcome": result.get("outcome"),
    }  # fmt: skip
    note = f"did not complete: {result['reason']}" if result.get("reason") else ""
    if not metrics:
        note = f"left no metrics; its recording ends at {recording.end:.2f} s"
    return Run(path, figures, {}, note)


def _from_recording(run: Run) -> Run:
    """The same with the signals of its recording, if it has one: numbers of a topic are a channel."""
    if not recording_file(run.path).is_file():
        return run
    recording, log, labels, units = read_recording(run.path), {}, {}, {}
    about = Columns(recording)
    for topic in [t for t in recording.topics if t.startswith(_SIGNALS)]:
        found = recording.table(topic)
        columns = {name: values for name, values in found.columns.items() if values.dtype.kind == "f"}
        if columns:
            channel = topic.strip("/")
            log[channel], log[f"{channel}.time"] = np.stack([*columns.values()], axis=1), found.times
            labels[channel] = tuple(columns)
            units[channel] = tuple(about.unit(topic, name, len(columns)) for name in columns)
    return replace(run, log=log, labels=labels, units=units)


def table(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each metric of any run: ``metric``, ``unit``, ``definition``, ``values`` by run (None where there is none),
    ``differences`` of every run to the first, ``change`` of the last run against the first (1), ``spread``: largest minus smallest."""
    names = dict.fromkeys(name for run in runs for name in run["metrics"])
    rows = []
    for name in names:
        found = [run["metrics"].get(name, {}) for run in runs]
        values = [m.get("value") for m in found]
        known = [v for v in values if v is not None]
        first, last = values[0], values[-1]
        about = next(filter(None, (definition_in(run, name) for run in runs)), "")
        change = (last - first) / abs(first) if first not in (None, 0) and last is not None else None
        differences = [None if v is None or first is None else v - first for v in values]
        spread = max(known) - min(known) if len(known) == len(values) else None
        unit = max(m["unit"] for m in found if m)  # a recording alone knows none
        row = {
            "metric": name, "unit": unit, "definition": about, "values": values, "differences": differences,
            "change": change,
        }  # fmt: skip
        rows.append({**row, "spread": spread})
    return rows


def outcomes(runs: list[dict[str, Any]]) -> list[str | None]:
    """How each run ended; None where its files do not say it."""
    return [run.get("outcome") for run in runs]


def experiments(runs: list[dict[str, Any]]) -> str:
    """A message where runs are of different experiments; else empty."""
    names = list(dict.fromkeys(run.get("experiment") or "unknown" for run in runs))
    if len(names) == 1:
        return ""
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    return f"the runs are of different experiments ({listed}): figures and settings of one may mean nothing for another"


def differences(runs: list[dict[str, Any]]) -> dict[str, list[Any]]:
    """Settings that the runs do not share, by dotted key: the values by run."""
    tables = [flat(run.get("settings", {})) for run in runs]
    keys = dict.fromkeys(key for settings in tables for key in settings)
    found = {"seed": [run.get("seed") for run in runs]}
    found |= {key: [settings.get(key) for settings in tables] for key in keys if key != "seed"}
    return {key: values for key, values in found.items() if any(value != values[0] for value in values)}


def _components(run: Run, channel: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of a channel's components: numbers where no names are known, "" where no units."""
    rows = run.log[channel]
    count = rows.shape[1] if rows.ndim == 2 else 1
    fitting = ((names, tuple(units)) for word, names, units in _PLACES if word in channel and len(names) == count)
    names, units = next(fitting, (tuple(f"[{i}]" for i in range(count)), (channel_unit(channel),) * count))
    return run.labels.get(channel, names), run.units.get(channel, () if channel in run.labels else units) or (
        "",
    ) * count


def overlay(runs: Sequence[Run], names: list[str]) -> list[Plot]:
    """The channels that all runs have, a plot for each unit of their components.

    Of two runs the second has the same colors, dashed; of more runs each component is a plot, and each run has a color.
    """
    logs = [run.log for run in runs]
    plots = []
    for channel in [c for c in logs[0] if all({c, f"{c}.time"} <= log.keys() for log in logs)]:
        found = by_unit(_components(runs[0], channel)[1])
        for own, places in found.items():
            read = scale(own)
            by_run, unit = [_lines(run, channel, places, read.factor) for run in runs], read.unit
            title = f"{channel}{f', {unit}' if len(found) > 1 else ''}{_left_out(places)}"
            if len(runs) == 2:
                plots.append(Plot(title, "time [s]", with_unit(channel, unit), [*_pair(by_run, names)]))
                continue
            for part in [p for p in by_run[0] if all(p in lines for lines in by_run)]:
                pairs = enumerate(zip(by_run, names, strict=True))
                lines = [Series(name, *shown[part], color=k) for k, (shown, name) in pairs]
                label = with_unit(f"{channel} {part}".strip(), unit)
                plots.append(Plot(f"{channel} {part}".strip(), "time [s]", label, lines))
    return plots


def _left_out(places: Sequence[int]) -> str:
    """How many components of one unit are drawn, where not all are."""
    return f" ({MAX_LINES} of {len(places)})" if len(places) > MAX_LINES else ""


def figures_table(rows: list[dict[str, Any]], names: Sequence[str], ended: Sequence[str | None]) -> str:
    """The rows of :func:`table` as HTML: figures by run in one unit, differences to the first run, spread."""
    head = ["metric", "unit", html.escape(names[0])]
    head += [text for name in names[1:] for text in (html.escape(name), "difference")]
    cells = [
        [
            "outcome", "", html.escape(ended[0] or ""),
            *(text for end in ended[1:] for text in (html.escape(end or ""), "")),
        ]
    ]  # fmt: skip
    for row in rows:
        unit = scale(row["unit"], *row["values"])
        first, *others = map(unit.text, row["values"])
        pairs = zip(others, row["differences"][1:], strict=True)
        cells.append([named(row["metric"], row["definition"]), html.escape(unit.unit), first])
        cells[-1] += [text for value, d in pairs for text in (value, difference_text(d, row["values"][0], unit))]
    if len(names) > 2:
        head.append("spread")
        cells[0].append("")
        for line, row in zip(cells[1:], rows, strict=True):
            line.append(scale(row["unit"], *row["values"]).text(row["spread"]))
    return html_table(head, cells, set(range(2, len(head))))


def settings_table(changed: dict[str, list[Any]], names: Sequence[str]) -> str:
    """What :func:`differences` finds as HTML; nothing where the runs share all settings."""
    cells = [[html.escape(str(text)) for text in (key, *values)] for key, values in changed.items()]
    return (
        f"<h2>Settings that differ</h2>{html_table(['setting', *map(html.escape, names)], cells, set())}"
        if cells
        else ""
    )


def difference_text(difference: float | None, first: float | None, unit: Scale) -> str:
    """A difference in ``unit``, and its share of the ``first`` figure: ``+0.2 (+12.5 %)``."""
    if difference is None or first is None:
        return ""
    if abs(difference) < ROUNDING * abs(first):
        return "0"
    text = f"{'+' if difference > 0 else ''}{unit.text(difference)}"
    return f"{text} ({100 * difference / abs(first):+.1f} %)" if first and difference else text


def _pair(by_run: Sequence[dict[str, tuple[np.ndarray, np.ndarray]]], names: Sequence[str]) -> Iterator[Series]:
    """The lines of two runs: a color for each component, the second run dashed."""
    for k, (lines, run) in enumerate(zip(by_run, names, strict=True)):
        for part, (t, y) in lines.items():
            name = f"{part}, {run}" if part and k else part or run
            yield Series(name, t, y, dashed=k == 1, color=None if part else 0, signal=part)


def _lines(run: Run, channel: str, places: Sequence[int], factor: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Times and values, times ``factor``, of a channel's components at ``places``, by their names; "" where the channel has one."""
    rows, t, parts = np.atleast_2d(run.log[channel].T), run.log[f"{channel}.time"], _components(run, channel)[0]
    return {parts[i] if len(rows) > 1 else "": (t, factor * rows[i]) for i in places[:MAX_LINES] if i < len(rows)}
