"""Reads files whose names come from outside, and JSON: one that never ends, is too large, nested too deep or broken is one clear error."""

from __future__ import annotations

import json
import math
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from wbmpc.errors import InputError

#: Bytes of a file and levels of nesting, at most.
LARGEST, DEEPEST = 64 * 1024 * 1024, 64


def load_json(path: Path) -> Any:
    """What a JSON file says. Raises :class:`InputError` naming the file."""
    return parse_json(read_file(path, LARGEST), str(path))


def parse_json(text: str | bytes, where: str) -> Any:
    """What a JSON text says; ``where``: what messages begin with.

    Raises :class:`InputError`, also for NaN, infinity, numbers that are too large and keys that appear twice.
    """
    try:
        value = json.loads(
            text, parse_constant=_no_number, parse_float=_finite, parse_int=_whole, object_pairs_hook=_once
        )
    except RecursionError as error:
        raise InputError(f"{where}: nested deeper than {DEEPEST} levels") from error
    except ValueError as error:
        raise InputError(f"{where}: is not JSON: {error}") from error
    level = [value]
    for _ in range(DEEPEST):
        level = [inner for outer in level for inner in _inside(outer)]
        if not level:
            return value
    raise InputError(f"{where}: nested deeper than {DEEPEST} levels")


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is not a number in JSON")


def _finite(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ValueError(f"{text[:40]} is too large for a number")
    return value


def _whole(text: str) -> int:
    _finite(text)
    return int(text)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"key '{twice[:80]}' appears twice")
    return found


def _inside(value: Any) -> list[Any]:
    found = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [v for v in found if isinstance(v, (dict, list))]


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
