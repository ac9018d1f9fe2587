"""Who else commands the drives: two controllers on one drive are worse than none."""

from __future__ import annotations

import time
from collections.abc import Callable

from wbmpc.ros2.bus import Node

#: Another publisher counts for so long [s] after it was seen last, and after it has left: one that comes and goes is as bad as one that
#: stays.
LINGERS = 1.0


class CommandConflicts:
    """Other nodes' publishers on command ``topics``. ``message``: that there is one; empty if there has been none lately."""

    def __init__(self, node: Node, topics: list[str], clock: Callable[[], float] = time.monotonic) -> None:
        self.message = ""
        self._node, self._topics, self._clock = node, topics, clock
        self._seen = -float("inf")

    def update(self) -> None:
        """Look at the graph."""
        now = self._clock()
        others = [t for t in self._topics if any(not e.own for e in self._node.publishers(t, LINGERS))]
        if others:
            self.message, self._seen = f"another node publishes on {others[0]}", now
        elif now - self._seen > LINGERS:
            self.message = ""
