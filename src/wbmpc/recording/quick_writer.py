"""The MCAP library's writer with messages that are packed in one piece.

The library writes a message field by field, which takes a tenth of a closed loop. What is packed here goes into the library's own chunk:
indices, compression and files are its work, and the bytes are the same.
"""

from __future__ import annotations

import struct
from typing import Any

from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer

#: A message's record up to its data: opcode, length, channel, sequence, log time, publish time.
_HEAD = struct.Struct("<BQHIQQ")
_INSIDE = _HEAD.size - 9  # the record's own length does not count opcode and length
_OPCODE = int(Opcode.MESSAGE)
#: What is used of the library's writer. Where it has them no more, its own way is taken.
_PARTS = ("_Writer__chunk_builder", "_Writer__statistics", "_Writer__maybe_finalize_chunk")


class _Index(MessageIndex):
    """Of a channel's messages in a chunk, written in one piece too."""

    def write(self, stream: Any) -> None:
        """Append the record."""
        numbers = [number for record in self.records for number in record]
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write(struct.pack(f"<HI{len(numbers)}Q", self.channel_id, 8 * len(numbers), *numbers))
        stream.finish_record()


class QuickWriter(Writer):
    """As the library's writer, for chunked files."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        parts: list[Any] = [getattr(self, name, None) for name in _PARTS]
        self._chunk, self._statistics, self._finalize = parts
        self._quick, self._size = all(parts), int(options.get("chunk_size", 1024 * 1024))

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0
    ) -> None:  # fmt: skip
        """Append a message; see the library's."""
        if not self._quick:
            super().add_message(channel_id, log_time, data, publish_time, sequence)
            return
        chunk, seen, size = self._chunk, self._statistics, len(data)
        if not seen.message_count or log_time < seen.message_start_time:
            seen.message_start_time = log_time
        if log_time > seen.message_end_time:
            seen.message_end_time = log_time
        if not chunk.num_messages or log_time < chunk.message_start_time:
            chunk.message_start_time = log_time
        if log_time > chunk.message_end_time:
            chunk.message_end_time = log_time
        seen.channel_message_counts[channel_id] += 1
        seen.message_count += 1
        chunk.num_messages += 1
        index = chunk.message_indices.get(channel_id)
        if index is None:
            index = chunk.message_indices[channel_id] = _Index(channel_id=channel_id, records=[])
        records = chunk.record_writer
        at = records.count
        index.records.append((log_time, at))
        records.write(_HEAD.pack(_OPCODE, _INSIDE + size, channel_id, sequence, log_time, publish_time) + data)
        if at + _HEAD.size + size > self._size:
            self._finalize()

    @property
    def chunks(self) -> int | None:
        """How many chunks went to the file; None: unknown."""
        return self._statistics.chunk_count if self._quick else None
