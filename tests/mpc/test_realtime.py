"""What a solver needs to run beside a controller: it allocates nothing and holds no interpreter lock.

Truth: the C library's and Python's own accounts of their heaps, and the same solve called with the lock held.
"""

from __future__ import annotations

import ctypes
import gc
import re
import threading
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from toys import rezero_solver, swerve_solver
from wbmpc.solver import SQP, Solver
from wbmpc.solver.compilation import LIBRARY
from wbmpc.solver.receding import receding_solve

SOLVES = 1000


class _Heap(ctypes.Structure):
    """The C library's ``struct mallinfo2``."""

    _fields_ = [
        (n, ctypes.c_size_t)
        for n in [
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keepcost",
        ]
    ]


_INFO = getattr(ctypes.CDLL(None), "mallinfo2", None)  # bound once: binding allocates
if _INFO is not None:
    _INFO.restype = _Heap


def heap() -> tuple[int, int]:
    """Bytes in use on the C heap, and in blocks of their own."""
    if _INFO is None:
        pytest.skip("the C library has no mallinfo2")
    info = _INFO()
    return info.uordblks, info.hblkhd


def growth(action: Callable[[], object]) -> tuple[int, int, int]:
    """By how much Python's memory [bytes], its peak and the C heap grow over 1 000 calls."""
    for _ in range(50):
        action()
    gc.collect()
    gc.disable()
    try:
        heap()
        before = heap()
        for _ in range(SOLVES):
            action()
        after = heap()
        tracemalloc.start()  # later, for its own tables are on the C heap
        for _ in range(50):
            action()
        tracemalloc.reset_peak()
        python = tracemalloc.get_traced_memory()[0]
        for _ in range(SOLVES):
            action()
        now, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        gc.enable()
    return now - python, peak - python, sum(after) - sum(before)


def real_time(name: str) -> tuple[Solver, Callable[[], object]]:
    """A solver with its real-time settings, and one receding solve of it."""
    make = rezero_solver if name == "rezero" else swerve_solver
    solver = make(n=15, **vars(SQP.real_time()))
    x0, clock = solver.ws.x[0].copy(), [0.0]

    def solve() -> None:
        clock[0] += 0.001
        solver.run(x0, clock[0], 0.001)

    return solver, solve


@pytest.mark.parametrize("name", ["rezero", "swerve"])
def test_solves_allocate_nothing(name: str) -> None:
    solver, solve = real_time(name)
    python, peak, native = growth(solve)
    assert native == 0
    assert python < 2000  # numbers that have replaced others; a leak would be 24 kB or more
    assert peak < 4096  # numbers of a call that go when it ends
    assert np.isfinite(solver.ws.x).all()


def test_the_accounts_see_an_allocation() -> None:
    kept: list[np.ndarray] = []
    python, _, native = growth(lambda: kept.append(np.zeros(100)))
    assert python > SOLVES * 800 and native > 0
    calls = ctypes.CDLL(None)
    calls.malloc.restype, calls.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
    calls.free.argtypes = [ctypes.c_void_p]
    blocks = np.zeros(3 * SOLVES, np.uintp)
    place = iter(range(3 * SOLVES))

    def leak() -> None:
        blocks[next(place)] = calls.malloc(64)

    assert growth(leak)[2] >= SOLVES * 64
    for block in blocks[blocks > 0]:
        calls.free(int(block))


def test_the_compiled_driver_calls_nothing_that_allocates() -> None:
    """Everything that it takes from outside its module is an elementary function."""
    declared = set(re.findall(r"^declare .*@([\w.]+)\(", LIBRARY.source(), re.MULTILINE))
    assert declared
    assert {
        name
        for name in declared
        if not re.fullmatch(r"llvm\.((sqrt|log|exp|floor|fabs|pow|fma)|vector\.reduce\.\w+)\.\w+", name)
    } == set()


# ---------------------------------------------------------------------- the interpreter lock
PERIOD = 1.0 / 400.0


class Ticks(threading.Thread):
    """Another thread's work: 400 Hz, by how much each tick is late [s]."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.late: list[float] = []
        self.end = False

    def run(self) -> None:
        due = time.perf_counter() + PERIOD
        while not self.end:
            left = due - time.perf_counter()
            if left > 0.0:
                time.sleep(left)
            now = time.perf_counter()
            self.late.append(now - due)
            due += PERIOD * (1 + int((now - due) / PERIOD))  # ticks that have passed are left out


def lateness(action: Callable[[], object], seconds: float) -> float:
    """Median [s] of how late another thread's ticks are while ``action`` runs again and again."""
    ticks = Ticks()
    ticks.start()
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        action()
    ticks.end = True
    ticks.join()
    return float(np.median(ticks.late[3:]))


@pytest.mark.wallclock
def test_solves_hold_no_interpreter_lock() -> None:
    """Ticks beside long solves are nearly as regular as beside a thread that sleeps; with the lock held they are not."""
    solver = swerve_solver(n=60, **vars(SQP.real_time(10)))
    x0 = solver.ws.x[0].copy()
    solver.run(x0)
    start = time.perf_counter()
    solver.run(x0)
    duration = time.perf_counter() - start
    entry, address = solver._entry, LIBRARY.address(f"{receding_solve.signature.symbol}.entry")
    types: Any = entry.argtypes if entry.argtypes is not None else type(entry)._argtypes_
    holding = ctypes.PYFUNCTYPE(None, *types)(address)
    free, held, idle = [], [], []
    for _ in range(16):  # in turns, and again: the machine may be busy
        idle.append(lateness(lambda: time.sleep(duration), 0.25))
        solver._entry = entry
        free.append(lateness(lambda: solver.run(x0), 0.25))
        solver._entry = holding
        held.append(lateness(lambda: solver.run(x0), 0.25))
        regular = min(free) < 0.4 * min(held) and min(free) < 5.0 * min(idle) + 0.2 * duration
        if regular and len(free) > 2:
            break
    assert duration > 1e-3
    assert regular, (free, held, idle, duration)
