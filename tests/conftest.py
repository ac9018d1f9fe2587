"""Tests may import what stands beside them (``driving``, ``oracles``)."""

import gc
import os
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# a loaded machine takes longer for the first example; a test says nothing about time
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

# A job in the background is started with Ctrl-C ignored, one of nohup with SIGHUP, and so would be every process that a test starts.
for _number, _usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(_number) == signal.SIG_IGN:
        signal.signal(_number, _usual)


def pytest_collection_finish() -> None:
    """The tests themselves stay: the garbage collector need not look at them again and again."""
    gc.collect()
    gc.freeze()


DIED = pytest.StashKey[bool]()


@pytest.hookimpl(optionalhook=True)
def pytest_handlecrashitem(sched: Any) -> None:
    """A process of tests died: more than a test that failed beside others, whatever that test does alone."""
    sched.config.stash[DIED] = True


def pytest_sessionfinish(session: pytest.Session) -> None:
    if session.config.stash.get(DIED, False):
        session.exitstatus = pytest.ExitCode.INTERNAL_ERROR


@pytest.fixture
def empty_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test runs in a directory of its own."""
    monkeypatch.chdir(tmp_path)
