"""Studies that run, are killed and go on. Truth: an experiment whose figures are known in closed form."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import shutil
import threading
from pathlib import Path
from typing import Any

import pytest
from valley import error

from wbmpc.cli import main
from wbmpc.errors import InputError, NotWritten
from wbmpc.result import RunResult
from wbmpc.study.files import LOCK
from wbmpc.study.store import Store, is_running
from wbmpc.study.study import Study, row_about
from wbmpc.study.work import execute

pytest.importorskip("pyarrow")
from studies import TEXT, study


def test_goals_may_differ_between_conditions(tmp_path: Path) -> None:
    """Truth: 0.25 m of error and what seeds add, for either goal."""
    text = TEXT.replace("far: {settings: {control.gain: 5}}", "strict: {settings: {control.gain: 2.5, goal: 0.1}}")
    summary = Study.load(study(tmp_path, text.replace("fall_from: 308", "")), tmp_path / "out").run(workers=0)
    found = {c["condition"]: c["metrics"]["error"] for c in summary.to_json()["cells"]}
    assert {name: (f["goal"], f["met"]) for name, f in found.items()} == {"near": (0.5, True), "strict": (0.1, False)}


def test_a_row_for_each_run_and_what_they_say(tmp_path: Path) -> None:
    made = Study.load(study(tmp_path), tmp_path / "out")
    summary = made.run(workers=0)
    rows = made.table().to_pylist()
    assert len(rows) == 20 and sum(r["completed"] for r in rows) == 16
    for row in rows:
        gain = json.loads(row["changes"])["control.gain"]
        expected = 1e-6 if row["seed"] >= 308 else error(gain, 0.0, row["seed"])
        assert row["metric.error"] == pytest.approx(expected) and row["version"] and row["wall_time"] > 0.0
        assert row["solve_ms_median"] == pytest.approx(2.0)
    near, far = summary.cells
    s = summary.spread(near, "error")
    # of ten runs two fell: they count as infinitely bad, whatever they measured
    assert s.median == pytest.approx(0.25 + 0.01 * 4.5) and s.worst == float("inf") and near.failures.failed == 2
    compared = summary.comparison(far, "error")
    assert compared is not None and summary.comparison(near, "error") is None
    assert (compared.difference, compared.wins, compared.losses) == (pytest.approx(4.0 - 0.25), 0, 8)
    assert json.loads((tmp_path / "out" / "statistics.json").read_text())["finished"] == 20
    page = (tmp_path / "out" / "index.html").read_text()
    assert "a valley" in page and "seed by seed" in page and "it fell" in page


def test_outcomes_that_a_condition_accepts_are_no_failures(tmp_path: Path) -> None:
    """Seeds 308 and 309 end as declined, with an error of 1e-6: their figures count where that is accepted, and the tables count them apart."""
    text = TEXT.replace("fall_from: 308", "fall_from: 308, failure: declined")
    text = text.replace("far: {settings: {control.gain: 5}}", "far: {settings: {control.gain: 5}, accept: [declined]}")
    strict, accepting = Study.load(study(tmp_path, text), tmp_path / "out").run(workers=0).to_json()["cells"]
    for cell, failed in ((strict, 2), (accepting, 0)):
        assert cell["failures"]["failed"] == failed and cell["outcomes"] == {"completed": 8, "declined": 2}
    assert strict["metrics"]["error"]["worst"] is None
    assert accepting["metrics"]["error"]["worst"] == pytest.approx(error(5.0, 0.0, 307))


def test_it_goes_on_and_errors_are_tried_again(tmp_path: Path) -> None:
    file = study(tmp_path, TEXT.replace("fall_from: 308", "raise_at: 304"))
    made = Study.load(file, tmp_path / "out")
    lost = made.run(workers=0).lost
    assert list(lost.values()) == [2] and next(iter(lost)).endswith("its run fails: ZeroDivisionError: of this seed")
    began = {r["key"]: r["started"] for r in made.table().to_pylist()}
    again = Study.load(file, tmp_path / "out").run(workers=0)
    rows = {r["key"]: r for r in made.table().to_pylist()}
    assert len(rows) == len(made.table()) == 20 and again.finished == 18
    assert {r["seed"] for key, r in rows.items() if r["started"] != began[key]} == {304}


def test_a_changed_setting_in_a_half_done_study_is_named(tmp_path: Path) -> None:
    Study.load(study(tmp_path), tmp_path / "out").run(workers=0)
    changed = Study.load(study(tmp_path, TEXT.replace("2.5", "2.25")), tmp_path / "out")
    with pytest.raises(InputError, match=r"10 of its 20 runs .* near: control.gain was 2.5, is 2.25; change the study"):
        changed.run(workers=0)
    sweep = lambda gains: re.sub(r"(?m)^conditions:\n(?:  .*\n)+", f"vary: {{control.gain: {gains}}}\n", TEXT)
    Study.load(study(tmp_path, sweep("[2.5, 4]")), tmp_path / "swept").run(workers=0)
    with pytest.raises(InputError, match=r"control.gain was 4.0, is 4.5; change"):
        Study.load(study(tmp_path, sweep("[2.5, 4.5]")), tmp_path / "swept").run(workers=0)
    more = Study.load(study(tmp_path, TEXT.replace("300-309", "300-311")), tmp_path / "out")
    assert more.run(workers=0).finished == 24  # more seeds are no change


def test_a_line_that_was_not_finished_costs_one_run(tmp_path: Path) -> None:
    made = Study.load(study(tmp_path), tmp_path / "out")
    rows = iter(made.runs())
    with Store(made.out) as store:  # a process that was killed: no Parquet, half a line
        for run in (next(rows), next(rows), next(rows)):
            store.add({"key": run.key, "seed": run.seed, **execute(made._task(run))})
    journal = made.out / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-9])
    with Store(made.out) as store:
        assert len(store.done()) == 2
    assert made.run(workers=0).finished == 20 and not journal.exists()


def test_a_full_disk_is_one_message(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        (tmp_path / "journal.jsonl").symlink_to("/dev/full")
        with pytest.raises(NotWritten, match=r"journal.jsonl: cannot be written \(No space left on device\)"):
            store.add({"key": "a-1", "outcome": "completed"})


ROW = {"key": "a-1", "experiment": "VALLEY", "outcome": "completed"}


#: What makes a row one that no study has written.
FOREIGN: tuple[dict[str, Any], ...] = (
    {"outcome": None}, {"metrics": 5}, {"metrics": {"e": "x"}}, {"metrics": {"f": 1.0}}, {"about": {"e": {}}}, {"about": 5},
    {"about": {"e": {"unit": 5}}}, {"about": {"e": {"unit": "m", "goal": "x"}}}, {"seed": "x"}, {"seed": 2**70}, {"draw": 1.5},
    {"about": {"e": {"unit": "m", "goal": 1.0}}},
    {"varied": [1]}, {"changes": 5}, {"timing": [1]}, {"timing": {"a": "x"}}, {"wall_time": "x"}, {"condition": 5},
)  # fmt: skip


@pytest.mark.parametrize(
    "line", ["[" * 100_000, "5", "{}", '{"key": [1]}', *(json.dumps({**ROW, **f}) for f in FOREIGN)]
)
def test_a_journal_of_another_program_is_an_error(line: str, tmp_path: Path) -> None:
    (tmp_path / "journal.jsonl").write_text(line + "\n")
    with Store(tmp_path) as store, pytest.raises(InputError, match=r"journal.jsonl: "):
        store.outcomes()


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"a": [1]}, "column 'key' of texts is missing"),
        ({**{name: [text] for name, text in ROW.items()}, "key": [5]}, "column 'key' of texts is missing"),
        ({name: [text, None] for name, text in ROW.items()}, "rows that do not say of which run"),
        ({name: [text] * 1_000_001 for name, text in ROW.items()}, "has 1000001 rows; at most 1000000"),
        ({**{name: [text] for name, text in ROW.items()}, "seed": ["x"]}, "column 'seed' is of string, not of int64"),
        ({**{name: [text] for name, text in ROW.items()}, "metric.e": ["x"]}, "'metric.e' is of string, not of double"),
    ],
)
def test_a_table_of_another_program_is_an_error(columns: dict[str, Any], says: str, tmp_path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    count = len(next(iter(columns.values())))
    rows = pyarrow.table({**columns, "wall_time": [1.0] * count})
    pyarrow.parquet.write_table(rows, tmp_path / "runs.parquet")
    with Store(tmp_path) as store:
        for read in (store.outcomes, store.table):
            with pytest.raises(InputError, match=f"runs.parquet: .*{says}"):
                read()


@pytest.mark.parametrize(
    "goals", [b"{", b"[]", b'{"a": {"e": {"goal": "x"}}}', b'{"a": {"e": {"goal": 1.0}}}', b"\xff", b"[" * 100_000]
)
def test_goals_of_another_program_are_an_error(goals: bytes, tmp_path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    rows = pyarrow.table({name: [text] for name, text in ROW.items()})
    pyarrow.parquet.write_table(rows.replace_schema_metadata({"targets": goals}), tmp_path / "runs.parquet")
    with Store(tmp_path) as store, pytest.raises(InputError, match=r"runs\.parquet: goals of metrics: "):
        store.outcomes()


def test_a_table_with_a_column_twice_is_an_error(tmp_path: Path) -> None:
    """Also with one that every row has: looked up by its name it was an error of Python's."""
    import pyarrow
    import pyarrow.parquet

    columns = [*ROW.items(), ("key", "a-2")]
    rows = pyarrow.table([[text] for _, text in columns], names=[name for name, _ in columns])
    pyarrow.parquet.write_table(rows, tmp_path / "runs.parquet")
    with Store(tmp_path) as store:
        for read in (store.outcomes, store.table):
            with pytest.raises(InputError, match=r"runs\.parquet: has a column twice"):
                read()


