"""Endpoints of others that do not match ours: reported once, and in the diagnostics for as long as they are there."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass

from wbmpc.ros2.bus import Endpoint, Node, Qos
from wbmpc.ros2.convert import one_line

_LOG = logging.getLogger("wbmpc")
#: So long [s] after the notice the graph may not show an endpoint yet, and who takes several types may be about to take another.
_UNSEEN = 2.0
#: What the graph shows of an endpoint: of other policies it is not known whose they were.
_SEEN = ("type", "durability", "reliability")


@dataclass(frozen=True)
class OwnEndpoint:
    """A publisher or a subscription of this node; ``others``: types that it takes or gives on this topic besides."""

    side: str
    topic: str
    type: str
    qos: Qos
    others: tuple[str, ...] = ()

    def wrong(self, endpoints: list[Endpoint]) -> list[Endpoint]:
        """Which endpoints of the other side do not match this one."""
        return [e for e in endpoints if self.wrong_type(e) or (e.type == self.type and self._rejects(e))]

    def wrong_type(self, e: Endpoint) -> bool:
        """Whether the node cannot understand an endpoint at all."""
        return e.type != self.type and e.type not in self.others

    def _rejects(self, e: Endpoint) -> bool:
        return bool(self.qos.incompatible(e.qos) if self.side == "subscription" else e.qos.incompatible(self.qos))


class Mismatches:
    """``notice`` comes from the back end's own thread, when the middleware has found one."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._found: dict[tuple[OwnEndpoint, str], tuple[str, float]] = {}  # message and time [s]
        self._waiting: set[OwnEndpoint] = set()  # for a look at types
        self._lock = threading.Lock()
        self._looking, self._closed = threading.Lock(), False

    def notice(self, ours: OwnEndpoint, policy: str) -> None:
        """``policy``: what does not match; ``type`` if that is the type."""
        if policy == "type":
            with self._lock:  # one look for all notices of an endpoint: others decide how many there are
                if ours in self._waiting:
                    return
                self._waiting.add(ours)
            later = threading.Timer(_UNSEEN, self._check_types, [ours])
            later.daemon = True
            later.start()
            return
        who = _across(ours)
        asks = "offers less than is asked for" if who == "publisher" else "asks for more than is offered"
        self._report(f"{ours.topic}: a {who} {asks} ({policy}); no message will come through", ours, policy)

    def close(self) -> None:
        """Nothing is checked any more."""
        with self._looking:
            self._closed = True

    def _check_types(self, ours: OwnEndpoint) -> None:
        with self._lock:
            self._waiting.discard(ours)
        with self._looking:
            types = [] if self._closed else sorted({e.type for e in self._wrong(ours) if ours.wrong_type(e)})
        if not types:
            return
        who = _across(ours)
        than = "is asked for" if who == "publisher" else "is published"
        why = f"{who} of {ours.topic} has another type ({', '.join(types)}) than {than} ({ours.type})"
        self._report(f"a {why}; no message will come through", ours, "type")

    def _report(self, message: str, ours: OwnEndpoint, policy: str) -> None:
        message = one_line(message)
        with self._lock:
            before, self._found[ours, policy] = self._found.get((ours, policy)), (message, time.monotonic())
        if before is None or before[0] != message:
            _LOG.error("%s", message)

    def messages(self) -> list[str]:
        """Of those that are still there."""
        with self._lock:
            found = dict(self._found)
        gone = {key for key, (_, at) in found.items() if not self._there(*key, at)}
        with self._lock:
            for key in gone:
                self._found.pop(key, None)
        return [message for key, (message, _) in found.items() if key not in gone]

    def _there(self, ours: OwnEndpoint, policy: str, at: float) -> bool:
        still = self._wrong(ours) if policy in _SEEN else [e for e in self._others(ours) if not e.own]
        return bool(still) or (policy != "type" and time.monotonic() - at < _UNSEEN)

    def _wrong(self, ours: OwnEndpoint) -> list[Endpoint]:
        """Those that do not match; a node that has another endpoint in our type takes part all the same."""
        across = self._others(ours)
        fit = {e.node for e in across if e.type == ours.type and e.node is not None}
        return [e for e in ours.wrong(across) if not (ours.wrong_type(e) and e.node in fit)]

    def _others(self, ours: OwnEndpoint) -> list[Endpoint]:
        find = self._node.publishers if ours.side == "subscription" else self._node.subscribers
        return find(ours.topic)


def _across(ours: OwnEndpoint) -> str:
    return "publisher" if ours.side == "subscription" else "subscription"
