"""A tick and Python's interpreter. Truth: a thread that wants it all the time, and gets it only when it is let go; NumPy's source."""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds

from wbmpc.mpc.policy import InputLimits
from wbmpc.ros2.dds_writing import write
from wbmpc.runtime.runner import RealTimeRunner

pytestmark = needs_dds
if not MISSING:
    from standin import drive

#: Functions of NumPy that let the interpreter go however short the array is (NPY_BEGIN_THREADS_DESCR in item_selection.c); those
#: with NPY_BEGIN_THREADS_THRESHOLDED do from 500 numbers on, copies too, and of a product of matrices n k m counts.
LET_GO = {
    "argmax", "argmin", "argpartition", "argsort", "choose", "lexsort", "partition", "put", "searchsorted", "sort", "take", "where",
}  # fmt: skip
LONG = {"sum", "any", "all", "matmul", "dot", "copy", "array", "concatenate", "ravel", "astype", "not_equal"}


class Calls:
    """Of NumPy's functions in C that the thread calls within, by name with the place."""

    def __init__(self) -> None:
        self.made: Counter[tuple[str, str]] = Counter()

    def _note(self, frame: Any, event: str, function: Any) -> None:
        of = getattr(function, "__self__", None)
        if event == "c_call" and (isinstance(of, np.ndarray) or getattr(of, "__name__", "").startswith("numpy")):
            self.made[function.__name__, f"{frame.f_code.co_filename}:{frame.f_lineno}"] += 1

    def __enter__(self) -> None:
        sys.setprofile(self._note)

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)

    def of(self, names: set[str]) -> dict[tuple[str, str], int]:
        """Those of some names."""
        return {call: n for call, n in self.made.items() if call[0] in names}


def test_a_tick_calls_nothing_that_lets_the_interpreter_go(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However seldom the other thread is quick enough to get it."""
    p = pair(rates={"control": 400})
    drive(p)
    calls, tick = Calls(), RealTimeRunner._tick

    def watched(self: RealTimeRunner, due: float) -> None:
        with calls:
            tick(self, due)

    monkeypatch.setattr(RealTimeRunner, "_tick", watched)
    policies = p.control.runner.own["policies"]
    p.run(0.2)
    assert p.control.runner.own["policies"] > policies + 3
    assert calls.of({"asarray"})  # it sees what is called
    assert not calls.of(LET_GO)


def test_limits_of_many_rows_keep_the_interpreter() -> None:
    """A tick makes them of every new policy."""
    matrix, offset, bound = np.ones((60, 20)), np.zeros(60), np.ones(20)
    calls = Calls()
    with calls:
        InputLimits(-bound, bound, matrix, offset)
    assert calls.made and not calls.of(LET_GO | LONG)


def test_a_tick_keeps_the_interpreter(pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Who lets it go, if for a microsecond, may wait for milliseconds to have it back: NumPy does in its search, in copies of
    more than 500 numbers and in some 20 other functions."""
    p = pair(rates={"control": 400})
    drive(p)
    ticking: list[int] = []
    where: Counter[str] = Counter()
    ticks = [0]
    tick = RealTimeRunner._tick

    def reported(self: RealTimeRunner, due: float) -> None:
        ticking.append(threading.get_ident())
        try:
            tick(self, due)
        finally:
            ticking.clear()
            ticks[0] += 1

    def want(ended: threading.Event) -> None:
        while not ended.is_set():
            time.sleep(2e-5)
            if ticking:
                frame = sys._current_frames()[ticking[0]]
                # what another node of this process reads is written without the interpreter, or the two would wait for each other;
                # a controller and a robot in processes of their own have no such topics
                if frame.f_code is write.__code__:
                    continue
                where[f"{frame.f_code.co_filename}:{frame.f_lineno}"] += 1

    def share() -> float:
        """Of half a second's ticks, in which the other thread got the interpreter."""
        where.clear()
        ticks[0] = 0
        usual, ended = sys.getswitchinterval(), threading.Event()
        thread = threading.Thread(target=want, args=(ended,), daemon=True)
        try:
            sys.setswitchinterval(1.0)
            thread.start()
            p.run(0.5)
        finally:
            sys.setswitchinterval(usual)
            ended.set()
            thread.join()
        assert ticks[0] > 150
        return sum(where.values()) / ticks[0]

    monkeypatch.setattr(RealTimeRunner, "_tick", reported)
    # a message that comes while a tick begins may have asked for its turn before; where the machine has other things to do a tick
    # is taken off its core where it has let go: that is not the tick's doing, and does not happen every time
    assert any(share() < 0.05 for _ in range(4)), where.most_common(5)
