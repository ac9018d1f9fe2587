"""A stand-in for rclpy and rosidl, as far as the back end uses them: messages with typed fields as rosidl generates them, a node
whose publishers end effector messages to the subscriptions of the same process.

Names, what is positional and what a keyword, enumerations, checks of types and exceptions are those of rclpy's sources
(github.com/ros2/rclpy, Humble to Kilted: __init__.py, node.py, qos.py, event_handler.py, executors.py, topic_endpoint_info.py).
It shows that the back end calls what there is, and that its own code is right; not that ROS is."""

from __future__ import annotations

import array
import sys
import threading
import types
from collections.abc import Callable
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from wbmpc.bases.swerve.ros_legs import DEFINITION, SET_LEGS
from wbmpc.ros2.messages import types as known_types

known_types("jazzy").define(SET_LEGS, DEFINITION)  # a ROS installation has the package

_BYTES = {"octet", "byte"}
_CODES = {"float64": "d", "float32": "f", "uint8": "B", "int8": "b", "int32": "i", "uint32": "I", "octet": "B"}

#: Defaults that definitions give.
GIVEN = {("geometry_msgs/msg/Quaternion", "w"): 1.0}


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
                object.__setattr__(self, name, GIVEN.get((kind, name), default(form)))

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


class HistoryPolicy(IntEnum):
    SYSTEM_DEFAULT, KEEP_LAST, KEEP_ALL, UNKNOWN = range(4)


class ReliabilityPolicy(IntEnum):
    SYSTEM_DEFAULT, RELIABLE, BEST_EFFORT, UNKNOWN = range(4)


class DurabilityPolicy(IntEnum):
    SYSTEM_DEFAULT, TRANSIENT_LOCAL, VOLATILE, UNKNOWN = range(4)


class QoSPolicyKind(IntEnum):
    INVALID, DURABILITY, DEADLINE, LIVELINESS, RELIABILITY = (1 << k for k in range(5))


def qos_policy_name_from_kind(policy_kind: int) -> str:
    return QoSPolicyKind(policy_kind).name


class QoSProfile:
    """The policies that ROS itself gives when they are left out are those of its default profile."""

    def __init__(self, **given: Any) -> None:
        assert given.keys() <= {"history", "depth", "reliability", "durability"}, given.keys()
        if "depth" not in given and given.get("history") != HistoryPolicy.KEEP_ALL:
            raise ValueError("Invalid QoSProfile: History set to KEEP_LAST without a depth setting.")
        self.history = HistoryPolicy(given.get("history", HistoryPolicy.KEEP_LAST))
        self.depth = given.get("depth", 10)
        assert isinstance(self.depth, int)
        self.reliability = ReliabilityPolicy(given.get("reliability", ReliabilityPolicy.RELIABLE))
        self.durability = DurabilityPolicy(given.get("durability", DurabilityPolicy.VOLATILE))


class PublisherEventCallbacks:
    def __init__(
        self,
        *,
        deadline: Any = None,
        liveliness: Any = None,
        incompatible_qos: Any = None,
        use_default_callbacks: bool = True,
    ) -> None:
        self.incompatible_qos = incompatible_qos


class SubscriptionEventCallbacks:
    def __init__(
        self, *, deadline: Any = None, incompatible_qos: Any = None, liveliness: Any = None, message_lost: Any = None,
        use_default_callbacks: bool = True,
    ) -> None:  # fmt: skip
        self.incompatible_qos = incompatible_qos


class ExternalShutdownException(Exception): ...


class Context:
    """A context is of no use before :func:`init` and after :func:`shutdown`."""

    def __init__(self) -> None:
        self._ok = False

    def ok(self) -> bool:
        return self._ok


def init(
    *,
    args: Any = None,
    context: Context | None = None,
    domain_id: int | None = None,
    signal_handler_options: Any = None,
) -> None:
    assert context is not None and not context.ok(), "Context.init() must only be called once"
    context._ok = True


def shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    assert context is not None and context.ok(), "Context must be initialized before it can be shutdown"
    context._ok = False


class SingleThreadedExecutor:
    def __init__(self, *, context: Context | None = None) -> None:
        self._context, self._nodes, self._end = context, [], threading.Event()  # type: ignore[var-annotated]

    def add_node(self, node: FakeNode) -> bool:
        node.executor = self
        self._nodes.append(node)
        return True

    def spin(self) -> None:
        """Until it is shut down; a context that is shut down first raises."""
        assert self._context is not None
        while not self._end.wait(0.01):
            if not self._context.ok():
                raise ExternalShutdownException

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        self._end.set()
        return True


