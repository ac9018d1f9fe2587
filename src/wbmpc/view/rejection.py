"""What a page says of what was asked for and is not done."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from wbmpc.view.snapshot import plain

#: How long it is shown [s]: a picture is there for a thirtieth of a second.
SHOWN = 10.0


class Rejection:
    """The last reason, for :data:`SHOWN` seconds of ``clock`` [s]."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._reason, self._until = clock, "", -math.inf

    def show(self, reason: str) -> None:
        """Show a reason from the next text on. From any thread, at any rate: it costs nothing here."""
        self._reason, self._until = reason, self._clock() + SHOWN

    @property
    def text(self) -> str:
        """A line of Markdown after others; empty if there is nothing to say."""
        return f"  \n**Not done:** {plain(self._reason)}" if self._clock() < self._until else ""
