"""`cmd-vel`: the base of any robot follows velocity commands and carries its end effector along."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.route import base_part
from wbmpc.result import Metric
from wbmpc.tasks.base_following import RAMP, base_path, lead_base, ordered_twist
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.loop import Hooks, closed_loop
from wbmpc.tasks.settings import TaskSettings

#: Speeds [m/s or rad/s] of an order; times [s] of all orders together, at most.
Speed = Annotated[float, Field(ge=-10, le=10)]
LONGEST = 3600.0


class CmdVelSettings(TaskSettings):
    """``orders``: for how long [s], and the base's speeds ahead [m/s], to the left [m/s] and about the vertical [rad/s]."""

    orders: tuple[tuple[Annotated[float, Field(ge=0, le=LONGEST)], Speed, Speed, Speed], ...] = (
        (3.0, 0.3, 0.0, 0.0),
        (4.0, 0.2, 0.0, 0.4),
        (2.0, 0.0, 0.0, 0.0),
    )

    @model_validator(mode="after")
    def _lasting(self) -> Self:
        if not self.orders or any(order[0] <= RAMP for order in self.orders):
            raise ValueError(f"orders: at least one is needed, and each must last longer than {RAMP:g} s")
        if sum(order[0] for order in self.orders) > LONGEST:
            raise ValueError(f"orders: they may last {LONGEST:g} s together")
        return self


def build(settings: CmdVelSettings, seed: int) -> Scenario:
    """One run: the end effector's reference is where the ordered base carries it."""
    robot, mpc = settings.prepare()
    start = robot.home[base_part(robot, "cmd-vel")]
    _check(robot, settings)
    times, poses = base_path(settings.orders, start, settings.settle_time, ordered_twist(robot))
    lead_base(robot, mpc, times, poses)

    def metrics(log: Log) -> dict[str, Metric]:
        use = log.times("base") >= settings.settle_time
        t = log.times("base")[use]
        target = np.stack([np.interp(t, times, column) for column in poses.T], axis=1)
        found = {}
        for name in ("base", "base_estimated"):
            error = np.hypot(*(log.array(name)[use] - target)[:, :2].T)
            ending = "_world" if name == "base" else ""
            found[f"base_error_mean{ending}"] = Metric(float(error.mean()) if error.size else np.inf, "m")
        return found

    return closed_loop(
        robot, mpc, float(times[-1]), seed, settings, since=settings.settle_time, hooks=Hooks(metrics=metrics), reshape=True
    )  # fmt: skip


def _check(robot: RobotModel, settings: CmdVelSettings) -> None:
    """Raise :class:`InputError` for an order to the left of a base whose speeds have none."""
    speeds = robot.input.groups.get("base", ())
    if speeds and "vy" not in speeds and any(order[2] for order in settings.orders):
        raise InputError(
            f"orders: the base of '{robot.description.name}' has no speed to the left; valid: {', '.join(speeds)}"
        )


EXPERIMENT = Experiment.of(
    "cmd-vel", "the base of any robot follows velocity commands", CmdVelSettings, build, DEFINITIONS
)
