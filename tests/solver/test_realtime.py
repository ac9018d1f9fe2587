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

import casadi as ca
import numpy as np
import pytest

from toys import Rows, ToyDynamics, rezero_solver, swerve_solver
from wbmpc.ocp import AugmentedLagrangian, Constraint, Cost, Mode, ModeSchedule, OptimalControlProblem, Reference, sets
from wbmpc.solver import SQP, Solver, Status
from wbmpc.solver.compilation import LIBRARY
from wbmpc.solver.memory_layout import StateField
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
        previous = heap()
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
    return now - python, peak - python, sum(after) - sum(previous)


def everything() -> OptimalControlProblem:
    """A trolley with all kinds of rows: bounds, a plane of one mode, a row that moves with a reference, a disc, limits of state,
    of state and input, a soft equality, an end, and a multiplier row that limits keep away."""
    row = lambda f, n=0: Rows(1, f, n)
    dynamics = ToyDynamics(2, 3, lambda x, u, w, m: ca.vertcat(x[1], ca.sum1(u)))
    ocp = OptimalControlProblem(dynamics, 1.0, 8, first_interval=0.02, align_events=True, modes=("one", "two"))
    ocp.add(Cost("state", Rows(2, lambda s: s.x), [10.0, 1.0], at="path+terminal"))
    ocp.add(Cost("input", Rows(3, lambda s: s.u), 0.1))
    ocp.add(Constraint("bounds", Rows(3, lambda s: s.u), sets.Box(-2.0, 2.0), hard=True))
    ocp.add(Constraint("plane", row(lambda s: 2.5 - s.u[0] - s.u[1]), sets.NonNegative(), hard=True, modes=("two",)))
    ocp.add(Constraint("reach", row(lambda s: 2.1 + s.reference - s.u[2], 1), sets.NonNegative(), hard=True))
    ocp.add(Constraint("disc", row(lambda s: 6.0 - ca.sumsqr(s.u)), sets.NonNegative(), hard=True))
    ocp.add(Constraint("speed", row(lambda s: s.x[1]), sets.Box(-0.5, 0.5), at="path+terminal", hard=True))
    ocp.add(Constraint("power", row(lambda s: s.x[1] * s.u[0]), sets.Box(-1.0, 1.0), hard=True))
    ocp.add(Constraint("goal", row(lambda s: s.u[0] - s.u[1]), softness=10.0))
    ocp.add(Constraint("beyond", row(lambda s: s.u[2] - 4.0), penalty=AugmentedLagrangian(10.0), modes=("two",)))
    ocp.add(Constraint("end", row(lambda s: s.x[0] - 0.1), at="terminal"))
    return ocp


def limited() -> tuple[Solver, Callable[[], object]]:
    """That problem in an MPC's settings: from states inside and outside of its limits, through events."""
    solver = Solver(everything(), SQP.real_time())
    times = np.linspace(0.0, 50.0, 101)
    solver.set_reference("reach", Reference(times, 0.05 * np.sin(times)[:, None]))
    events = tuple(float(t) for t in np.arange(1.0, 50.0))
    solver.set_schedule(ModeSchedule(tuple(Mode(("one", "two")[k % 2]) for k in range(50)), events))
    starts, count = np.array([[0.1, 0.0], [0.1, 1.5], [0.2, -0.8]]), [0]

    def solve() -> None:
        count[0] += 1
        k = count[0] % 3000
        solver.iterate(starts[k // 20 % 3], 0.01 * k, 0.01 if k else 0.0)

    return solver, solve


def real_time(name: str) -> tuple[Solver, Callable[[], object]]:
    """A solver with its real-time settings, and one receding solve of it."""
    if name == "limited":
        return limited()
    make = rezero_solver if name == "rezero" else swerve_solver
    solver = make(n=15, **vars(SQP.real_time()))
    x0, clock = solver.trajectory().x[0], [0.0]

    def solve() -> None:
        clock[0] += 0.001
        solver.iterate(x0, clock[0], 0.001)

    return solver, solve


@pytest.mark.parametrize("name", ["rezero", "swerve", "limited"])
def test_solves_allocate_nothing(name: str) -> None:
    solver, solve = real_time(name)
    python, peak, native = growth(solve)
    assert native == 0
    assert python < 12_000  # what other threads of the process do meanwhile; a leak would be 24 kB or more
    assert peak < 4096  # numbers of a call that go when it ends
    assert np.isfinite(solver.trajectory().x).all()


def test_the_limited_trolley_is_all_that_it_is_to_be() -> None:
    """Within its solves limits are passed, multiplier rows held by limits, equalities missed, plans rejected; and some are fine."""
    solver, solve = limited()
    seen: dict[str, int] = dict.fromkeys(("passed", "held", "fine"), 0)
    status = set()
    run = solver.iterate

    def reported(*given: Any) -> tuple[int, int]:
        code, count = run(*given)
        status.add(solver.status(code))
        seen["passed"] += solver.limit_violation > 0.0
        seen["held"] += solver.ws.state[StateField.BLOCKING_ROW] >= 0.0
        seen["fine"] += solver.limit_violation == 0.0 and code == 1
        return code, count

    solver.iterate = reported  # type: ignore[method-assign]
    for _ in range(300):
        solve()
    assert min(seen.values()) > 5 and Status.EQUALITY_INFEASIBLE in status, (seen, status)


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
        if not re.fullmatch(
            r"llvm\.((sqrt|log|exp|sin|cos|floor|fabs|pow|fma)|vector\.reduce\.\w+)\.\w+|asin|atan2", name
        )
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
    x0 = solver.trajectory().x[0]
    solver.iterate(x0)
    start = time.perf_counter()
    solver.iterate(x0)
    duration = time.perf_counter() - start
    backend: Any = solver._backend
    entry, address = backend._entry, LIBRARY.address(f"{receding_solve.signature.symbol}.entry")
    types: Any = entry.argtypes if entry.argtypes is not None else type(entry)._argtypes_
    holding = ctypes.PYFUNCTYPE(None, *types)(address)
    free, held, idle = [], [], []
    for _ in range(16):  # in turns, and again: the machine may be busy
        idle.append(lateness(lambda: time.sleep(duration), 0.25))
        backend._entry = entry
        free.append(lateness(lambda: solver.iterate(x0), 0.25))
        backend._entry = holding
        held.append(lateness(lambda: solver.iterate(x0), 0.25))
        regular = min(free) < 0.4 * min(held) and min(free) < 5.0 * min(idle) + 0.2 * duration
        if regular and len(free) > 2:
            break
    assert duration > 1e-3
    assert regular, (free, held, idle, duration)
