"""Log records of one cause, limited in their rate: a flood of bad input must not become a flood of lines."""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable

#: Causes that are remembered; of more the one that was heard longest ago is forgotten.
_CAUSES = 256


class RateLimit(logging.Filter):
    """Lets one record of each cause pass per ``interval`` [s] of ``clock``, with the number of those left out since the last.

    A filter for a logger or a handler; the cause of a record is its level, its message before the arguments are filled in and
    the type of its exception. For a cause of one's own see :meth:`admit`. ``brief``: exceptions are named without tracebacks.
    """

    def __init__(
        self, interval: float = 5.0, clock: Callable[[], float] = time.monotonic, *, brief: bool = False
    ) -> None:
        super().__init__()
        self.interval, self.clock, self.brief = interval, clock, brief
        self._causes: OrderedDict[Hashable, list[float]] = (
            OrderedDict()
        )  # cause: when one passed, how many did not since

    def admit(self, cause: Hashable) -> int | None:
        """Whether something of this cause may be logged now: None if not, else how many were left out since the last one."""
        now, seen = self.clock(), self._causes.get(cause)
        if seen is not None and now < seen[0] + self.interval:
            seen[1] += 1
            return None
        self._causes[cause] = [now, 0]
        self._causes.move_to_end(cause)
        if len(self._causes) > _CAUSES:
            self._causes.popitem(last=False)
        return 0 if seen is None else int(seen[1])

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record passes; the one that does says how many like it did not."""
        error = record.exc_info[1] if record.exc_info else None
        left_out = self.admit((record.name, record.levelno, str(record.msg), type(error)))
        if left_out is None:
            return False
        text = record.getMessage()
        if self.brief and error is not None:
            text, record.exc_info, record.exc_text = f"{text}: {type(error).__name__}: {error}", None, None
        record.msg, record.args = text + (f" ({left_out} more like this)" if left_out else ""), None
        return True
