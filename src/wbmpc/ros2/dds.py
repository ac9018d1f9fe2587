"""A ROS 2 node by DDS alone: what rmw_cyclonedds puts on the wire, without a ROS installation.

Topics are ``rt/NAME`` with types ``pkg::msg::dds_::Type_`` in plain CDR; the node, its readers and writers are announced on
``ros_discovery_info``; type hashes go into the endpoints' user data; a service is a pair of topics whose messages begin with
the client's identity and a sequence number. Source: the ROS 2 design articles (design.ros2.org) and rmw_cyclonedds.
"""

from __future__ import annotations

import logging
import re
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from cyclonedds.core import DDSException
from cyclonedds.core import Qos as DdsQos
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from wbmpc.checks import real_number
from wbmpc.errors import InputError, RunAborted
from wbmpc.logs import RateLimit
from wbmpc.ros2.bus import DEFAULT, LARGEST, LATCHED, LONGEST_NODE_NAME, SMALL, Endpoint, Qos, full_name, nothing
from wbmpc.ros2.cdr_types import idl_types, shared_message_class
from wbmpc.ros2.convert import error_message
from wbmpc.ros2.dds_domain import OPEN, open_domain, return_participant, take_participant
from wbmpc.ros2.dds_graph import POLICIES, Graph, dds_qos
from wbmpc.ros2.dds_listener import Take, Watch, silence
from wbmpc.ros2.dds_source import FilteredTopic, cannot_talk, gets_answers, matched, new_identity, taken
from wbmpc.ros2.dds_writing import LOCAL, DdsPublisher, write
from wbmpc.ros2.deferred import Deferred, most
from wbmpc.ros2.in_use import InUse, while_open
from wbmpc.ros2.messages import request, response, types
from wbmpc.ros2.mismatch import Mismatches, OwnEndpoint
from wbmpc.ros2.network import Network
from wbmpc.ros2.parameter_services import ParameterServices
from wbmpc.ros2.parameters import Parameters

_LOG = logging.getLogger("wbmpc")
_INFO = "rmw_dds_common/msg/ParticipantEntitiesInfo"
#: What stands before the body of a service's messages: client and number.
_HEADER = {"client": idl_types.uint64, "number": idl_types.int64}
_HEADER_SIZE = 16
#: A node announces its endpoints when it has made them; in this time [s] that has come, and in the other one what was announced
#: before somebody listened, on a busy machine too.
_ANNOUNCED, _EARLIER = 1.0, 5.0
#: So long [s] an answer waits for the reader of who asked.
_LATE = 1.0
#: What the user data of a service's endpoints begin with, at its client and at its server.
_CLIENT, _SERVER = "clientid=", "serviceid="
_FOREIGN = "is of another RMW than rmw_cyclonedds, whose services are others"


