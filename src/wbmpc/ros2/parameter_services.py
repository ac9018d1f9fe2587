"""The services of rcl_interfaces that offer a node's parameters, for a back end that has none."""

from __future__ import annotations

import time
from typing import Any

from wbmpc.errors import InputError
from wbmpc.ros2.bus import Node, Qos, nothing
from wbmpc.ros2.convert import error_message, stamp
from wbmpc.ros2.parameters import Parameters, Value, descriptor_of, message_of, value_of

#: More than any node here has.
MAX_ASKED = 200
#: As of ROS 2's own publishers of parameter events.
_EVENTS = Qos(depth=1000)


def _few(asked: list[Any]) -> list[Any]:
    """What a request asks for. Raises :class:`InputError` if that is too much at once."""
    if len(asked) > MAX_ASKED:
        raise InputError(f"a request for {len(asked)} parameters at once; valid: at most {MAX_ASKED}")
    return asked


def _failed(reason: str) -> dict[str, Any]:
    """A rcl_interfaces/msg/SetParametersResult."""
    return {"successful": False, "reason": reason}


class ParameterServices:
    """The services of rcl_interfaces for a node that has none, and /parameter_events."""

    def __init__(self, node: Node, name: str, parameters: Parameters) -> None:
        self.parameters, self.name = parameters, f"/{name}"
        self._events = node.publisher("/parameter_events", "rcl_interfaces/msg/ParameterEvent", _EVENTS)
        self._publish_event("new_parameters", list(parameters.known))
        for service, kind, answer, rejected in (
            ("get_parameters", "GetParameters", self._get, nothing),
            ("get_parameter_types", "GetParameterTypes", self._types, nothing),
            ("set_parameters", "SetParameters", self._set, lambda why: {"results": [_failed(why)]}),
            (
                "set_parameters_atomically",
                "SetParametersAtomically",
                self._set_all,
                lambda why: {"result": _failed(why)},
            ),
            ("list_parameters", "ListParameters", self._list, nothing),
            ("describe_parameters", "DescribeParameters", self._describe, nothing),
        ):
            # in the node's own thread: a flood of requests does not delay the robot's states
            node.serve(f"{self.name}/{service}", f"rcl_interfaces/srv/{kind}", answer, deferred=True, rejected=rejected)

    def _value(self, name: str) -> Value | None:
        p = self.parameters.known.get(name)
        return None if p is None else p.value

    def _get(self, request: Any) -> dict[str, Any]:
        return {"values": [message_of(self._value(n)) for n in _few(request.names)]}

    def _types(self, request: Any) -> dict[str, Any]:
        return {"types": [message_of(self._value(n))["type"] for n in _few(request.names)]}

    def _describe(self, request: Any) -> dict[str, Any]:
        known = self.parameters.known
        return {"descriptors": [descriptor_of(known[n]) if n in known else {"name": n} for n in _few(request.names)]}

    def _list(self, request: Any) -> dict[str, Any]:
        names = self.parameters.names(_few(request.prefixes), int(request.depth))
        prefixes = sorted({n.rpartition(".")[0] for n in names} - {""})
        return {"result": {"names": names, "prefixes": prefixes}}

    def _set(self, request: Any) -> dict[str, Any]:
        return {"results": [self._change({p.name: value_of(p.value)}) for p in _few(request.parameters)]}

    def _set_all(self, request: Any) -> dict[str, Any]:
        return {"result": self._change({p.name: value_of(p.value) for p in _few(request.parameters)})}

    def _change(self, values: dict[str, Any]) -> dict[str, Any]:
        try:
            self.parameters.set(values)
        except Exception as error:
            return _failed(error_message(error))
        self._publish_event("changed_parameters", list(values))
        return {"successful": True}

    def _publish_event(self, what: str, names: list[str]) -> None:
        changed = [{"name": n, "value": message_of(self._value(n))} for n in names]
        self._events.publish({"stamp": stamp(time.time()), "node": self.name, what: changed})
