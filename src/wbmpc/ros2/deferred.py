"""Messages that wait for a node's own thread, bounded for each topic: a flood on one takes neither memory nor time from others."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from wbmpc.ros2.bus import Qos

#: Of more messages of one topic, or bytes of them, the oldest are dropped; but the newest one is kept whatever its size.
MAX_MESSAGES, MAX_BYTES = 20, 2**23
#: No more messages are begun after so long [s]: the node has other things to look after.
BUDGET = 0.02
Call = Callable[[Any], None]


def most(qos: Qos) -> int:
    """So many messages of a subscription wait: where late joiners get the last ones, all of these."""
    return max(qos.depth, MAX_MESSAGES) if qos.latched else MAX_MESSAGES


class Deferred:
    """Messages in the order in which they came, with what is called for each. Thread-safe."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[tuple[int, Call, Any, int]]] = {}
        self._lock = threading.Lock()
        self._number = 0

    def put(self, topic: str, call: Call, message: Any, size: int = 0, most: int = MAX_MESSAGES) -> None:
        """Keep a message of ``size`` bytes, and of its topic's ``most``."""
        with self._lock:
            waiting = self._waiting.setdefault(topic, deque(maxlen=most))
            waiting.append((self._number, call, message, size))
            self._number += 1
            while len(waiting) > 1 and sum(w[3] for w in waiting) > MAX_BYTES:
                waiting.popleft()

    def work(self) -> None:
        """Call for the messages that have come until now, as far as they fit into :data:`BUDGET`."""
        begin, last = time.perf_counter(), self._number
        while (first := self._first(last)) is not None:
            first[1](first[2])
            if time.perf_counter() - begin > BUDGET:
                return

    def _first(self, before: int) -> tuple[int, Call, Any, int] | None:
        """The oldest message with a number below ``before``, once."""
        with self._lock:
            heads = [w for w in self._waiting.values() if w and w[0][0] < before]
            return min(heads, key=lambda w: w[0][0]).popleft() if heads else None
