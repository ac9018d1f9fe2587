"""A study on several workers: processes, threads, schedulers. Truth: rows of a study without them."""

from __future__ import annotations

import json
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

from effort import thorough
from wbmpc.cli import main
from wbmpc.study import workers
from wbmpc.study.study import Study
from wbmpc.study.work import execute

pytest.importorskip("pyarrow")
from studies import HERE, TEXT, command, environment, study


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


def test_workers_that_cannot_start_are_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As where the system gives no more processes, or their directory is gone. Truth: what Dask raises then."""

    def fails(**_: object) -> None:
        raise RuntimeError("Nanny failed to start.") from FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr("distributed.LocalCluster", fails)
    assert main(["study", str(study(tmp_path)), "--workers", "1", "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert (
        "--workers: the processes do not start ([Errno 2] No such file or directory)" in said
        and "Traceback" not in said
    )


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


def test_an_interrupt_that_a_program_raises_in_a_workers_thread_is_its_own_mistake(tmp_path: Path) -> None:
    """Truth: Python runs handlers of signals in the main thread alone. It ended Dask's worker, three times, with a traceback each."""
    file = tmp_path / "valley.py"
    file.write_text((HERE / "valley.py").read_text().replace("ZeroDivisionError(", "KeyboardInterrupt("))
    task = {"source": str(file), "changes": {"raise_at": 1}, "seed": 1, "files": None, "keep": "none"}
    with ThreadPoolExecutor(1) as threads:
        row = threads.submit(execute, task).result()
    assert (row["outcome"], row["reason"]) == ("error", "KeyboardInterrupt: of this seed")


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


def test_a_worker_that_is_gone_for_good_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask gives up a process that ends while it starts, and a study waited for it without an end. Truth: the task's own row."""
    monkeypatch.setattr(workers, "GONE", 1.0)
    monkeypatch.setattr(workers, "_LOOK", 0.1)
    with workers.pool(1, None) as pool:
        assert isinstance(pool, workers.Cluster) and pool._own is not None
        (nanny,) = pool._own.workers.values()
        pool._client.sync(nanny.close)
        pool.submit(len, {"key": "one"})
        found: list[Any] = []
        waiting = threading.Thread(target=lambda: found.append(pool.next()), daemon=True)
        waiting.start()
        waiting.join(60.0)
        assert found == [({"key": "one"}, 1)]


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
    assert not (tmp_path / "out" / "trials.db").exists()  # a search would store a hundred rejected trials


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
