"""The MCAP library's writer with messages that are packed in one piece.

The library writes a message field by field, which takes a tenth of a closed loop. What is packed here goes into the library's own chunk:
indices, compression and files are its work, and the bytes are the same.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer

from wbmpc.recording.template import Topics

#: A message's record up to its data: opcode, length, channel, sequence, log time, publish time.
_HEAD = struct.Struct("<BQHIQQ")
_INSIDE = _HEAD.size - 9  # the record's own length does not count opcode and length
_OPCODE = int(Opcode.MESSAGE)
#: What is used of the library's writer. Where it has them no more, its own way is taken.
_PARTS = ("_Writer__chunk_builder", "_Writer__statistics", "_Writer__maybe_finalize_chunk")


#: Channel, sequence, log time, publish time, bytes.
_Message = tuple[int, int, int, int, bytes]


class _Row(NamedTuple):
    """Messages of one time, each on its channel."""

    channels: Sequence[int]
    time: int
    topics: Topics
    numbers: np.ndarray


class _Index(MessageIndex):
    """Of a channel's messages in a chunk, written in one piece too."""

    def write(self, stream: Any) -> None:
        """Append the record."""
        numbers = [number for record in self.records for number in record]
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write(struct.pack(f"<HI{len(numbers)}Q", self.channel_id, 8 * len(numbers), *numbers))
        stream.finish_record()


class QuickWriter(Writer):
    """As the library's writer, for chunked files. Messages of a chunk are kept until it is full, and packed together then.

    ``chunks``: how many went to the file; None: unknown.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        parts: list[Any] = [getattr(self, name, None) for name in _PARTS]
        self._chunk, self._statistics, self._finalize = parts
        self._quick, self._size = all(parts), int(options.get("chunk_size", 1024 * 1024))
        self.chunks: int | None = 0 if self._quick else None
        #: messages (channel, sequence, log time, publish time, bytes), or what is made into several of one time: the row of their numbers
        self._kept: list[_Message | _Row] = []
        self._filled = 0  # bytes of the chunk, with those of the messages that are kept

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0
    ) -> None:  # fmt: skip
        """Append a message; see the library's."""
        if not self._quick:
            super().add_message(channel_id, log_time, data, publish_time, sequence)
            return
        self._keep((channel_id, sequence, log_time, publish_time, data), _HEAD.size + len(data))

    def add_row(self, channels: Sequence[int], time: int, topics: Topics, row: np.ndarray) -> None:
        """Append the messages of ``topics``, each on its channel, at a ``time`` [ns], with the ``row`` of their numbers. Their bytes are made with
        those of others like them."""
        if self._quick:
            self._keep(_Row(channels, time, topics, row), _HEAD.size * len(channels) + topics.length)
            return
        for channel, (data,) in zip(channels, topics.fill([time], [row]), strict=True):
            super().add_message(channel, time, data, time)

    def _keep(self, kept: _Message | _Row, length: int) -> None:
        self._kept.append(kept)
        self._filled += length
        if self._filled > self._size:
            self._pack()
            self._finalize()
            self.chunks, self._filled = self._statistics.chunk_count, 0

    def _pack(self) -> None:
        chunk, seen = self._chunk, self._statistics
        if not self._kept:
            return
        messages = self._messages()
        indices, counts, parts, at = chunk.message_indices, seen.channel_message_counts, list[bytes](), chunk.count
        for channel, sequence, logged, published, data in messages:
            size = len(data)
            index = indices.get(channel)
            if index is None:
                index = indices[channel] = _Index(channel_id=channel, records=[])
            index.records.append((logged, at))
            counts[channel] += 1
            parts += (_HEAD.pack(_OPCODE, _INSIDE + size, channel, sequence, logged, published), data)
            at += _HEAD.size + size
        chunk.record_writer.write(b"".join(parts))
        first, last = min(message[2] for message in messages), max(message[2] for message in messages)
        chunk.message_start_time = min(chunk.message_start_time, first) if chunk.num_messages else first
        seen.message_start_time = min(seen.message_start_time, first) if seen.message_count else first
        chunk.message_end_time = max(chunk.message_end_time, last)
        seen.message_end_time = max(seen.message_end_time, last)
        chunk.num_messages += len(messages)
        seen.message_count += len(messages)
        self._kept.clear()

    def _messages(self) -> list[_Message]:
        alike: dict[Topics, list[int]] = {}
        made: list[list[_Message]] = []
        for i, kept in enumerate(self._kept):
            made.append([] if isinstance(kept, _Row) else [kept])
            if isinstance(kept, _Row):
                alike.setdefault(kept.topics, []).append(i)
        for topics, places in alike.items():
            rows: list[Any] = [self._kept[i] for i in places]
            times = [row.time for row in rows]
            filled = topics.fill(times, [row.numbers for row in rows])
            for k, (i, row, t) in enumerate(zip(places, rows, times, strict=True)):
                made[i] = [(channel, 0, t, t, part[k]) for channel, part in zip(row.channels, filled, strict=True)]
        return [message for several in made for message in several]

    def _behind(self) -> None:
        """What comes next into the chunk stands behind the messages that there are."""
        if self._quick:
            self._pack()

    def register_schema(self, *arguments: Any, **options: Any) -> int:
        """See the library's."""
        self._behind()
        found = super().register_schema(*arguments, **options)
        self._filled = self._chunk.count if self._quick else 0
        return found

    def register_channel(self, *arguments: Any, **options: Any) -> int:
        """See the library's."""
        self._behind()
        found = super().register_channel(*arguments, **options)
        self._filled = self._chunk.count if self._quick else 0
        return found

    def finish(self) -> None:
        """See the library's."""
        self._behind()
        super().finish()
