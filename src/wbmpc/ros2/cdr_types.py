"""Message types as Cyclone DDS knows types, for samples that are CDR already: the types' fields are announced, never encoded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass as make_dataclass
from functools import cache
from types import new_class
from typing import Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl import types as idl_types_of_package
from rosbags.interfaces import Nodetype

from wbmpc.ros2.messages import Types, types

idl_types: Any = idl_types_of_package  # its annotations say less than it can do
_INTEGERS = [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
_BASE: dict[str, Any] = {name: getattr(idl_types, name) for name in _INTEGERS}
_BASE |= {"float32": idl_types.float32, "float64": idl_types.float64, "bool": bool}
_BASE |= dict.fromkeys(("octet", "byte", "char"), idl_types.uint8)


@cache
def shared_message_class(distribution: str, kind: str, header: tuple[tuple[str, Any], ...]) -> type:
    """One class for all topics of a type in the process: DDS takes every class for a type of its own with the same hash, and its
    table of types, which holds 32 of those, would grow forever."""
    return message_class(types(distribution), kind, dict(header))


def message_class(known: Types, kind: str, header: Mapping[str, Any] | None = None) -> type:
    """A DDS type with the fields of a message whose samples are CDR that is there already."""
    base = _idl(known, kind, dict(header or {}), {})

    class SerializedMessage(base):  # type: ignore[valid-type, misc]
        def __init__(self, data: bytes = b"") -> None:
            object.__setattr__(self, "data", data)

        def __repr__(self) -> str:
            return f"{kind}, {len(self.data)} bytes"

        def serialize(self, *ignored: Any, **also: Any) -> bytes:
            return self.data  # type: ignore[no-any-return, attr-defined]

        @classmethod
        def deserialize(cls, data: bytes, **ignored: Any) -> SerializedMessage:
            return cls(bytes(data))

    SerializedMessage.__idl_typename__, SerializedMessage.__idl__ = base.__idl_typename__, base.__idl__  # type: ignore[attr-defined]
    return SerializedMessage


def _idl(known: Types, kind: str, extra: dict[str, Any], made: dict[str, type]) -> type:
    """The package's form of a message type; ``made``: those that are there already."""
    if kind in made and not extra:
        return made[kind]
    fields = {**extra, **{name: _idl_field(known, form, made) for name, form in known.store.fielddefs[kind][1]}}
    package, folder, name = kind.split("/")
    typename = f"{package}.{folder}.dds_.{name}_"
    struct_type = new_class(
        f"{name}_", (IdlStruct,), {"typename": typename}, lambda body: body.__setitem__("__annotations__", fields)
    )
    made[kind] = make_dataclass(struct_type)
    return made[kind]


def _idl_field(known: Types, form: Any, made: dict[str, type]) -> Any:
    node, detail = form
    if node == Nodetype.NAME:
        return _idl(known, detail, {}, made)
    if node == Nodetype.BASE:
        name, limit = detail
        if name == "string":
            return idl_types.bounded_str[limit] if limit else str
        return _BASE[name]
    inner, size = detail
    part = _idl_field(known, inner, made)
    if node == Nodetype.ARRAY:
        return idl_types.array[part, size]
    return idl_types.sequence[part, size] if size else idl_types.sequence[part]
