"""The graph as DDS knows it: everybody's endpoints, also those that have just left."""

from __future__ import annotations

import time
from collections import OrderedDict
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import InstanceState
from cyclonedds.domain import DomainParticipant

from wbmpc.ros2.bus import Endpoint, full_name
from wbmpc.ros2.dds_qos import ros_qos, ros_type
from wbmpc.ros2.dds_source import GRAPH_LOCK

#: Endpoints that have left are kept for so long [s], and at most so many of them.
LATELY, _KEPT = 2.0, 1000


class _Side:
    """Endpoints of one kind: those that are there, and those that have left with the time [s] at which that was seen."""

    def __init__(self, participant: DomainParticipant, kind: Any) -> None:
        self.reader = BuiltinDataReader(participant, kind)
        self._known: dict[Any, Any] = {}
        self._left: OrderedDict[Any, tuple[float, Any]] = OrderedDict()

    def look(self) -> None:
        """Take in what has changed: the whole graph of a robot takes milliseconds, in which no other thread of Python's runs."""
        now = time.monotonic()
        for sample in self.reader.take(N=4096):
            if sample.sample_info.instance_state == InstanceState.Alive:
                self._known[sample.key] = sample
            else:  # also of one that was never seen alive
                self._left[sample.key] = now, self._known.pop(sample.key, sample)
        while self._left and (len(self._left) > _KEPT or now - next(iter(self._left.values()))[0] > LATELY):
            self._left.popitem(last=False)

    def found(self, topic: str, within: float) -> list[Any]:
        """Samples of a topic of DDS, of endpoints that are there or have left at most ``within`` [s] ago."""
        since = time.monotonic() - within
        left = [sample for at, sample in self._left.values() if at > since]
        return [sample for sample in (*self._known.values(), *left) if sample.topic_name == topic]


class Graph:
    """What a ``participant`` knows of all others, and of itself."""

    def __init__(self, participant: DomainParticipant) -> None:
        self._own = participant.guid
        self._writers = _Side(participant, BuiltinTopicDcpsPublication)
        self._readers = _Side(participant, BuiltinTopicDcpsSubscription)

    @property
    def readers(self) -> list[BuiltinDataReader]:
        """What it reads with, for who ends it."""
        return [side.reader for side in (self._writers, self._readers)]

    def publishers(self, topic: str, within: float) -> list[Endpoint]:
        """See :meth:`wbmpc.ros2.bus.Node.publishers`."""
        return self._endpoints(self._writers, topic, within)

    def subscribers(self, topic: str) -> list[Endpoint]:
        """See :meth:`wbmpc.ros2.bus.Node.subscribers`."""
        return self._endpoints(self._readers, topic, 0.0)

    def _endpoints(self, side: _Side, topic: str, within: float) -> list[Endpoint]:
        name, found = full_name(topic), []
        with GRAPH_LOCK:  # callbacks do not wait for it
            side.look()
            samples = side.found(f"rt{name}", within)
        for s in samples:
            own, kind, qos = s.participant_key == self._own, ros_type(s.type_name), ros_qos(s.qos)
            found.append(Endpoint(name, kind, qos, own, s.key.bytes, s.participant_key.bytes))
        return found
