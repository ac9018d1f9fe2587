"""ROS 2 messages as bytes and back, without ROS: the definitions that recordings use, and their CDR encoding.

A message is a dictionary by field. A type that holds nothing but float64 (Pose, Vector3, Wrench …) is one flat vector of
its numbers in the order of its definition: a Pose is x, y, z, qx, qy, qz, qw. The bus (``wbmpc.ros2``) encodes with this
module too, by ROS 2's own definitions, and may leave fields out.

Sources: the interfaces of ROS 2 (common_interfaces, geometry2); OMG DDS-XTypes 1.3, section 7.4.1 (plain CDR, little
endian; every primitive is aligned to its size, counted from the end of the 4-byte header).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
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
_PRIMITIVES = {
    "bool": "?", "octet": "B", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_SIZES = {kind: struct.calcsize(code) for kind, code in _PRIMITIVES.items()}
_HEADER = b"\x00\x01\x00\x00"


@dataclass(frozen=True)
class Field:
    """``array``: None for one value, 0 for a sequence, n for n values."""

    name: str
    kind: str
    array: int | None


#: Fields of a type by its name.
Lookup = Callable[[str], tuple[Field, ...]]


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
def encode(
    kind: str, message: Message, lookup: Lookup = fields, missing: Mapping[str, Mapping[str, Any]] | None = None
) -> bytes:
    """CDR bytes of a message. Raises :class:`InputError` naming a field that is missing, unknown or has the wrong length.

    ``look``: fields of types by name. ``missing``: fields may be left out; they are zero or empty, or what this says by type.
    """
    out = bytearray()
    _Writer(out, lookup, missing).write(kind, message, kind)
    return _HEADER + bytes(out)


class _Writer:
    """Appends to ``out``."""

    def __init__(self, out: bytearray, lookup: Lookup, missing: Mapping[str, Mapping[str, Any]] | None) -> None:
        self.out, self.lookup, self.missing = out, lookup, missing

    def write(self, kind: str, message: Any, where: str) -> None:
        if not isinstance(message, Mapping):
            count = len(numbers(kind)) if self.lookup is fields else 0
            if not count:
                raise InputError(f"message: {where} is missing")
            self._numbers(message, count, where)
            return
        left = len(message)
        for field in self.lookup(kind):
            place = f"{where}.{field.name}"
            if field.name in message:
                left -= 1
                self._field(field, message[field.name], place)
            elif self.missing is None:
                raise InputError(f"message: {place} is missing")
            else:
                self._field(field, self.missing.get(kind, {}).get(field.name), place)
        if left:
            known = [f.name for f in self.lookup(kind)]
            raise unknown_name(f"field of {kind}", next(k for k in message if k not in known), known)

    def _field(self, field: Field, value: Any, place: str) -> None:
        if field.array is None:
            self._value(field.kind, value, place)
            return
        if value is None:
            value = [None] * field.array
        if not hasattr(value, "__len__"):
            raise InputError(f"message: {place} cannot be {value!r} (several values are needed)")
        if field.array == 0:
            self._value("uint32", len(value), place)
        elif len(value) != field.array:
            raise InputError(f"message: {place} needs {field.array} values, got {len(value)}")
        if field.kind in _PRIMITIVES:
            self._array(field.kind, value, place)
            return
        for one in value:
            self._value(field.kind, one, place)

    def _array(self, kind: str, values: Any, place: str) -> None:
        if len(values) == 0:
            return
        if values[0] is None:
            values = np.zeros(len(values))
        code = _PRIMITIVES[kind]
        array = _array(values, f"<{code}" if code != "?" else "?", place)
        if array.ndim != 1:
            raise InputError(f"message: {place} needs plain {kind} numbers, got shape {array.shape}")
        self._align(array.itemsize)
        self.out.extend(array.tobytes())

    def _numbers(self, values: Any, count: int, where: str) -> None:
        array = _array(values, "<f8", where)
        if array.size != count:
            raise InputError(f"message: {where} needs {count} numbers, got {array.size}")
        self._align(8)
        self.out.extend(array.tobytes())

    def _value(self, kind: str, value: Any, where: str) -> None:
        if kind == "string":
            try:
                text = ("" if value is None else value).encode() + b"\0"
            except (AttributeError, UnicodeEncodeError) as error:
                raise InputError(f"message: {where} cannot be {value!r} (a text is needed)") from error
            self._align(4)
            self.out.extend(struct.pack("<I", len(text)) + text)
        elif kind in _PRIMITIVES:
            code = _PRIMITIVES[kind]
            self._align(_SIZES[kind])
            try:
                self.out.extend(struct.pack(f"<{code}", 0 if value is None else value))
            except struct.error as error:
                raise InputError(f"message: {where} cannot be {value!r} ({error})") from error
        else:
            self.write(kind, {} if value is None else value, where)

    def _align(self, size: int) -> None:
        self.out.extend(b"\0" * (-len(self.out) % size))


def _array(values: Any, kind: str, where: str) -> np.ndarray:
    try:
        return np.asarray(values, kind)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"message: {where} cannot be {str(values)[:80]} ({error})") from error


# ---------------------------------------------------------------------- from bytes
#: Bytes that may follow a message: some middleware fills up to a multiple of 4 or 8.
PADDING = 7


def decode(kind: str, data: bytes, where: str = "message") -> Any:
    """The message in CDR bytes; sequences of float64 as arrays, types of float64 alone as one vector.

    Raises :class:`InputError` that begins with ``where`` if they are not a whole message of this type.
    """
    if data[:4] != _HEADER:
        raise InputError(f"{where}: only plain little-endian CDR can be read, got header {data[:4].hex()}")
    try:
        message, end = _read(data, 4, kind)
    except (struct.error, ValueError, OverflowError, MemoryError) as error:
        raise InputError(f"{where}: {len(data)} bytes are no {kind}: {error}") from error
    if len(data) - end > PADDING:
        raise InputError(f"{where}: {len(data)} bytes are no {kind}: {len(data) - end} are left over")
    return message


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
        text = data[at + 4 : at + 4 + length]
        if len(text) < length or text[-1:] not in (b"", b"\0"):
            raise ValueError(f"a text of {length} bytes does not end where it says")
        return text[:-1].decode(), at + 4 + length
    if kind in _PRIMITIVES:
        code = _PRIMITIVES[kind]
        at = _aligned(at, struct.calcsize(code))
        return struct.unpack_from(f"<{code}", data, at)[0], at + struct.calcsize(code)
    return _read(data, at, kind)
