"""Two runs side by side: their figures in a table, their signals over each other."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.result import Plot, Series
from wbmpc.robots import SwerveBaseDescription, load_description

#: Components of a channel, at most, that are drawn.
MOST_LINES = 6
#: What the components of channels are called, by the first word of their names; those of wheels are the robot's.
_PLACES = {"base": ("x", "y", "yaw"), "hand": ("x", "y", "z", "qw", "qx", "qy", "qz"), "force": ("x", "y", "z")}
_WHEELS = ("leg", "brake", "steer", "wheel")


def load(directory: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """metrics.json and log.npz of a run. Raises :class:`InputError` if they are not there."""
    for name in ("metrics.json", "log.npz"):
        if not (directory / name).is_file():
            raise InputError(f"{directory}: is not the directory of a run: there is no {name}")
    try:
        metrics = json.loads((directory / "metrics.json").read_text())
        with np.load(directory / "log.npz") as log:
            return metrics, {name: log[name] for name in log.files}
    except (ValueError, OSError) as error:
        raise InputError(f"{directory}: metrics.json or log.npz cannot be read: {error}") from error


def table(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each metric of either run: ``metric``, ``unit``, ``values`` (a, b), ``change`` of b against a (1)."""
    names = dict.fromkeys(name for run in runs for name in run["metrics"])
    rows = []
    for name in names:
        found = [run["metrics"].get(name, {}) for run in runs]
        a, b = (m.get("value") for m in found)
        change = (b - a) / abs(a) if a not in (None, 0) and b is not None else None
        unit = next(m["unit"] for m in found if m)
        rows.append({"metric": name, "unit": unit, "values": [a, b], "change": change})
    return rows


def differences(runs: list[dict[str, Any]]) -> dict[str, list[Any]]:
    """Settings that the runs do not share, by dotted key: both values."""
    flat = [_flat(run.get("settings", {})) for run in runs]
    keys = dict.fromkeys(key for settings in flat for key in settings)
    both = {key: [settings.get(key) for settings in flat] for key in keys}
    if runs[0]["seed"] != runs[1]["seed"]:
        both = {"seed": [run["seed"] for run in runs], **both}
    return {key: values for key, values in both.items() if values[0] != values[1]}


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in tree.items():
        out |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return out


def wheels(run: dict[str, Any]) -> tuple[str, ...]:
    """What the wheels of a run's robot are called; nothing where that is not known."""
    robot = run.get("settings", {}).get("robot")
    try:
        base = load_description(robot).base if isinstance(robot, str) else None
    except InputError:  # a file that is elsewhere
        return ()
    return (
        tuple(m.wheel.removeprefix("wheel_") for m in base.modules) if isinstance(base, SwerveBaseDescription) else ()
    )


def _components(channel: str, count: int, modules: tuple[str, ...]) -> tuple[str, ...]:
    """Names of a channel's components: numbers where none are known."""
    kind = channel.split(".")[-1].split("_")[0]
    names = modules if kind in _WHEELS and len(modules) == count else _PLACES.get(kind, ())
    known = len(names) == count or (kind == "hand" and count == 3)
    return names[:count] if known else tuple(f"[{i}]" for i in range(count))


def overlay(logs: list[dict[str, np.ndarray]], names: list[str], modules: tuple[str, ...] = ()) -> list[Plot]:
    """A plot for each channel that both runs have; the second run has the same colours, dashed. ``modules``: :func:`wheels`."""
    channels = [c for c in logs[0] if f"{c}.time" in logs[0] and f"{c}.time" in logs[1]]
    return [Plot(channel, "time [s]", channel, _lines(channel, logs, names, modules)) for channel in channels]


def _lines(channel: str, logs: list[dict[str, np.ndarray]], names: list[str], modules: tuple[str, ...]) -> list[Series]:
    lines = []
    for k, (log, name) in enumerate(zip(logs, names, strict=True)):
        rows = np.atleast_2d(log[channel].T)
        parts = _components(channel, len(rows), modules)
        for i, row in enumerate(rows[:MOST_LINES]):
            label = f"{name} {parts[i]}" if len(rows) > 1 else name
            lines.append(Series(label, log[f"{channel}.time"], row, dashed=k == 1, colour=i))
    return lines
