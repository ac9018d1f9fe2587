"""Reads recordings, also those of runs that were killed: as messages, and as tables of numbers over time."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Footer, McapRecord, Metadata, Schema
from mcap.records import Message as Record

from wbmpc.errors import InputError, unknown_name
from wbmpc.input_file import parse_json, read_file
from wbmpc.recording.messages import DEFINITIONS, decode, fields, numbers
from wbmpc.recording.records import MAGIC, records
from wbmpc.recording.writer import older_part

_LOG = logging.getLogger(__name__)
#: Bytes of a recording that is read as a whole, at most.
LARGEST = 8 * 1024**3
#: Cells of a table, at most, of which not one in :data:`_SPARSE` is a number that was recorded: messages with other names each time.
MAX_SPARSE, _SPARSE = 10_000_000, 10
#: Columns of a table, at most: a path of 3000 poses has as many.
MAX_COLUMNS = 25_000
#: Types of the topics that plots, films and pages read by name; with a slash at the end, of all below.
KINDS = {
    "/robot_description": "std_msgs/String", "/mode": "std_msgs/String", "/tf": "tf2_msgs/TFMessage",
    "/tf_static": "tf2_msgs/TFMessage", "/joint_states": "sensor_msgs/JointState", "/odom": "nav_msgs/Odometry",
    "/end_effector_pose": "geometry_msgs/PoseStamped", "/end_effector_reference": "geometry_msgs/PoseStamped",
    "/ground_truth/end_effector": "geometry_msgs/PoseStamped", "/plan": "nav_msgs/Path", "/end_effector_plan": "nav_msgs/Path",
    "/contact/": "geometry_msgs/WrenchStamped", "/mpc/": "std_msgs/Float64",
}  # fmt: skip
#: Fields of a message's header and of its layout: no numbers of their own.
_SKIPPED = ("header", "layout")


@dataclass
class Topic:
    """Messages of one topic: type (``geometry_msgs/Pose``), times [s] and CDR bytes; ``where``: file and name, for errors."""

    kind: str
    where: str
    times: list[float] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)

    def messages(self) -> Iterator[tuple[float, Any]]:
        """Times [s] and decoded messages."""
        for t, data in zip(self.times, self.data, strict=True):
            yield t, decode(self.kind, data, self.where)

    def last(self) -> Any:
        """The newest message."""
        return decode(self.kind, self.data[-1], self.where)


@dataclass(frozen=True)
class Table:
    """Columns of a topic by name, all over ``times`` (n,) [s]. What a message does not have is not a number."""

    times: np.ndarray
    columns: dict[str, np.ndarray]


@dataclass
class Recording:
    """A whole file at ``path``: ``topics`` by name; ``metadata``: tables of texts by name, of the run, its versions and its result.
    ``complete``: whether the run closed it; else it was killed and the last moments are missing.
    ``damage``: clauses that name parts that are unreadable or altered. ``unknown``: types by name of topics that other programs recorded and
    whose type is not known here.

    ``path``: of the file; ``topics``: by name; ``metadata``: texts by key of each record, "run" and "result" of a run.
    ``attachments``: for each name the time [s] from which it holds, and its bytes.
    """

    path: Path
    topics: dict[str, Topic]
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, tuple[float, bytes]]
    complete: bool
    damage: list[str] = field(default_factory=list)
    unknown: dict[str, str] = field(default_factory=dict)

    def __getitem__(self, topic: str) -> Topic:
        if topic not in self.topics:
            raise unknown_name("topic", topic, self.topics, where=str(self.path))
        return self.topics[topic]

    @cached_property
    def start(self) -> float:
        """Time of the first message [s]: not 0 of a part, and of a recording whose clock is a calendar's."""
        return min((t.times[0] for t in self.topics.values()), default=0.0)

    @cached_property
    def end(self) -> float:
        """Time of the last message [s]."""
        return max((t.times[-1] for t in self.topics.values()), default=0.0)

    @property
    def earlier(self) -> str:
        """A clause that says where the messages before this file's first one are; empty if it has the start of the run."""
        if "continues" not in self.metadata:
            return ""
        older = older_part(self.path)
        before = f"before {self.start:.2f} s" if self.topics else "recorded"
        where = f"is in {older.name}, or was overwritten" if older.is_file() else "was overwritten"
        return f"the run is longer than its --record-limit: what was {before} {where}"

    @property
    def unread(self) -> str:
        """:attr:`unknown` in words."""
        return ", ".join(f"{name} ({kind})" for name, kind in sorted(self.unknown.items()))

    @property
    def title(self) -> str:
        """Experiment and seed; of what another program recorded the file's name."""
        run = self.metadata.get("run", {})
        return f"{run.get('experiment', self.path.stem)}, seed {run.get('seed', '?')}" if run else self.path.stem

    @property
    def settings(self) -> Any:
        """Settings of the run; empty if the file does not say them, or not as JSON."""
        try:
            return parse_json(self.metadata.get("run", {}).get("settings", "{}"), f"{self.path}: settings of its run")
        except InputError:
            return {}

    def attachment(self, name: str) -> Any:
        """A JSON file inside the recording."""
        if name not in self.attachments:
            raise InputError(f"{self.path}: holds no '{name}': it was not written by wbmpc")
        return parse_json(self.attachments[name][1], f"{self.path}: its '{name}', not written by wbmpc")

    @property
    def scenes(self) -> list[tuple[float, Any]]:
        """The scenes with the times [s] from which they hold; empty if another program wrote the file."""
        found = [(t, self.attachment(name)) for name, (t, _) in self.attachments.items() if name.startswith("scene")]
        return sorted(found, key=lambda pair: pair[0])

    def table(self, topic: str) -> Table:
        """The numbers and texts of a topic; a list of messages gives columns for each."""
        found = self[topic]
        try:
            rows = [dict(islice(_flat("", found.kind, message), MAX_COLUMNS + 1)) for _, message in found.messages()]
        except InputError:
            raise
        except ValueError:  # of zip
            raise InputError(f"{found.where}: a message has not as many numbers as names") from None
        names = list(dict.fromkeys(name for row in rows for name in row))
        given, cells = sum(map(len, rows)), len(names) * len(rows)
        if len(names) > MAX_COLUMNS:
            raise InputError(
                f"{found.where}: is no table: it has more than {MAX_COLUMNS} columns; other topics can be named"
            )
        if cells > max(MAX_SPARSE, _SPARSE * given):
            raise InputError(
                f"{found.where}: is no table: its {len(rows)} messages have {len(names)} different names; other topics can be named"
            )
        columns = {}
        for name in names:
            values = [row.get(name, np.nan) for row in rows]
            columns[name] = np.array(values) if not any(isinstance(v, str) for v in values) else _texts(values)
        return Table(np.array(found.times), columns)


