"""Files of studies and searches, and the folders of their results."""

from __future__ import annotations

import random
import shutil
import sqlite3
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from fuzzing.case import INVALID, NEVER, OPEN, VALID, Case, flipped

#: An experiment that takes no time.
_PROGRAM = """
from pydantic import BaseModel, ConfigDict, Field
from wbmpc.experiment import Experiment
from wbmpc.log import Log
from wbmpc.result import Metric, RunResult
class Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    gain: float = Field(1.0, gt=0, le=100)
    count: int = Field(1, ge=1, le=9)
    robot: str = "one"
def run(s, seed, progress=None):
    error = Metric((s.gain - 3.0) ** 2 + 0.01 * (seed % 7), "m", goal=0.5)
    return RunResult("toy", seed, True, "", {"error": error}, None, Log(), settings=s.model_dump(mode="json"))
EXPERIMENT = Experiment("toy", "a parabola", Settings, run)
"""


def _definition() -> dict[str, Any]:
    return {
        "title": "toy", "experiments": {"toy.py": {"count": 2}}, "seeds": "3-5", "settings": {"robot": "two"},
        "vary": {"gain": [1, 2.5]}, "draws": 1, "draw_seed": 0, "conditions": {"a": {"settings": {}}, "b": {}},
        "compare_with": "a", "metrics": ["error"], "larger_is_better": [], "files": "none",
    }  # fmt: skip


def _search() -> dict[str, Any]:
    return {
        "experiments": ["toy.py"], "seeds": "3-4",
        "tune": {
            "seeds": "10-11", "search": {"gain": {"from": 0.5, "to": 5}, "count": {"from": 1, "to": 4, "whole": True}},
            "minimize": [{"metric": "error", "limit": 9}], "trials": 2, "sampler": "random", "constraints": {"error": 50},
            "allow_failures": False, "sampler_seed": 1, "prune": False, "pareto": False,
        },
    }  # fmt: skip


#: Values that are of the wrong kind for most keys.
_ODD: tuple[Any, ...] = (
    None, 5, -1, 1.5, 10**20, 10**300, float("nan"), float("inf"), True, "", " ", "a", [], {}, [[]], [None], {"a": 1}, [{"a": {}}],
    {"": ""}, {"a": None}, {1: 2}, {"from": 0, "to": 1}, {"from": 0, "to": 1, "steps": 3}, {"from": -1, "to": 1, "log": True, "steps": 3},
    {"from": 0.1, "to": 1, "random": True}, {"from": 1e300, "to": 1e301, "steps": 2}, "3-2", "1-999999999", ["1", 2], "²", "a\u0000b"[:1],
    "../x", "/", "x" * 5000, "\u202e", "toy.py", ["toy.py", "toy.py"], [1e-320], "-0", [True, False], {"robot": [1]}, "1-3,2",
)  # fmt: skip


def _places(data: Any) -> list[tuple[Any, Any]]:
    """All containers with each of their keys."""
    keys = list(data) if isinstance(data, dict) else list(range(len(data))) if isinstance(data, list) else []
    return [(data, key) for key in keys] + [place for key in keys for place in _places(data[key])]


def studies(rng: random.Random, folder: Path) -> Case:
    """Files of ``wbmpc study`` and ``wbmpc tune``."""
    (folder / "toy.py").write_text(_PROGRAM)
    command = rng.choice(("study", "tune"))
    data = _definition() if command == "study" else _search()
    kind, expected, more = (
        rng.choice(("as it is", "odd", "odd", "odd", "never", "unknown", "missing", "twice")),
        OPEN,
        "",
    )
    place, key = rng.choice(_places(data))
    if kind == "as it is":
        expected = VALID
    elif kind == "odd":
        place[key] = rng.choice(_ODD)
    elif kind == "unknown":
        data[rng.choice(("titel", "seed", "", "a.b", "experiments "))], expected = 1, INVALID
    elif kind == "missing":
        del data[rng.choice(("experiments", "seeds"))]
        expected = INVALID
    elif kind == "never":
        key = rng.choice(list(data))
        del data[key]
        more, expected = f"{key}: {rng.choice(NEVER)}\n", INVALID
    else:
        more, expected = f"{rng.choice(list(data))}: 1\n", INVALID
    path, out = folder / "study.yaml", folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    Dumper = type("Dumper", (yaml.SafeDumper,), {"ignore_aliases": lambda *_: True})
    path.write_text(yaml.dump(data, Dumper=Dumper, sort_keys=False) + more, "utf-8", "surrogatepass")
    return Case(f"{command}: {kind}: {key}: {str(place)[:80]}{more[:40]!r}", expected,
                [command, str(path), "--workers", "0", "--out", str(out), "--json"], real=True)  # fmt: skip


# ---------------------------------------------------------------------- folders
@cache
def _finished(command: str) -> dict[str, bytes]:
    """The files of a study or a search that has ended."""
    import tempfile

    from wbmpc.study.study import Study

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "toy.py").write_text(_PROGRAM)
        (folder / "study.yaml").write_text(yaml.safe_dump(_definition() if command == "study" else _search()))
        found = Study.load(folder / "study.yaml", folder / "out")
        found.run(0) if command == "study" else found.tune(0)
        return {str(p.relative_to(folder / "out")): p.read_bytes() for p in (folder / "out").rglob("*") if p.is_file()}


