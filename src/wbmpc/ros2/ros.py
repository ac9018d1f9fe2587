"""The node by rclpy, for machines on which ROS 2 is installed and sourced; any RMW."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind

from wbmpc.logs import RateLimit
from wbmpc.ros2.bus import DEFAULT, LARGEST, Endpoint, Qos, full_name, nothing
from wbmpc.ros2.convert import error_message
from wbmpc.ros2.deferred import Deferred, most
from wbmpc.ros2.mismatch import Mismatches, OwnEndpoint
from wbmpc.ros2.parameters import Parameters, descriptor_of
from wbmpc.ros2.sources import AMBIGUOUS, Source

try:
    from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
except ImportError:  # Humble
    from rclpy.qos_event import PublisherEventCallbacks, SubscriptionEventCallbacks
try:
    from rosidl_runtime_py.utilities import get_message, get_service
except ModuleNotFoundError:  # rclpy does not need it

    def get_message(identifier: str) -> Any:
        """The class of a type such as sensor_msgs/msg/JointState."""
        package, folder, name = identifier.split("/")
        return getattr(import_module(f"{package}.{folder}"), name)

    get_service = get_message

_LOG = logging.getLogger("wbmpc")
#: How often [s] the publishers of a topic are checked whose number does not change.
_LOOK = 0.5


class RosNode:
    """See :class:`wbmpc.ros2.bus.Node`. It has a context and an executor of its own, so that several live in one process."""

    backend = "rclpy"

    def __init__(self, name: str) -> None:
        self.name = name
        self._mismatches, self._limit = Mismatches(self), RateLimit()
        self._deferred = Deferred()
        self._made: Counter[tuple[str, str]] = Counter()  # publishers and subscriptions of this node by topic
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node(name, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return

    @property
    def faults(self) -> list[str]:
        """Messages about endpoints that do not match."""
        return self._mismatches.messages()

    def publisher(self, topic: str, kind: str, qos: Qos = DEFAULT) -> RosPublisher:
        name, message = full_name(topic), get_message(kind)
        self._made["publisher", name] += 1
        ours = OwnEndpoint("publisher", name, kind, qos)
        events = PublisherEventCallbacks(incompatible_qos=lambda e: self._mismatch(ours, e))
        return RosPublisher(self._node.create_publisher(message, name, _profile(qos), event_callbacks=events), message)

    def subscribe(
        self, topic: str, kind: str, callback: Callable[..., None], qos: Qos = DEFAULT, deferred: bool = False,
        others: tuple[str, ...] = (), largest: int = LARGEST, sourced: bool = False,
    ) -> Callable[[], None]:  # fmt: skip
        """Call back for every message; ``deferred``: not before :meth:`work`. What the callback raises is logged: the bus must
        go on. Returns what ends it."""
        name = full_name(topic)
        ours = OwnEndpoint("subscription", name, kind, qos, others)
        events = SubscriptionEventCallbacks(incompatible_qos=lambda e: self._mismatch(ours, e))
        source = _Source(self._node, name, kind) if sourced else None

        def call(message: Any) -> None:
            try:
                callback(message, *([] if source is None else [source.current()]))
            except Exception as error:
                self._limit.log(_LOG, logging.ERROR, name, f"{name}: {error_message(error)}")

        later = lambda message: self._deferred.put(name, call, message, most=most(qos))
        taken = later if deferred else call
        made = self._node.create_subscription(get_message(kind), name, taken, _profile(qos), event_callbacks=events)
        self._made["subscription", name] += 1

        def end() -> None:
            self._made["subscription", name] -= 1
            self._node.destroy_subscription(made)

        return end

    def work(self) -> None:
        """Call back for the messages of deferred subscriptions that have come, in this thread."""
        self._deferred.work()

    def serve(
        self, service: str, kind: str, answer: Callable[[Any], Mapping[str, Any]], deferred: bool = False,
        rejected: Callable[[str], Mapping[str, Any]] = nothing, definition: tuple[str, str] | None = None,
    ) -> None:  # fmt: skip
        """Answer a service, in the executor's thread."""
        name = full_name(service)

        def reply(request: Any, response: Any) -> Any:
            try:
                return fill(response, answer(request))
            except Exception as error:
                self._limit.log(_LOG, logging.ERROR, name, f"{name}: {error_message(error)}")
                return fill(response, rejected(error_message(error)))

        self._node.create_service(get_service(kind), name, reply)

    def offer(self, parameters: Parameters) -> None:
        """Parameters of this node, as rclpy has them."""
        for p in parameters.known.values():
            descriptor = fill(get_message("rcl_interfaces/msg/ParameterDescriptor")(), descriptor_of(p))
            if not self._node.has_parameter(p.name):  # every node of rclpy has use_sim_time
                self._node.declare_parameter(p.name, p.value, descriptor)
        result = get_message("rcl_interfaces/msg/SetParametersResult")

        def change(values: list[Any]) -> Any:
            try:
                parameters.set({p.name: p.value for p in values})
            except Exception as error:
                return fill(result(), {"successful": False, "reason": error_message(error)})
            return fill(result(), {"successful": True})

        self._node.add_on_set_parameters_callback(change)

    def publishers(self, topic: str, within: float = 0.0) -> list[Endpoint]:
        """Everybody's publishers of a topic, this node's too."""
        return self._endpoints("publisher", topic, self._node.get_publishers_info_by_topic(full_name(topic)))

    def subscribers(self, topic: str) -> list[Endpoint]:
        """Everybody's subscriptions of a topic, this node's too."""
        return self._endpoints("subscription", topic, self._node.get_subscriptions_info_by_topic(full_name(topic)))

    def owner(self, endpoint: Endpoint) -> str:
        """The name of an endpoint's node."""
        return str(endpoint.who or "")

    def _endpoints(self, side: str, topic: str, infos: list[Any]) -> list[Endpoint]:
        """Of more endpoints with this node's name than it has itself, some are another node's of the same name."""
        found, own = [], self._made[side, full_name(topic)]
        for info in infos:
            profile = info.qos_profile
            qos = Qos(
                profile.reliability != ReliabilityPolicy.BEST_EFFORT,
                profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
                int(profile.depth or 0),
            )
            mine = own > 0 and info.node_name == self.name
            own -= mine
            found.append(Endpoint(full_name(topic), info.topic_type, qos, mine, info.node_name, info.node_name))
        return found

    def close(self) -> None:
        """Leave the bus. Callbacks have ended when this returns."""
        self._mismatches.close()
        self._executor.shutdown()
        self._thread.join(5.0)
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _mismatch(self, ours: OwnEndpoint, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind).lower()
        # ROS has no name for the policy by which types differ
        self._mismatches.notice(ours, "type" if policy.startswith("invalid") else policy)


