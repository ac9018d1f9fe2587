"""The rows of a study on the disk: a line of a journal as soon as a run ends, Parquet in the end.

A study's folder has ``journal.jsonl`` (finished runs that are in no Parquet file yet), ``parts/`` (each some thousand rows), and at
the end of a session ``runs.parquet``, one row per run. Whatever is interrupted, killed or finds the disk full: at most the line
that was being written is lost, and with it one run.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self, TextIO

from wbmpc.errors import InputError, NotWritten
from wbmpc.input_file import open_file, read_file
from wbmpc.output_file import whole_file
from wbmpc.study.files import ABOUT, BEST, DATABASE, JOURNAL, LOCK, PAGE, PARTS, ROWS, STATISTICS, TRIALS
from wbmpc.study.rows import check_rows, check_targets
from wbmpc.study.work import ERROR, LOST

if TYPE_CHECKING:
    import pyarrow

MISSING = "studies need Dask, Optuna and pyarrow: pip install 'wbmpc[study]'"
#: Rows of a part, bytes of a journal of as many, and rows of a Parquet file, at most.
PART, LARGEST, MAX_ROWS = 5000, 256 * 1024 * 1024, 1_000_000
#: Rows of a Parquet file that are read at a time, and bytes of all of them, at most: a million rows have some hundred bytes each.
BATCH, LARGEST_TABLE = 5000, 4 * 1024**3
_OPEN_LOCK = os.O_RDWR | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC
#: What each row has: of which run it is. Texts.
_OF_RUN = ("key", "experiment", "outcome")
#: Where a file's metadata has goals and papers' figures of metrics, by combination.
TARGETS = "targets"
#: Metadata of a metric's column whose small values are the bad ones.
LARGER = {"larger_is_better": "yes"}
Targets = dict[str, dict[str, dict[str, float | None]]]
_TEXTS = (
    "key", "experiment", "condition", "robot", "outcome", "reason", "started", "version", "commit", "code", "host",
    "files",
)  # fmt: skip


def parquet() -> Any:
    """pyarrow.parquet. Raises :class:`InputError` where it is not installed."""
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(MISSING) from error
    return pyarrow.parquet


def is_running(folder: Path) -> bool:
    """Whether a process has the lock on a study's folder."""
    # not waiting for the reader of a pipe in its place
    with open(folder / LOCK, "r+b", buffering=0, opener=lambda path, _: os.open(path, _OPEN_LOCK, 0o666)) as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


