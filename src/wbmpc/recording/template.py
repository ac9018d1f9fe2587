"""Messages that differ only in their time and their numbers: encoded once, filled in.

A recording writes thousands of messages whose names and lengths never change. Their bytes are kept with the places of all
stamps and float64, which plain CDR (see :mod:`wbmpc.recording.messages`) aligns to 4 and 8 bytes from the end of its header.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.recording.messages import Message, encode, fields, numbers

#: Bytes of CDR's own header, and of the integers of a type.
_HEADER, _SIZES = 4, {"int32": 4, "uint32": 4, "float64": 8}


class Template:
    """Messages like ``message``: one time in all stamps, and ``size`` other float64."""

    def __init__(self, kind: str, message: Message) -> None:
        data = encode(kind, message)
        self._header, body = data[:_HEADER], data[_HEADER:]
        self._kind, self._length = kind, len(body)
        self._body = np.frombuffer(body + bytes(-len(body) % 8), np.uint8).copy()
        self._words, self._numbers = self._body.view("<u4"), self._body.view("<f8")
        stamps: list[int] = []
        floats: list[int] = []
        _places(kind, message, 0, stamps, floats)
        self._seconds, self._floats, self.size = np.array(stamps, int) // 4, np.array(floats, int) // 8, len(floats)

    def fill(self, time: int, numbers: np.ndarray) -> bytes:
        """The message at a ``time`` [ns] with other ``numbers`` (size, of any shape). Raises :class:`InputError` for more or fewer."""
        if numbers.size != self.size:
            raise InputError(f"message: {self._kind} needs {self.size} numbers, got {numbers.size}")
        self._words[self._seconds], self._words[self._seconds + 1] = divmod(time, 1_000_000_000)
        self._numbers[self._floats] = numbers.ravel()
        return self._header + self._body[: self._length].tobytes()


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