def _texts(values: list[Any]) -> np.ndarray:
    return np.array([v if isinstance(v, str) else "" for v in values])


def _flat(prefix: str, kind: str, message: Any) -> Iterator[tuple[str, Any]]:
    """Names and values of all numbers and texts of a message."""
    join = lambda *parts: ".".join(p for p in parts if p)
    if isinstance(message, np.ndarray):
        yield from zip((join(prefix, n) for n in numbers(kind)), message.tolist(), strict=True)
    elif isinstance(message, dict):
        labels = message.get("name")
        for name, value in message.items():
            if name in _SKIPPED or value is labels:
                continue
            if isinstance(value, np.ndarray) and value.size and name in ("position", "velocity", "effort") and labels:
                yield from zip((join(prefix, name, label) for label in labels), value.tolist(), strict=True)
            else:
                yield from _flat_field(join(prefix, name), kind, name, value)
    else:
        yield prefix or "data", message


def _flat_field(prefix: str, kind: str, name: str, value: Any) -> Iterator[tuple[str, Any]]:
    inner = next(f for f in fields(kind) if f.name == name)
    if isinstance(value, np.ndarray) and inner.array is not None:
        if inner.array == 0:  # arrays of fixed length are covariances, which are not filled
            yield from ((f"{prefix}.{i}", v) for i, v in enumerate(value.tolist()))
    elif isinstance(value, list):
        for i, one in enumerate(value):
            label = one.get("child_frame_id", i) if isinstance(one, dict) else i
            yield from _flat(f"{prefix}.{label}", inner.kind, one)
    elif name != "child_frame_id":
        yield from _flat(prefix, inner.kind, value)


