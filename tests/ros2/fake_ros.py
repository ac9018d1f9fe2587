"""A stand-in for rclpy and rosidl, as far as the back end uses them: messages with typed fields as rosidl generates them, a node
whose publishers hand messages to the subscriptions of the same process. It shows that the back end's own code is right, not
that ROS is."""

from __future__ import annotations

import array
import sys
import types
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from wbmpc.ros2.messages import types as known_types

_BYTES = {"octet", "byte"}
_CODES = {"float64": "d", "float32": "f", "uint8": "B", "int8": "b", "int32": "i", "uint32": "I", "octet": "B"}


def message_class(kind: str) -> type:
    """A class like rosidl's: every field with its default; a wrong Python type is an AssertionError, as in ROS."""
    fields = known_types("jazzy").store.fielddefs[kind][1]

    def default(form: Any) -> Any:
        node, detail = form
        if node == Nodetype.NAME:
            return message_class(detail)()
        if node == Nodetype.BASE:
            if detail[0] in _BYTES:
                return b"\0"
            return {"string": "", "bool": False}.get(detail[0], 0.0 if detail[0].startswith("float") else 0)
        (inner, name), size = detail
        if node == Nodetype.ARRAY:
            return np.zeros(size)
        return [] if inner == Nodetype.NAME or name[0] == "string" else array.array(_CODES[name[0]])

    def declared(form: Any) -> str:
        node, detail = form
        if node == Nodetype.NAME:
            return detail.replace("/msg/", "/")
        if node == Nodetype.BASE:
            return str(detail[0])
        (inner, name), size = detail
        part = name.replace("/msg/", "/") if inner == Nodetype.NAME else name[0]
        return f"{part}[{size}]" if node == Nodetype.ARRAY else f"sequence<{part}>"

    forms = dict(fields)

    class Message:
        def __init__(self) -> None:
            for name, form in forms.items():
                object.__setattr__(self, name, default(form))

        @classmethod
        def get_fields_and_field_types(cls) -> dict[str, str]:
            return {name: declared(form) for name, form in forms.items()}

        def __setattr__(self, name: str, value: Any) -> None:
            present = getattr(self, name)
            if isinstance(present, array.array):
                value = array.array(present.typecode, value)
            assert type(value) is type(present), f"{kind}.{name}: {type(value)} in place of {type(present)}"
            object.__setattr__(self, name, value)

    Message.__name__ = kind
    return Message


class FakeNode:
    """All nodes of the process are on one bus."""

    bus: ClassVar[list[tuple[str, type, Callable[[Any], None]]]] = []

    def __init__(self, name: str) -> None:
        self.name = name
        self.profiles: list[Any] = []
        self.services: dict[str, Callable[[Any, Any], Any]] = {}

    def create_publisher(self, kind: type, topic: str, profile: Any, event_callbacks: Any = None) -> Any:
        self.profiles.append(profile)
        self.events = event_callbacks
        send = lambda message: [call(message) for t, _, call in FakeNode.bus if t == topic]
        return types.SimpleNamespace(publish=send)

    def create_subscription(
        self, kind: type, topic: str, callback: Any, profile: Any, event_callbacks: Any = None
    ) -> None:
        FakeNode.bus.append((topic, kind, callback))

    def create_service(self, kind: type, name: str, call: Any) -> None:
        self.services[name] = call

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        profile = types.SimpleNamespace(reliability="BEST_EFFORT", durability="VOLATILE", depth=5)
        info = {"topic_type": "std_msgs/msg/String", "node_namespace": "/", "qos_profile": profile}
        return [types.SimpleNamespace(node_name=n, **info) for n in (self.name, "somebody")]

    get_subscriptions_info_by_topic = get_publishers_info_by_topic

    def destroy_node(self) -> None: ...


def install(patch: pytest.MonkeyPatch) -> list[FakeNode]:
    """Make ``import rclpy`` give the stand-in; returns the nodes that will be made."""
    made: list[FakeNode] = []
    name_of = lambda *names: {n: n for n in names}
    record = lambda **values: types.SimpleNamespace(**values)

    def create_node(name: str, context: Any) -> FakeNode:
        made.append(FakeNode(name))
        return made[-1]

    executor = lambda context: record(add_node=lambda node: None, spin=lambda: None, shutdown=lambda: None)
    modules = {
        "rclpy": {"Context": object, "init": lambda context: None, "create_node": create_node, "shutdown": lambda context: None},
        "rclpy.executors": {"ExternalShutdownException": KeyError, "SingleThreadedExecutor": executor},
        "rclpy.qos": {
            "DurabilityPolicy": record(**name_of("TRANSIENT_LOCAL", "VOLATILE")),
            "HistoryPolicy": record(**name_of("KEEP_LAST")), "QoSProfile": record,
            "ReliabilityPolicy": record(**name_of("RELIABLE", "BEST_EFFORT")),
        },
        "rclpy.event_handler": {"PublisherEventCallbacks": record, "SubscriptionEventCallbacks": record},
        "rosidl_runtime_py": {},
        "rosidl_runtime_py.utilities": {"get_message": message_class, "get_service": lambda kind: kind},
    }  # fmt: skip
    for name, content in modules.items():
        module = types.ModuleType(name)
        module.__dict__.update(content)
        module.__spec__ = types.SimpleNamespace(name=name)  # type: ignore[assignment]
        patch.setitem(sys.modules, name, module)
    patch.delitem(sys.modules, "wbmpc.ros2.ros", raising=False)
    FakeNode.bus = []
    return made
