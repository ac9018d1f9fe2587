"""The graph as DDS knows it: everybody's endpoints, also those that have just left."""

from __future__ import annotations

import time
from collections import OrderedDict
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import InstanceState, Policy
from cyclonedds.core import Qos as DdsQos
from cyclonedds.domain import DomainParticipant
from cyclonedds.util import duration

from wbmpc.ros2.bus import Endpoint, Qos, full_name
from wbmpc.ros2.dds_source import GRAPH_LOCK

#: Numbers of the policies in DDS's notices of a mismatch (DDS 1.4, section 2.2.3; DDS-XTypes 1.3, section 7.6.3).
POLICIES = {2: "durability", 4: "deadline", 8: "liveliness", 11: "reliability", 23: "data representation", 24: "type"}


def dds_qos(qos: Qos, user_data: str, *, local: bool) -> DdsQos:
    """QoS of an endpoint with ``user_data``; ``local``: it hears endpoints of its own node too."""
    reliable = Policy.Reliability.Reliable(duration(milliseconds=100))
    return DdsQos(
        reliable if qos.reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(qos.depth),
        # how many of a latched topic's messages late joiners get; one, unless it is said
        Policy.DurabilityService(0, Policy.History.KeepLast(qos.depth), -1, -1, -1),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        # a write of this node would wait for a callback of its own; services have one anyway, see `write`
        Policy.IgnoreLocal.Nothing if local else Policy.IgnoreLocal.Participant,
        Policy.Userdata(user_data.encode()),
    )


def ros_type(name: str) -> str:
    """A ROS 2 type by its name in DDS; other names as they are."""
    parts = name.split("::")
    return "/".join([*parts[:-2], parts[-1].removesuffix("_")]) if "dds_" in parts else name


def ros_qos(qos: DdsQos) -> Qos:
    """What of an endpoint's QoS this package shows."""
    reliability, durability, history = (qos[p] for p in (Policy.Reliability, Policy.Durability, Policy.History))
    latched = durability not in (None, Policy.Durability.Volatile)
    return Qos(reliability != Policy.Reliability.BestEffort, latched, int(getattr(history, "depth", 0)))


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
