"""One topic in several types: speeds and poses come in either of two."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from wbmpc.ros2.bus import SENSOR, SMALL, Node
from wbmpc.ros2.convert import error_message

_LOG = logging.getLogger("wbmpc")


class MultiTypeSubscriber:
    """A topic whose messages come in one of several types, also in another one later; ``takes``: what is called, by type, with
    ``sourced`` as :meth:`wbmpc.ros2.bus.Node.subscribe` has it;
    ``fault``: which type is not heard, and why; empty when all are."""

    def __init__(self, node: Node, topic: str, takes: Mapping[str, Callable[..., None]], sourced: bool = False) -> None:
        self._node, self._topic, self._takes, self._sourced = node, topic, takes, sourced
        self._ends: dict[str, Callable[[], None]] = {}
        self.fault = ""
        if topic:  # who publishes in the first type finds a subscription at once
            self._take_in([next(iter(takes))])

    def update(self) -> None:
        """Subscribe in the types that are published; the others' subscriptions end: a middleware may have room for
        one type only."""
        kinds = {e.type for e in self._node.publishers(self._topic)} & self._takes.keys() if self._topic else set()
        for kind in [k for k in self._ends if kinds and k not in kinds]:
            self._ends.pop(kind)()
        self._take_in(sorted(kinds - self._ends.keys()))

    def _take_in(self, kinds: list[str]) -> None:
        fault = ""
        for kind in kinds:
            try:
                self._ends[kind] = self._node.subscribe(
                    self._topic, kind, self._takes[kind], SENSOR, others=tuple(self._takes), largest=SMALL,
                    sourced=self._sourced,
                )  # fmt: skip
            except Exception as error:
                fault = f"{self._topic}: {kind} is not heard beside {', '.join(self._ends)}: {error_message(error)}"
        if fault and fault != self.fault:
            _LOG.error("%s", fault)
        self.fault = fault
