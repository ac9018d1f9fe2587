"""The process and its interpreter for the sake of the controller's ticks: who gets the interpreter, when garbage is collected,
before whom the kernel lets the control thread run."""

from __future__ import annotations

import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from wbmpc.runtime.clock import Turns

#: How long [s] another thread waits for the interpreter before it takes it from a tick, and from any other thread.
TURNS = Turns(work=5e-3, rest=1e-5)
#: How often young garbage is collected [s]: it takes some 10 µs then, and cycles are rare.
COLLECT = 1.0


@contextmanager
def real_time_interpreter() -> Iterator[Callable[[Callable[[], None]], None]]:
    """Threads give way at once, and nothing is collected but young garbage by what this yields: to be called again and again,
    with a function that waits for a good moment."""
    gc.collect()
    gc.freeze()
    gc.disable()
    usual = sys.getswitchinterval()
    sys.setswitchinterval(TURNS.rest)
    collected = time.monotonic()

    def collect(wait: Callable[[], None]) -> None:
        nonlocal collected
        if time.monotonic() - collected > COLLECT:
            wait()
            gc.collect(0)
            collected = time.monotonic()

    try:
        yield collect
    finally:
        sys.setswitchinterval(usual)
        gc.enable()
        gc.unfreeze()


def control_priority() -> int:
    """Of the control thread: before all others of a process that is in the kernel's real-time class itself; 0 in none."""
    real_time = os.sched_getscheduler(0) == os.SCHED_FIFO
    return min(os.sched_getparam(0).sched_priority + 2, 99) if real_time else 0
