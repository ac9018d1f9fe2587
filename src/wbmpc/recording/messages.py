"""ROS 2 messages as bytes and back, without ROS: the definitions that recordings use, and their CDR encoding.

A message is a dictionary by field. A type that holds nothing but float64 (Pose, Vector3, Wrench …) is one flat vector of
its numbers in the order of its definition: a Pose is x, y, z, qx, qy, qz, qw.

Sources: the interfaces of ROS 2 (common_interfaces, geometry2); OMG DDS-XTypes 1.3, section 7.4.1 (plain CDR, little
endian; every primitive is aligned to its size, counted from the end of the 4-byte header).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from wbmpc.errors import InputError, unknown_name

Message = Mapping[str, Any] | Sequence[float] | np.ndarray

#: Fields by type, as in the .msg files.
DEFINITIONS: dict[str, str] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/String": "string data",
    "std_msgs/Float64": "float64 data",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    "std_msgs/Float64MultiArray": "std_msgs/MultiArrayLayout layout\nfloat64[] data",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "sensor_msgs/JointState": "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    "nav_msgs/Odometry": "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    "geometry_msgs/TwistWithCovariance twist",
    "nav_msgs/Path": "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}
_PRIMITIVES = {"int32": "i", "uint32": "I", "float64": "d"}
_HEADER = b"\x00\x01\x00\x00"


@dataclass(frozen=True)
class Field:
    """``array``: None for one value, 0 for a sequence, n for n values."""

    name: str
    kind: str
    array: int | None


@cache
def fields(kind: str) -> tuple[Field, ...]:
    """The fields of a type (``geometry_msgs/Pose``)."""
    if kind not in DEFINITIONS:
        raise unknown_name("message type", kind, DEFINITIONS)
    out = []
    for line in DEFINITIONS[kind].splitlines():
        type_name, name = line.split()[:2]
        base, bracket, count = type_name.partition("[")
        out.append(Field(name, base, int(count.rstrip("]") or 0) if bracket else None))
    return tuple(out)


@cache
def numbers(kind: str) -> tuple[str, ...]:
    """Names of the numbers of a type that holds nothing but single float64, else nothing."""
    names: list[str] = []
    for field in fields(kind):
        if field.array is not None or (field.kind in (*_PRIMITIVES, "string") and field.kind != "float64"):
            return ()
        inside = ("",) if field.kind == "float64" else numbers(field.kind)
        if not inside:
            return ()
        names += [f"{field.name}.{n}".rstrip(".") for n in inside]
    return tuple(names)


def full_name(kind: str) -> str:
    """``geometry_msgs/msg/Pose`` for ``geometry_msgs/Pose``: how ROS 2 names it."""
    package, name = kind.split("/")
    return f"{package}/msg/{name}"


def schema(kind: str) -> str:
    """The definition with those of all types that it needs, as MCAP files hold it (encoding ``ros2msg``)."""
    needed: dict[str, None] = {}

    def collect(name: str) -> None:
        for field in fields(name):
            if field.kind in DEFINITIONS and field.kind not in needed:
                needed[field.kind] = None
                collect(field.kind)

    collect(kind)
    rule = "=" * 80
    return "\n".join([DEFINITIONS[kind], *(f"{rule}\nMSG: {name}\n{DEFINITIONS[name]}" for name in needed)]) + "\n"


# ---------------------------------------------------------------------- to bytes
def encode(kind: str, message: Message) -> bytes:
    """CDR bytes of a message. Raises :class:`InputError` naming a field that is missing or has the wrong length."""
    out = bytearray()
    _write(out, kind, message, kind)
    return _HEADER + bytes(out)


def _align(out: bytearray, size: int) -> None:
    out.extend(b"\0" * (-len(out) % size))


def _write(out: bytearray, kind: str, message: Message, where: str) -> None:
    names = numbers(kind)
    if names:
        _write_numbers(out, message, len(names), where)
        return
    for field in fields(kind):
        place = f"{where}.{field.name}"
        if not isinstance(message, Mapping) or field.name not in message:
            raise InputError(f"message: {place} is missing")
        value = message[field.name]
        if field.array is None:
            _write_value(out, field.kind, value, place)
            continue
        if field.array == 0:
            _write_value(out, "uint32", len(value), place)
        elif len(value) != field.array:
            raise InputError(f"message: {place} needs {field.array} values, got {len(value)}")
        if field.kind == "float64":
            _write_numbers(out, value, len(value), place)
        else:
            for one in value:
                _write_value(out, field.kind, one, place)


def _write_numbers(out: bytearray, values: Any, count: int, where: str) -> None:
    array = np.asarray(values, "<f8")
    if array.size != count:
        raise InputError(f"message: {where} needs {count} numbers, got {array.size}")
    if count:
        _align(out, 8)
        out.extend(array.tobytes())


def _write_value(out: bytearray, kind: str, value: Any, where: str) -> None:
    if kind == "string":
        text = value.encode() + b"\0"
        _align(out, 4)
        out.extend(struct.pack("<I", len(text)) + text)
    elif kind in _PRIMITIVES:
        code = _PRIMITIVES[kind]
        _align(out, struct.calcsize(code))
        out.extend(struct.pack(f"<{code}", value))
    else:
        _write(out, kind, value, where)


# ---------------------------------------------------------------------- from bytes
def decode(kind: str, data: bytes) -> Any:
    """The message in CDR bytes; sequences of float64 as arrays, types of float64 alone as one vector."""
    if data[:4] != _HEADER:
        raise InputError(f"message: only plain little-endian CDR can be read, got header {data[:4].hex()}")
    return _read(data, 4, kind)[0]


def _read(data: bytes, at: int, kind: str) -> tuple[Any, int]:
    names = numbers(kind)
    if names:
        values, at = _read_numbers(data, at, len(names))
        return (float(values[0]) if kind == "std_msgs/Float64" else values), at
    out: dict[str, Any] = {}
    for field in fields(kind):
        if field.array is None:
            out[field.name], at = _read_value(data, at, field.kind)
            continue
        count = field.array
        if count == 0:
            count, at = _read_value(data, at, "uint32")
        if field.kind == "float64":
            out[field.name], at = _read_numbers(data, at, count)
        else:
            several = []
            for _ in range(count):
                one, at = _read_value(data, at, field.kind)
                several.append(one)
            out[field.name] = several
    return out, at


def _aligned(at: int, size: int) -> int:
    return at + (4 - at) % size


def _read_numbers(data: bytes, at: int, count: int) -> tuple[np.ndarray, int]:
    if count == 0:
        return np.zeros(0), at
    at = _aligned(at, 8)
    return np.frombuffer(data, "<f8", count, at).astype(float), at + 8 * count


def _read_value(data: bytes, at: int, kind: str) -> tuple[Any, int]:
    if kind == "string":
        at = _aligned(at, 4)
        (length,) = struct.unpack_from("<I", data, at)
        return data[at + 4 : at + 3 + length].decode(), at + 4 + length
    if kind in _PRIMITIVES:
        code = _PRIMITIVES[kind]
        at = _aligned(at, struct.calcsize(code))
        return struct.unpack_from(f"<{code}", data, at)[0], at + struct.calcsize(code)
    return _read(data, at, kind)
