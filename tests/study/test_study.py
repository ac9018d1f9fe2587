"""Studies that run, are killed, go on, and are searched. Truth: an experiment whose figures are known in closed form."""

from __future__ import annotations

import errno
import json
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from valley import error

from effort import thorough
from wbmpc.cli import main
from wbmpc.errors import InputError, NotWritten
from wbmpc.study import workers
from wbmpc.study.store import Store
from wbmpc.study.study import Study
from wbmpc.study.work import execute

pytest.importorskip("pyarrow")
HERE = Path(__file__).parent
SOURCE = HERE.parents[1] / "src"
TEXT = """
title: a valley
experiments: {VALLEY: {fall_from: 308}}
seeds: 300-309
conditions:
  near: {settings: {control.gain: 2.5}}
  far: {settings: {control.gain: 5}}
metrics: [error]
"""


def study(tmp_path: Path, text: str = TEXT, name: str = "study.yaml") -> Path:
    file = tmp_path / name
    file.write_text(text.replace("VALLEY", str(HERE / "valley.py")))
    return file


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


def test_it_goes_on_and_errors_are_tried_again(tmp_path: Path) -> None:
    file = study(tmp_path, TEXT.replace("fall_from: 308", "raise_at: 304"))
    made = Study.load(file, tmp_path / "out")
    assert made.run(workers=0).lost == {"error: ZeroDivisionError: of this seed": 2}
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


@pytest.mark.parametrize("line", ["[" * 100_000, "5", "{}", '{"key": [1]}', json.dumps({**ROW, "outcome": None})])
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


def test_reports_of_failed_runs_are_kept(tmp_path: Path) -> None:
    made = Study.load(study(tmp_path, TEXT + "files: failed\n"), tmp_path / "out")
    made.run(workers=0)
    kept = {r["key"]: r["files"] for r in made.table().to_pylist() if r["files"]}
    assert set(kept) == {r.key for r in made.runs() if r.seed >= 308}
    assert all((Path(files) / "report.html").is_file() for files in kept.values())


TUNE = """
experiments: [VALLEY]
seeds: 300-304
tune:
  seeds: 0-2
  search: {control.gain: {from: 0.01, to: 100, log: true}, offset: [0, 1]}
  minimize: [{metric: error, limit: 100}]
  trials: 14
"""


