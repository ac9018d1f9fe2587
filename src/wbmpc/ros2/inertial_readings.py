"""Readings of the inertial unit that came since the last joint states: those that belong to the next ones, averaged."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np

from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.joints import OVERTAKEN, Inertial, mean_of, mean_rate
from wbmpc.runtime.clock import WallClock

#: Two messages whose stamps differ by less than this [s] are of one moment.
_TOGETHER = 1e-6
#: A reading of the gyro counts for so long [s] at most: longer than between two messages of 100 Hz, shorter than a base changes
#: its turning by much.
_READING = 0.02
#: Readings farther apart than this [s] say nothing of the turning between, however patient the watchdog is: a base stops within less than
#: twice of it.
GAP = 0.1
#: So many readings wait for joint states at most.
_WAITING = 4000


class InertialReadings:
    """Put in by a back end's thread, averaged in another one. ``watchdog`` [s]: without readings for longer nothing is known of the
    turning between."""

    def __init__(self, clock: WallClock | BusClock, watchdog: float) -> None:
        self._clock, self._watchdog = clock, watchdog
        self._last: tuple[Inertial, float] | None = None  # with its stamp [s], or when it came
        self._fresh: list[tuple[float, Inertial]] = []  # with stamps [s], since the joint states that were read last
        self._read: tuple[float, Inertial] | None = None
        self._previous: tuple[float, np.ndarray] | None = None  # stamp and gyro of the one that was read last
        self._until = -np.inf  # stamp of the last one
        self._asked: tuple[float, float] | None = (
            None  # stamp of the last joint states, and their time since those before [s]
        )
        self._lock = threading.Lock()

    @property
    def heard(self) -> bool:
        """Whether there has been one."""
        return self._last is not None

    @property
    def turning(self) -> float:
        """Yaw rate [rad/s] of the newest reading; 0 before the first and where none has come lately."""
        with self._lock:
            return float(self._last[0].gyro[2]) if self._last is not None and self.silent() < GAP else 0.0

    def put(self, stamp: float, reading: Inertial) -> None:
        """One of ``stamp`` [s] has come."""
        simulated = isinstance(self._clock, BusClock)
        with self._lock:
            again = bool(self._until == stamp > 0.0)  # a driver that hangs repeats itself
            if stamp < self._until - OVERTAKEN:  # what waits is of another clock, and would wait as long
                self._fresh.clear()
            self._until = stamp
            if again and self._last is not None and not simulated:
                return
            self._last = reading, stamp if simulated else time.perf_counter()
            self._fresh.append((stamp, reading))
            del self._fresh[:-_WAITING]

    def forget(self) -> None:
        """The next ones are another publisher's."""
        with self._lock:
            self._fresh.clear()
            self._read = self._previous = self._asked = None
            self._until = -np.inf

    def averaged(self, stamp: float) -> Inertial | None:
        """Of what was measured since the joint states that were read before: filters integrate it over their interval. None before the
        first one.

        What is stamped later than these joint states, of ``stamp`` [s], is for the next ones, unless the stamps are of another clock.
        """
        with self._lock:
            if self._read is not None and self._read[0] == stamp:
                return self._read[1]
            interval = self._interval(stamp)
            if not self._fresh:
                return self._newest(interval)
            later = [k for k, (at, _) in enumerate(self._fresh) if at > stamp + _TOGETHER]
            near = min(abs(self._fresh[k][0] - stamp) for k in (0, -1)) < self._watchdog
            same_clock = near or (bool(later) and later[0] > 0)
            end = later[0] if later and same_clock else len(self._fresh)
            due, self._fresh = self._fresh[:end], self._fresh[end:]
            if not due:
                return self._newest(interval)
            previous = [self._previous] if self._previous is not None else []
            seen = [*previous, *((at, i.gyro) for at, i in due)]
            times, rates = zip(*seen, strict=True)
            covered = stamp - times[-1] <= _READING or not isinstance(self._clock, BusClock)  # no stamp ahead
            if interval > GAP:  # what came of it, before the node was held up or after, is not all
                covered = covered and times[-1] - times[0] >= interval - _READING
            turning = mean_rate(times, rates, min(self._watchdog, GAP)) if covered else None
            self._previous = seen[-1]
            self._read = stamp, replace(mean_of([i for _, i in due]), turning=turning)
            return self._read[1]

    def _interval(self, stamp: float) -> float:
        """Time [s] that joint states of ``stamp`` [s] end: since the ones before."""
        if self._asked is None or self._asked[0] != stamp:
            self._asked = stamp, 0.0 if self._asked is None else stamp - self._asked[0]
        return self._asked[1]

    def _newest(self, interval: float) -> Inertial | None:
        """The last one again where none came for joint states; an old one says nothing of the turning, nor does any of a long ``interval``
        [s]."""
        if self._last is None:
            return None
        taken = self._last[0]
        return replace(taken, turning=taken.gyro if max(self.silent(), interval) <= _READING else None)

    def silent(self) -> float:
        """For how long [s] none has come; below 0 where the last one is stamped ahead of the bus's time."""
        assert self._last is not None
        return (self._clock.stamp() if isinstance(self._clock, BusClock) else time.perf_counter()) - self._last[1]
