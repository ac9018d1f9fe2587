"""Endpoints of others that do not match ours: told once, and in the diagnostics for as long as they are there."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass

from wbmpc.ros2.bus import Endpoint, Node, Qos

_LOG = logging.getLogger("wbmpc")
#: So long [s] after the notice the graph may not show an endpoint yet.
_UNSEEN = 2.0
#: What the graph shows of an endpoint: of other policies it is not known whose they were.
_SEEN = ("type", "durability", "reliability")


@dataclass(frozen=True)
class Ours:
    """A publisher or a subscription of this node; ``others``: types that it takes or gives on this topic besides."""

    side: str
    topic: str
    type: str
    qos: Qos
    others: tuple[str, ...] = ()

    def wrong(self, endpoints: list[Endpoint]) -> list[Endpoint]:
        """Which endpoints of the other side do not match this one."""
        return [e for e in endpoints if self.wrong_type(e) or (e.type == self.type and self._refuses(e))]

    def wrong_type(self, e: Endpoint) -> bool:
        """Whether the node cannot understand an endpoint at all."""
        return e.type != self.type and e.type not in self.others

    def _refuses(self, e: Endpoint) -> bool:
        return bool(self.qos.refuses(e.qos) if self.side == "subscription" else e.qos.refuses(self.qos))


class Mismatches:
    """``notice`` comes from the back end's own thread, when the middleware has found one."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._found: dict[str, tuple[Ours, str, float]] = {}
        self._lock = threading.Lock()

    def notice(self, ours: Ours, policy: str) -> None:
        """``policy``: what does not match; ``type`` if that is the type."""
        who = "publisher" if ours.side == "subscription" else "subscription"
        types = sorted({e.type for e in self._across(ours) if ours.wrong_type(e)})
        if policy == "type":
            if ours.others and not types:
                return  # it is heard in another type
            than = "is asked for" if who == "publisher" else "is published"
            why = f"{who} of {ours.topic} has another type ({', '.join(types) or 'unknown'}) than {than} ({ours.type})"
            sentence = f"a {why}; no message will come through"
        else:
            asks = "offers less than is asked for" if who == "publisher" else "asks for more than is offered"
            sentence = f"{ours.topic}: a {who} {asks} ({policy}); no message will come through"
        with self._lock:
            new = sentence not in self._found
            self._found[sentence] = ours, policy, time.monotonic()
        if new:
            _LOG.error("%s", sentence)

    def sentences(self) -> list[str]:
        """Of those that are still there."""
        with self._lock:
            found = dict(self._found)
        gone = [s for s, (ours, policy, at) in found.items() if not self._there(ours, policy, at)]
        with self._lock:
            for sentence in gone:
                self._found.pop(sentence, None)
        return [s for s in found if s not in gone]

    def _there(self, ours: Ours, policy: str, at: float) -> bool:
        across = self._across(ours)
        still = ours.wrong(across) if policy in _SEEN else [e for e in across if not e.own]
        return bool(still) or time.monotonic() - at < _UNSEEN

    def _across(self, ours: Ours) -> list[Endpoint]:
        look = self._node.publishers if ours.side == "subscription" else self._node.subscribers
        return look(ours.topic)
