"""Whose a message on DDS is, and a filter that keeps a publisher's messages apart from a flood of others'.

The filter is machine code that DDS calls where it receives a message: a message that does not pass takes no room in the reader's
history and does not wake Python. It is a filter of the topic by the sample's description (``dds_set_topic_filter_extended``).
"""

from __future__ import annotations

import ctypes
import os
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from cyclonedds.core import DDSException, Policy
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import load_cyclonedds
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from wbmpc.kernel.codegen_target import compile_module, load_object

#: Of all others' messages one passes in this time [ns]: enough to see that there are others, and what they send.
RARELY = 5_000_000
#: In the filter's mode of DDS a function gets a sample's description (dds_sample_info_t) and an argument.
_BY_DESCRIPTION, _WRITER_OFFSET = 3, 32
#: Memory: the writer whose messages all pass (0: everybody's do), and when another one's passed last [ns]. The difference of times is
#: unsigned: after a clock that was set back a message passes.
_CODE = f"""
declare i64 @wbmpc_dds_time()
define zeroext i1 @wbmpc_dds_passes(ptr %sample, ptr %memory) nounwind {{
  %place = getelementptr i8, ptr %sample, i64 {_WRITER_OFFSET}
  %writer = load i64, ptr %place
  %first = load atomic i64, ptr %memory monotonic, align 8
  %none = icmp eq i64 %first, 0
  %same = icmp eq i64 %first, %writer
  %counts = or i1 %none, %same
  br i1 %counts, label %yes, label %other
other:
  %now = call i64 @wbmpc_dds_time()
  %since = getelementptr i64, ptr %memory, i64 1
  %last = load i64, ptr %since
  %passed = sub i64 %now, %last
  %early = icmp ult i64 %passed, {RARELY}
  br i1 %early, label %no, label %rare
rare:
  store i64 %now, ptr %since
  br label %yes
yes:
  ret i1 true
no:
  ret i1 false
}}
"""

#: The package reads the QoS of endpoints through buffers that all threads of the process share.
GRAPH_LOCK = threading.Lock()
#: So many writers of a topic are looked through.
_MATCHED = 1000
# the package asks for the count, then for as many, and fails where another one has come in between
_peers = {
    DataReader: load_cyclonedds().dds_get_matched_publications,
    DataWriter: load_cyclonedds().dds_get_matched_subscriptions,
}
#: A description of a writer (dds_builtintopic_endpoint_t) begins with its GUID, of so many bytes.
_GUID = 16
_look = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_int32, ctypes.c_uint64)(
    ("dds_get_matched_publication_data", load_cyclonedds())
)
_free = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(("dds_builtintopic_free_endpoint", load_cyclonedds()))


def matched(entity: DataReader | DataWriter) -> list[int]:
    """Handles of the writers that a reader matches, or of a writer's readers; the first :data:`_MATCHED` at most."""
    found = (ctypes.c_uint64 * _MATCHED)()
    count = _peers[type(entity)](ctypes.c_int32(entity._ref), found, ctypes.c_size_t(_MATCHED))
    return list(found[: min(max(count, 0), _MATCHED)])  # below 0: the entity is gone itself


def taken(reader: DataReader) -> list[tuple[bytes, int]]:
    """The CDR of all samples that have come, with the handles of their writers; none of those that only say that a writer has gone."""
    with suppress(DDSException):
        samples = reader.take(N=64)
        return [(s.data, s.sample_info.publication_handle) for s in samples if getattr(s, "data", None)]
    return []


def new_identity() -> str:
    """Of a service's client or server."""
    return ".".join(f"{b:x}" for b in os.urandom(16))


def cannot_talk(entity: DataReader | DataWriter, mark: str) -> bool:
    """Whether a service's reader or writer has peers, but none with ``mark`` in its user data. rmw_cyclonedds writes who asks into the
    message, and its endpoints have a mark; Fast DDS has that in the inline QoS of RTPS, which Cyclone DDS neither writes nor shows."""
    look = (
        entity.get_matched_publication_data if isinstance(entity, DataReader) else entity.get_matched_subscription_data
    )
    marks = []
    for handle in matched(entity):
        with suppress(DDSException), GRAPH_LOCK:  # who has gone meanwhile counts for nothing
            peer = look(handle)
            if peer is not None:
                marks.append(mark.encode() in (peer.qos[Policy.Userdata].data if Policy.Userdata in peer.qos else b""))
    return bool(marks) and not any(marks)


