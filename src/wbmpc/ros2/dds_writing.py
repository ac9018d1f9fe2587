"""Writing to DDS in a process that may also read what it writes.

The package ``cyclonedds`` writes with Python's interpreter lock held. A reader of the same process is served from within the
write, and DDS lets only one callback of a reader run at a time: a write then waits in C for a callback that waits for the
interpreter. So a topic that another node of the process reads is written without the interpreter lock. Other topics are written
with it: a tick of the controller must not let the interpreter go. A new reader waits until no such write is under way.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.internal import load_cyclonedds
from cyclonedds.pub import DataWriter

from wbmpc.errors import InputError, RunAborted
from wbmpc.ros2.messages import Types

#: A topic of a domain: domain, name in DDS.
Where = tuple[int, str]


class _Sample(ctypes.Structure):
    """What the package's type support takes for a sample: CDR and its size."""

    _fields_ = (("data", ctypes.c_char_p), ("size", ctypes.c_size_t))


_write = load_cyclonedds().dds_write  # a function of ctypes: it is called without the interpreter lock
_write.argtypes, _write.restype = [ctypes.c_int32, ctypes.POINTER(_Sample)], ctypes.c_int32


class LocalReaders:
    """Readers with callbacks in this process, by topic and by the node (any key) that has them. Thread-safe."""

    def __init__(self) -> None:
        self._nodes: dict[Where, list[Any]] = {}
        self._writing: dict[Where, list[int]] = {}  # threads that write with the interpreter lock
        self._lock = threading.Condition(threading.Lock())
        self._running = threading.local()

    def add(self, where: Where, node: Any) -> Callable[[], None]:
        """Note a reader, before it exists; returns what forgets it, once it has gone. No other thread writes the topic with the
        interpreter lock when this returns."""
        own = threading.get_ident()
        with self._lock:
            self._nodes.setdefault(where, []).append(node)
            self._lock.wait_for(lambda: all(thread == own for thread in self._writing.get(where, ())))

        def unregister() -> None:
            with self._lock:
                self._nodes[where].remove(node)
                if not self._nodes[where]:
                    del self._nodes[where]

        return unregister

    @contextmanager
    def write(self, where: Where, node: Any) -> Iterator[bool]:
        """While ``node`` writes a topic: whether another node of this process reads it, so that the writer must let the
        interpreter lock go."""
        own = threading.get_ident()
        with self._lock:
            others = any(n is not node for n in self._nodes.get(where, ()))
            if not others:
                self._writing.setdefault(where, []).append(own)
        try:
            yield others
        finally:
            if not others:
                with self._lock:
                    self._writing[where].remove(own)
                    self._lock.notify_all()

    @contextmanager
    def callback(self, where: Where, node: Any) -> Iterator[None]:
        """While a callback of a node's reader runs in this thread."""
        stack = self._running.__dict__.setdefault("stack", [])
        stack.append((where, node))
        try:
            yield
        finally:
            stack.pop()

    def check_waits(self, what: str) -> None:
        """Raise :class:`InputError` if this thread is in a callback: what waits for the bus would wait for that callback to end."""
        for (_, topic), _ in self._running.__dict__.get("stack", ()):
            raise InputError(
                f"{topic[2:]}: a callback of it {what}, which waits for callbacks to end; "
                "give it deferred=True, which calls back from work()"
            )

    def check_write(self, where: Where, node: Any) -> None:
        """Raise :class:`InputError` if this thread is in a callback, and another node than the writer's reads the topic with
        callbacks: DDS would call that one from within the first. Two threads that do so on two nodes, each the other way round,
        wait for each other for ever."""
        running = self._running.__dict__.get("stack", ())
        with self._lock:
            heard = any(n is not node for n in self._nodes.get(where, ()))
        if running and heard:
            (_, topic), _ = running[-1]
            raise InputError(
                f"{topic[2:]}: a callback of it leads to a message on {where[1][2:]}, which another node of this process hears; "
                "give the subscription deferred=True, which calls back from work()"
            )


LOCAL = LocalReaders()


class DdsPublisher:
    """See :class:`wbmpc.ros2.bus.Publisher`. Two threads take turns on one writer: with the interpreter lock held they would
    wait for each other forever."""

    def __init__(self, writer: DataWriter, types: Types, kind: str, where: Where, node: Any) -> None:
        self._writer, self._types, self._kind = writer, types, kind
        self._where, self._node = where, node
        self._turn = threading.RLock()

    def publish(self, values: Mapping[str, Any]) -> None:
        """Send a message."""
        self.send(self._types.encode(self._kind, values))

    def send(self, data: bytes) -> None:
        """Send a message that is CDR already, for example from a recording. Raises :class:`InputError` from a callback, if
        another node of this process hears the topic."""
        write(self._writer, data, self._where, self._node, self._turn)


def write(writer: DataWriter, data: bytes, where: Where, node: Any, turn: threading.RLock) -> None:  # type: ignore[valid-type]
    """Write CDR with a writer of ``node``; see the module. ``turn``: the writer's own lock. Raises :class:`RunAborted` if the
    node is closed."""
    LOCAL.check_write(where, node)  # before the turn: who has it may wait for this callback
    with turn, LOCAL.write(where, node) as others:  # type: ignore[attr-defined]
        try:
            if not others:
                writer.write(writer.topic.data_type(data))
                return
            padded = data.ljust(-(-len(data) // 4) * 4, b"\0")
            status = _write(writer._ref, ctypes.byref(_Sample(padded, len(padded))))
            if status < 0:
                raise DDSException(status, f"while writing on {where[1]}")
        except DDSException as error:
            if node.closed:
                raise RunAborted(f"{where[1].removeprefix('rt')}: node '{node.name}' is closed") from error
            raise