def test_a_pipe_among_the_parts_is_an_error(tmp_path: Path) -> None:
    """Whoever lists the studies of a folder, or goes on with one, would wait for its writer; and for a reader of one in the lock's place. The
    thread that would is not waited for."""
    (tmp_path / "parts").mkdir()
    os.mkfifo(tmp_path / "parts/000001.parquet")
    os.mkfifo(tmp_path / LOCK)
    said: list[str] = []

    def read() -> None:
        is_running(tmp_path)
        try:
            Store(tmp_path).outcomes()
        except InputError as error:
            said.append(str(error))

    reading = threading.Thread(target=read, daemon=True)
    reading.start()
    reading.join(30.0)
    assert said == [f"{tmp_path}/parts/000001.parquet: is no regular file"]


@pytest.mark.parametrize("name", [".lock", "study.json", "journal.jsonl", "runs.parquet", "index.html"])
def test_a_pipe_in_a_studys_folder_is_an_error(name: str, tmp_path: Path) -> None:
    """Writing into it would wait for its reader."""
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match=f"{name}: is a pipe or a folder"), Store(tmp_path):
        pass


class Full:
    """A file on a disk that takes some bytes of what is written."""

    def __init__(self, path: Path, room: int) -> None:
        self._path, self._room = path, room

    def write(self, text: str) -> None:
        with self._path.open("a") as file:
            file.write(text[: self._room])
        raise OSError(errno.ENOSPC, "No space left on device")

    def close(self) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("room", [0, 40])