def gets_answers(writer: DataWriter, reader: DataReader, handle: int, mark: str) -> bool:
    """Whether the client whose request has come to a service's ``reader`` from the writer with a ``handle`` has a reader that the service's
    ``writer`` knows: discovery brings the two of a client in any order. They have one identity, which follows ``mark`` in their
    user data; True of a client without one, and of one that has gone."""
    own = _identity(reader.get_matched_publication_data, handle, mark)
    return not own or any(
        _identity(writer.get_matched_subscription_data, peer, mark) == own for peer in matched(writer)
    )


def _identity(look: Any, handle: int, mark: str) -> bytes:
    """Of a peer; empty if it has none."""
    with suppress(DDSException), GRAPH_LOCK:
        peer = look(handle)
        if peer is not None and Policy.Userdata in peer.qos:
            _, found, rest = bytes(peer.qos[Policy.Userdata].data).partition(mark.encode())
            return rest.partition(b";")[0] if found else b""
    return b""


class _Filter(ctypes.Structure):
    """dds_topic_filter."""

    _fields_ = (("mode", ctypes.c_int), ("function", ctypes.c_void_p), ("argument", ctypes.c_void_p))


@cache
def _code() -> tuple[Any, int]:
    """The engine that holds the machine code, and the code's address."""
    now = ctypes.cast(load_cyclonedds().dds_time, ctypes.c_void_p).value
    assert now is not None
    engine = load_object(compile_module(_CODE), {"wbmpc_dds_time": now})
    return engine, engine.get_function_address("wbmpc_dds_passes")


class FilteredTopic:
    """A topic for one reader, whose messages all pass until :meth:`prefer`. Keep it as long as the participant.

    Writers are known by their GUIDs: one whose lease ended, and who is heard again, has the same one under another handle."""

    def __init__(self, participant: DomainParticipant, like: Topic) -> None:
        self.topic = Topic(participant, like.name, like.data_type)
        self._memory = (ctypes.c_uint64 * 2)()
        self._guids: dict[int, bytes] = {}
        self._preferred = b""
        entry = _Filter(_BY_DESCRIPTION, _code()[1], ctypes.addressof(self._memory))
        status = load_cyclonedds().dds_set_topic_filter_extended(ctypes.c_int32(self.topic._ref), ctypes.byref(entry))
        if status < 0:
            raise DDSException(status, f"while filtering {like.name}")

    def writer(self, reader: DataReader, handle: int) -> DdsWriter:
        """Whose a message is that has come to the topic's ``reader``."""
        guid = self.guid(reader, handle)
        if guid == self._preferred:
            self._memory[0] = handle
        return DdsWriter(guid, handle, reader, self)

    def guid(self, reader: DataReader, handle: int) -> bytes:
        """Of a writer; what is known of one that has gone is its handle."""
        known = self._guids.get(handle)
        if known is None:
            description = _look(reader._ref, handle)
            known = ctypes.string_at(description, _GUID) if description else handle.to_bytes(_GUID + 1, "little")
            if description:
                _free(description)
            while len(self._guids) >= _MATCHED:
                self._guids.pop(next(iter(self._guids)), None)
            self._guids[handle] = known
        return known

    def prefer(self, writer: DdsWriter) -> None:
        """All messages of a writer pass, those of others one in :data:`RARELY`."""
        self._preferred, self._memory[0] = writer.guid, writer.handle


@dataclass(frozen=True)
class DdsWriter:
    """See :class:`wbmpc.ros2.sources.Source`: the writer with a GUID, under a handle, as a reader of ``topic`` knows it."""

    guid: bytes
    handle: int = field(compare=False)
    reader: DataReader = field(compare=False)
    topic: FilteredTopic = field(compare=False)

    def gone(self) -> bool:
        """Whether the reader has no such writer any more: it was deleted, or its process's lease has ended."""
        writers = matched(self.reader)
        if self.handle in writers or len(writers) >= _MATCHED:
            return False
        return all(self.topic.guid(self.reader, handle) != self.guid for handle in writers)

    def prefer(self) -> None:
        """Let all of its messages pass."""
        self.topic.prefer(self)
