"""An MCAP file of ROS 2 messages that is readable whenever the program dies."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from wbmpc import __version__
from wbmpc.recording.messages import Message, encode, full_name, schema

#: Bytes of a chunk before compression: what a killed run loses at most.
CHUNK = 128 * 1024
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
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=CHUNK, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start(profile="ros2", library=f"wbmpc {__version__}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def put(self, topic: str, kind: str, t: float, message: Message, *, latched: bool = False) -> None:
        """Append a message of type ``kind`` (``geometry_msgs/Pose``) at time ``t`` [s]."""
        self.put_bytes(topic, kind, t, encode(kind, message), latched=latched)

    def put_bytes(self, topic: str, kind: str, t: float, data: bytes, *, latched: bool = False) -> None:
        """The same of a message that is encoded already."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._channel(topic, kind, latched)
        at = nanoseconds(t)
        self._writer.add_message(channel, at, data, at)
        self._file.flush()

    def _channel(self, topic: str, kind: str, latched: bool) -> int:
        if kind not in self._schemas:
            text = schema(kind).encode()
            self._schemas[kind] = self._writer.register_schema(name=full_name(kind), encoding="ros2msg", data=text)
        qos = _QOS.format(depth=1 if latched else 10, durability="transient_local" if latched else "volatile")
        return int(
            self._writer.register_channel(topic, "cdr", self._schemas[kind], metadata={"offered_qos_profiles": qos})
        )

    def metadata(self, name: str, values: Mapping[str, Any]) -> None:
        """A named table of texts."""
        self._writer.add_metadata(name, {k: str(v) for k, v in values.items()})
        self._file.flush()

    def attach(self, name: str, value: Any, t: float = 0.0) -> None:
        """A JSON file inside the file, as it is from time ``t`` [s] on."""
        self._writer.add_attachment(0, nanoseconds(t), name, "application/json", json.dumps(value).encode())
        self._file.flush()

    def close(self) -> None:
        """Write index and end."""
        self._writer.finish()
        self._file.close()


def nanoseconds(t: float) -> int:
    """Time [s] as MCAP counts it."""
    return round(t * 1e9)


def stamp(t: float) -> dict[str, int]:
    """Time [s] as builtin_interfaces/Time."""
    seconds = math.floor(nanoseconds(t) / 1_000_000_000)
    return {"sec": seconds, "nanosec": nanoseconds(t) - seconds * 1_000_000_000}
