"""Whether other people's code gave back a whole result of a run: reports, tables and files take its parts for granted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any, get_args

import numpy as np

from wbmpc.errors import InputError
from wbmpc.log import TEXTS, Log
from wbmpc.result import Drawing, Metric, MpcStatistics, OutcomeName, Plot, RunResult, Series

#: Characters of a channel's name, at most: an archive has room for 65 535 bytes with an ending, a page for less.
_LONGEST_NAME = 200
#: How deep settings are nested, at most.
_DEEPEST = 50


def check_result(result: Any) -> None:
    """Raise :class:`InputError` that names the part of a :class:`RunResult` that is not what it should be. Figures of other kinds of numbers
    (fractions, NumPy's) become those of Python: they are compared and printed together."""
    _expect("", result, RunResult)
    _expect("experiment", result.experiment, str)
    _expect("seed", result.seed, int, np.integer)
    for key in ("completed", "interrupted"):
        _expect(key, getattr(result, key), bool, np.bool_)
    _expect("reason", result.reason, str)
    if result.failure not in get_args(OutcomeName):
        raise InputError(f"failure: one of {', '.join(get_args(OutcomeName))} is needed, got {result.failure!r:.60}")
    _expect("metrics", result.metrics, Mapping)
    for name, metric in result.metrics.items():
        _expect("metrics: a name", name, str)
        _check_metric(f"metrics: '{name}'", metric)
    result.metrics = {name: _with_plain_figures(metric) for name, metric in result.metrics.items()}
    if result.mpc is not None:
        _check_statistics(result.mpc)
    _expect("log", result.log, Log)
    _check_log(result.log)
    _expect("plots", result.plots, list, tuple)
    for k, plot in enumerate(result.plots):
        _check_plot(f"plots[{k}]", plot)
    for key in ("idealizations", "faults"):
        _check_texts(key, getattr(result, key))
    _expect("settings", result.settings, dict)
    _check_plain("settings", result.settings, 0)


def _expect(where: str, value: Any, *kinds: type) -> None:
    if not isinstance(value, kinds):
        needed = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(f"{where}{': ' if where else ''}{needed} is needed, got {type(value).__name__}")


def _number(where: str, value: Any) -> None:
    """Raise :class:`InputError` unless it is one number, which need not be finite."""
    try:
        good = isinstance(value, Real | np.bool_) and float(value) is not None
    except OverflowError as error:
        raise InputError(f"{where}: a whole number beyond all numbers of a machine") from error
    if not good:
        raise InputError(f"{where}: a number is needed, got {type(value).__name__}")


def _check_texts(where: str, texts: Any) -> None:
    _expect(where, texts, list, tuple)
    for k, text in enumerate(texts):
        _expect(f"{where}[{k}]", text, str)


def _check_metric(where: str, metric: Any) -> None:
    _expect(where, metric, Metric)
    _number(f"{where}: value", metric.value)
    for key in ("unit", "goal_note", "definition"):
        _expect(f"{where}: {key}", getattr(metric, key), str)
    for key in ("paper", "goal", "least"):
        if getattr(metric, key) is not None:
            _number(f"{where}: {key}", getattr(metric, key))


def _with_plain_figures(metric: Metric) -> Metric:
    known = lambda figure: None if figure is None else _plain_number(figure)
    paper, goal, least = map(known, (metric.paper, metric.goal, metric.least))
    return replace(metric, value=_plain_number(metric.value), paper=paper, goal=goal, least=least)


def _plain_number(value: Any) -> int | float:
    found = value.item() if isinstance(value, np.generic) else value
    return found if isinstance(found, int | float) else float(found)


def _check_statistics(mpc: Any) -> None:
    _expect("mpc", mpc, MpcStatistics)
    _number("mpc: rate_hz", mpc.rate_hz)
    _expect("mpc: solve_ms", mpc.solve_ms, dict)
    for key in ("median", "p95", "max"):
        _number(f"mpc: solve_ms: {key}", mpc.solve_ms.get(key))
    for key in ("deadline_misses", "solves", "failures", "no_step"):
        _expect(f"mpc: {key}", getattr(mpc, key), int, np.integer)


def _check_log(log: Log) -> None:
    for channel in log.channels:
        _expect("log: the name of a channel", channel, str)
        if not channel.isprintable() or channel in ("", "file"):  # NumPy's own argument has this name
            raise InputError(f"log: channel {channel!r}: a printable name is needed, and not 'file'")
        if len(channel) > _LONGEST_NAME:
            raise InputError(f"log: channel '{channel[:40]}…': its name has more than {_LONGEST_NAME} characters")
        if channel.endswith(TEXTS):
            raise InputError(f"log: channel '{channel}': {' and '.join(TEXTS)} end the names of what labels channels")
        try:
            rows = log.array(channel)
        except ValueError as error:
            raise InputError(f"log: channel '{channel}': its rows have different shapes") from error
        width = rows.shape[1] if rows.ndim == 2 else 1
        if rows.ndim not in (1, 2):
            raise InputError(f"log: channel '{channel}': rows of numbers are needed, got shape {rows.shape[1:]}")
        if channel.endswith(".time") and not (rows.ndim == 1 and np.isfinite(rows).all()):
            raise InputError(f"log: channel '{channel}': by its name these are times, finite ones, one in a row")
        if not np.isfinite(log.times(channel)).all():
            raise InputError(f"log: channel '{channel}': its times must be finite")
        if f"{channel}.time" in log.channels:
            raise InputError(f"log: channel '{channel}.time': the times of '{channel}' are kept by this name")
        for kind, known in (("names", log.names), ("units", log.units)):
            if channel in known:
                _check_texts(f"log: {kind} of '{channel}'", known[channel])
                if len(known[channel]) != width:
                    raise InputError(f"log: {kind} of '{channel}': {width} are needed, got {len(known[channel])}")


def _check_plot(where: str, plot: Any) -> None:
    _expect(where, plot, Plot, Drawing)
    _expect(f"{where}: title", plot.title, str)
    if isinstance(plot, Drawing):
        _expect(f"{where}: svg", plot.svg, str)
        return
    for key in ("x_label", "y_label"):
        _expect(f"{where}: {key}", getattr(plot, key), str)
    _expect(f"{where}: series", plot.series, list, tuple)
    for k, line in enumerate(plot.series):
        _check_series(f"{where}: series[{k}]", line)


def _check_series(where: str, line: Any) -> None:
    _expect(where, line, Series)
    for key in ("name", "signal"):
        _expect(f"{where}: {key}", getattr(line, key), str)
    sizes = []
    for key in ("x", "y"):
        _expect(f"{where}: {key}", getattr(line, key), np.ndarray, list, tuple)
        try:
            values = np.asarray(getattr(line, key))
        except ValueError:  # rows of different lengths
            values = np.zeros((0, 0))
        if values.ndim != 1 or (values.size and values.dtype.kind not in "fiub"):
            raise InputError(f"{where}: {key}: numbers (n) are needed, got shape {values.shape} of {values.dtype}")
        sizes.append(values.size)
    if sizes[0] != sizes[1]:
        raise InputError(f"{where}: x has {sizes[0]} values, y {sizes[1]}")
    if line.color is not None:
        _expect(f"{where}: color", line.color, int, np.integer)
    if line.limits is not None:
        if not isinstance(line.limits, Sequence | np.ndarray) or len(line.limits) != 2:
            raise InputError(f"{where}: limits: two numbers are needed, got {line.limits!r:.60}")
        for bound in line.limits:
            _number(f"{where}: limits", bound)


def _check_plain(where: str, value: Any, depth: int) -> None:
    """Raise :class:`InputError` for what JSON cannot hold."""
    if depth > _DEEPEST:
        raise InputError(f"settings: nested more than {_DEEPEST} deep")
    if isinstance(value, dict):
        for key, inner in value.items():
            _expect(f"{where}: a key", key, str)
            _check_plain(f"{where}: '{key}'" if depth == 0 else where, inner, depth + 1)
    elif isinstance(value, list | tuple):
        for inner in value:
            _check_plain(where, inner, depth + 1)
    elif isinstance(value, int):
        _number(where, value)
    elif not (value is None or isinstance(value, str | float | np.floating | np.integer | np.bool_)):
        raise InputError(f'{where}: {type(value).__name__} is no value of JSON; try model_dump(mode="json")')
