"""Inputs with one source: messages of one publisher count, those of others are ignored and reported."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Hashable

from wbmpc.logs import RateLimit

_LOG = logging.getLogger("wbmpc")
#: A publisher that has been silent for so long [s] makes room for another one: a killed process is on the bus until its lease ends.
SILENT = 1.0
#: Others are reported for so long [s] after their last message, and at most so many are counted.
_REPORTED, _COUNTED = 2.0, 100
#: In place of a publisher's identity: one of several, and the back end does not know which one.
AMBIGUOUS = object()


class OneSource:
    """The publisher whose messages on a topic count: the first one that is heard, until it has been silent for :data:`SILENT` and
    another one speaks. ``replaced``: whether that has happened since :meth:`settle`; ``switched`` is called when it does.

    Called from one thread of a back end; :attr:`conflict` from any. ``take_ambiguous``: messages count although nobody knows whose they are.
    """

    def __init__(self, topic: str, switched: Callable[[], None] = lambda: None, take_ambiguous: bool = False) -> None:
        self.topic, self.replaced = topic, ""
        self._switched, self._take_ambiguous = switched, take_ambiguous
        self._limit = RateLimit()
        self._source: Hashable | None = None
        self._heard = 0.0
        self._others: dict[Hashable, float] = {}  # when they were heard last

    def follows(self, source: Hashable) -> bool:
        """Whether it is this publisher's messages that count, or nobody's yet."""
        return self._source is None or source == self._source

    def takes(self, source: Hashable) -> bool:
        """Whether a message that has just come from a publisher counts."""
        now = time.monotonic()
        if source is AMBIGUOUS:
            self._others[source] = now
            return self._take_ambiguous
        if not self.follows(source):
            if now - self._heard <= SILENT:
                self._note(source, now)
                return False
            self.replaced = f"the publisher of {self.topic} was replaced by another one"
            self._limit.log(_LOG, logging.WARNING, "replaced", self.replaced)
            self._others.pop(source, None)
            self._switched()
        self._source, self._heard = source, now
        return True

    def settle(self) -> None:
        """Whoever is heard now is the right one."""
        self.replaced = ""

    @property
    def conflict(self) -> str:
        """That others publish too; empty if none has lately."""
        limit = time.monotonic() - _REPORTED
        recent = [s for s, at in tuple(self._others.items()) if at > limit]
        if not recent:
            return ""
        if AMBIGUOUS in recent:
            return f"more than one publisher on {self.topic}, which has one source"
        many = f"{len(recent) + 1} publishers on {self.topic}, which has one source"
        return f"{many}: only the first one counts, until it is silent for {SILENT:g} s"

    def _note(self, source: Hashable, now: float) -> None:
        if source not in self._others and len(self._others) >= _COUNTED:
            del self._others[min(self._others, key=lambda s: self._others[s])]
        self._others[source] = now
