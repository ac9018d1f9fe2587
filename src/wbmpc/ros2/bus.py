"""What a ROS 2 node is for the rest of this package, whichever back end it has."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from wbmpc.errors import InputError
from wbmpc.ros2.parameters import Parameters

BACK_ENDS = ("auto", "rclpy", "dds")
#: Characters of a name of a topic: with the prefix of its kind DDS takes 255.
LONGEST_NAME = 247
#: Of a node: the topics of its parameters' services, which begin with it, are names too.
LONGEST_NODE_NAME = 200


@dataclass(frozen=True)
class Qos:
    """Quality of service: ``reliable`` or best effort; ``latched``: late joiners get the last ``depth`` messages too."""

    reliable: bool = True
    latched: bool = False
    depth: int = 10

    def incompatible(self, offered: Qos) -> str:
        """Why a subscription with this does not match a publisher that offers that; empty if it does."""
        parts = []
        if self.reliable and not offered.reliable:
            parts.append("it offers best effort, reliable is asked for")
        if self.latched and not offered.latched:
            parts.append("it offers volatile, transient local is asked for")
        return " and ".join(parts)


#: Reliable for commands and goals. For sensors best effort is asked for, which matches every publisher.
DEFAULT, SENSOR, LATCHED = Qos(), Qos(reliable=False, depth=5), Qos(latched=True, depth=1)

#: Bytes of a message at most: of any subscription, of one that was made no larger, and of a path of all points that it may have.
LARGEST, SMALL, LONG = 2**26, 2**16, 2**22


@dataclass(frozen=True)
class Endpoint:
    """A publisher or a subscription of a node; ``own``: this node. ``type`` as in ``sensor_msgs/msg/JointState``;
    ``who``: what the back end knows its node by, see :meth:`Node.owner`; ``node``: equal for endpoints of one node."""

    topic: str
    type: str
    qos: Qos
    own: bool
    who: Any = field(default=None, compare=False)
    node: Any = field(default=None, compare=False)


def nothing(reason: str) -> dict[str, Any]:
    """An answer whose fields are as their type begins: what a service without a field for reasons says to a request that is wrong."""
    return {}


class Publisher(Protocol):
    """Sends messages of one topic."""

    def publish(self, values: Mapping[str, Any]) -> None:
        """A message from a nested mapping; what is not given is zero or empty."""
        ...


class Node(Protocol):
    """A node. Callbacks come from a thread of the back end, one at a time, so they must be short; those of ``deferred``
    subscriptions from :meth:`work`, and so the answers of ``deferred`` services (rclpy answers in its own thread). Messages have
    attributes as in ROS. :meth:`subscribe` gives a function that ends the subscription; ``others``: types in which the node can
    take the same topic, if the back end can have both at once; messages of more than ``largest`` bytes are dropped with a log
    line before they are decoded (rclpy decodes them itself). With ``sourced`` the callback gets a second argument, what the
    message's publisher is known by (see :mod:`wbmpc.ros2.sources`). :meth:`offer` makes parameters those of the node; once.

    ``publishers``: those that have left at most ``within`` [s] ago too, where the back end knows of them (rclpy does not).
    ``owner`` of an endpoint: its node's name, empty if that is not known. ``faults``: messages about endpoints that do not
    match, as long as these are there; ``backend``: its name.
    """

    backend: str

    @property
    def faults(self) -> list[str]: ...
    def publisher(self, topic: str, kind: str, qos: Qos = DEFAULT) -> Publisher: ...
    def subscribe(
        self, topic: str, kind: str, callback: Callable[..., None], qos: Qos = DEFAULT, deferred: bool = False,
        others: tuple[str, ...] = (), largest: int = LARGEST, sourced: bool = False,
    ) -> Callable[[], None]: ...  # fmt: skip
    def work(self) -> None: ...
    def serve(
        self, service: str, kind: str, answer: Callable[[Any], Mapping[str, Any]], deferred: bool = False,
        rejected: Callable[[str], Mapping[str, Any]] = nothing, definition: tuple[str, str] | None = None,
    ) -> None: ...  # fmt: skip
    def offer(self, parameters: Parameters) -> None: ...
    def publishers(self, topic: str, within: float = 0.0) -> list[Endpoint]: ...
    def subscribers(self, topic: str) -> list[Endpoint]: ...
    def owner(self, endpoint: Endpoint) -> str: ...
    def close(self) -> None: ...


def name_fault(name: str) -> str:
    """What is wrong with the name of a topic or a service, as ROS has them (REP 144 and the design article on names); empty if
    nothing is."""
    if not re.fullmatch(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*", name):
        return "is made of letters, digits, _ and /, and no part begins with a digit"
    if "__" in name:
        return "has no two _ in a row"
    return f"has at most {LONGEST_NAME} characters" if len(name) > LONGEST_NAME else ""


def full_name(name: str) -> str:
    """A name from the root; this bridge has no namespaces but those that are written out. Raises :class:`InputError` for what is
    no name of a topic or a service."""
    fault = name_fault(name)
    if fault:
        raise InputError(f"topic or service {name!r}: such a name {fault}")
    return name if name.startswith("/") else f"/{name}"