class Store:
    """Rows of a study in ``folder``; a context, with a lock on the folder. Raises :class:`InputError` if another process has it."""

    def __init__(self, folder: Path) -> None:
        parquet()
        self.folder = folder
        self._journal = folder / JOURNAL
        self._lines: TextIO | None = None
        self._count = 0

    def __enter__(self) -> Self:
        self.folder.mkdir(parents=True, exist_ok=True)
        for name in (LOCK, ABOUT, JOURNAL, ROWS, STATISTICS, TRIALS, DATABASE, BEST, PAGE):
            path = self.folder / name
            if path.is_fifo() or path.is_dir():  # writing into a pipe would wait for its reader
                raise InputError(f"{path}: is a pipe or a folder; remove it, or give another --out")
        for name in (LOCK, ABOUT, JOURNAL, ROWS, PARTS, STATISTICS, TRIALS, DATABASE, BEST, PAGE):
            if (self.folder / name).is_symlink():
                raise InputError(
                    f"{self.folder / name}: is a link: another file would be written; remove it, or give another --out"
                )
        self._lock = (self.folder / LOCK).open("w")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._lock.close()
            raise InputError(f"{self.folder}: another study is running here; give another --out") from error
        self._recover()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._close()
        self._lock.close()

    @contextmanager
    def finishing(self) -> Iterator[None]:
        """Runs in here add rows; in the end, and where it is interrupted, they become Parquet. Where nothing can be written the journal
        keeps them."""
        try:
            yield
        except NotWritten:
            raise
        except BaseException:
            self.finish()
            raise
        self.finish()

    def _close(self) -> None:
        if self._lines is not None:
            with suppress(OSError):  # of what a full disk did not take
                self._lines.close()
            self._lines = None

    def _recover(self) -> None:
        """A line that was not finished when the disk or the process ended is cut off."""
        if not self._journal.is_file():
            return
        data = read_file(self._journal, LARGEST)
        whole = data[: data.rfind(b"\n") + 1]
        self._count = whole.count(b"\n")
        if len(whole) < len(data):
            with self._journal.open("r+b") as file:
                file.truncate(len(whole))

    def add(self, row: Mapping[str, Any]) -> None:
        """Keep a row. Raises :class:`NotWritten`."""
        try:
            if self._lines is None:
                self._lines = self._journal.open("a", encoding="utf-8")
            self._lines.write(json.dumps(row, separators=(",", ":")) + "\n")
            self._lines.flush()
        except OSError as error:
            self._close()
            self._recover()  # what a full disk took of the line
            raise NotWritten(
                f"{self._journal}: cannot be written ({error.strerror}); what was finished before is kept, the same command continues"
            ) from error
        self._count += 1
        if self._count >= PART:
            self._make_part()

    def _journal_rows(self) -> list[dict[str, Any]]:
        if not self._journal.is_file():
            return []
        try:
            rows = [json.loads(line) for line in read_file(self._journal, LARGEST).decode("utf-8").splitlines()]
        except (ValueError, RecursionError) as error:
            raise InputError(f"{self._journal}: this is no journal of a study ({error})") from error
        check_rows(self._journal, rows)
        return rows

    def _make_part(self) -> None:
        rows = self._journal_rows()
        if not rows:
            return
        parts = self.folder / PARTS
        parts.mkdir(exist_ok=True)
        number = 1 + max((int(p.stem) for p in parts.glob("[0-9]*.parquet") if p.stem.isdecimal()), default=0)
        with whole_file(parts / f"{number:06d}.parquet", follow=False) as partial:
            parquet().write_table(table_of(rows), partial)
        self._close()
        self._journal.unlink()  # killed before this line: its rows are there twice, and the later one counts
        self._count = 0

    def _files(self) -> list[Path]:
        whole = self.folder / ROWS
        return [*([whole] if whole.is_file() else []), *sorted((self.folder / PARTS).glob("[0-9]*.parquet"))]

    def outcomes(self) -> dict[str, dict[str, Any]]:
        """By key of a run: its ``experiment``, ``outcome`` and ``wall_time`` [s], nan where it is not known."""
        names = ("key", "experiment", "outcome", "wall_time")
        found: dict[str, dict[str, Any]] = {}
        for path in self._files():
            found |= {row["key"]: row for row in _read(path, list(names)).to_pylist()}
        for row in self._journal_rows():
            found[row["key"]] = {name: row.get(name, float("nan")) for name in names}
        return found

    def done(self) -> set[str]:
        """Keys of runs that have a result."""
        return {key for key, row in self.outcomes().items() if row["outcome"] not in (ERROR, LOST)}

    def finish(self) -> Path | None:
        """Put all rows into one Parquet file, one per run, part by part; returns it, None without rows. Raises :class:`NotWritten`."""
        self._make_part()
        files = self._files()
        target = self.folder / ROWS
        if not files:
            return None
        if files == [target]:
            return target
        latest = {row: path for path in files for row in _read(path, ["key"])["key"].to_pylist()}
        with whole_file(target, follow=False) as partial:
            _merge(files, latest, partial)
        for path in files:
            if path != target:
                path.unlink()
        with suppress(OSError):
            (self.folder / PARTS).rmdir()
        return target

    def keep(self, combinations: set[str]) -> None:
        """Remove the rows of all other combinations. Raises :class:`NotWritten`."""
        import pyarrow

        if all(combination_of(key) in combinations for key in self.outcomes()):
            return
        self.finish()
        table = self.table()
        wanted = [combination_of(key) in combinations for key in table["key"].to_pylist()]
        with whole_file(self.folder / ROWS, follow=False) as partial:
            parquet().write_table(table.filter(pyarrow.array(wanted)), partial)

    def table(self, columns: list[str] | None = None) -> pyarrow.Table:
        """All rows that are in Parquet; see :meth:`finish`."""
        return _read(self.folder / ROWS, columns)