def test_a_search_finds_the_best_of_its_trials_on_its_own_seeds(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    made = Study.load(study(tmp_path, TUNE), tmp_path / "out")
    tuned = made.tune(workers=0)
    mean = [error(t["settings"]["control.gain"], t["settings"]["offset"], 1) for t in tuned.trials]
    assert tuned.best is not None and tuned.best["values"] == [pytest.approx(min(mean))]
    assert len(tuned.trials) == 14 and (tmp_path / "out" / "index.html").is_file()
    rows = Study.load(made.path, made.out / "trials").table().to_pylist()
    assert len(rows) == 42 and {r["seed"] for r in rows} == {0, 1, 2}
    assert tuned.report is not None and {s for c in tuned.report.cells for s in c.seeds} == set(range(300, 305))
    after = tuned.report.comparison(tuned.report.cells[1], "error")
    assert after is not None and after.text == "better" and after.wins == 5
    assert Study.load(made.path, made.out).tune(workers=0).trials == tuned.trials  # nothing is left to do
    other = Study.load(study(tmp_path, TUNE.replace("to: 100", "to: 90")), made.out)
    with pytest.raises(InputError, match=r"14 trials are of another search \(search\)"):
        other.tune(workers=0)


def test_a_front_is_what_no_trial_beats_and_the_least_sum_is_kept(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    text = TUNE.replace(
        "minimize: [{metric: error, limit: 100}]", "minimize: [{metric: error, limit: 100}, {metric: effort, limit: 9}]"
    )
    made = Study.load(study(tmp_path, text + "  pareto: true\n"), tmp_path / "out")
    tuned = made.tune(workers=0)
    values = {t["trial"]: t["values"] for t in tuned.trials}
    beaten = {k for k, a in values.items() for b in values.values() if b != a and b[0] <= a[0] and b[1] <= a[1]}
    assert {t["trial"] for t in tuned.front} == values.keys() - beaten and len(tuned.front) > 1
    assert tuned.best is not None and sum(tuned.best["values"]) == min(sum(values[t["trial"]]) for t in tuned.front)
    assert tuned.settings == tuned.best["settings"]


def traces(page: Path) -> list[dict[str, Any]]:
    """What all plots of a page draw."""
    calls = page.read_text().split("Plotly.newPlot(")[1:]
    found = (json.JSONDecoder().raw_decode(c[c.index("[") :])[0] for c in calls if c.lstrip().startswith('"'))
    return [trace for data in found for trace in data]


def test_heat_maps_and_scatters_keep_conditions_apart(tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    vary = (
        "vary: {control.gain: [1, 3], offset: [0.0, 0.2]}\nconditions: {protocol: {}, far: {settings: {shift: 7.0}}}\n"
    )
    file = tmp_path / "maps.yaml"
    file.write_text(f"experiments: [{HERE / 'valley.py'}]\nseeds: 300-302\nmetrics: [error]\n{vary}")
    made = Study.load(file, tmp_path / "maps")
    made.run(workers=0)
    maps = [trace for trace in traces(made.out / "index.html") if trace["type"] == "heatmap"]
    shifts = {0.0, 7.0}
    assert {round(m["z"][0][0] - error(1, 0.0, 1), 9) for m in maps} == shifts and len(maps) == 2
    assert {(m["zmin"], m["zmax"]) for m in maps} == {(error(3, 0.0, 1), 7.0 + error(1, 0.2, 1))}  # one scale of colors
    file.write_text(file.read_text().replace(", offset: [0.0, 0.2]", ", offset: [0.0]").replace("[1, 3]", "[1, 2, 3]"))
    other = Study.load(file, tmp_path / "scatter")
    other.run(workers=0)
    assert {t["name"] for t in traces(other.out / "index.html") if t["type"] == "scatter"} >= {
        "protocol, offset=0.0",
        "far, offset=0.0",
    }


def test_constraints_and_pruning(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    limits = "  constraints: {error: 5}\n  prune: true\n"
    made = Study.load(study(tmp_path, TUNE + limits), tmp_path / "out")
    tuned = made.tune(workers=0)
    rows = Study.load(made.path, made.out / "trials").table().to_pylist()
    worst = {t["trial"]: max(r["metric.error"] for r in rows if r["draw"] == t["trial"]) for t in tuned.trials}
    whole = [t for t in tuned.trials if not t["pruned"]]
    assert all(t["feasible"] == (worst[t["trial"]] <= 5.0) for t in whole) and not all(t["feasible"] for t in whole)
    pruned = [t["trial"] for t in tuned.trials if t["pruned"]]
    assert pruned and all(sum(r["draw"] == k for r in rows) < 3 for k in pruned)


def command(*words: object) -> list[str]:
    return [sys.executable, "-m", "wbmpc", *map(str, words)]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(SOURCE)}


def test_the_command_prints_one_object(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = study(tmp_path)
    assert main(["study", str(file), "--workers", "0", "--out", str(tmp_path / "out"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["finished"] == said["planned"] == 20 and said["cells"][0]["failures"]["failed"] == 2
    assert all(Path(f).is_file() for f in said["files"].values())
    assert main(["study", str(file), "--report", "--out", str(tmp_path / "out")]) == 0
    assert "far" in capsys.readouterr().out


@pytest.mark.parametrize(("robots", "status"), [("[unknown]", 1), ("[one, unknown]", 0)])
def test_settings_that_only_the_runs_reject_and_metrics_that_none_has_are_reported(
    robots: str, status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A study of which every run rejected its settings has failed."""
    file = tmp_path / "rejected.yaml"
    file.write_text(f"experiments: [{HERE / 'valley.py'}]\nrobots: {robots}\nseeds: 1-2\nmetrics: [eror]\n")
    assert main(["study", str(file), "--workers", "0", "--out", str(tmp_path / "out"), "--json"]) == status
    said = capsys.readouterr().err
    assert "wbmpc: 2 runs rejected their settings: there is no such robot\n" in said
    assert (f"{file}: metrics: no run has 'eror'; valid: error" in said) is (status == 0)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("constraints: {error: .nan}", "constraints.error=nan: input should be"),
        ("constraints: {eror: 1}", "tune.constraints: no run has the metric 'eror'; valid: error"),
        ("storage: 'nothing://there'", "tune.storage: 'nothing://there' cannot be opened ("),
        ("storage: 'sqlite:////proc/nowhere/trials.db'", "trials.db' cannot be opened ("),
    ],
)
def test_what_is_wrong_with_a_search_is_named(
    more: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("optuna")
    file = tmp_path / "search.yaml"
    search = "search: {offset: {from: 0, to: 1}}, minimize: [{metric: error, limit: 9}], trials: 1"
    file.write_text(f"experiments: [{HERE / 'valley.py'}]\nseeds: 1\ntune: {{seeds: 0, {search}, {more}}}\n")
    assert main(["tune", str(file), "--workers", "0", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("wbmpc:") == 1


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_workers_that_are_being_started_are_started_and_ended(
    number: int, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Dask cannot close a cluster that is half there. The signal comes while it is made; truth: the order of what happens."""
    seen: list[str] = []

    class Cluster:
        workers: ClassVar[dict[str, Any]] = {}

        def __init__(self, **_: object) -> None:
            os.kill(os.getpid(), number)
            seen.append("made")

        def close(self, timeout: float) -> None:
            seen.append("closed")

    monkeypatch.setattr("distributed.LocalCluster", Cluster)
    monkeypatch.setattr("distributed.Client", lambda cluster, set_as_default: cluster)
    assert main(["study", str(study(tmp_path)), "--workers", "1", "--out", str(tmp_path / "out")]) == status
    assert seen[0] == "made" and set(seen[1:]) == {"closed"}
    assert "wbmpc: interrupted" in capsys.readouterr().err


def test_an_unknown_study_names_those_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "nowhere"]) == 2
    assert "unknown study 'nowhere'" in capsys.readouterr().err


def test_without_the_extra_it_is_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["study", str(study(tmp_path)), "--workers", "1", "--out", str(tmp_path / "out")]) == 2
    assert "pip install 'wbmpc[study]'" in capsys.readouterr().err


def test_dasks_workers_do_the_runs(tmp_path: Path) -> None:
    """A scheduler with two workers, all in this process: what is sent is what other processes would get."""
    distributed = pytest.importorskip("distributed")
    made = Study.load(study(tmp_path), tmp_path / "out")
    seen: list[float] = []
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None, silence_logs=50,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
    ) as cluster:  # fmt: skip
        summary = made.run(scheduler=cluster.scheduler_address, progress=lambda share, note: seen.append(share))
    assert not logging.getLogger("distributed.client").isEnabledFor(logging.ERROR)  # a lost scheduler is one message
    assert summary.finished == 20 and seen == pytest.approx([k / 20 for k in range(1, 21)])


def test_threads_that_import_one_file_at_a_time_get_whole_modules(tmp_path: Path) -> None:
    """Workers with several threads do: the annotation of Outer is text, and is looked up by the module's name."""
    file = tmp_path / "slow.py"
    head, body = (HERE / "valley.py").read_text().split("class Inner")
    file.write_text(f"{head}import time\ntime.sleep(0.05)\n\n\nclass Inner{body}")

    def later(k: int) -> object:
        time.sleep(0.01 * k)
        row = execute({"source": str(file), "changes": {"control.gain": 2.5}, "seed": k, "files": None, "keep": "none"})
        return row["outcome"], row.get("reason")

    with ThreadPoolExecutor(8) as threads:
        assert list(threads.map(later, range(8))) == [("completed", "")] * 8


@thorough
def test_a_run_that_kills_its_process_costs_itself_alone(tmp_path: Path) -> None:
    """Processes of Dask; each run has one thread. The port of Dask's pages is taken, as by another study: no matter."""
    pytest.importorskip("distributed")
    taken = socket.socket()
    with suppress(OSError):  # somebody else has it
        taken.bind(("127.0.0.1", 8787))
        taken.listen()
    file = study(tmp_path, TEXT.replace("fall_from: 308", "die_at: 303").replace("300-309", "300-305"))
    done = subprocess.run(
        command("study", file, "--workers", 2, "--out", tmp_path / "out", "--json"),
        env=environment(), capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    taken.close()
    said = json.loads(done.stdout)
    assert "8787" not in done.stderr
    assert done.returncode == 1 and said["finished"] == 10 and sum(said["lost"].values()) == 2, done.stderr
    rows = Study.load(file, tmp_path / "out").table().to_pylist()
    assert {r["seed"] for r in rows if r["outcome"] == "lost"} == {303}
    assert {r["metric.threads"] for r in rows if r["completed"]} == {1.0}


@thorough
def test_a_scheduler_and_workers_in_other_folders(tmp_path: Path) -> None:
    """Separate processes; one worker is killed, and the study ends as if nothing had happened."""
    pytest.importorskip("distributed")
    address_file = tmp_path / "scheduler.json"
    words = ("--no-dashboard", "--scheduler-file", str(address_file))
    begun = [subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *words],
                              env=environment(), stderr=subprocess.DEVNULL)]  # fmt: skip
    try:
        for name in ("a", "b"):
            (tmp_path / name).mkdir()
            worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", *words]
            begun.append(subprocess.Popen(worker, cwd=tmp_path / name, env=environment(), stderr=subprocess.DEVNULL))
        from distributed import Client

        with Client(scheduler_file=str(address_file)) as client:  # waits for the file
            client.wait_for_workers(2)
            address = client.scheduler.address
        made = Study.load(study(tmp_path), tmp_path / "out")
        killed: list[int] = []

        def kill(share: float, note: str) -> None:
            if not killed:
                killed.append(begun[1].pid)
                begun[1].send_signal(signal.SIGKILL)

        assert made.run(scheduler=address, progress=kill).finished == 20 and killed
    finally:
        for process in begun:
            process.kill()
            process.wait()


class Started(Exception):
    """A process would have been started."""


@pytest.mark.parametrize("command", ["study", "tune"])
@pytest.mark.parametrize(
    ("about", "said"),
    [
        ("robots: [/etc/passwd]", "experiment 'hold': unknown robot '/etc/passwd'; valid: "),
        ("robots: [ur5, broken.yaml]", "broken.yaml"),
        ("settings: {obstacles: nowhere.yaml}", "nowhere.yaml"),
        ("conditions: {near: {}, far: {settings: {obstacles: SCENE}}}", "experiment 'hold', condition 'far': "),
        ("settings: {path.kind: csv, path.file: nowhere.csv}", "nowhere.csv"),
    ],
)
def test_nothing_is_started_for_files_that_cannot_be_read(
    command: str, about: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    """Truth: the cluster is never made."""

    def cluster(*_: Any, **__: Any) -> None:
        raise Started

    monkeypatch.setattr("distributed.LocalCluster", cluster)
    for name in ("broken.yaml", "scene.yaml"):
        (tmp_path / name).write_text("nonsense: 1\n")
    name = "end-effector-track" if "path" in about else "hold"
    tune = "tune: {seeds: [1], search: {settle_time: [0.5, 1.0]}, minimize: [{metric: fell, limit: 1}]}\n"
    file = study(
        tmp_path, f"experiments: [{name}]\nseeds: [0]\n{about.replace('SCENE', str(tmp_path / 'scene.yaml'))}\n{tune}"
    )
    assert main([command, str(file), "--out", str(tmp_path / "out"), "--workers", "2"]) == 2
    found = capsys.readouterr().err
    assert said in found and found.count("\n") == 1


def test_a_study_is_no_server_for_browsers() -> None:
    """Dask always opens one. Truth: what it answers to a request for anything that it shows by default."""
    pytest.importorskip("distributed")
    with workers.pool(1, None) as pool:
        assert isinstance(pool, workers.Cluster)
        port = pool._client.scheduler_info()["services"]["dashboard"]
        for page in ("", "info/main/workers.html", "json/identity.json", "health", "metrics", "sysmon"):
            with pytest.raises(HTTPError) as error:
                urlopen(f"http://127.0.0.1:{port}/{page}")
            error.value.close()
            assert error.value.code == 404, page
