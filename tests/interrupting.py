"""Calls that are interrupted in their middle, as by a signal's handler."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


def interrupted(call: Callable[[], Any], handler: Callable[[], None], step: int) -> tuple[Any, bool]:
    """What a call returns whose ``step``-th instruction of Python a handler comes before; whether there are so many."""
    count = 0

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal count
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        if event == "opcode":
            count += 1
            if count == step:
                handler()
        return trace

    previous = sys.gettrace()
    sys.settrace(trace)
    try:
        found = call()
    finally:
        sys.settrace(previous)
    return found, count >= step


@contextmanager
def in_time(seconds: int) -> Iterator[None]:
    """What waits for longer, as for a lock that nobody leaves, fails. For the main thread."""

    def late(*_: object) -> None:
        raise AssertionError(f"it has not ended within {seconds} s")

    previous = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)