def test_a_disk_that_is_full_in_a_study_costs_one_run_and_is_the_message(
    room: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third row does not fit whole. Truth: what the disk had taken of it; all runs are there once there is room."""
    made, add, count = Study.load(study(tmp_path), tmp_path / "out"), Store.add, 0

    def counted(self: Store, row: dict[str, Any]) -> None:
        nonlocal count
        count += 1
        if count == 3:
            assert self._lines is not None
            self._lines.close()
            self._lines = Full(made.out / "journal.jsonl", room)  # type: ignore[assignment]
        add(self, row)

    monkeypatch.setattr(Store, "add", counted)
    with pytest.raises(NotWritten, match=r"journal.jsonl: cannot be written \(No space left on device\); what was"):
        made.run(workers=0)
    assert (made.out / "journal.jsonl").read_bytes().count(b"\n") == 2 and not list(made.out.glob("*.parquet"))
    monkeypatch.undo()
    assert made.run(workers=0).finished == 20


def test_two_studies_do_not_write_into_one_folder(tmp_path: Path) -> None:
    with Store(tmp_path), pytest.raises(InputError, match="another study is running here"), Store(tmp_path):
        pass


def test_many_rows_become_parts_and_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbmpc.study.store.PART", 4)
    made = Study.load(study(tmp_path), tmp_path / "out")
    made.run(workers=0)
    keys = made.table(["key"])["key"].to_pylist()
    assert sorted(keys) == sorted(r.key for r in made.runs()) and not (made.out / "parts").exists()


@pytest.mark.parametrize("name", ["1²", "1٣", "1 copy", "7"])
def test_parts_of_any_name_are_read(name: str, tmp_path: Path) -> None:
    """Digits that Python's numbers do not have, and copies. Truth: the keys of all runs."""
    made = Study.load(study(tmp_path, TEXT.replace("300-309", "300-301")), tmp_path / "out")
    made.run(workers=0)
    (made.out / "parts").mkdir()
    (made.out / "runs.parquet").rename(made.out / "parts" / f"{name}.parquet")
    more = Study.load(study(tmp_path, TEXT.replace("300-309", "300-302")), tmp_path / "out")
    more.run(workers=0)
    assert len(more.table()) == 6 and not (made.out / "parts").exists()


def test_reports_of_failed_runs_are_kept(tmp_path: Path) -> None:
    made = Study.load(study(tmp_path, TEXT + "files: failed\n"), tmp_path / "out")
    made.run(workers=0)
    kept = {r["key"]: r["files"] for r in made.table().to_pylist() if r["files"]}
    assert set(kept) == {r.key for r in made.runs() if r.seed >= 308}
    for key, files in kept.items():
        seed = key.rpartition("-")[2]
        found = json.loads((Path(files) / "metrics.json").read_text())
        assert (Path(files) / "report.html").is_file() and found["wall_time"] > 0.0
        words = shlex.split(found["command"])  # repeats this run and no other
        assert words[:2] == ["wbmpc", "run"] and f"--seed {seed} --set" in found["command"]
        assert {"fall_from=308", f"control.gain={found['settings']['control']['gain']:g}"} <= set(words)


def test_a_run_that_gave_up_has_a_report(tmp_path: Path) -> None:
    """Truth: the experiment's reason; its row is that of a study without files."""
    lost, rows = TEXT.replace("fall_from: 308", "robot: lost"), []
    for name in ("failed", "none"):
        made = Study.load(study(tmp_path, lost + f"files: {name}\n"), tmp_path / name)
        made.run(workers=0)
        rows.append(
            sorted(made.table().drop_columns(["files", "started", "wall_time", "cpu_time"]).to_pylist(), key=str)
        )
    assert rows[0] == rows[1] and {r["outcome"] for r in rows[0]} == {"gave_up"}
    pages = list((tmp_path / "failed" / "files").glob("*/report.html"))
    assert len(pages) == 20 and all("this robot does not move" in p.read_text() for p in pages)


def test_a_full_disk_that_takes_no_reports_ends_the_study_and_is_no_fall(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Truth: what the disk did not take is repeated, and all runs complete then."""
    text = TEXT.replace("{fall_from: 308}", "{}") + "files: all\n"
    made, written = Study.load(study(tmp_path, text), tmp_path / "out"), []

    def full(result: RunResult, directory: Path) -> None:
        written.append(result.seed)
        if len(written) > 2:
            raise NotWritten(f"{directory}: cannot be written (No space left on device)")

    with monkeypatch.context() as patched:
        patched.setattr("wbmpc.study.work.write_run", full)
        with pytest.raises(NotWritten, match=r"No space left on device\); .* the same command continues"):
            made.run(workers=0)
    assert len(written) == 3 and made.report().finished == 2
    shutil.rmtree(made.out / "files")
    (made.out / "files").symlink_to("/dev/null")  # no folder can be made in it
    with pytest.raises(NotWritten, match=r"cannot be written \(Not a directory\)"):
        made.run(workers=1)
    (made.out / "files").unlink()
    again = made.run(workers=0)
    assert again.finished == 20 and not again.lost and not any(c.failures.failed for c in again.cells)


def test_a_report_has_what_a_killed_study_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its rows are in the journal alone, as if the process had ended before Parquet was written; while it runs nothing is taken."""
    made = Study.load(study(tmp_path), tmp_path / "out")
    with monkeypatch.context() as killed:
        killed.setattr(Store, "finish", lambda store: None)
        with pytest.raises(InputError, match="no finished runs"):
            made.run(workers=0)
    with Store(made.out), pytest.raises(InputError, match="no finished runs"):
        made.report()
    assert (made.out / "journal.jsonl").is_file()
    assert made.report().finished == 20 and not (made.out / "journal.jsonl").exists()


def test_rows_from_somebody_else_are_texts_in_the_page(tmp_path: Path) -> None:
    made, hostile = Study.load(study(tmp_path), tmp_path / "out"), "</td><img src=x onerror=alert(1)>"
    made.out.mkdir()
    run = next(made.runs())
    row = {**row_about(run), "outcome": hostile, "reason": hostile, "files": hostile, "commit": hostile}
    row |= {
        "metrics": {hostile: 1.0},
        "about": {hostile: {"unit": hostile, "paper": None, "goal": 1.0, "least": None, "larger_is_better": False}},
    }
    (made.out / "journal.jsonl").write_text(json.dumps(row) + "\n")
    assert made.report().finished == 1
    page = (made.out / "index.html").read_text()
    assert "&lt;img" in page and "<img" not in page.partition("<main>")[2]


def test_the_command_prints_one_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = study(tmp_path)
    assert main(["study", str(file), "--workers", "0", "--out", str(tmp_path / "out"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["finished"] == said["planned"] == 20 and said["cells"][0]["failures"]["failed"] == 2
    assert all(Path(f).is_file() for f in said["files"].values())
    assert main(["study", str(file), "--report", "--out", str(tmp_path / "out")]) == 0
    assert "far" in capsys.readouterr().out
