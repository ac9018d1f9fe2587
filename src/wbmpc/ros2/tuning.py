"""What of the controller's settings is a parameter of its node, and weights that change while it runs."""

from __future__ import annotations

import logging
from typing import Any, get_args

from pydantic import ValidationError

from wbmpc.configuration import describe
from wbmpc.errors import InputError
from wbmpc.ocp import OptimalControlProblem
from wbmpc.ros2.base_adapter import BaseAdapter, Weights
from wbmpc.ros2.convert import error_message
from wbmpc.ros2.parameters import Parameter, Parameters, Value
from wbmpc.ros2.settings import RosSettings
from wbmpc.settings import LARGEST, Settings, Weight

_LOG = logging.getLogger("wbmpc")
#: What says in the settings' classes that a number is a weight.
_OF_WEIGHTS = list(get_args(Weight)[1].metadata)
#: A weight from the bus is at most so many times that of the file, or of 1: one of 1e8 alone makes a robot that balances fall.
LARGEST_FACTOR = 1e3


class Tuning:
    """``parameters``: ``robot``, ``use_sim_time``, ``rates.*``, ``frames.*`` read-only; the weights ``cost.*`` settable.

    They are set in any thread, cheaply; :meth:`update`, in the node's own, applies what was set last.
    """

    def __init__(self, adapter: BaseAdapter, settings: RosSettings) -> None:
        self._adapter, self._cost = adapter, settings.cost
        self._in_force = settings.cost
        self.parameters = Parameters(_parameters(adapter, settings), self._change)

    def _change(self, values: dict[str, Value]) -> None:
        self._cost = changed_cost(self._cost, values)

    def update(self) -> None:
        """Give the MPC new weights, if there are some."""
        cost = self._cost
        if cost is self._in_force:
            return
        self._in_force = cost
        try:
            self._adapter.pending.reweigh(weights_of(self._adapter.problem(cost)))
        except Exception as error:
            _LOG.error("parameters: the weights do not change: %s", error_message(error))


def _parameters(adapter: BaseAdapter, settings: RosSettings) -> list[Parameter]:
    return [
        Parameter("robot", adapter.robot.description.name, "name of the robot's description"),
        Parameter("use_sim_time", settings.use_sim_time, "whether time is that of /clock"),
        *(Parameter(f"rates.{n}", float(v), "rate [Hz]") for n, v in settings.rates.model_dump().items()),
        *(Parameter(f"frames.{n}", str(v), "name of a frame") for n, v in settings.frames.model_dump().items()),
        *_weights("cost", settings.cost),
    ]


def _weights(prefix: str, cost: Settings) -> list[Parameter]:
    """All weights of a group of settings and of the groups in it; what shapes the problem instead is read-only."""
    found = []
    for name, field in type(cost).model_fields.items():
        value, full = getattr(cost, name), f"{prefix}.{name}"
        if isinstance(value, Settings):
            found += _weights(full, value)
        elif field.annotation is float and field.metadata == _OF_WEIGHTS:
            text, largest = "weight; applied between two solves", min(LARGEST_FACTOR * max(value, 1.0), LARGEST)
            found.append(Parameter(full, float(value), text, read_only=False, range=(0.0, largest)))
        else:
            found.append(Parameter(full, value, "part of the problem's structure"))
    return found


def changed_cost(cost: Any, values: dict[str, Value]) -> Any:
    """Settings with other weights, named as in ``cost.end_effector.weight``. Raises :class:`InputError`."""
    data = cost.model_dump()
    for name, value in values.items():
        *path, last = name.split(".")[1:]
        part = data
        for key in path:
            part = part[key]
        part[last] = value
    try:
        return type(cost).model_validate(data)
    except ValidationError as error:
        raise InputError(f"parameters: {describe(error)}") from error


def weights_of(problem: OptimalControlProblem) -> Weights:
    """Of all costs, by name and by whether they count along the path or at its end."""
    found: Weights = {}
    for term in problem.costs:
        if term.at != "terminal":
            found[term.name, "path"] = term.weight
        if term.at != "path":
            found[term.name, "terminal"] = term.weight if term.terminal_weight is None else term.terminal_weight
    return found