class FakeNode:
    """All nodes of the process are on one bus."""

    bus: ClassVar[list[tuple[str, type, Callable[[Any], None]]]] = []

    def __init__(self, node_name: str, *, context: Context | None = None, namespace: str | None = None) -> None:
        assert context is not None and context.ok(), "cannot create node"
        self.name, self.context, self.destroyed = node_name, context, False
        self.executor: SingleThreadedExecutor | None = None
        self.profiles: list[Any] = []
        self.topics: list[tuple[str, str, str, Any]] = []  # side, topic, name of the node, profile
        self.services: dict[str, Callable[[Any, Any], Any]] = {}
        self.parameters: dict[str, Any] = {}

    def create_publisher(
        self, msg_type: type, topic: str, qos_profile: QoSProfile | int, *, callback_group: Any = None,
        event_callbacks: PublisherEventCallbacks | None = None, qos_overriding_options: Any = None,
    ) -> Any:  # fmt: skip
        assert isinstance(qos_profile, QoSProfile) and isinstance(event_callbacks, PublisherEventCallbacks)
        self.profiles.append(qos_profile)
        self.topics.append(("publisher", topic, self.name, qos_profile))
        self.events = event_callbacks

        def publish(msg: Any) -> None:
            assert isinstance(msg, msg_type), f"Expected {msg_type}, got {type(msg)}"
            for t, kind, call in FakeNode.bus:
                if t == topic:
                    assert kind is msg_type
                    call(msg)

        return types.SimpleNamespace(publish=publish)

    def create_subscription(
        self, msg_type: type, topic: str, callback: Any, qos_profile: QoSProfile | int, *, callback_group: Any = None,
        event_callbacks: SubscriptionEventCallbacks | None = None, qos_overriding_options: Any = None, raw: bool = False,
    ) -> Any:  # fmt: skip
        assert isinstance(qos_profile, QoSProfile) and isinstance(event_callbacks, SubscriptionEventCallbacks)
        self.topics.append(("subscription", topic, self.name, qos_profile))
        FakeNode.bus.append((topic, msg_type, callback))
        return FakeNode.bus[-1]

    def destroy_subscription(self, subscription: Any) -> bool:
        FakeNode.bus.remove(subscription)
        self.topics.remove(next(t for t in self.topics if t[:2] == ("subscription", subscription[0])))
        return True

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Any, *, qos_profile: Any = None, callback_group: Any = None
    ) -> None:
        self.services[srv_name] = callback

    def has_parameter(self, name: str) -> bool:
        return name == "use_sim_time" or name in self.parameters

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: Any = None, ignore_override: bool = False
    ) -> None:
        assert name not in self.parameters and type(descriptor).__name__ == "rcl_interfaces/msg/ParameterDescriptor"
        self.parameters[name] = value, descriptor

    def add_on_set_parameters_callback(self, callback: Any) -> None:
        self.on_set = callback

    def get_publishers_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[Any]:
        return self._info("publisher", topic_name)

    def get_subscriptions_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[Any]:
        return self._info("subscription", topic_name)

    def count_publishers(self, topic_name: str) -> int:
        return len(self._info("publisher", topic_name))

    def _info(self, side: str, topic: str) -> list[Any]:
        """As TopicEndpointInfo: depth and history are not known of other processes' endpoints (rmw says 0, UNKNOWN)."""
        known = {"topic_type": "std_msgs/msg/String", "node_namespace": "/"}
        return [
            types.SimpleNamespace(node_name=name, qos_profile=profile, endpoint_gid=[*name.encode()], **known)
            for s, t, name, profile in self.topics
            if (s, t) == (side, topic)
        ]

    def destroy_node(self) -> None:
        assert self.executor is not None and self.executor._end.is_set(), "the executor still spins"
        self.destroyed = True


def install(patch: pytest.MonkeyPatch) -> list[FakeNode]:
    """Make ``import rclpy`` give the stand-in; returns the nodes that will be made."""
    made: list[FakeNode] = []
    classes: dict[str, type] = {}

    def create_node(node_name: str, *, context: Context | None = None, namespace: str | None = None) -> FakeNode:
        made.append(FakeNode(node_name, context=context, namespace=namespace))
        return made[-1]

    def get_message(identifier: str) -> type:
        return classes.setdefault(identifier, message_class(identifier))

    modules: dict[str, dict[str, Any]] = {
        "rclpy": {"Context": Context, "init": init, "create_node": create_node, "shutdown": shutdown},
        "rclpy.executors": {
            "ExternalShutdownException": ExternalShutdownException, "SingleThreadedExecutor": SingleThreadedExecutor
        },
        "rclpy.qos": {
            "DurabilityPolicy": DurabilityPolicy, "HistoryPolicy": HistoryPolicy, "QoSProfile": QoSProfile,
            "ReliabilityPolicy": ReliabilityPolicy, "qos_policy_name_from_kind": qos_policy_name_from_kind,
        },
        "rclpy.event_handler": {
            "PublisherEventCallbacks": PublisherEventCallbacks, "SubscriptionEventCallbacks": SubscriptionEventCallbacks
        },
        "rosidl_runtime_py": {},
        "rosidl_runtime_py.utilities": {"get_message": get_message, "get_service": lambda identifier: identifier},
    }  # fmt: skip
    for name, content in modules.items():
        module = types.ModuleType(name)
        module.__dict__.update(content)
        module.__spec__ = types.SimpleNamespace(name=name)  # type: ignore[assignment]
        patch.setitem(sys.modules, name, module)
    patch.delitem(sys.modules, "wbmpc.ros2.ros", raising=False)
    FakeNode.bus = []
    return made
