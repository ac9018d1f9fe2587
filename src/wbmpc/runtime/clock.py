"""Time for the real-time runner: the wall's, or a virtual one in which the same loops run repeatably without sleeping.

A loop is a generator that yields the time [s] at which it resumes. A thread follows one loop by the wall clock; in
virtual time :func:`interleave` takes the loops in turns, always the one that is due first.
"""

from __future__ import annotations

import heapq
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from wbmpc.errors import InputError

Loop = Iterator[float]


class Clock(Protocol):
    """Seconds since :meth:`restart`."""

    def restart(self) -> None: ...
    def now(self) -> float: ...
    def wait(self, until: float) -> None: ...

    def computing(self) -> float:
        """How long a solve is to take [s]: modeled in virtual time; 0 where it takes time by itself."""
        ...


@dataclass(frozen=True)
class Turns:
    """How long [s] another thread waits for Python's interpreter before it takes it: from a loop that works (``work``), and from
    other threads while that loop waits (``rest``).

    The interval holds for the process and for waits that begin later. So it changes in the moment in which the loop gets the
    interpreter back: a thread that had begun a short wait after that would take it from the loop's first lines, and then the
    loop would be the one who waits for long.
    """

    work: float
    rest: float

    def during(self, wait: Callable[[], object]) -> None:
        sys.setswitchinterval(self.rest)
        wait()
        sys.setswitchinterval(self.work)


class WallClock:
    """The machine's steady clock, the same in all processes.

    It sleeps until ``spin`` [s] before the end and then polls the clock: sleeping alone is late by a timer slack of some 50 µs. ``origin``
    [s]: the clock's zero (default: now). ``turns`` of the loop that waits by this clock with the
    other threads (left out: as they are in this process).
    """

    def __init__(self, origin: float | None = None, spin: float = 1e-4, turns: Turns | None = None) -> None:
        self.origin, self.spin = time.perf_counter() if origin is None else origin, spin
        self.turns = turns

    def restart(self) -> None:
        """Now is 0."""
        self.origin = time.perf_counter()

    def now(self) -> float:
        """Time [s]."""
        return time.perf_counter() - self.origin

    def wait(self, until: float) -> None:
        """Return at the time ``until`` [s], at once if it has passed."""
        left = until - self.now() - self.spin
        if self.turns is not None:
            self.turns.during(lambda: time.sleep(max(left, 0.0)))
        elif left > 0.0:
            time.sleep(left)
        while self.now() < until:
            pass

    def computing(self) -> float:
        """Modeled duration of a solve [s]: 0, because solves take real time."""
        return 0.0


class VirtualClock:
    """Time that passes only when a loop waits or :meth:`wait` is called. ``computing``: duration [s] of each solve."""

    def __init__(self, computing: float | Callable[[], float] = 0.0) -> None:
        self._time = 0.0
        self._computing = computing

    def restart(self) -> None:
        """Now is 0."""
        self._time = 0.0

    def now(self) -> float:
        """Time [s]."""
        return self._time

    def wait(self, until: float) -> None:
        """Move on to the time ``until`` [s], not back."""
        self._time = max(self._time, until)

    def computing(self) -> float:
        """The modeled duration of this solve [s]."""
        return self._computing() if callable(self._computing) else self._computing


class Ticker:
    """Deadlines at a fixed period [s]: tick i is due at ``start`` + i periods and has to be over before the next is due.

    After an overrun the deadlines that have passed are skipped; the grid of times stays as it is.
    """

    def __init__(self, period: float, start: float = 0.0) -> None:
        if not period > 0.0:
            raise InputError(f"period: must be positive, got {period}")
        self.period, self.start = period, start
        self._index = 0

    @property
    def due(self) -> float:
        """When the present tick is due [s]."""
        return self.start + self._index * self.period

    def over(self, now: float) -> int:
        """The present tick ended at ``now`` [s]: go on to the next; returns how many deadlines were missed."""
        missed = max(math.ceil((now - self.due) / self.period - 1e-9) - 1, 0)
        self._index += missed + 1
        return missed


def follow(clock: Clock, loop: Loop) -> None:
    """Run a loop by the wall clock, in this thread, to its end."""
    for due in loop:
        clock.wait(due)


def interleave(clock: Clock, loops: Sequence[Loop], until: float) -> None:
    """Run loops in virtual time up to ``until`` [s]; of those that are due at the same time the first in the list."""
    queue = []
    for order, loop in enumerate(loops):
        due = next(loop, None)
        if due is not None:
            queue.append((due, order))
    heapq.heapify(queue)
    while queue and queue[0][0] <= until:
        due, order = heapq.heappop(queue)
        clock.wait(due)
        following = next(loops[order], None)
        if following is not None:
            heapq.heappush(queue, (following, order))
    clock.wait(until)
