"""Parameters of a node: names and values as in the settings file, those that can be changed and those that cannot.

The back ends offer them: ``rclpy`` by the node's own parameters, ``dds`` by :mod:`wbmpc.ros2.parameter_services`.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from wbmpc.errors import InputError, unknown_name

Value = bool | int | float | str
#: Numbers and fields of the types of rcl_interfaces/msg/ParameterType that are used here; 0 is "not set".
TYPES: dict[type, tuple[int, str]] = {
    bool: (1, "bool_value"), int: (2, "integer_value"), float: (3, "double_value"), str: (4, "string_value"),
}  # fmt: skip
_READ = {number: field for number, field in TYPES.values()}
#: The other types: no parameter here has them.
_ARRAYS = {5: "bytes", 6: "bools", 7: "integers", 8: "doubles", 9: "strings"}


@dataclass
class Parameter:
    """``range``: least and largest number; ``read_only``: it is set in the file only."""

    name: str
    value: Value
    description: str = ""
    read_only: bool = True
    range: tuple[float, float] | None = None


class Parameters:
    """All of a node, by name. ``changed`` gets the new values of settable ones, all of a request at once, and may raise
    :class:`InputError`: then nothing has changed. Thread-safe."""

    def __init__(self, parameters: Iterable[Parameter], changed: Callable[[dict[str, Value]], None]) -> None:
        self.known = {p.name: p for p in parameters}
        self._changed, self._lock = changed, threading.Lock()

    def set(self, values: Mapping[str, Any]) -> None:
        """Change all or none. Raises :class:`InputError` naming the parameter and what is valid."""
        with self._lock:
            new = {name: self._checked(name, value) for name, value in values.items()}
            self._changed(new)
            for name, value in new.items():
                self.known[name].value = value

    def _checked(self, name: str, value: Any) -> Value:
        if name not in self.known:
            raise unknown_name("parameter", name, self.known)
        p = self.known[name]
        if p.read_only:
            raise InputError(f"parameter '{name}' is read-only: set it in the settings file and restart")
        target = type(p.value)
        if target is float and type(value) is int:
            value = float(value)
        if type(value) is not target:
            raise InputError(f"parameter '{name}': {target.__name__} is needed, got {_kind(value)}")
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"parameter '{name}': a finite number is needed, got {value}")
        if p.range is not None and not p.range[0] <= float(value) <= p.range[1]:
            raise InputError(f"parameter '{name}': {value} is out of range; valid: {p.range[0]:g} to {p.range[1]:g}")
        return value  # type: ignore[no-any-return]

    def names(self, prefixes: Iterable[str], depth: int) -> list[str]:
        """Those that begin with one of some prefixes (none: all), at most ``depth`` parts below it (0: all)."""
        ends = [f"{p}." for p in prefixes]
        found = []
        for name in self.known:
            below = [name[len(e) :] for e in ends or [""] if name.startswith(e)] + [""] * (f"{name}." in ends)
            if any(depth == 0 or rest.count(".") < depth for rest in below):
                found.append(name)
        return found


def message_of(value: Value | None) -> dict[str, Any]:
    """A value as rcl_interfaces/msg/ParameterValue; None is not set."""
    if value is None:
        return {"type": 0}
    number, field = TYPES[type(value)]
    return {"type": number, field: value}


@dataclass(frozen=True)
class OtherValue:
    """A value of a ``kind``, in words, that no parameter here has."""

    kind: str


def _kind(value: Any) -> str:
    if isinstance(value, OtherValue):
        return value.kind
    return "nothing (a parameter cannot be deleted)" if value is None else type(value).__name__


def value_of(message: Any) -> Any:
    """The value of a ParameterValue; None of one that is not set."""
    if message.type not in _READ:
        kind = f"an array of {_ARRAYS[message.type]}" if message.type in _ARRAYS else f"the unknown type {message.type}"
        return None if message.type == 0 else OtherValue(kind)
    value = getattr(message, _READ[message.type])
    return {1: bool, 2: int, 3: float, 4: str}[message.type](value)


def descriptor_of(p: Parameter) -> dict[str, Any]:
    """A parameter's rcl_interfaces/msg/ParameterDescriptor."""
    ends = [] if p.range is None else [{"from_value": p.range[0], "to_value": p.range[1]}]
    return {
        "name": p.name, "type": TYPES[type(p.value)][0], "description": p.description, "read_only": p.read_only,
        "floating_point_range": ends,
    }  # fmt: skip
