"""ROS 2 messages without ROS: definitions, type hashes and reading from rosbags; written by the recordings' encoder."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from wbmpc.errors import InputError, unknown_name
from wbmpc.recording.messages import Field, encode

_EMPTY = "uint8 structure_needs_at_least_one_member\n"
_RESULT = "bool success\nstring message\n"
#: Services have no definitions in rosbags.
SERVICES = {
    "std_srvs/srv/Trigger": (_EMPTY, _RESULT),
    "std_srvs/srv/SetBool": ("bool data\n", _RESULT),
    # of a node's parameters (rcl_interfaces)
    "rcl_interfaces/srv/GetParameters": ("string[] names\n", "rcl_interfaces/ParameterValue[] values\n"),
    "rcl_interfaces/srv/GetParameterTypes": ("string[] names\n", "uint8[] types\n"),
    "rcl_interfaces/srv/SetParameters": (
        "rcl_interfaces/Parameter[] parameters\n", "rcl_interfaces/SetParametersResult[] results\n",
    ),
    "rcl_interfaces/srv/SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters\n", "rcl_interfaces/SetParametersResult result\n",
    ),
    "rcl_interfaces/srv/ListParameters": (
        "string[] prefixes\nuint64 depth\n", "rcl_interfaces/ListParametersResult result\n",
    ),
    "rcl_interfaces/srv/DescribeParameters": (
        "string[] names\n", "rcl_interfaces/ParameterDescriptor[] descriptors\n",
    ),
}  # fmt: skip
#: Of packages that rosbags does not have (vision_msgs as of Humble).
MESSAGES = {
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}
#: What is not zero or empty when it is not given.
DEFAULTS: dict[str, dict[str, Any]] = {"geometry_msgs/msg/Quaternion": {"w": 1.0}}


@cache
def types(distribution: str) -> Types:
    """The definitions of a distribution, loaded once."""
    return Types(distribution)


class Types:
    """All message types of a ROS 2 ``distribution`` and the services of :data:`SERVICES`."""

    def __init__(self, distribution: str) -> None:
        self._known: dict[str, tuple[Field, ...]] = {}
        self.store = get_typestore(getattr(Stores, f"ROS2_{distribution.upper()}"))
        for name, text in MESSAGES.items():
            self.store.register(get_types_from_msg(text, name))
        for name, parts in SERVICES.items():
            self.define(name, parts)

    def define(self, service: str, parts: tuple[str, str]) -> None:
        """Take in the ``service`` of a package that is not known here: definitions of request and response."""
        for half, text in zip((request(service), response(service)), parts, strict=True):
            (fields,) = get_types_from_msg(text, half).values()
            self.store.register({half: fields})

    def check(self, kind: str) -> None:
        """Raise :class:`InputError` if there is no such type."""
        if kind not in self.store.fielddefs:
            package = kind.split("/")[0]
            known = sorted(self.store.fielddefs)
            raise unknown_name("message type", kind, [k for k in known if k.split("/")[0] == package] or known)

    def encode(self, kind: str, values: Mapping[str, Any]) -> bytes:
        """CDR with its four bytes of header, of a nested mapping; what is not given is zero or empty, or as in
        :data:`DEFAULTS`. Raises :class:`InputError` for a key that does not exist."""
        self.check(kind)
        return encode(kind, values, self._fields, DEFAULTS)

    def _fields(self, kind: str) -> tuple[Field, ...]:
        """ROS 2's own definition of a type."""
        known = self._known.get(kind)
        if known is None:
            known = tuple(_field(name, form) for name, form in self.store.fielddefs[kind][1])
            self._known[kind] = known
        return known

    def decode(self, kind: str, data: bytes) -> Any:
        """The message of some CDR. Raises :class:`InputError` for what is none of this type."""
        try:
            return self.store.deserialize_cdr(data, kind)
        except Exception as error:
            raise InputError(f"{kind}: {error}") from error

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


def _field(name: str, form: Any) -> Field:
    node, detail = form
    if node in (Nodetype.NAME, Nodetype.BASE):
        return Field(name, detail if node == Nodetype.NAME else detail[0], None)
    (inner, kind), size = detail
    return Field(name, kind if inner == Nodetype.NAME else kind[0], int(size) if node == Nodetype.ARRAY else 0)
