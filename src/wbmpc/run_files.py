"""Reads what a run has written, with everything checked that its readers take for granted: metrics.json and log.npz."""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.input_file import load_json, open_file
from wbmpc.log import TEXTS

#: Bytes of a log's arrays, at most: an hour of a run has about 0.5 GB.
LARGEST_LOG = 4 * 1024**3
#: What logs are packed to is about half of their arrays: a small file that unpacks to more than so many bytes, and so many times its own
#: size, is made to fill the memory.
LARGEST_PACKED, MOST_PACKED = 256 * 1024**2, 50
#: Numbers and texts of a metrics.json, at most: a run has some 300, and tables take a millisecond for each.
MAX_VALUES = 5_000
_DAMAGED = (
    ValueError, OSError, EOFError, LookupError, AttributeError, TypeError, MemoryError, RecursionError, SyntaxError,
)  # fmt: skip
_BROKEN_ARCHIVE = (*_DAMAGED, zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError)


def flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings by dotted key."""
    out: dict[str, Any] = {}
    for key, value in settings.items():
        out |= flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) and value else {f"{prefix}{key}": value}
    return out


def read_metrics(path: Path) -> dict[str, Any]:
    """A metrics.json: ``metrics`` (value or None, and unit, by name), ``targets`` (numbers by metric), ``settings`` and ``versions`` are
    mappings, "idealisations" are texts, empty where they are missing.

    Raises :class:`InputError` naming file and key.
    """
    data = load_json(path)
    if not isinstance(data, dict):
        raise InputError(f"{path}: an object is needed, with the key 'metrics'")
    check_amount(str(path), data)
    for key, kind, name in (
        ("experiment", str, "a text"),
        ("reason", str, "a text"),
        ("outcome", str, "a text"),
        ("completed", bool, "true or false"),
    ):
        if data.get(key) is not None and not isinstance(data[key], kind):
            raise InputError(f"{path}: key '{key}': {name} is needed, got {data[key]!r:.60}")
    for key in ("metrics", "settings", "targets", "versions"):
        if not isinstance(data.setdefault(key, {}), dict):
            raise InputError(f"{path}: key '{key}': an object is needed, got {data[key]!r:.60}")
    for name, metric in data["metrics"].items():
        check_metric(f"{path}: key 'metrics.{name}'", metric)
    for name, target in data["targets"].items():
        _check_target(f"{path}: key 'targets.{name}'", target)
    texts = data.setdefault("idealisations", [])
    if not isinstance(texts, list) or not all(isinstance(t, str) for t in (*texts, *data["versions"].values())):
        raise InputError(f'{path}: keys "idealisations" and "versions": texts are needed')
    return data


def _check_target(where: str, target: Any) -> None:
    """Raise :class:`InputError` unless a metric's goals are numbers or None."""
    numbers = [target.get(key) for key in ("paper", "goal", "least")] if isinstance(target, dict) else [""]
    if not all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in numbers):
        raise InputError(f"{where}: an object with numbers is needed, got {target!r:.60}")


def check_amount(where: str, data: Any) -> None:
    """Raise :class:`InputError` for what a JSON text says of a run if it has more than :data:`MAX_VALUES` numbers and texts;
    ``where``: what messages begin with."""
    count, left = 0, [data]
    while left:
        value = left.pop()
        if isinstance(value, dict | list):
            left += value.values() if isinstance(value, dict) else value
        else:
            count += 1
    if count > MAX_VALUES:
        raise InputError(f"{where}: has {count} numbers and texts; at most {MAX_VALUES} are read of a run")


def check_metric(where: str, metric: Any) -> None:
    """Raise :class:`InputError` unless a metric has a finite value or None, and a unit; ``where``: what messages begin with."""
    if not isinstance(metric, dict) or "value" not in metric or not isinstance(metric.get("unit"), str):
        raise InputError(f"{where}: an object with 'value' and 'unit' is needed, got {metric!r:.60}")
    value = metric["value"]
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    try:
        finite = value is None or (number and math.isfinite(value))
    except OverflowError:  # a whole number beyond all floats
        finite = False
    if not finite:
        raise InputError(f"{where}: 'value' must be a finite number or null, got {value!r:.60}")


def definition_in(data: dict[str, Any], metric: str) -> str:
    """What a metrics.json says that a metric is; ``""`` where it does not."""
    targets = data.get("targets")
    about = targets.get(metric) if isinstance(targets, dict) else None
    text = about.get("definition") if isinstance(about, dict) else None
    return text if isinstance(text, str) else ""


def read_log(path: Path) -> dict[str, np.ndarray]:
    """The channels of a log.npz: rows of numbers, (n, width) or (n,), and their times CHANNEL.time (n,) [s]; of some
    CHANNEL.names and CHANNEL.units (width,): texts, what the components are called and their units.

    Raises :class:`InputError` naming the file, and the channel that is not so.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; give a run's folder or its log.npz")
    try:
        with open_file(path) as file, zipfile.ZipFile(file) as archive:
            members = archive.infolist()
        size, names = sum(member.file_size for member in members), {member.filename for member in members}
        if len(names) < len(members):
            raise InputError(f"{path}: two of its arrays have one name")
        if size > LARGEST_LOG:
            raise InputError(f"{path}: its arrays have {size} bytes; at most {LARGEST_LOG} are read")
        packed = sum(member.compress_size for member in members)
        if size > LARGEST_PACKED and size > MOST_PACKED * packed:
            raise InputError(f"{path}: its arrays have {size} bytes, packed into {packed}: no run's are packed so well")
        with open_file(path) as file, np.load(file, allow_pickle=False) as log:
            channels = {name: log[name] for name in log.files}
    except InputError:
        raise
    except _BROKEN_ARCHIVE as error:
        raise InputError(
            f"{path}: this is not the log of a run (log.npz), or not whole: {error or type(error).__name__}"
        ) from error
    for name in sorted(
        channels, key=lambda name: not name.endswith(".time")
    ):  # times first: channels are compared with theirs
        _check_channel(path, name, channels[name], channels)
    return channels


def _check_channel(path: Path, name: str, values: Any, channels: dict[str, Any]) -> None:
    where = f"{path}: channel '{name}'"
    if name.endswith(TEXTS):
        rows = channels.get(name.rpartition(".")[0])
        width = rows.shape[1] if isinstance(rows, np.ndarray) and rows.ndim == 2 else 1
        if not isinstance(values, np.ndarray) or values.dtype.kind != "U" or values.shape != (width,):
            raise InputError(f"{where}: a text for each component of its channel is needed")
        return
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiub":
        raise InputError(f"{where}: an array of numbers is needed")
    if name.endswith(".time"):
        if values.ndim != 1 or not np.isfinite(values).all():
            raise InputError(f"{where}: finite times (n) [s] are needed, got shape {values.shape}")
        return
    times = channels.get(f"{name}.time")
    if times is None:
        return
    if values.ndim not in (1, 2) or len(values) != len(times):
        raise InputError(f"{where}: a row for each of its {len(times)} times is needed, got shape {values.shape}")
