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
#: A goal that may have waited for longer than this [s] is not of now: who sent it has long seen that nothing moves.
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
        self._spent_before = spent()
        self._looked, self._over = np.inf, -np.inf  # the last look, and the end of the last long hold-up [s]
        self._held, self._fresh_from, self._in_order_from = 0.0, -np.inf, -np.inf
        self._recent: tuple[
            tuple[float, float], ...
        ] = ()  # how long hold-ups were, and until when messages of theirs may come [s]
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
        now, stood = self.wall(), self._stood()
        if stood > WAITED:
            self._held, self._fresh_from = self.waited(), now + WAITED
            self._recent = (*(h for h in self._recent if now < h[1]), (stood, now + AGAIN))
        if now - self._looked > WAITED:
            self._in_order_from = now + AGAIN
        if stood > OLD:
            self._over = now
        self._looked, self._spent_before = now, self._spent()

    def _stood(self) -> float:
        """For how long [s] the process has not been looked at while it did not work either."""
        passed = self.wall() - self._looked
        return passed if self._spent() - self._spent_before < OWN_WORK * passed else 0.0

    def waited(self) -> float:
        """For how long [s] a message that comes now may have waited."""
        now = self.wall()
        return max(self._stood(), self._held if now < self._fresh_from else 0.0)

    def silence(self, seconds: float) -> bool:
        """Whether so long a silence [s] is that of who sends: not of a process that was held up, or did other work than to listen, nor of
        what waits for messages that found no room meanwhile."""
        now = self.wall()
        return now - self._looked <= WAITED and now >= self._in_order_from + seconds

    def since(self, time: float) -> bool:
        """Whether there was one longer than :data:`OLD` after a ``time`` [s], also where no look has noticed it yet."""
        return time <= self._over or (time <= self._looked and self._stood() > OLD)

    def too_old(self, what: str, limit: float = OLD) -> str:
        """Why ``what`` has just come and does not count, for it may have waited longer than a limit [s]; empty if it does."""
        if self.waited() > limit:
            return f"{what} is not of now: it came while the node was held up"
        now = self.wall()
        if any(length > limit and now < until for length, until in self._recent):
            return f"{what} may not be of now: the node was held up within the last {AGAIN:g} s"
        return ""

    def check(self, came: float) -> None:
        """Raise :class:`InputError` if what came at a time [s], and has not begun, does not count any more."""
        if self.since(came):
            raise InputError("it is from before the node was held up")