#: What no study writes into its JSON files.
_JSON = (
    "", "[]", "5", "null", "{", "[" * 1000, '{"a": 1}', '{"combinations": []}', '{"combinations": {"a": 5}}', '"\\ud800"', '{"title": 5}', "[{}]",
    '[{"trial": 1}]', '{"cells": [{}], "lost": 5}', '{"planned": NaN}', '{"planned": "1e400"}', '{"planned": 1' + "0" * 400 + "}", "\ufeff{}",
)  # fmt: skip
_LINES = (
    "{}", "5", "[]", '{"key": 5}', '{"key": "a-1", "experiment": "toy", "outcome": "completed"}', "\x00", '{"key":', '{"key": "a-1", "outcome": []}',
    '{"key": "a-1", "experiment": "toy", "outcome": "completed", "metrics": {"error": 1.0}}',
    '{"key": "a-1", "experiment": "toy", "outcome": "completed", "metrics": {"error": "x"}, "about": {"error": {"unit": "m"}}}',
    '{"key": "a-1", "experiment": "toy", "outcome": "completed", "seed": 1e30, "draw": 99999999999999999999999}',
    '{"key": "a-1", "experiment": "toy", "outcome": "completed", "varied": 5, "timing": []}',
)  # fmt: skip


def _odd_cell(rng: random.Random, path: Path) -> str:
    """A table with one cell, or column, of another kind."""
    import pyarrow
    import pyarrow.parquet as parquet

    table = parquet.read_table(path)
    name = rng.choice(table.column_names)
    k, column = table.column_names.index(name), table[name]
    values: list[Any] = column.to_pylist()
    values[rng.randrange(len(values))] = rng.choice((None, values[0]))
    kind = rng.choice((column.type, column.type, pyarrow.string()))
    odd: Any = {"string": ["", "\x1b[31m", "{", "x" * 9000, "[]", '{"a": 1}', None], "double": [float("nan"), float("inf"), -1e308, None],
                "int64": [2**63 - 1, -(2**63), None], "bool": [None]}.get(str(kind), [None])  # fmt: skip
    made = [v if v is None else str(v) if str(kind) == "string" else v for v in values]
    made[rng.randrange(len(made))] = rng.choice(odd)
    table = table.set_column(
        k, pyarrow.field(name, kind, metadata=table.schema.field(name).metadata), pyarrow.array(made, kind)
    )
    parquet.write_table(table, path)
    return f"{name} {kind}"


def _odd_database(rng: random.Random, path: Path) -> str:
    """A search's database with one value of another kind."""
    with sqlite3.connect(path) as there:
        tables = [row[0] for row in there.execute("select name from sqlite_master where type='table'")]
        table = rng.choice(tables)
        columns = [row[1] for row in there.execute(f"pragma table_info({table})")]
        how = rng.choice(("value", "value", "value", "delete", "drop"))
        if how == "value":
            value = rng.choice((None, -1, 2**60, "x", b"\xff", 1e308, "", "{", "[1]"))
            column = rng.choice(columns)
            try:
                there.execute(f"update {table} set {column}=?", (value,))
            except sqlite3.Error as error:
                return f"no change: {error}"
            return f"{table}.{column}={value!r}"
        there.execute(f"delete from {table}" if how == "delete" else f"drop table {table}")
        return f"{how} {table}"


def folders(rng: random.Random, folder: Path) -> Case:
    """Folders of studies and searches with damaged files, gone on with, reported and listed."""
    command = rng.choice(("study", "tune"))
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    for name, data in _finished(command).items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(data)
    (folder / "toy.py").write_text(_PROGRAM)
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(_definition() if command == "study" else _search()))
    files = sorted(p for p in out.rglob("*") if p.is_file())
    chosen = rng.choice(files)
    tables = [p for p in files if p.suffix == ".parquet"]
    kind = rng.choice(
        (
            "as it is",
            "cut",
            "bytes",
            "empty",
            "gone",
            "folder",
            "json",
            "line",
            "cell",
            "cell",
            "database",
            "database",
            "part",
        )
    )
    expected, about = OPEN, ""
    if kind == "as it is":
        expected = VALID
    elif kind == "cut":
        chosen.write_bytes(chosen.read_bytes()[: rng.randint(0, chosen.stat().st_size)])
    elif kind == "bytes" and chosen.stat().st_size:
        chosen.write_bytes(flipped(rng, chosen.read_bytes()))
    elif kind in ("empty", "gone", "folder"):
        chosen.unlink()
        if kind != "gone":
            chosen.touch() if kind == "empty" else chosen.mkdir()
    elif kind == "json":
        chosen = rng.choice([p for p in files if p.suffix == ".json"])
        about = rng.choice(_JSON)
        chosen.write_text(about, "utf-8")
    elif kind == "line":
        about = rng.choice(_LINES)
        chosen = out / rng.choice(("", "trials", "report")) / "journal.jsonl"
        chosen.parent.mkdir(exist_ok=True)
        chosen.write_text(f"{about}\n" * rng.randint(1, 2))
    elif kind == "cell":
        chosen = rng.choice(tables)
        about = _odd_cell(rng, chosen)
    elif kind == "database" and command == "tune":
        chosen = next(p for p in files if p.suffix == ".db")
        about = _odd_database(rng, chosen)
    elif kind == "part":
        source = rng.choice(tables)
        name = rng.choice(("000001", "1²", "9" * 200, "1", "0", "1 ", "1\n"))
        (source.parent / "parts").mkdir(exist_ok=True)
        chosen = source.parent / "parts" / f"{name}.parquet"
        shutil.copy(source, chosen)
        (source.parent / "journal.jsonl").write_text("")
    todo = rng.choice(([command, str(path), "--workers", "0", "--out", str(out), "--json"], ["runs", str(folder), "--json"],
                       ["study", str(path), "--report", "--out", str(out)]))  # fmt: skip
    if todo[0] == "study" and command == "tune":
        expected = INVALID if kind == "as it is" else OPEN
    return Case(
        f"{todo[0]} of a {command}: {kind}: {chosen.relative_to(folder)}: {about[:80]!r}", expected, todo, real=True
    )
