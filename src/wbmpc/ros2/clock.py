"""The runner's time from a bus: what ``/clock`` says, for simulators that are slower or faster than the wall clock."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from wbmpc.ros2.settings import GONE
from wbmpc.ros2.sources import OneSource, Source

#: Differences of times [s] below this are none.
_ROUNDING = 1e-7
#: Messages may overtake each other by this [s].
_REORDERED = 0.02
#: What came before time went back is so much older [s] than what comes afterwards: more than any age that the settings allow.
_BEFORE = 100.0
#: Times that are farther apart than this [s] are a jump: slow simulators publish theirs ten times in a second.
_JUMP = 0.2
#: Over which time [s] of the wall the speed of the bus's time is averaged.
_MEMORY = 0.5


class BusClock:
    """See :class:`wbmpc.runtime.clock.Clock`. ``origin`` [s]: the bus's time that counts as 0; ``heard``: wall time of the last
    message with another time [s], None before the first; ``went_back``: whether time has since :meth:`restart`; ``speed``: of the
    bus's time by the wall's, lately. ``source``: whose time it is.

    ``delay`` [s]: a solve takes this much of the bus's time, and controller and MPC run in turns (``in_turns``), so that nothing
    depends on the machine's speed, provided that the bus waits for the commands. None: a solve takes the time that it takes.
    """

    def __init__(self, delay: float | None = None) -> None:
        self.delay, self.in_turns = delay, delay is not None
        self.origin, self.heard = 0.0, None  # type: float, float | None
        self._time, self.went_back = 0.0, False
        self._steady = self._ahead = self._elapsed = 0.0
        self._stood = 0.0, 1.0  # the longest silence since the restart [s of the wall], and the speed before it
        self._changed = threading.Condition()
        self._released = False
        self.speed = 1.0
        self.source = OneSource("/clock")

    def set(self, time_of_bus: float, source: Source | None = None) -> None:
        """The bus's time [s] is now this, says a publisher. Time that goes back is a simulator that was restarted; a message that another one
        has overtaken says nothing."""
        if not self.source.takes(source):
            return
        with self._changed:
            if self._time - _REORDERED <= time_of_bus < self._time:
                return
            if time_of_bus < self._time:
                self.went_back = True
                self._ahead += self._time - time_of_bus + _BEFORE
            if self.heard is None or time_of_bus != self._time:
                previous, self.heard = self.heard, time.monotonic()
                if previous is not None:  # before the speed says what the silence has made of it
                    self._stood = max(self._stood, (self.heard - previous, self.speed))
                if previous is not None and time_of_bus > self._time:
                    self._pass(min(time_of_bus - self._time, _MEMORY), max(self.heard - previous, 1e-6))
            self._elapsed += min(max(time_of_bus - self._time, 0.0), _JUMP)
            self._time, self._steady = time_of_bus, time_of_bus + self._ahead
            self._changed.notify_all()

    def _pass(self, of_bus: float, of_wall: float) -> None:
        """So much time [s] has passed."""
        share = 1.0 - math.exp(-of_wall / _MEMORY)
        self.speed += share * (of_bus / of_wall - self.speed)

    def stamp(self) -> float:
        """The bus's time [s]."""
        return self._time

    def steady(self) -> float:
        """A time [s] by which messages grow old: the bus's, but where that goes back this one jumps ahead."""
        return self._steady

    def elapsed(self) -> float:
        """Time [s] that has passed on the bus, of which a jump counts as :data:`_JUMP` at most: it is no silence of who sends."""
        return self._elapsed

    def lost(self, limit: float, published: Callable[[], bool]) -> str:
        """Why there is no time any more: none for ``limit`` [s] of the wall, or for :data:`GONE` and no publisher of it; empty
        if there is, or has never been any."""
        if self.heard is None:
            return ""
        silent = time.monotonic() - self.heard
        gone = silent > min(GONE, limit) and not published()
        who = ", it has no publisher any more" if gone else ""
        return f"the time on /clock has stopped for {silent:.1f} s{who}" if gone or silent > limit else ""

    def stood(self, limit: Callable[[float], float]) -> str:
        """Why time does not count that goes on now: since :meth:`restart` it has stood for longer than ``limit(speed)`` [s of the wall], also
        where this process was held up and messages wait that lead to now step by step; empty if it has not."""
        silent, speed = self._stood
        return f"the time on /clock stood still for {silent:.1f} s" if silent > limit(speed) else ""

    def restart(self) -> None:
        """Now is 0."""
        self._stood = 0.0, 1.0
        self.origin, self.went_back, self._released = self._time, False, False
        self.source.settle()

    def now(self) -> float:
        """Time [s]."""
        return self._time - self.origin

    def wait(self, until: float) -> None:
        """Return when it is ``until`` [s], or from :meth:`release` on."""
        with self._changed:
            self._changed.wait_for(lambda: self._released or self.now() >= until - _ROUNDING)

    def release(self) -> None:
        """No call waits any more until :meth:`restart`: time may never come that far."""
        with self._changed:
            self._released = True
            self._changed.notify_all()

    def computing(self) -> float:
        """The modeled duration of a solve [s]."""
        return self.delay or 0.0
