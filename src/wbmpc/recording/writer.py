"""An MCAP file of ROS 2 messages that is readable whenever the program dies."""

from __future__ import annotations

import errno
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from wbmpc import __version__
from wbmpc.recording.messages import Message, encode, full_name, schema

#: Bytes of a chunk before compression: what a killed run loses at most.
CHUNK = 128 * 1024
#: Bytes that a run's recording may have on the disk, by default: some hours of a robot with a dozen joints.
LIMIT = 2_000_000_000
#: Quality of service for topics whose last message latecomers get, and for the others (rosbag2's form).
_QOS = """- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {{sec: 0, nsec: 0}}
  lifespan: {{sec: 0, nsec: 0}}
  liveliness: automatic
  liveliness_lease_duration: {{sec: 0, nsec: 0}}
  avoid_ros_namespace_conventions: false
"""


class McapFile:
    """Topics come into being with their first message. Times are of the simulation [s], from 0.

    The library's writer hands a chunk to the file when it is full, and it goes to the system at once: a program that is
    killed leaves every whole chunk behind.

    ``limit``: bytes on the disk, about. With half of them the file is closed and becomes ``run-1.mcap``, in place of one that was
    there, and a new one begins; both are whole recordings, and the newest half of the limit is always there. What every file begins
    with counts for at most half of it: a scene larger than that makes the files larger.
    """

    def __init__(self, path: Path, limit: int = LIMIT) -> None:
        self.path, self._half = path, limit // 2
        #: What holds for the whole run, which every new file begins with: by name, by attachment, by latched topic.
        self._about: dict[str, dict[str, str]] = {}
        self._attached: dict[str, tuple[float, bytes]] = {}
        self._latched: dict[str, tuple[str, bytes]] = {}
        self._open()

    def _open(self) -> None:
        """An error where a link is: its name is the run's, and nobody has chosen what it leads to."""
        no_link = lambda path, flags: os.open(path, flags | os.O_NOFOLLOW, 0o666)
        self._file = open(self.path, "wb", opener=no_link)  # noqa: SIM115 - until it is closed
        self._writer = Writer(self._file, chunk_size=CHUNK, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start(profile="ros2", library=f"wbmpc {__version__}")
        self._size = 0  # of the file, as of its last chunk
        self._time, self._now = -math.inf, 0  # of the last message [s], and in nanoseconds
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._end = self._half  # from which size on the next file begins

    def _rotate(self, t: float) -> None:
        """Make this file the one before, in place of another, and go on in a new one that stands by itself."""
        self._writer.add_metadata("rotated", {"until": f"{t:.9f}"})
        self.close()
        self.path.replace(older_part(self.path))
        self._open()
        self._writer.add_metadata("continues", {"from": f"{t:.9f}"})
        for name, table in self._about.items():
            self._writer.add_metadata(name, table)
        for name, (at, data) in self._attached.items():
            self._writer.add_attachment(0, nanoseconds(at), name, "application/json", data)
        for topic, (kind, data) in self._latched.items():
            self._append(topic, kind, t, data, True)
        self._make_room()

    def _make_room(self) -> None:
        """Leave half of a file to messages, however much every file begins with."""
        given = (data for _, data in (*self._attached.values(), *self._latched.values()))
        self._end = max(self._half, sum(map(len, given)) + self._half // 2)

    def put(self, topic: str, kind: str, t: float, message: Message, *, latched: bool = False) -> None:
        """Append a message of type ``kind`` (``geometry_msgs/Pose``) at time ``t`` [s]."""
        self.put_bytes(topic, kind, t, encode(kind, message), latched=latched)

    def put_bytes(self, topic: str, kind: str, t: float, data: bytes, *, latched: bool = False) -> None:
        """The same of a message that is encoded already."""
        if latched:
            self._latched[topic] = (kind, data)
        if self._size > self._end:
            self._rotate(t)
            if latched:  # the new file has begun with it
                return
        self._append(topic, kind, t, data, latched)

    def _append(self, topic: str, kind: str, t: float, data: bytes, latched: bool) -> None:
        now = self._at(t)
        self._writer.add_message(self._channel(topic, kind, latched), now, data, now)
        self._flush_chunk()

    def _at(self, t: float) -> int:
        """A time [s] in nanoseconds: messages come with the same one in a row."""
        if t != self._time:
            self._time, self._now = t, nanoseconds(t)
        return self._now

    def _flush_chunk(self) -> None:
        """A chunk that is full has gone to the file, and goes to the system."""
        if self._file.tell() != self._size:
            self._flush()

    def _flush(self) -> None:
        """What went to the file goes to the system."""
        self._file.flush()
        self._size = self._file.tell()

    def _channel(self, topic: str, kind: str, latched: bool) -> int:
        """That of a topic, which comes into being with its first message."""
        known = self._channels.get(topic)
        if known is None:
            known = self._channels[topic] = self._register(topic, kind, latched)
        return known

    def _register(self, topic: str, kind: str, latched: bool) -> int:
        if kind not in self._schemas:
            text = schema(kind).encode()
            self._schemas[kind] = self._writer.register_schema(name=full_name(kind), encoding="ros2msg", data=text)
        qos = _QOS.format(depth=1 if latched else 10, durability="transient_local" if latched else "volatile")
        return int(
            self._writer.register_channel(topic, "cdr", self._schemas[kind], metadata={"offered_qos_profiles": qos})
        )

    def metadata(self, name: str, values: Mapping[str, Any]) -> None:
        """A named table of texts."""
        self._about[name] = {k: str(v) for k, v in values.items()}
        self._writer.add_metadata(name, self._about[name])
        self._flush()

    def attach(self, name: str, value: Any, t: float = 0.0) -> None:
        """A JSON file inside the file, as it is from time ``t`` [s] on."""
        self._attached[name] = (t, json.dumps(value).encode())
        self._writer.add_attachment(0, nanoseconds(t), name, "application/json", self._attached[name][1])
        self._flush()
        self._make_room()

    def close(self) -> None:
        """Write index and end; nothing if that was tried before: a disk that is full at the end is so again.

        Raises :class:`OSError` too if the file is not there any more, or another one in its place.
        """
        if self._file.closed:
            return
        try:
            self._writer.finish()
            if not os.path.samestat(os.fstat(self._file.fileno()), self.path.stat()):
                raise OSError(errno.EEXIST, "another file took its place")
        finally:
            self._file.close()


def older_part(path: Path) -> Path:
    """The part of a recording before the newest one: ``run-1.mcap`` of ``run.mcap``."""
    return path.with_name(f"{path.stem}-1{path.suffix}")


def nanoseconds(t: float) -> int:
    """Time [s] as MCAP counts it."""
    return round(t * 1e9)


def stamp(t: float) -> dict[str, int]:
    """Time [s] as builtin_interfaces/Time."""
    seconds = math.floor(nanoseconds(t) / 1_000_000_000)
    return {"sec": seconds, "nanosec": nanoseconds(t) - seconds * 1_000_000_000}
