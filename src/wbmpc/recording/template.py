"""Messages that differ only in their time and their numbers: encoded once, filled in many at a time.

A recording writes thousands of messages whose names and lengths never change. Their bytes are kept with the places of all
stamps and float64, which plain CDR (see :mod:`wbmpc.recording.messages`) aligns to 4 and 8 bytes from the end of its header.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.recording.messages import Message, encode, fields, numbers

#: Bytes of CDR's own header, and of the integers of a type.
_HEADER, _SIZES = 4, {"int32": 4, "uint32": 4, "float64": 8}


class Template:
    """Messages like ``message``: one time in all stamps, and other float64. ``length``: bytes of one."""

    def __init__(self, kind: str, message: Message) -> None:
        data = encode(kind, message)
        self._header, self.length = data[:_HEADER], len(data)
        body = data[_HEADER:]
        self._body = np.frombuffer(body + bytes(-len(body) % 8), np.uint8)
        stamps: list[int] = []
        floats: list[int] = []
        _places(kind, message, 0, stamps, floats)
        seconds = np.array(stamps, int) // 4
        #: how many numbers a message has
        self._stamped, self.size = len(stamps) > 0, len(floats)
        self._seconds, self._nanoseconds = _slice(seconds), _slice(seconds + 1)
        self._floats = _slice(np.array(floats, int) // 8)

    def fill(self, times: Sequence[int], numbers: np.ndarray) -> list[bytes]:
        """Messages at ``times`` (n) [ns] with the ``numbers`` (n, size) of each."""
        rows = np.tile(self._body, (len(times), 1))
        if self._stamped:
            seconds, nanoseconds = np.divmod(np.array(times), 1_000_000_000)
            words = rows.view("<u4")
            words[:, self._seconds], words[:, self._nanoseconds] = seconds[:, None], nanoseconds[:, None]
        rows.view("<f8")[:, self._floats] = numbers
        whole, width, length, header = rows.tobytes(), rows.shape[1], self.length - _HEADER, self._header
        return [header + whole[at : at + length] for at in range(0, len(whole), width)]


class Topics:
    """Messages of one time that are written together: ``parts``, topic, type and template of each in order. Their numbers are one row."""

    def __init__(self, parts: Sequence[tuple[str, str, Template]]) -> None:
        self.parts = list(parts)
        self._sizes = [template.size for _, _, template in parts]
        #: bytes of all of them
        self.length = sum(template.length for _, _, template in parts)
        ends = np.cumsum(self._sizes).tolist()
        self._places = [slice(end - size, end) for end, size in zip(ends, self._sizes, strict=True)]

    def row(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """A copy of the numbers of all messages; raises :class:`InputError` where one has more or fewer than places."""
        sizes = [part.size for part in values]
        if sizes != self._sizes:
            raise InputError(f"messages: need {self._sizes} numbers, got {sizes}")
        return np.concatenate(values, axis=None)

    def fill(self, times: Sequence[int], rows: Sequence[np.ndarray]) -> list[list[bytes]]:
        """By topic the messages at ``times`` (n) [ns] with n ``rows``."""
        numbers = np.array(rows)
        return [part.fill(times, numbers[:, at]) for (_, _, part), at in zip(self.parts, self._places, strict=True)]


def _slice(index: np.ndarray) -> slice | np.ndarray:
    """The same places as a slice, where they follow each other."""
    if index.size and (np.diff(index) == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index


def _places(kind: str, value: Any, at: int, stamps: list[int], floats: list[int]) -> int:
    """Collect where stamps and float64 of a value that begins after byte ``at`` are; returns where it ends."""
    if kind == "string":
        return at + -at % 4 + 4 + len(value.encode()) + 1
    if kind in _SIZES:
        at += -at % _SIZES[kind]
        if kind == "float64":
            floats.append(at)
        return at + _SIZES[kind]
    if kind == "builtin_interfaces/Time":
        stamps.append(at + -at % 4)
    flat = numbers(kind)
    if flat:
        for one in np.asarray(value).ravel():
            at = _places("float64", one, at, stamps, floats)
        return at
    for field in fields(kind):
        inside = value[field.name]
        if field.array is None:
            at = _places(field.kind, inside, at, stamps, floats)
            continue
        if field.array == 0:
            at = _places("uint32", len(inside), at, stamps, floats)
        for one in inside:
            at = _places(field.kind, one, at, stamps, floats)
    return at
