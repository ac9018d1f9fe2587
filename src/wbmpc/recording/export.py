"""Recordings as files for other tools: CSV, NumPy, Parquet. One table for each topic."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from wbmpc.errors import InputError, unknown_name
from wbmpc.recording.reader import Recording, Table

#: Topics that are one text for the whole run, and belong into no table.
_TEXTS = ("/robot_description",)


def export(recording: Recording, form: str, directory: Path, topics: Sequence[str] = ()) -> list[Path]:
    """Write ``topics`` (all when left out) as ``form``: csv or parquet, a file each; npz, one archive. Returns the files."""
    if form not in FORMS:
        raise unknown_name("format", form, FORMS)
    if form == "parquet":
        _parquet_module()  # before anything is written
    names = list(topics) or [n for n in recording.topics if n not in _TEXTS]
    tables = {name: recording.table(name) for name in names}
    directory.mkdir(parents=True, exist_ok=True)
    return FORMS[form](tables, directory, recording.path.stem)


def file_name(topic: str) -> str:
    """``hand_pose`` for ``/hand/pose``."""
    return topic.strip("/").replace("/", "_")


def _csv(tables: dict[str, Table], directory: Path, stem: str) -> list[Path]:
    paths = []
    for name, table in tables.items():
        path = directory / f"{file_name(name)}.csv"
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["time", *table.columns])
            # tolist() gives Python's numbers, whose text has all their digits
            writer.writerows(zip(table.times.tolist(), *(c.tolist() for c in table.columns.values()), strict=True))
        paths.append(path)
    return paths


def _npz(tables: dict[str, Table], directory: Path, stem: str) -> list[Path]:
    """Arrays TOPIC/COLUMN and TOPIC/time, as ``hand_pose/pose.position.x``."""
    arrays: dict[str, np.ndarray] = {}
    for name, table in tables.items():
        arrays[f"{file_name(name)}/time"] = table.times
        arrays |= {f"{file_name(name)}/{column}": values for column, values in table.columns.items()}
    path = directory / f"{stem}.npz"
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]
    return [path]


def _parquet_module() -> tuple[object, object]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            "export: Parquet needs pyarrow: pip install 'wbmpc[parquet]'; valid without it: csv, npz"
        ) from error
    return pyarrow, pyarrow.parquet


def _parquet(tables: dict[str, Table], directory: Path, stem: str) -> list[Path]:
    import pyarrow
    import pyarrow.parquet

    paths = []
    for name, table in tables.items():
        path = directory / f"{file_name(name)}.parquet"
        pyarrow.parquet.write_table(pyarrow.table({"time": table.times, **table.columns}), path)
        paths.append(path)
    return paths


FORMS: dict[str, Callable[[dict[str, Table], Path, str], list[Path]]] = {
    "csv": _csv,
    "npz": _npz,
    "parquet": _parquet,
}
