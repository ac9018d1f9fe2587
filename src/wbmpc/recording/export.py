"""Recordings as files for other tools: CSV, NumPy, Parquet. One table for each topic."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from wbmpc.errors import InputError, unknown_name
from wbmpc.output_file import whole_file
from wbmpc.recording.reader import Recording, Table

#: Topics that are one text for the whole run, and belong into no table.
_TEXTS = ("/robot_description",)


def export(
    recording: Recording, form: str, directory: Path, topics: Sequence[str] = (),
    check: Callable[[list[Path]], None] = lambda paths: None,
) -> list[Path]:  # fmt: skip
    """Write ``topics`` (all when left out) as ``form``: csv or parquet, a file each; npz, one archive. Returns the files.

    ``check`` gets the files before any is written, and may reject them.
    """
    if form not in FORMS:
        raise unknown_name("format", form, FORMS)
    if form == "parquet":
        _parquet_module()  # before anything is written
    names = list(dict.fromkeys(topics)) or [n for n in recording.topics if n not in _TEXTS]
    stems = [recording.path.stem] if form == "npz" else [file_name(name) for name in names]
    paths = [directory / f"{stem}.{form}" for stem in stems]
    tables = {name: recording.table(name) for name in names}
    check(paths)
    directory.mkdir(parents=True, exist_ok=True)
    FORMS[form](tables, paths)
    return paths


def file_name(topic: str) -> str:
    """``ground_truth_end_effector`` for ``/ground_truth/end_effector``."""
    return topic.strip("/").replace("/", "_")


def _csv(tables: dict[str, Table], paths: list[Path]) -> None:
    for path, table in zip(paths, tables.values(), strict=True):
        with whole_file(path, follow=False) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["time", *table.columns])
            # tolist() gives Python's numbers, whose text has all their digits
            writer.writerows(zip(table.times.tolist(), *(c.tolist() for c in table.columns.values()), strict=True))


def _npz(tables: dict[str, Table], paths: list[Path]) -> None:
    """Arrays TOPIC/COLUMN and TOPIC/time, as ``end_effector_pose/pose.position.x``."""
    arrays: dict[str, np.ndarray] = {}
    for name, table in tables.items():
        arrays[f"{file_name(name)}/time"] = table.times
        arrays |= {f"{file_name(name)}/{column}": values for column, values in table.columns.items()}
    with whole_file(paths[0], follow=False) as partial:
        np.savez_compressed(partial, **arrays)  # type: ignore[arg-type]


def _parquet_module() -> tuple[object, object]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(
            "export: Parquet needs pyarrow: pip install 'wbmpc[parquet]'; valid without it: csv, npz"
        ) from error
    return pyarrow, pyarrow.parquet


def _parquet(tables: dict[str, Table], paths: list[Path]) -> None:
    import pyarrow
    import pyarrow.parquet

    for path, table in zip(paths, tables.values(), strict=True):
        with whole_file(path, follow=False) as partial:
            pyarrow.parquet.write_table(pyarrow.table({"time": table.times, **table.columns}), partial)


FORMS: dict[str, Callable[[dict[str, Table], list[Path]], None]] = {"csv": _csv, "npz": _npz, "parquet": _parquet}