def read_recording(path: str | Path) -> Recording:
    """Read the recording ``path`` (a file, or a folder of a run or of ``ros2 bag record``): all that is whole of one that is cut or damaged,
    without topics of :data:`KINDS` that have another type.

    Damage is noted in the recording and logged as a warning. Raises :class:`InputError` when there is no such file, it is not
    MCAP, or nothing of it can be read.
    """
    path = recording_file(Path(path))
    if not path.is_file():
        raise InputError(f"{path}: there is no such recording")
    if path.suffix == ".db3":
        raise InputError(f"{path}: is a bag in SQLite; 'ros2 bag convert' makes a recording of it (storage_id: mcap)")
    data, damage = read_file(path, LARGEST, MAGIC), []  # type: bytes, list[str]
    if not data.startswith(MAGIC):
        raise InputError(
            f"{path}: is not a recording (MCAP): {'it does not begin like one' if data else 'it is empty'}"
        )
    try:
        out = _Assembly(Recording(path, {}, {}, {}, False, damage)).of(records(data, damage))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if not (out.topics or out.metadata or out.unknown):
        raise InputError(
            f"{path}: nothing can be read of this recording: {damage[0] if damage else 'it holds nothing yet'}"
        )
    if damage:
        more = f"; and {len(damage) - 1} more like it" if len(damage) > 1 else ""
        _LOG.warning("%s is damaged, and read without what is not whole: %s%s", path, damage[0], more)
    return out


def recording_file(path: Path) -> Path:
    """The recording in a directory: a run's, or the only one, as ``ros2 bag record`` leaves it. Raises :class:`InputError` if there are
    others, or none."""
    own = path / "run.mcap"
    if not path.is_dir():
        return path
    found = sorted(f for ending in ("mcap", "db3") for f in path.glob(f"*.{ending}"))
    if len(found) > 1 and not own.is_file():
        raise InputError(f"{path}: holds {len(found)} recordings; give one of them: {', '.join(f.name for f in found)}")
    return found[0] if found and not own.is_file() else own


class _Assembly:
    """Puts records where they belong."""

    def __init__(self, recording: Recording) -> None:
        self._out = recording
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, Topic | None] = {}
        #: Messages whose topic was in a damaged chunk: the file's end says it once more.
        self._waiting: list[Record] = []

    def of(self, found: Iterable[McapRecord]) -> Recording:
        """All records, the file's own in their order."""
        for record in found:
            self._take(record)
        for record in self._waiting:
            self._message(record)
        lost = sum(record.channel_id not in self._channels for record in self._waiting)
        if lost:
            self._out.damage.append(f"{lost} messages are of topics that it does not name")
        self._out.topics = {name: topic for name, topic in self._out.topics.items() if topic.times}
        return self._out

    def _take(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
        elif isinstance(record, Channel) and record.id not in self._channels:
            kind = self._schemas.get(record.schema_id, "").replace("/msg/", "/")
            # other programs' topics may be of types that are not known here
            known = kind in DEFINITIONS and record.message_encoding == "cdr"
            there = self._out.topics.get(record.topic)
            usual = KINDS.get(record.topic[: record.topic.find("/", 1) + 1], kind if there is None else there.kind)
            needed = KINDS.get(record.topic, usual)
            if known and kind != needed:
                known = False
                self._out.damage.append(f"{record.topic} is left out: its type is {kind}, {needed} is needed")
            elif not known:
                self._out.unknown[record.topic] = kind or record.message_encoding
            self._channels[record.id] = self._topic(record.topic, kind) if known else None
        elif isinstance(record, Record):
            if record.channel_id in self._channels:
                self._message(record)
            else:
                self._waiting.append(record)
        elif isinstance(record, Metadata):
            self._out.metadata[record.name] = record.metadata
        elif isinstance(record, Attachment):
            self._out.attachments[record.name] = (record.log_time / 1e9, record.data)
        elif isinstance(record, Footer):
            self._out.complete = True

    def _topic(self, name: str, kind: str) -> Topic:
        return self._out.topics.setdefault(name, Topic(kind, f"{self._out.path}: {name}"))

    def _message(self, record: Record) -> None:
        topic = self._channels.get(record.channel_id)
        if topic is not None:
            topic.times.append(record.log_time / 1e9)
            topic.data.append(record.data)