@dataclass(frozen=True)
class RosWriter:
    """See :class:`wbmpc.ros2.sources.Source`: the publisher of an identity, named only while it is the only one of its topic."""

    identity: bytes

    def gone(self) -> bool:
        """An endpoint that is named after it is alone by then."""
        return True

    def prefer(self) -> None:
        """rclpy cannot choose."""


class _Source:
    """Whose the messages of a topic are, as far as the graph says so: rclpy has no publisher's identity beside a message. One that was
    killed is in the graph until its lease ends (Fast DDS: 20 s)."""

    def __init__(self, node: Any, topic: str, kind: str) -> None:
        self._node, self._topic, self._kind = node, topic, kind
        self._count, self._due = -1, -np.inf
        self._seen: Source | None = None

    def current(self) -> Source | None:
        """The only publisher, or :data:`AMBIGUOUS`; None before one is in the graph.

        The whole list is read when its length changes, and every :data:`_LOOK`."""
        count, now = self._node.count_publishers(self._topic), time.monotonic()
        if count != self._count or now >= self._due:
            self._count, self._due = count, now + _LOOK
            infos = self._node.get_publishers_info_by_topic(self._topic)
            ids = {bytes(i.endpoint_gid) for i in infos if i.topic_type == self._kind}
            if ids:  # else it has left with its last message on the way
                self._seen = RosWriter(ids.pop()) if len(ids) == 1 else AMBIGUOUS
        return self._seen


class RosPublisher:
    """See :class:`wbmpc.ros2.bus.Publisher`."""

    def __init__(self, publisher: Any, message: type) -> None:
        self._publisher, self._message = publisher, message

    def publish(self, values: Mapping[str, Any]) -> None:
        """Send a message."""
        self._publisher.publish(fill(self._message(), values))


def fill(message: Any, values: Mapping[str, Any]) -> Any:
    """Write nested values into a message; returns it."""
    for name, value in values.items():
        present = getattr(message, name)
        if isinstance(value, Mapping):
            fill(present, value)
        elif isinstance(present, bytes):
            setattr(message, name, bytes([value]))
        elif isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping):
            kind = _part(message.get_fields_and_field_types()[name])
            setattr(message, name, [fill(kind(), v) for v in value])
        elif isinstance(present, (bool, int, float, str)):
            setattr(message, name, type(present)(value))
        elif isinstance(present, np.ndarray):
            setattr(message, name, np.asarray(value, present.dtype))
        else:
            setattr(message, name, np.asarray(value).tolist())
    return message


def _part(declared: str) -> Any:
    """The class of ``pkg/Type`` in ``sequence<pkg/Type>`` or ``pkg/Type[3]``."""
    package, name = re.sub(r"^sequence<|(, \d+)?>$|\[\d+\]$", "", declared).split("/")
    return get_message(f"{package}/msg/{name}")


def _profile(qos: Qos) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
    )
