"""The records of an MCAP file, one after the other, also of a file that is damaged or ends in the middle.

What is damaged is left out, and noted. Checksums are compared: each chunk's and each attachment's, and in a file that was closed
those of everything before the summary and of the summary. Source: the MCAP format specification (mcap.dev/spec), version 0.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, McapRecord, Message, Metadata, Schema

from wbmpc.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
#: Kind (1 byte) and length of a record; what a message begins with: channel, number, time of the log and of the sender [ns].
_HEAD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_READ: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.HEADER: Header.read, Opcode.FOOTER: Footer.read, Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read, Opcode.ATTACHMENT: Attachment.read, Opcode.METADATA: Metadata.read,
    Opcode.DATA_END: DataEnd.read,
}  # fmt: skip
#: Bytes of a chunk when it is unpacked, at most; what a compressed frame says that does not know its size.
LARGEST_CHUNK, UNKNOWN = 256 * 1024 * 1024, 2**64 - 1
#: Records, and bytes of chunks when they are unpacked, that a file may have: so many, and more by each of its bytes. A recording of
#: this program has one in about 100 bytes and becomes two or three times as large; some of zeros would keep a reader for minutes.
MAX_RECORDS, MAX_UNPACKED = (500_000, 1 / 20), (256 * 1024 * 1024, 64.0)
_KINDS = frozenset(map(int, Opcode))
#: After so many damaged records one after the other a file is not followed any further: a power cut leaves ends that are all zeros, each
#: nine of which are a record.
_LOST = 1000
#: What a chunk may have.
_IN_CHUNKS = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
#: Kinds from here on are other programs' own.
_PRIVATE = 0x80
_CHECKSUM = "its checksum does not fit"
#: What decoders of records and of compressed data raise.
_DAMAGED = (McapError, zstandard.ZstdError, struct.error, ValueError, RuntimeError, OverflowError, MemoryError)


def records(data: bytes, damage: list[str]) -> Iterator[McapRecord]:
    """Every whole record of a file's bytes, those inside of chunks too; a footer only if it ends the file.

    What is wrong is appended to ``damage``: clauses without a full stop. A file that just ends in the middle is not damaged.
    Raises :class:`InputError` for one that holds far more than its bytes could be (:data:`MAX_RECORDS`, :data:`MAX_UNPACKED`).
    """
    largest = [int(first + more * len(data)) for first, more in (MAX_RECORDS, MAX_UNPACKED)]
    count = unpacked = 0
    at, summary, closed, good = len(MAGIC), 0, False, 0
    while at + _HEAD.size <= len(data):
        kind, length = _HEAD.unpack_from(data, at)
        start, end = at + _HEAD.size, at + _HEAD.size + length
        if end > len(data):
            break
        count += 1
        if count > largest[0]:
            raise InputError(f"has more than {largest[0]} records, which no recording of {len(data)} bytes has")
        try:
            found = _record(kind, data[start:end])
            if isinstance(found, Chunk):
                unpacked += _size(found)
                if unpacked > largest[1]:
                    raise InputError(
                        f"becomes larger than {largest[1]} bytes unpacked, which no recording of {len(data)} bytes does"
                    )
                for inner in _inside(_unpacked(found), largest[0] - count):
                    count += 1
                    if inner is not None:
                        yield inner
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
        except InputError:
            raise
        except _DAMAGED as error:
            damage.append(f"the record at byte {at} ({_name(kind)}): {_describe(error)}")
        at = end
        if len(damage) - good >= _LOST:
            damage.append(f"nothing is read from byte {at} of {len(data)} on")
            return
    if data[len(MAGIC) :].endswith(MAGIC) and not closed:  # it was closed once: what is missing is not its end
        damage.append(f"its records cannot be followed from byte {at} of {len(data)} on")


def _size(chunk: Chunk) -> int:
    """Bytes of a chunk when it is unpacked. Raises for one that would become too large, before any of it is."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":  # the decoder makes room for what the compressed frame says
        size = max(size, zstandard.get_frame_parameters(chunk.data).content_size % UNKNOWN)
    if size > LARGEST_CHUNK:
        raise ValueError(f"it would have {size} bytes unpacked; at most {LARGEST_CHUNK} are read")
    return size


def _unpacked(chunk: Chunk) -> bytes:
    """What is inside. Raises one of ``_DAMAGED``, also where it is larger than the chunk says."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        data = zstandard.decompress(chunk.data, size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"it is compressed by '{chunk.compression[:20]}'; valid: zstd, lz4")
    if len(data) != size:
        raise ValueError("it has not as many bytes unpacked as it says")
    _compare(chunk.uncompressed_crc, data)
    return data


def _inside(data: bytes, left: int) -> Iterator[McapRecord | None]:
    """The records in a chunk's bytes; None for those that do not count. Raises :class:`InputError` for more than are ``left``."""
    at = 0
    while at < len(data):
        if left <= 0:
            raise InputError("has more records in its chunks than a recording of its size has")
        kind, length = _HEAD.unpack_from(data, at)
        start, at, left = at + _HEAD.size, at + _HEAD.size + length, left - 1
        if at > len(data):
            raise ValueError("a record in it is longer than what is left of it")
        yield _record(kind, data[start:at]) if kind in _IN_CHUNKS else None


def _record(kind: int, body: bytes) -> McapRecord | None:
    """The record; None for those that only serve to find others. Raises one of ``_DAMAGED``."""
    if kind == Opcode.ATTACHMENT:
        _compare(int.from_bytes(body[-4:], "little"), body[:-4])
    if kind == Opcode.MESSAGE:
        channel, number, logged, sent = _MESSAGE.unpack_from(body)
        return Message(channel, logged, body[_MESSAGE.size :], sent, number)
    if kind in _READ:
        return _READ[kind](ReadDataStream(BytesIO(body)))
    if kind not in _KINDS and kind < _PRIVATE:
        raise ValueError("the format has no such record")
    return None


def _name(kind: int) -> str:
    return Opcode(kind).name.lower().replace("_", " ") if kind in _KINDS else "of no known kind"


def _describe(error: Exception) -> str:
    return str(error) or type(error).__name__


def _compare(expected: int, data: bytes) -> None:
    """Raise unless this is the checksum of ``data``; 0 is none."""
    if expected and zlib.crc32(data) != expected:
        raise ValueError(_CHECKSUM)
