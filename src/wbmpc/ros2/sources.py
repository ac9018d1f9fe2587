"""Inputs with one source: messages of one publisher count, those of others are ignored and reported."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Hashable
from typing import Protocol

from wbmpc.logs import RateLimit

_LOG = logging.getLogger("wbmpc")
#: Others are reported for so long [s] after their last message, and at most so many are counted.
_REPORTED, _COUNTED = 2.0, 100


class Source(Hashable, Protocol):
    """What a back end knows a publisher by; equal for messages of one publisher."""

    def gone(self) -> bool:
        """Whether it has left the bus: it ended, or its lease did. A silent one, or one that is not heard, has not."""
        ...

    def prefer(self) -> None:
        """Only this publisher's messages count: the back end may drop most of the others'."""
        ...


class _Ambiguous:
    """See :data:`AMBIGUOUS`."""

    def gone(self) -> bool:
        return False

    def prefer(self) -> None:
        pass


#: In place of a publisher's identity: one of several, and the back end does not know which one.
AMBIGUOUS = _Ambiguous()


class OneSource:
    """The publisher whose messages on a topic count: the first one that is heard, until it is gone from the bus and another one
    speaks. One that is silent is not replaced: a publisher that floods a topic may keep the first one's messages from arriving.
    ``replaced``: whether that has happened since :meth:`settle`; ``switched`` is called when it does.

    Called from one thread of a back end; :attr:`conflict` from any. ``take_ambiguous``: messages count although their publisher is unknown.
    """

    def __init__(self, topic: str, switched: Callable[[], None] = lambda: None, take_ambiguous: bool = False) -> None:
        self.topic, self.replaced = topic, ""
        self._switched, self._take_ambiguous = switched, take_ambiguous
        self._limit = RateLimit()
        self._source: Source | None = None
        self._others: dict[Source, float] = {}  # when they were heard last

    def follows(self, source: Source | None) -> bool:
        """Whether it is this publisher's messages that count, or no publisher's yet."""
        return self._source is None or source == self._source

    def takes(self, source: Source | None) -> bool:
        """Whether a message that has just come from a publisher counts. None: there is only one."""
        if source is None or source == self._source:
            return True
        if source is AMBIGUOUS:
            self._note(source)
            return self._take_ambiguous
        if self._source is not None:
            if not self._source.gone():
                self._note(source)
                return False
            self.replaced = f"the publisher of {self.topic} was replaced by another one"
            self._limit.log(_LOG, logging.WARNING, "replaced", self.replaced)
            self._others.pop(source, None)
            self._switched()
        self._source = source
        source.prefer()
        return True

    def settle(self) -> str:
        """The publisher that is heard now is the right one; returns what :attr:`replaced` was."""
        was, self.replaced = self.replaced, ""
        return was

    @property
    def conflict(self) -> str:
        """That others publish too; empty if none has lately."""
        limit = time.monotonic() - _REPORTED
        recent = [s for s, at in tuple(self._others.items()) if at > limit]
        if not recent:
            return ""
        if AMBIGUOUS in recent:
            return f"more than one publisher on {self.topic}, which has one source"
        return f"{len(recent) + 1} publishers on {self.topic}, which has one source: only the first one counts"

    def _note(self, source: Source) -> None:
        if source not in self._others and len(self._others) >= _COUNTED:
            del self._others[min(self._others, key=lambda s: self._others[s])]
        self._others[source] = time.monotonic()