def _check_table(path: Path) -> None:
    """Raise :class:`InputError` for a Parquet file of other columns than a study's, or of too many rows: before they are unpacked."""
    import pyarrow
    import pyarrow.types as types

    with open_file(path) as file:
        about = parquet().read_metadata(file)
    if about.num_rows > MAX_ROWS:
        raise InputError(f"{path}: has {about.num_rows} rows; at most {MAX_ROWS} are read")
    schema = about.schema.to_arrow_schema()
    if len(set(schema.names)) < len(schema.names):
        raise InputError(f"{path}: has a column twice; this was not written by a study")
    for name in _OF_RUN:
        if name not in schema.names or not types.is_string(schema.field(name).type):
            raise InputError(f"{path}: column '{name}' of texts is missing; this was not written by a study")
    kinds = {field.name: field.type for field in table_of([]).schema}
    for field in schema:
        kind = kinds.get(field.name, pyarrow.float64() if field.name.startswith("metric.") else field.type)
        if field.type != kind:
            raise InputError(f"{path}: column '{field.name}' is of {field.type}, not of {kind}; no study wrote this")
    check_targets(path, (schema.metadata or {}).get(TARGETS.encode(), b"{}"))


def _read(path: Path, columns: list[str] | None) -> pyarrow.Table:
    import pyarrow

    try:
        _check_table(path)
        with open_file(path) as file:
            found = _unpacked(path, file, columns)
    except (OSError, pyarrow.ArrowException) as error:
        raise InputError(f"{path}: this is no Parquet file of a study, or not whole ({error})") from error
    if any(found[name].null_count for name in _OF_RUN if name in found.column_names):
        raise InputError(f"{path}: has rows that do not say of which run they are; this was not written by a study")
    return found


def _unpacked(path: Path, file: BinaryIO, columns: list[str] | None) -> pyarrow.Table:
    """The rows of a Parquet file, some at a time, until they are more than :data:`LARGEST_TABLE`. Texts that are there once and stand in a
    million rows are counted before they are copied."""
    import pyarrow
    import pyarrow.compute as compute
    import pyarrow.types as types

    kinds = parquet().read_schema(file)
    source = parquet().ParquetFile(file, read_dictionary=[f.name for f in kinds if types.is_string(f.type)])
    about, size, found = source.metadata, 0, []
    too_large = InputError(f"{path}: unpacks to more than {LARGEST_TABLE} bytes; at most so many are read")
    stored = (about.row_group(i).column(j) for i in range(about.num_row_groups) for j in range(about.num_columns))
    if sum(c.total_uncompressed_size for c in stored if columns is None or c.path_in_schema in columns) > LARGEST_TABLE:
        raise too_large
    for batch in source.iter_batches(BATCH, columns=columns):
        for column in batch.columns:
            size += column.nbytes
            if types.is_dictionary(column.type):
                lengths = compute.binary_length(column.dictionary).take(column.indices)
                size += compute.sum(lengths).as_py() or 0
        if size > LARGEST_TABLE:
            raise too_large
        found.append(batch)
    chosen = [f for f in kinds if columns is None or f.name in columns]
    table = pyarrow.Table.from_batches(found, schema=None if found else pyarrow.schema(chosen))
    plain = [kinds.field(name) for name in table.column_names]
    return table.unify_dictionaries().cast(pyarrow.schema(plain, kinds.metadata))


def _merge(files: list[Path], latest: Mapping[str, Path], target: Path) -> None:
    """Rows of all files, of each run the latest, as a file whose columns are those of all."""
    import pyarrow

    schema = _unified([parquet().read_schema(path) for path in files])
    with parquet().ParquetWriter(target, schema) as writer:
        for path in files:
            table = _read(path, None)
            last = {key: k for k, key in enumerate(table["key"].to_pylist())}
            keep = [last[key] == k and latest[key] == path for k, key in enumerate(table["key"].to_pylist())]
            table = table.filter(pyarrow.array(keep))
            columns = [
                table[f.name].cast(f.type) if f.name in table.column_names else pyarrow.nulls(len(table), f.type)
                for f in schema
            ]
            writer.write_table(pyarrow.table(columns, schema=schema))