class DdsNode:
    """See :class:`wbmpc.ros2.bus.Node`. A node does not hear what it publishes itself."""

    backend = "dds"

    def __init__(self, name: str, network: Network) -> None:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or len(name) > LONGEST_NODE_NAME:
            most = LONGEST_NODE_NAME
            raise InputError(f"node: a name of letters, digits and _ is needed, {most} at most, got '{name[:300]}'")
        self.name, self.network, self.types = name, network, types(network.distribution)
        self.in_use = InUse(name)
        self._mismatches, self._limit = Mismatches(self), RateLimit()
        self._lock = threading.RLock()
        open_domain(network)
        self._kept = take_participant(network.domain)
        self._participant = self._kept.entity
        self._key = self._participant.guid
        self._topics: dict[str, dict[str, Any]] = {}  # by name and type
        self._filtered: list[FilteredTopic] = []
        self._readers: list[DataReader] = []
        self._unregister: dict[
            DataReader, Callable[[], None]
        ] = {}  # of readers that call back, what ends their entry in LOCAL
        self._deferred = Deferred()
        self._writers: list[DataWriter] = []
        self._graph = Graph(self._participant)
        self._names: tuple[dict[bytes, str], DataReader] | None = None
        topic = self._topic("ros_discovery_info", _INFO)
        self._info = DataWriter(self._participant, topic, qos=self._qos(LATCHED, _INFO))
        OPEN.add(self)
        self._announce()

    @property
    def closed(self) -> bool:
        return self.in_use.closed

    # ------------------------------------------------------------------ topics
    @property
    def faults(self) -> list[str]:
        """Messages about endpoints that do not match."""
        return self._mismatches.messages()

    @while_open
    def publisher(self, topic: str, kind: str, qos: Qos = DEFAULT) -> DdsPublisher:
        """A publisher; messages are complete on the wire when :meth:`DdsPublisher.publish` returns."""
        name = full_name(topic)
        place = self._topic(f"rt{name}", kind)
        ours = OwnEndpoint("publisher", name, kind, qos)
        listener = Watch(lambda policy: self._mismatch(ours, policy))
        writer = DataWriter(self._participant, place, qos=self._qos(qos, kind), listener=listener)
        self._own(self._writers, writer)
        return DdsPublisher(writer, self.types, kind, self._where(place), self)

    @while_open
    def subscribe(
        self, topic: str, kind: str, callback: Callable[..., None], qos: Qos = DEFAULT, deferred: bool = False,
        others: tuple[str, ...] = (), largest: int = LARGEST, sourced: bool = False,
    ) -> Callable[[], None]:  # fmt: skip
        """Call back for every message; ``deferred``: not before :meth:`work`. What the callback raises is logged: the bus must
        go on. Returns what ends it."""
        name = full_name(topic)

        def call(sample: tuple[bytes, Any]) -> None:
            data, source = sample
            try:
                callback(self.types.decode(kind, data), *([] if filtered is None else [source]))
            except Exception as error:
                self._limit.log(_LOG, logging.ERROR, name, f"{name}: {error_message(error)}")

        def take(reader: DataReader) -> None:
            with self._lock:  # taking too: another thread may bring what came later
                for data, handle in self._small(name, reader, largest):
                    source = filtered.writer(reader, handle) if filtered is not None else None
                    if deferred:
                        self._deferred.put(name, call, (data, source), len(data), most(qos))
                    else:
                        call((data, source))

        ours = OwnEndpoint("subscription", name, kind, qos, others)
        place = self._topic(f"rt{name}", kind, others=others)
        filtered = FilteredTopic(self._participant, place) if sourced else None
        if filtered is not None:
            self._filtered.append(filtered)
            place = filtered.topic
        reader = self._read(place, self._qos(qos, kind), take, self, lambda policy: self._mismatch(ours, policy))
        return lambda: self._end(reader)

    def _small(self, name: str, reader: DataReader, largest: int) -> Iterator[tuple[bytes, int]]:
        """What has come with the handles of its writers, but for messages of more than ``largest`` bytes."""
        for data, source in taken(reader):
            if len(data) <= largest:
                yield data, source
                continue
            why = f"{name}: a message of {len(data)} bytes is dropped; valid: at most {largest}"
            self._limit.log(_LOG, logging.ERROR, name, why)

    def work(self) -> None:
        """Decode the messages of deferred subscriptions and services that have come, and call back, in this thread."""
        self._deferred.work()

    @while_open
    def serve(
        self, service: str, kind: str, answer: Callable[[Any], Mapping[str, Any]], deferred: bool = False,
        rejected: Callable[[str], Mapping[str, Any]] = nothing, definition: tuple[str, str] | None = None,
    ) -> None:  # fmt: skip
        """Answer a service to clients of rmw_cyclonedds. Those of Fast DDS see it and get no answer, which the log says."""
        name = full_name(service)
        if definition is not None:
            self.types.define(kind, definition)
        request_type, response_type = request(kind), response(kind)
        mark = f"{_SERVER}{new_identity()};"
        replies = self._topic(f"rr{name}Reply", response_type, _HEADER)
        writer = DataWriter(self._participant, replies, qos=self._qos(DEFAULT, response_type, mark))

        def reply(asked: tuple[bytes, int, Callable[[], bool]]) -> None:
            data, size, heard = asked
            head, body = data[4 : 4 + _HEADER_SIZE], data[:4] + data[4 + _HEADER_SIZE :]
            try:
                if size > SMALL:
                    raise InputError(f"a request of {size} bytes is too large; valid: at most {SMALL}")
                said = self.types.encode(response_type, answer(self.types.decode(request_type, body)))
            except Exception as error:
                self._limit.log(_LOG, logging.ERROR, name, f"{name}: {error_message(error)}")
                said = self.types.encode(response_type, rejected(error_message(error)))
            send((said[:4] + head + said[4:], heard, time.monotonic() + _LATE))

        def send(said: tuple[bytes, Callable[[], bool], float]) -> None:
            data, heard, end = said
            if not heard() and time.monotonic() < end:  # it would be lost
                self._deferred.put(f"answers of {name}", send, said, len(data))
                return
            with suppress(DDSException):  # who asked has gone
                writer.write(replies.data_type(data))

        def take(reader: DataReader) -> None:
            for data, handle in taken(reader):
                if len(data) < 4 + _HEADER_SIZE:  # no client could be answered
                    continue
                heard = partial(gets_answers, writer, reader, handle, _CLIENT)
                asked = data if len(data) <= SMALL else data[: 4 + _HEADER_SIZE], len(data), heard
                if deferred:
                    self._deferred.put(name, reply, asked, len(asked[0]))
                else:
                    with self._lock:
                        reply(asked)

        def judge(reader: DataReader) -> None:
            if cannot_talk(reader, _CLIENT):
                self._limit.log(_LOG, logging.WARNING, name, f"{name}: who asks {_FOREIGN}: it gets no answer")

        self._own(self._writers, writer)
        requests = self._topic(f"rq{name}Request", request_type, _HEADER)
        come = lambda reader: self._deferred.put(f"clients of {name}", judge, reader)
        self._read(requests, self._qos(DEFAULT, request_type, mark), take, None, come=come)

    @while_open
    def call(self, service: str, kind: str, values: Mapping[str, Any], timeout: float = 5.0) -> Any:
        """Ask a service and wait for its answer [s]. Raises :class:`RunAborted` if none comes, :class:`InputError` in a callback
        that is not deferred: no answer could come."""
        name = full_name(service)
        LOCAL.check_waits(f"calls {name}")
        real_number("timeout", timeout)
        request_type, response_type = request(kind), response(kind)
        mark = f"{_CLIENT}{new_identity()};"
        requests, replies = (
            self._topic(f"rq{name}Request", request_type, _HEADER),
            self._topic(f"rr{name}Reply", response_type, _HEADER),
        )
        writer = DataWriter(self._participant, requests, qos=self._qos(DEFAULT, request_type, mark))
        reader = DataReader(self._participant, replies, qos=self._qos(DEFAULT, response_type, mark))
        self._own(self._writers, writer)
        self._own(self._readers, reader)
        head = writer.guid.bytes[:8] + struct.pack("<q", 1)
        body = self.types.encode(request_type, values)
        end = time.monotonic() + timeout
        try:
            while not (matched(writer) and matched(reader)) or cannot_talk(writer, _SERVER):
                self._wait(end, f"{name}: its server {_FOREIGN}" if matched(writer) else f"{name}: no server")
            write(writer, body[:4] + head + body[4:], self._where(requests), self, threading.RLock())
            while True:
                for data, _ in taken(reader):
                    if data[4 : 4 + _HEADER_SIZE] == head:
                        return self.types.decode(response_type, data[:4] + data[4 + _HEADER_SIZE :])
                self._wait(end, f"{name}: no answer within {timeout:g} s")
        finally:
            with self._lock:
                self._writers.remove(writer)
                self._readers.remove(reader)
            writer.__del__()
            reader.__del__()
            self._announce()

    def offer(self, parameters: Parameters) -> None:
        ParameterServices(self, self.name, parameters)

    # ------------------------------------------------------------------ graph
    @while_open
    def publishers(self, topic: str, within: float = 0.0) -> list[Endpoint]:
        """Everybody's publishers of a topic, this node's too, and those that have left at most ``within`` [s] ago."""
        return self._graph.publishers(topic, within)

    @while_open
    def subscribers(self, topic: str) -> list[Endpoint]:
        """Everybody's subscriptions of a topic, this node's too."""
        return self._graph.subscribers(topic)

    @while_open
    def owner(self, endpoint: Endpoint) -> str:
        """The name of an endpoint's node, as that has announced it; empty if it has not within :data:`_ANNOUNCED`, the first time
        :data:`_EARLIER`."""
        if endpoint.own:
            return self.name
        end = time.monotonic() + (_EARLIER if self._names is None else _ANNOUNCED)
        if self._names is None:
            topic = self._topic("ros_discovery_info", _INFO)
            self._names = {}, DataReader(self._participant, topic, qos=self._qos(Qos(latched=True, depth=100), _INFO))
        names, reader = self._names
        while True:
            for data, _ in taken(reader):
                with suppress(InputError):  # what cannot be read names nobody
                    for node in self.types.decode(_INFO, data).node_entities_info_seq:
                        for gid in (*node.reader_gid_seq, *node.writer_gid_seq):
                            names[bytes(gid.data)[:16]] = node.node_name
            self.in_use.check()
            if endpoint.who in names or time.monotonic() > end:
                return names.get(endpoint.who, "")
            time.sleep(0.01)

    def _announce(self) -> None:
        """Publish to the graph which node has which readers and writers: again whenever there is another one. A closed node is gone."""
        size = 24 if self.network.distribution == "humble" else 16
        gid = lambda e: {"data": np.frombuffer(e.guid.bytes.ljust(size, b"\0"), np.uint8)}
        with self._lock:
            node = {
                "node_namespace": "/", "node_name": self.name,
                "reader_gid_seq": [gid(r) for r in self._readers], "writer_gid_seq": [gid(w) for w in self._writers],
            }  # fmt: skip
            message = {"gid": gid(self._participant), "node_entities_info_seq": [] if self.closed else [node]}
            self._info.write(self._info.topic.data_type(self.types.encode(_INFO, message)))

    def close(self) -> None:
        """Leave the bus. Callbacks have ended when this returns. Raises :class:`InputError` in a callback that is not deferred."""
        LOCAL.check_waits(f"closes node '{self.name}'")
        self._mismatches.close()
        if not self.in_use.close():
            return
        with self._lock:
            entities = [*self._readers, *self._writers]
            self._readers, self._writers = [], []
        for entity in entities:
            silence(entity)
        self._announce()
        names = [] if self._names is None else [self._names[1]]
        for entity in (*entities, *names, *self._graph.readers, self._info, *(f.topic for f in self._filtered)):
            entity.__del__()  # the package has no other way
        return_participant(self.network.domain, self._kept)
        for reader in list(self._unregister):
            self._unregister.pop(reader)()
        OPEN.discard(self)

    # ------------------------------------------------------------------ inside
    def _where(self, topic: Topic) -> tuple[int, str]:
        return self.network.domain, topic.name

    def _read(
        self, topic: Any, qos: DdsQos, take: Take, of: DdsNode | None, mismatch: Callable[[int], None] | None = None,
        come: Take | None = None,
    ) -> DataReader:  # fmt: skip
        """A reader that calls ``take``, and ``come`` when it has another peer; ``of``: the node that it does not hear, None for a
        service. The package calls listeners before the reader is complete, with None for a reader: what came then is taken as
        soon as it is."""
        complete: list[DataReader] = []
        where = self._where(topic)

        def call(_: DataReader | None) -> None:
            if complete:
                with LOCAL.callback(where, of):
                    take(complete[0])

        def peers(_: DataReader | None) -> None:
            if complete and come is not None:
                come(complete[0])

        unregister = LOCAL.add(where, of)
        reader = DataReader(self._participant, topic, qos=qos, listener=Watch(mismatch, call, peers if come else None))
        self._unregister[reader] = unregister
        complete.append(reader)
        self._own(self._readers, reader)
        take(reader)
        peers(reader)
        return reader

    def _end(self, reader: DataReader) -> None:
        LOCAL.check_waits("ends a subscription")
        if (held := self.in_use.begin()) is None:  # what closes it ends its subscriptions
            return
        with held:
            with self._lock:
                if reader not in self._readers:
                    return
                self._readers.remove(reader)
            silence(reader)  # without the lock: it waits for callbacks
            reader.__del__()
            self._unregister.pop(reader, lambda: None)()
            self._announce()

    def _own(self, group: list[Any], entity: Any) -> None:
        with self._lock:
            group.append(entity)
        self._announce()

    def _topic(
        self, name: str, kind: str, header: Mapping[str, Any] | None = None, others: tuple[str, ...] = ()
    ) -> Topic:
        self.types.check(kind)
        known = self._topics.setdefault(name, {})
        strange = known.keys() - {kind, *others}
        if strange:
            raise InputError(f"{name.removeprefix('rt')}: is used with {strange.pop()} and {kind}")
        if kind not in known:
            try:
                carry = shared_message_class(self.network.distribution, kind, tuple((header or {}).items()))
                known[kind] = self._kept.topic(name, kind, carry)
            except DDSException as error:
                raise InputError(f"{name.removeprefix('rt')}: not a topic of ROS 2 ({error})") from error
        topic: Topic = known[kind]
        return topic

    def _qos(self, qos: Qos, kind: str, mark: str = "") -> DdsQos:
        return dds_qos(qos, f"{mark}typehash={self.types.hash(kind)};", local=bool(mark))

    def _mismatch(self, ours: OwnEndpoint, policy: int) -> None:
        self._mismatches.notice(ours, POLICIES.get(policy, f"policy {policy}"))

    def _wait(self, end: float, message: str) -> None:
        self.in_use.check()
        if time.monotonic() > end:
            raise RunAborted(message)
        time.sleep(0.002)
