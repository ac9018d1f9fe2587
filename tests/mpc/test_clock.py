"""Clocks, deadlines and loops in turns. Truth: lists written by hand."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.runtime.clock import Ticker, Turns, VirtualClock, WallClock, interleave


@pytest.mark.parametrize(
    ("ends", "missed", "dues"),
    [
        ([0.1, 1.2, 2.9], [0, 0, 0], [1.0, 2.0, 3.0]),
        ([1.0, 2.0], [0, 0], [1.0, 2.0]),  # just in time
        ([1.3, 2.5], [1, 0], [2.0, 3.0]),
        ([2.3, 3.5], [2, 0], [3.0, 4.0]),
        ([0.2, 7.0], [0, 5], [1.0, 7.0]),
    ],
)
def test_deadlines(ends: list[float], missed: list[int], dues: list[float]) -> None:
    ticker = Ticker(1.0)
    for end, count, due in zip(ends, missed, dues, strict=True):
        assert ticker.over(end) == count
        assert ticker.due == due
    with pytest.raises(InputError, match="must be positive"):
        Ticker(0.0)


def test_the_grid_of_deadlines_does_not_drift() -> None:
    ticker = Ticker(1.0 / 400.0, 0.5)
    for _ in range(400_000):
        ticker.over(ticker.due)
    assert ticker.due == pytest.approx(1000.5, abs=1e-9)


def test_loops_in_turns() -> None:
    clock, reported = VirtualClock(), []

    def loop(name: str, dues: list[float], takes: float = 0.0) -> Iterator[float]:
        for due in dues:
            yield due
            reported.append((name, clock.now()))
            clock.wait(clock.now() + takes)

    interleave(clock, [loop("a", [0.0, 2.0, 4.0, 9.0]), loop("b", [0.0, 1.0, 4.0], takes=1.5)], 5.0)
    # b's second turn is late because its first took 1.5; the last turn of a comes after the end
    assert reported == [("a", 0.0), ("b", 0.0), ("b", 1.5), ("a", 3.0), ("a", 4.0), ("b", 4.0)]
    assert clock.now() == 5.5


def test_virtual_time_does_not_go_back() -> None:
    clock = VirtualClock(iter([0.1, 0.2]).__next__)
    clock.wait(3.0)
    clock.wait(1.0)
    assert clock.now() == 3.0
    assert [clock.computing(), clock.computing()] == [0.1, 0.2]
    clock.restart()
    assert clock.now() == 0.0


def test_the_wall_clock_is_never_early() -> None:
    clock = WallClock()
    for k in range(1, 6):
        clock.wait(0.004 * k)
        assert clock.now() >= 0.004 * k
    clock.wait(clock.now() - 1.0)  # a time that has passed: waiting for it would never end
    previous = time.perf_counter()
    assert previous <= WallClock(origin=0.0).now() <= time.perf_counter()
    clock.restart()
    assert clock.origin > previous


@pytest.mark.wallclock
def test_a_loop_with_turns_gets_the_interpreter_back_soon() -> None:
    """Truth: a thread that only counts, and Python's usual turns of 5 ms, which is how late a loop is beside such a thread."""
    usual, ended = sys.getswitchinterval(), threading.Event()

    def count() -> None:
        while not ended.is_set():
            pass

    def late(clock: WallClock) -> float:
        found = []
        for _ in range(60):
            due = clock.now() + 1e-3
            clock.wait(due)
            found.append(clock.now() - due)
        return float(np.median(found))

    thread = threading.Thread(target=count)
    try:
        thread.start()
        without = late(WallClock())
        assert late(WallClock(turns=Turns(work=0.05, rest=1e-5))) < 0.3 * without
    finally:
        sys.setswitchinterval(usual)
        ended.set()
        thread.join()
