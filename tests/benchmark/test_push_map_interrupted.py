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

import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import push_map
from workers import Workers

from wbmpc.experiments.push_map import MOST, Point
from wbmpc.experiments.rezero_push import Outcome


def made_up(point: Point, impulse: float) -> Outcome:
    """Falls at ``MOST``; anything weaker goes on for a minute."""
    if impulse < MOST:
        time.sleep(60.0)
    return Outcome(False, False, 1.0)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_ctrl_c_ends_the_map_with_a_sentence_and_keeps_what_is_done(
    number: int, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(push_map, "simulated", made_up)
    file, point = tmp_path / "pushes.json", Point("hand", 0.0, 0.2, 0)
    workers = Workers(1, "fork")  # spawned ones would import everything

    def interrupt() -> None:
        while not file.exists():
            time.sleep(0.01)
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=interrupt)
    thread.start()
    started = time.monotonic()
    with pytest.raises(SystemExit) as ended:
        push_map.run([point], file, workers, 1, 5.0, ["recovers"])
    thread.join()
    assert time.monotonic() - started < 30.0
    assert ended.value.code == status
    told = capsys.readouterr()
    assert told.err == f"interrupted: what is done is in {file}; the same command goes on from there\n"
    assert "1 of 1 left" in told.out and "320 N s: no" in told.out
    assert {k: list(v) for k, v in json.loads(file.read_text()).items()} == {point.key: [str(MOST)]}
    assert not multiprocessing.active_children()


def test_workers_do_not_hear_ctrl_c() -> None:
    """The signal that a terminal sends to all processes: the worker goes on with its work."""
    with Workers(1, "fork") as workers:
        own = workers.submit(os.getpid).result()
        os.kill(own, signal.SIGINT)
        assert workers.submit(os.getpid).result() == own
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
