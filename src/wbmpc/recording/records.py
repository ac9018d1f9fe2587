"""The records of an MCAP file, one after the other, also of a file that is damaged or ends in the middle.

What is damaged is left out, and noted. Checksums are compared: each chunk's and each attachment's, and in a file that was closed
those of everything before the summary and of the summary. Source: the MCAP format specification (mcap.dev/spec), version 0.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk

MAGIC = b"\x89MCAP0\r\n"
#: Kind (1 byte) and length of a record.
_HEAD = struct.Struct("<BQ")
_READ: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.HEADER: Header.read, Opcode.FOOTER: Footer.read, Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read, Opcode.ATTACHMENT: Attachment.read, Opcode.METADATA: Metadata.read,
    Opcode.DATA_END: DataEnd.read,
}  # fmt: skip
#: Bytes of a chunk when it is unpacked, at most; what a compressed frame says that does not know its size.
LARGEST_CHUNK, UNKNOWN = 256 * 1024 * 1024, 2**64 - 1
#: After so many damaged records one after the other a file is not followed any further: a power cut leaves ends that are all zeros, each
#: nine of which are a record.
_LOST = 1000
#: Kinds from here on are other programs' own.
_PRIVATE = 0x80
_CHECKSUM = "its checksum does not fit"
#: What decoders of records and of compressed data raise.
_DAMAGED = (McapError, zstandard.ZstdError, struct.error, ValueError, RuntimeError, OverflowError, MemoryError)


def records(data: bytes, damage: list[str]) -> Iterator[McapRecord]:
    """Every whole record of a file's bytes, those inside of chunks too; a footer only if it ends the file.

    What is wrong is appended to ``damage``: clauses without a full stop. A file that just ends in the middle is not damaged.
    """
    at, summary, closed, good = len(MAGIC), 0, False, 0
    while at + _HEAD.size <= len(data):
        kind, length = _HEAD.unpack_from(data, at)
        start, end = at + _HEAD.size, at + _HEAD.size + length
        if end > len(data):
            break
        try:
            found = _record(kind, data[start:end])
            if isinstance(found, Chunk):
                _check_growth(found)
                yield from breakup_chunk(found, validate_crc=True)
            elif isinstance(found, DataEnd):
                summary = end
                _compare(found.data_section_crc, data[:at])
            elif isinstance(found, Footer):
                closed = data[end:] == MAGIC
                if closed:
                    yield found
                elif not MAGIC.startswith(data[end:]):
                    raise ValueError("it is not the last one")
                _compare(found.summary_crc, data[summary : end - 4])
            elif found is not None:
                yield found
            good = len(damage)
        except _DAMAGED as error:
            damage.append(f"the record at byte {at} ({_name(kind)}): {_describe(error)}")
        at = end
        if len(damage) - good >= _LOST:
            damage.append(f"nothing is read from byte {at} of {len(data)} on")
            return
    if data[len(MAGIC) :].endswith(MAGIC) and not closed:  # it was closed once: what is missing is not its end
        damage.append(f"its records cannot be followed from byte {at} of {len(data)} on")


def _check_growth(chunk: Chunk) -> None:
    """Raise for a chunk that would become too large, or larger than it says, before any of it is unpacked."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":  # the decoder makes room for what the compressed frame says
        size = max(size, zstandard.get_frame_parameters(chunk.data).content_size % UNKNOWN)
    if size > LARGEST_CHUNK:
        raise ValueError(f"it would have {size} bytes unpacked; at most {LARGEST_CHUNK} are read")


def _record(kind: int, body: bytes) -> McapRecord | None:
    """The record; None for those that only serve to find others. Raises one of ``_DAMAGED``."""
    if kind == Opcode.ATTACHMENT:
        _compare(int.from_bytes(body[-4:], "little"), body[:-4])
    if kind == Opcode.MESSAGE:
        return Message.read(ReadDataStream(BytesIO(body)), len(body))
    if kind in _READ:
        return _READ[kind](ReadDataStream(BytesIO(body)))
    if kind not in list(Opcode) and kind < _PRIVATE:
        raise ValueError("the format has no such record")
    return None


def _name(kind: int) -> str:
    return Opcode(kind).name.lower().replace("_", " ") if kind in list(Opcode) else "of no known kind"


def _describe(error: Exception) -> str:
    return _CHECKSUM if isinstance(error, CRCValidationError) else str(error) or type(error).__name__


def _compare(expected: int, data: bytes) -> None:
    """Raise unless this is the checksum of ``data``; 0 is none."""
    if expected and zlib.crc32(data) != expected:
        raise ValueError(_CHECKSUM)
