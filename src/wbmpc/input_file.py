"""Reads files whose names come from outside: one that would never end, or is too large, is one clear error."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from wbmpc.errors import InputError


def read_file(path: Path, largest: int) -> bytes:
    """The bytes of a regular file, at most ``largest``. Raises :class:`InputError` naming the file."""
    try:
        with open(path, "rb", opener=_open) as file:
            about = os.fstat(file.fileno())
            if not stat.S_ISREG(about.st_mode):
                raise InputError(f"{path}: is no regular file")
            data = b"" if about.st_size > largest else file.read(largest + 1)  # more than its size: it may grow
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except InputError:
        raise
    except ValueError as error:  # a name that no file system takes
        raise InputError(f"{str(path)!r}: cannot be read ({error})") from error
    size = max(about.st_size, len(data))
    if size > largest:
        raise InputError(f"{path}: has {size} bytes; at most {largest} are read")
    return data


def _open(path: str, flags: int) -> int:
    """Without waiting for a pipe's writer. What is open is then looked at: a name could lead elsewhere a moment later."""
    return os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY)
