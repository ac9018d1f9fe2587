"""A push map that Ctrl-C ends. Truth: made-up pushes, of which the second never comes to its end."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import push_map
from workers import Workers

from wbmpc.errors import InputError
from wbmpc.studies.minniti2019.push_map import MAXIMUM, Point
from wbmpc.studies.minniti2019.push_once import Outcome


def made_up(point: Point, impulse: float) -> Outcome:
    """Falls at ``MAXIMUM``; anything weaker goes on for a minute."""
    if impulse < MAXIMUM:
        time.sleep(60.0)
    return Outcome(False, False, 1.0)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_ctrl_c_ends_the_map_with_a_message_and_keeps_what_is_done(
    number: int, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(push_map, "simulated", made_up)
    file, point = tmp_path / "pushes.json", Point("hand", 0.0, 0.2, 0)
    workers = Workers(1, "fork")  # spawned ones would import everything
    first_reported = threading.Event()

    def reported_line(*words: object, **how: Any) -> None:
        print(*words, **how)
        first_reported.set()

    monkeypatch.setattr(push_map, "print", reported_line, raising=False)

    def interrupt() -> None:
        if first_reported.wait(30.0):  # the file alone comes before its line on the terminal
            os.kill(os.getpid(), number)

    thread = threading.Thread(target=interrupt)
    thread.start()
    started = time.monotonic()
    with pytest.raises(SystemExit) as ended:
        push_map.run([point], file, workers, 1, 5.0, ["recovers"])
    thread.join()
    assert time.monotonic() - started < 30.0
    assert ended.value.code == status
    reported = capsys.readouterr()
    assert reported.err == f"interrupted: what is done is in {file}; the same command goes on from there\n"
    assert "1 of 1 left" in reported.out and "320 N s: no" in reported.out
    assert {k: list(v) for k, v in json.loads(file.read_text()).items()} == {point.key: [str(MAXIMUM)]}
    assert not multiprocessing.active_children()


def rejected(point: Point, impulse: float) -> Outcome:
    raise InputError("mpc.rate: 77 Hz is not a whole number of periods")


def test_what_a_run_rejects_is_a_message_and_status_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where only the process of a push finds it."""
    monkeypatch.setattr(push_map, "simulated", rejected)
    monkeypatch.setattr(push_map, "Workers", lambda count: Workers(1, "fork"))
    monkeypatch.setattr(sys, "argv", ["push_map.py", "--directions", "2", "--lengths", "0.2", "--out", str(tmp_path)])
    with pytest.raises(SystemExit, match="2"):
        push_map.main()
    assert capsys.readouterr().err.endswith("error: mpc.rate: 77 Hz is not a whole number of periods\n")
    assert not multiprocessing.active_children()


def test_there_has_to_be_something_to_draw(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder that is not there is not made."""
    place = tmp_path / "nowhere"
    monkeypatch.setattr(sys, "argv", ["push_map.py", "--draw", "--out", str(place)])
    with pytest.raises(SystemExit, match="2"):
        push_map.main()
    assert f"--draw: there are no such pushes in '{place / 'pushes.json'}'" in capsys.readouterr().err
    assert not place.exists()


def test_ctrl_c_before_the_first_push_names_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(push_map, "push_map", interrupted)
    with pytest.raises(SystemExit):
        push_map.run([], tmp_path / "pushes.json", Workers(1, "fork"), 1, 5.0, ["recovers"])
    assert capsys.readouterr().err == "interrupted: nothing is done yet\n"


@pytest.mark.parametrize(
    ("given", "reported"),
    [
        (["--lengths", "0.001"], "of 2.5 ms; valid: e.g. 0.0025 s\n"),
        (["--lengths", "0.2", "0.003"], "0.003 s is not a whole number of controller periods"),
        (["--lengths", "nan"], "must be a finite number"),
        (["--lengths", "6"], "length"),
        (["--lengths", "-0.1"], "length"),
        (["--fine", "nan"], "--fine a number above 0"),
        (["--set", "push_duration=0.4"], "push_duration: the push map does not use it"),
        (["--set", " settle_time=1"], "settle_time: the push map does not use it"),
        (["--out", "{}/broken.json"], "cannot be a folder"),
        (["--out", "{}/old"], "no file of a push map"),
        (["--controllers", "lqr", "--gains", "{}/broken.json"], "no file of gains"),
        (["--controllers", "lqr", "--gains", "{}/words.json"], "no file of gains"),
    ],
)
def test_what_a_map_cannot_take_is_reported_before_it_starts(
    given: list[str], reported: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "words.json").write_text('{"hand": {"lqr": {"torque": "much"}}}')
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "pushes.json").write_text('{"a push": {"320.0": true}}')
    monkeypatch.setattr(push_map, "run", lambda *_: pytest.fail("it started"))
    out = ["--out", str(tmp_path / "new")] if "--out" not in given else []
    monkeypatch.setattr(sys, "argv", ["push_map.py", "--modes", "hand", *(a.format(tmp_path) for a in given), *out])
    with pytest.raises(SystemExit) as ended:
        push_map.main()
    assert ended.value.code == 2 and reported in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_workers_do_not_hear_ctrl_c() -> None:
    """The signal that a terminal sends to all processes: the worker goes on with its work."""
    with Workers(1, "fork") as workers:
        own = workers.submit(os.getpid).result()
        os.kill(own, signal.SIGINT)
        assert workers.submit(os.getpid).result() == own
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
