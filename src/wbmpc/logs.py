"""Log lines of one cause, limited in their rate: a flood of bad input must not become a flood of lines."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass

from wbmpc.errors import NO_TEXT

#: Causes that are known at a time; of more the oldest is forgotten.
MAX_CAUSES = 1000
#: Attribute of a record that says whether it passes, once it was counted.
_COUNTED = "wbmpc_counted"


@dataclass
class _Seen:
    """``since`` [s]: when the period began; lines in it; lines that were left out since the last one that was written."""

    since: float
    written: int = 0
    left_out: int = 0


class RateLimit:
    """At most ``lines`` of one cause within ``period`` [s] of ``clock()``; the next line of the cause that is written says how
    many were left out before it. Thread-safe."""

    def __init__(self, lines: int = 5, period: float = 10.0, clock: Callable[[], float] = time.monotonic) -> None:
        self.lines, self.period, self.clock = lines, period, clock
        self._seen: dict[Hashable, _Seen] = {}
        self._lock = threading.RLock()  # a signal's handler may log in the middle

    def left_out(self, cause: Hashable) -> int | None:
        """Count a line of a cause. How many of it were left out before, if this one may be written, else None."""
        now = self.clock()
        with self._lock:
            seen = self._seen.pop(cause, None) or _Seen(now)
            self._seen[cause] = seen  # the newest is the last
            if len(self._seen) > MAX_CAUSES:
                del self._seen[next(iter(self._seen))]
            if now - seen.since >= self.period:
                seen.since, seen.written = now, 0
            if seen.written >= self.lines:
                seen.left_out += 1
                return None
            seen.written += 1
            left_out, seen.left_out = seen.left_out, 0
            return left_out

    def log(self, logger: logging.Logger, level: int, cause: Hashable, message: str) -> None:
        """Write a line, unless there were too many of its cause."""
        left_out = self.left_out(cause)
        if left_out is not None:
            more = f" ({left_out} more of this kind were left out)" if left_out else ""
            logger.log(level, "%s%s", message, more, stacklevel=2, extra={_COUNTED: True})


def message_of(record: logging.LogRecord) -> str:
    """Its text, if that can be made: no line may stop who logs it, which can be a control thread."""
    try:
        return record.getMessage()
    except Exception:
        return f"{record.msg} {NO_TEXT}" if isinstance(record.msg, str) else NO_TEXT


class PlaceLimit(logging.Filter):
    """A filter for handlers of a program that others make speak, as a node on a bus: lines of one place in the code are as few as those
    of one cause of a :class:`RateLimit`. What one has counted already passes, also where several handlers have a filter."""

    def __init__(self, limit: RateLimit | None = None) -> None:
        super().__init__()
        self.limit = limit or RateLimit()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record passes; the one that does says how many of its place did not."""
        passes: bool | None = getattr(record, _COUNTED, None)
        if passes is None:
            left_out = self.limit.left_out((record.pathname, record.lineno))
            passes = left_out is not None
            if left_out:
                record.msg, record.args = f"{message_of(record)} ({left_out} more of this kind were left out)", None
            setattr(record, _COUNTED, passes)
        return passes


class RateLimitFilter(logging.Filter):
    """A filter for a logger or a handler that lets one record of each cause pass per ``interval`` [s] of ``clock``.

    The cause of a record is its logger, its level, its message before the arguments are filled in and the type of its exception.
    ``brief``: exceptions are named without tracebacks.
    """

    def __init__(
        self, interval: float = 5.0, clock: Callable[[], float] = time.monotonic, *, brief: bool = False
    ) -> None:
        super().__init__()
        self.limit, self.brief = RateLimit(1, interval, clock), brief

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record passes; the one that does says how many like it did not."""
        error = record.exc_info[1] if record.exc_info else None
        left_out = self.limit.left_out((record.name, record.levelno, str(record.msg), type(error)))
        if left_out is None:
            return False
        text = message_of(record)
        if self.brief and error is not None:
            text, record.exc_info, record.exc_text = f"{text}: {type(error).__name__}: {error}", None, None
        record.msg, record.args = text + (f" ({left_out} more like this)" if left_out else ""), None
        return True
