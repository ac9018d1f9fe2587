"""Reads files whose names come from outside: one that would never end, or is too large, is one clear error."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from wbmpc.errors import InputError

#: Bytes that are read at a time of a file whose size says less.
_PART = 2**20


def expanded(path: Path) -> Path:
    """A path whose leading ``~`` or ``~user`` is a home directory. Raises :class:`InputError` naming the path where there is none."""
    try:
        return path.expanduser()
    except RuntimeError as error:
        raise InputError(f"{str(path)!r}: there is no home directory that '~' stands for") from error


@contextmanager
def open_file(path: Path) -> Iterator[BinaryIO]:
    """A regular file to read from, which does not wait. Raises :class:`InputError` naming the file, also for errors while it is
    read."""
    try:
        with open(path, "rb", opener=_open) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InputError(f"{path}: is no regular file")
            yield file
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    except MemoryError as error:
        raise InputError(f"{path}: cannot be read (it does not fit into the memory)") from error


def read_file(path: Path, largest: int, magic: bytes = b"") -> bytes:
    """The bytes of a regular file, at most ``largest``; of one that does not begin with ``magic`` its first bytes only. Raises
    :class:`InputError` naming the file."""
    try:
        with open_file(path) as file:
            size = os.fstat(file.fileno()).st_size
            data = _read(path, file, len(magic))
            if data != magic:
                return data
            parts, end = [data], len(data)
            # more than its size: it may grow; and no more at a time, for memory is taken before anything is read
            while size <= largest and end <= largest:
                parts.append(_read(path, file, min(largest + 1 - end, max(size, _PART))))
                end += len(parts[-1])
                if not parts[-1]:
                    break
            data = b"".join(parts)
    except InputError:
        raise
    except ValueError as error:  # a name that no file system takes
        raise InputError(f"{str(path)!r}: cannot be read ({error})") from error
    size = max(size, len(data))
    if size > largest:
        raise InputError(f"{path}: has {size} bytes; at most {largest} are read")
    return data


def _read(path: Path, file: BinaryIO, count: int) -> bytes:
    data = file.read(count)
    if data is None:  # a file of the kernel, whose readers wait for more
        raise InputError(f"{path}: cannot be read (its end has not been written)")
    return data


def _open(path: str, flags: int) -> int:
    """Without waiting for a pipe's writer. What is open is then checked: a name could lead elsewhere a moment later."""
    return os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY)
