"""`cmd-vel`: the base of any robot drives as it is ordered, and carries its end effector along."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from wbmpc import lie
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Cost, Reference
from wbmpc.result import Metric
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.loop import closed_loop
from wbmpc.tasks.path_settings import SAMPLED
from wbmpc.tasks.paths import rise
from wbmpc.tasks.settings import TaskSettings, moving_base

Array = np.ndarray
#: How long [s] a change of speed takes.
RAMP = 1.0
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


def base_path(
    orders: tuple[tuple[float, float, float, float], ...], start: Array, since: float, twist: Array
) -> tuple[Array, Array]:
    """Times (n) [s] and poses (n, 3) of a base that stands until ``since`` [s] and then drives as ordered; speeds change smoothly.
    ``twist`` (3, 3): the twist of the body's frame by the ordered speeds."""
    ends = since + np.cumsum([order[0] for order in orders])
    times = np.arange(0.0, ends[-1] + SAMPLED, SAMPLED)
    speed, current, begin = np.zeros((times.size, 3)), np.zeros(3), since
    for order, end in zip(orders, ends, strict=True):
        target = twist @ np.array(order[1:])
        speed[times >= begin] = (current + rise(times - begin, RAMP)[:, None] * (target - current))[times >= begin]
        current, begin = target, end
    poses = [start]
    for a, b in pairwise(speed):
        poses.append(lie.se2_step(poses[-1], 0.5 * (a + b) * SAMPLED))
    return times, np.array(poses)


def build(settings: CmdVelSettings, seed: int) -> Scenario:
    """One run: the end effector's reference is where the ordered base carries it."""
    robot, mpc = settings.prepare()
    start = robot.home[moving_base(robot, "cmd-vel")]
    _check(robot, settings)
    times, poses = base_path(settings.orders, start, settings.settle_time, _twist(robot))
    tool = mpc.reference["end_effector"].at(0.0)
    carried = np.array([_carried(tool, start, pose) for pose in poses])
    mpc.reference["end_effector"] = Reference(times, carried, "pose")
    _guide_base(robot, mpc, times, poses)

    def metrics(log: Log) -> dict[str, Metric]:
        use = log.times("base") >= settings.settle_time
        t = log.times("base")[use]
        wanted = np.stack([np.interp(t, times, column) for column in poses.T], axis=1)
        found = {}
        for name in ("base", "base_estimated"):
            error = np.hypot(*(log.array(name)[use] - wanted)[:, :2].T)
            ending = "_world" if name == "base" else ""
            found[f"base_error_mean{ending}"] = Metric(float(error.mean()) if error.size else np.inf, "m")
        return found

    return closed_loop(robot, mpc, float(times[-1]), seed, settings, since=settings.settle_time, metrics=metrics)


def _guide_base(robot: RobotModel, mpc: MPC, times: Array, poses: Array) -> None:
    """The base itself follows its path, with the weight of the end effector, where the problem has a cost of the whole state."""
    if "state" not in mpc.reference or mpc.reference["state"].values.shape[1] != robot.state.size:
        return
    part = moving_base(robot, "cmd-vel")
    values = np.tile(mpc.reference["state"].values[:1], (len(times), 1))
    values[:, part] = poses
    mpc.reference["state"] = Reference(times, values)
    cost, effector = mpc.ocp.term("state"), mpc.ocp.term("end_effector")
    assert isinstance(cost, Cost) and isinstance(effector, Cost)
    pose = effector.expand(effector.weight)
    weight = np.array(cost.expand(cost.weight))
    weight[part] = [pose[0], pose[1], pose[5]]
    mpc.solver.set_weight("state", list(weight))


def _carried(tool: Array, start: Array, pose: Array) -> Array:
    """Pose (7) of what was at ``tool`` when the base stood at ``start``, now that it is at ``pose``."""
    spatial = lambda p: np.array([p[0], p[1], 0.0, *lie.quaternion_about((0.0, 0.0, 1.0), float(p[2]))])
    return lie.pose_compose(spatial(pose), lie.pose_compose(lie.pose_inverse(spatial(start)), tool))


def _twist(robot: RobotModel) -> Array:
    """(3, 3): what the body's frame does when its base has speeds ahead, to the left and about the vertical."""
    matrix = robot.base.twist
    return np.asarray(matrix if matrix.shape[1] == 3 else np.column_stack([matrix[:, 0], np.zeros(3), matrix[:, -1]]))


def _check(robot: RobotModel, settings: CmdVelSettings) -> None:
    """Raise :class:`InputError` for an order to the left of a base whose speeds have none."""
    speeds = robot.input.groups.get("base", ())
    if speeds and "vy" not in speeds and any(order[2] for order in settings.orders):
        raise InputError(
            f"orders: the base of '{robot.description.name}' has no speed to the left; valid: {', '.join(speeds)}"
        )


EXPERIMENT = Experiment.of(
    "cmd-vel", "the base of any robot drives as it is ordered", CmdVelSettings, build, DEFINITIONS
)
