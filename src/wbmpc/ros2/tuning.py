"""What of the controller's settings is a parameter of its node, and weights that change while it runs."""

from __future__ import annotations

from typing import Any, get_args

from pydantic import ValidationError

from wbmpc.configuration import describe
from wbmpc.errors import InputError
from wbmpc.ocp import OptimalControlProblem
from wbmpc.ros2.base_adapter import BaseAdapter, Weights
from wbmpc.ros2.parameters import Parameter, Parameters, Value
from wbmpc.ros2.settings import RosSettings
from wbmpc.settings import LARGEST, Settings, Weight

#: What says in the settings' classes that a number is a weight.
_OF_WEIGHTS = list(get_args(Weight)[1].metadata)


def parameters_of(adapter: BaseAdapter, settings: RosSettings) -> Parameters:
    """``robot``, ``use_sim_time``, ``rates.*``, ``frames.*`` read-only; the weights ``cost.*`` settable."""
    parameters = [
        Parameter("robot", adapter.robot.description.name, "name of the robot's description"),
        Parameter("use_sim_time", settings.use_sim_time, "whether time is that of /clock"),
        *(Parameter(f"rates.{n}", float(v), "rate [Hz]") for n, v in settings.rates.model_dump().items()),
        *(Parameter(f"frames.{n}", str(v), "name of a frame") for n, v in settings.frames.model_dump().items()),
        *_weights("cost", settings.cost),
    ]
    state = {"cost": settings.cost}

    def change(values: dict[str, Value]) -> None:
        cost = changed_cost(state["cost"], values)
        adapter.pending.reweigh(weights_of(adapter.problem(cost)))
        state["cost"] = cost

    return Parameters(parameters, change)


def _weights(prefix: str, cost: Settings) -> list[Parameter]:
    """All weights of a group of settings and of the groups in it; what shapes the problem instead is read-only."""
    found = []
    for name, field in type(cost).model_fields.items():
        value, full = getattr(cost, name), f"{prefix}.{name}"
        if isinstance(value, Settings):
            found += _weights(full, value)
        elif field.annotation is float and field.metadata == _OF_WEIGHTS:
            text = "weight; applied between two solves"
            found.append(Parameter(full, float(value), text, read_only=False, range=(0.0, LARGEST)))
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