def _unified(schemas: list[Any]) -> Any:
    """Columns of all schemas; one that is of numbers here and of texts there is of texts."""
    import pyarrow

    fields: dict[str, Any] = {}
    for field in (f for schema in schemas for f in schema):
        known = fields.get(field.name)
        if known is None or known.type == pyarrow.null():
            fields[field.name] = field
        elif known.type != field.type and field.type != pyarrow.null():
            fields[field.name] = known.with_type(pyarrow.string())
    targets: Targets = {}
    for found in map(targets_of, schemas):
        for combination, of in found.items():
            targets.setdefault(combination, {}).update(of)
    return pyarrow.schema(list(fields.values()), {TARGETS: json.dumps(targets)})


def table_of(rows: list[dict[str, Any]]) -> pyarrow.Table:
    """Rows as columns: ``set.KEY`` for what is varied, ``metric.NAME`` with the unit, and :data:`LARGER`, in the field's metadata."""
    import pyarrow

    columns: dict[str, tuple[Any, Any, dict[str, str]]] = {}
    for name in _TEXTS:
        columns[name] = (pyarrow.string(), [row.get(name, "") for row in rows], {})
    for name in ("seed", "draw"):
        columns[name] = (pyarrow.int64(), [row.get(name, 0) for row in rows], {})
    columns["completed"] = (pyarrow.bool_(), [row["outcome"] == "completed" for row in rows], {})
    for name in ("wall_time", "cpu_time"):
        columns[name] = (pyarrow.float64(), [row.get(name, float("nan")) for row in rows], {"unit": "s"})
    columns["changes"] = (pyarrow.string(), [json.dumps(row.get("changes", {}), sort_keys=True) for row in rows], {})
    for name in _names(rows, "timing"):
        columns[name] = (pyarrow.float64(), [row.get("timing", {}).get(name) for row in rows], {})
    for key in _names(rows, "varied"):
        values = [row.get("varied", {}).get(key) for row in rows]
        numeric = all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in values)
        made = [v if v is None or numeric or isinstance(v, str) else json.dumps(v) for v in values]
        columns[f"set.{key}"] = (pyarrow.float64() if numeric else pyarrow.string(), made, {})
    for name in _names(rows, "metrics"):
        about = next(row["about"][name] for row in rows if name in row.get("metrics", {}))
        values = [row.get("metrics", {}).get(name) for row in rows]
        larger = LARGER if about.get("larger_is_better") else {}
        columns[f"metric.{name}"] = (pyarrow.float64(), values, {"unit": about["unit"], **larger})
    fields = [pyarrow.field(name, kind, metadata=about) for name, (kind, _, about) in columns.items()]
    arrays = [pyarrow.array(values, kind) for kind, values, _ in columns.values()]
    targets: Targets = {}
    for row in rows:
        of = targets.setdefault(combination_of(row.get("key", "")), {})
        of.update({n: {k: about[k] for k in ("paper", "goal", "least")} for n, about in row.get("about", {}).items()})
    return pyarrow.table(arrays, schema=pyarrow.schema(fields, {TARGETS: json.dumps(targets)}))


def combination_of(key: str) -> str:
    """The key of the combination that a row's key begins with."""
    return key.rpartition("-")[0]


def targets_of(schema: Any) -> Targets:
    """By combination and metric: the paper's figure, largest and smallest value of the goal, each None where there is none."""
    found: Targets = json.loads((schema.metadata or {}).get(TARGETS.encode(), b"{}"))
    return found


def _names(rows: list[dict[str, Any]], part: str) -> Iterator[str]:
    return iter(dict.fromkeys(name for row in rows for name in row.get(part, {})))
