"""Whether the process was held up as a whole, and what has waited meanwhile."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np

from wbmpc.errors import InputError
from wbmpc.ros2.network import LEASE

#: How often [s] a thread looks.
BEAT = 0.02
#: Looks farther apart than this [s] are a hold-up; so long after one messages that waited come.
WAITED = 0.1
#: A process that has worked for this share of a time was not held up.
OWN_WORK = 0.5
#: A goal that may have waited for longer than this [s] is not current: who sent it has long seen that nothing moves.
OLD = 1.0
#: So long [s] after a hold-up messages of its time may still come, and others wait for them: what found no room in the process's
#: buffers reliable writers offer again, after pauses that grow until they forget a reader that is silent.
AGAIN = LEASE + 0.5


def machine_time() -> float:
    """Time [s] that goes on while the machine is suspended, where the system has such a one; else its steady time."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if clock is None else time.clock_gettime(clock)


class HoldUps:
    """Looks at the time ``wall()`` [s] in a thread of its own, between :meth:`begin` and :meth:`end`: work of other threads that takes long
    is no hold-up, for messages come meanwhile; nor is work that keeps the interpreter to itself: the process has ``spent()`` that time [s].
    On a bus that waits ``wall`` stands still."""

    def __init__(
        self, wall: Callable[[], float] = machine_time, spent: Callable[[], float] = time.process_time
    ) -> None:
        self.wall, self._spent = wall, spent
        # the last look [s], what the process had worked by then [s], and how long messages that it had not taken in had waited [s]
        self._last = np.inf, spent(), 0.0
        self._over = -np.inf  # the end of the last long hold-up [s]
        self._held, self._fresh_from, self._in_order_from = 0.0, -np.inf, -np.inf
        # of each hold-up: how long messages have waited, and until when they may come [s]
        self._recent: tuple[tuple[float, float], ...] = ()
        self._ended = threading.Event()

    def begin(self) -> None:
        """Look from now on."""
        self.look()
        threading.Thread(target=self._beat, name="hold-ups", daemon=True).start()

    def end(self) -> None:
        """Look no more."""
        self._ended.set()

    def _beat(self) -> None:
        while not self._ended.wait(BEAT):
            self.look()

    def look(self) -> None:
        """Messages that have come since the last look may be of any time since then, if that was long ago."""
        now, stood = self.wall(), self._stood(self._last)
        if stood > WAITED:
            self._held, self._fresh_from = self.waited(), now + WAITED
            self._recent = (*(h for h in self._recent if now < h[1]), (self._held, now + AGAIN))
        if now - self._last[0] > WAITED:
            self._in_order_from = now + AGAIN
        if stood > OLD:
            self._over = now
        self._last = now, self._spent(), self._held if now < self._fresh_from else 0.0

    def _stood(self, last: tuple[float, float, float]) -> float:
        """For how long [s] since the ``last`` look the process has not been looked at while it did not work either."""
        passed = self.wall() - last[0]
        return passed if self._spent() - last[1] < OWN_WORK * passed else 0.0

    def waited(self) -> float:
        """For how long [s] a message that comes now may have waited: what was not taken in between two hold-ups, for both."""
        last = self._last  # once: another thread looks
        stood = self._stood(last)
        before = last[2] if stood > WAITED else 0.0
        return max(stood + before, self._held if self.wall() < self._fresh_from else 0.0)

    def silence(self, seconds: float) -> bool:
        """Whether a silence of ``seconds`` that ends now means that nothing was sent. It may not where this process was held up, or its own
        work kept it from listening, for longer than :data:`WAITED`; nor for :data:`AGAIN` afterwards, while lost messages are sent again."""
        now = self.wall()
        return now - self._last[0] <= WAITED and now >= self._in_order_from + seconds

    def since(self, time: float) -> bool:
        """Whether there was one longer than :data:`OLD` after a ``time`` [s], also where no look has noticed it yet."""
        last = self._last
        return time <= self._over or (time <= last[0] and self._stood(last) > OLD)

    def too_old(self, what: str, limit: float = OLD) -> str:
        """Why ``what`` has just come and does not count, for it may have waited longer than a limit [s]; empty if it does."""
        if self.waited() > limit:
            return f"{what} is not current: it came while the node was held up"
        now = self.wall()
        if any(length > limit and now < until for length, until in self._recent):
            return f"{what} may not be current: the node was held up within the last {AGAIN:g} s"
        return ""

    def check(self, came: float) -> None:
        """Raise :class:`InputError` if what came at a time [s], and has not begun, does not count any more."""
        if self.since(came):
            raise InputError("it is from before the node was held up")
