"""ROS 2 messages without ROS: definitions, CDR and type hashes from rosbags; messages are made from nested mappings."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from wbmpc.errors import InputError, unknown_name

_EMPTY = "uint8 structure_needs_at_least_one_member\n"
_RESULT = "bool success\nstring message\n"
#: Services have no definitions in rosbags. SetLegs is of the package that docs/ros2.md shows.
SERVICES = {
    "wbmpc_msgs/srv/SetLegs": ("string configuration\nstring[] leg\nfloat64[] angle\nbool[] brake_open\n", _RESULT),
    "std_srvs/srv/Trigger": (_EMPTY, _RESULT),
    "std_srvs/srv/SetBool": ("bool data\n", _RESULT),
}
#: What is not zero or empty when it is not given.
DEFAULTS: dict[str, dict[str, Any]] = {"geometry_msgs/msg/Quaternion": {"w": 1.0}}
_NUMBERS = {"octet": "uint8", "byte": "uint8", "char": "uint8"}


@cache
def types(distribution: str) -> Types:
    """The definitions of a distribution, loaded once."""
    return Types(distribution)


class Types:
    """All message types of a ROS 2 ``distribution`` and the services of :data:`SERVICES`."""

    def __init__(self, distribution: str) -> None:
        self.store = get_typestore(getattr(Stores, f"ROS2_{distribution.upper()}"))
        for name, parts in SERVICES.items():
            for half, text in zip((request(name), response(name)), parts, strict=True):
                (fields,) = get_types_from_msg(text, half).values()
                self.store.register({half: fields})

    def check(self, kind: str) -> None:
        """Raise :class:`InputError` if there is no such type."""
        if kind not in self.store.fielddefs:
            package = kind.split("/")[0]
            known = sorted(self.store.fielddefs)
            raise unknown_name("message type", kind, [k for k in known if k.split("/")[0] == package] or known)

    def make(self, kind: str, values: Mapping[str, Any] | None = None) -> Any:
        """A message from a nested mapping; what is not given is zero or empty, or as in :data:`DEFAULTS`.

        Raises :class:`InputError` for a key that does not exist.
        """
        fields = self.store.fielddefs[kind][1]
        given = {**DEFAULTS.get(kind, {}), **(values or {})}
        made = {name: self._field(form, given.pop(name, None)) for name, form in fields}
        if given:
            raise unknown_name(f"field of {kind}", next(iter(given)), made)
        return self.store.types[kind](**made)

    def _field(self, form: Any, value: Any) -> Any:
        node, detail = form
        if node == Nodetype.NAME:
            return value if hasattr(value, "__msgtype__") else self.make(detail, value)
        if node == Nodetype.BASE:
            return _number(detail[0], value)
        (inner, kind), size = detail
        if inner == Nodetype.NAME:
            return [
                self._field((inner, kind), v) for v in (value if value is not None else [None] * _fixed(node, size))
            ]
        if kind[0] in ("string", "wstring"):
            return list(value) if value is not None else [""] * _fixed(node, size)
        number = _NUMBERS.get(kind[0], kind[0])
        array = np.zeros(_fixed(node, size), number) if value is None else np.ascontiguousarray(value, number)
        if array.ndim != 1 or (node == Nodetype.ARRAY and array.size != size):
            raise InputError(f"message: an array of {size or 'some'} {kind[0]} is needed, got shape {array.shape}")
        return array

    def encode(self, kind: str, message: Any) -> bytes:
        """CDR with its four bytes of header."""
        return bytes(self.store.serialize_cdr(message, kind))

    def decode(self, kind: str, data: bytes) -> Any:
        """The message of some CDR."""
        return self.store.deserialize_cdr(data, kind)

    def hash(self, kind: str) -> str:
        """The type's hash as in REP 2016, with its version: RIHS01_…"""
        value = self.store.hash_rihs01(kind)
        return value if value.startswith("RIHS01_") else f"RIHS01_{value}"


def request(service: str) -> str:
    """Message type of a service's request."""
    return f"{service}_Request"


def response(service: str) -> str:
    """Message type of a service's answer."""
    return f"{service}_Response"


def _fixed(node: Any, size: int) -> int:
    return int(size) if node == Nodetype.ARRAY else 0


def _number(kind: str, value: Any) -> Any:
    if kind in ("string", "wstring"):
        return "" if value is None else str(value)
    if kind == "bool":
        return bool(value)
    if kind.startswith("float"):
        return 0.0 if value is None else float(value)
    return 0 if value is None else int(value)
