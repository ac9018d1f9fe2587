"""`tip-over`: a robot that drives with a load at full reach is stopped at once. Wheels must not lift."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from wbmpc.arrays import Array
from wbmpc.constants import GRAVITY
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.route import base_part
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot, Series
from wbmpc.robots.examples import EXAMPLES
from wbmpc.settings import Positive, Robot, Stability, SupportMarginSettings, WheelLoadSettings
from wbmpc.stability import StanceOf, configuration_positions, configurations, standing
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.loop import Hooks, closed_loop
from wbmpc.tasks.path_settings import Line, follow, timed
from wbmpc.tasks.settings import MujocoPlant, TaskSettings
from wbmpc.types import Truth

#: Of postures of which the one with the farthest reach is taken; which share of a joint's range they use.
POSTURES, SHARE = 20_000, 0.95
#: A wheel that carries less [N] has lifted; a base that is slower [m/s] for so long [s] stands.
LIFTED, STANDS, REST = 1.0, 0.02, 0.2


class TipOverSettings(TaskSettings):
    """``direction`` [rad] from straight ahead, in which the robot drives and reaches; ``speed`` [m/s]: before it stops; ``ramp`` [s]:
    until it has the speed; ``cruise`` [s]: from then to the order to stop, after which the end effector is to be where its reference is
    (by a low weight, or the arm would swing); ``after`` [s]: time for which the robot is watched after the stop; ``legs``:
    configuration of legs that move, by its name or angles, "home": as at home, "first": the first that its base
    type names. Wheels are of one size: a stiff body on four stiff wheels that differ by
    0.2 mm stands on three of them, whatever is planned."""

    robot: Robot = EXAMPLES["tip-over"]
    plant: MujocoPlant = MujocoPlant(payload=10.0, wheel_radius_each=0.0)
    stability: Stability = WheelLoadSettings(payload=10.0)
    weights: dict[str, Positive] = Field(default={"end_effector": 0.05})
    settle_time: float = Field(0.5, ge=0, le=60)
    direction: float = Field(np.pi / 2, ge=-6.3, le=6.3)
    speed: float = Field(0.9, ge=0.01, le=10)
    ramp: float = Field(1.5, ge=0.01, le=60)
    cruise: float = Field(0.3, ge=0, le=60)
    after: float = Field(3.0, ge=0.5, le=600)
    legs: str = Field("first", max_length=200)


def reaching(robot: RobotModel, direction: float, legs: str, rolling: float | None = None) -> RobotModel:
    """The robot with another home: the arm reaches as far as it can in a direction [rad], level with the middle of where it can be, hinged
    legs are in a configuration, and steered wheels roll in the direction, or in another one, ``rolling`` [rad]."""
    x, state = robot.home.copy(), robot.state
    steered = standing(robot).steered
    legs = next(iter(configurations(robot)), "home") if legs == "first" else legs
    if legs != "home" and steered is not None and steered.leg_group:
        x = steered.with_legs(x, configuration_positions(robot, legs))
    along = np.array([np.cos(direction), np.sin(direction), 0.0])
    if steered is not None:
        towards = direction if rolling is None else rolling
        x = steered.rolling(x, np.array([np.cos(towards), np.sin(towards), 0.0]))
    x[state["arm"]] = farthest(robot, x, along)
    names = {n: float(x[state[g]][i]) for g in state.groups if g != "base" for i, n in enumerate(state.groups[g])}
    description = robot.description
    return RobotModel(description.model_copy(update={"home": {**description.home, **names}}))


def farthest(robot: RobotModel, x: Array, along: Array) -> Array:
    """Arm angles [rad] with the farthest reach along a direction (3) of many random ones; higher or lower costs three times as much."""
    part, rng = robot.state["arm"], np.random.default_rng(0)
    low, high = (np.clip(v[part], -np.pi, np.pi) for v in (robot.limits.state_lower, robot.limits.state_upper))
    middle, half = 0.5 * (low + high), 0.5 * SHARE * (high - low)
    states = np.tile(x, (POSTURES, 1))
    states[:, part] = middle + half * rng.uniform(-1.0, 1.0, (POSTURES, low.size))
    at = robot.poses(states)[:, :3]
    best = np.argmax(at @ along - 3.0 * np.abs(at[:, 2] - at[:, 2].mean()))
    return np.asarray(states[best, part])


class LoadWatch:
    """Loads (n) [N] of the wheels and tilt [rad] of the base, at every controller period from ``since`` [s] on."""

    def __init__(self, since: float) -> None:
        self._since, self._last = since, 0.0
        self.times: list[float] = []
        self.loads: list[Array] = []
        self.tilt: list[float] = []

    def see(self, t: float, truth: Truth) -> None:
        """At a controller period."""
        if t >= self._since:
            self.times.append(t)
            self.loads.append(truth.wheel_force)
            self.tilt.append(truth.tilt)

    def metrics(self) -> dict[str, Metric]:
        """Least load of any wheel, longest time that one is in the air, how far the base tilts beyond how it stood."""
        loads, times = np.array(self.loads), np.array(self.times)
        return {
            "wheel_load_min": Metric(float(loads.min()), "N", least=LIFTED),
            "wheel_lifted_time_max": Metric(longest(times, loads < LIFTED), "s", goal=0.0),
            "tilt_change_max": Metric(float(np.abs(np.array(self.tilt) - self.tilt[0]).max()), "rad"),
        }

    def plots(self, names: list[str]) -> list[Plot]:
        """Loads over time."""
        t, loads = np.array(self.times), np.array(self.loads)
        return [Plot("Wheel loads", "time [s]", "force [N]", [Series(n, t, loads[:, i]) for i, n in enumerate(names)])]


def longest(times: Array, lifted: NDArray[np.bool_]) -> float:
    """Longest time [s] for which one column of ``lifted`` (n, wheels) is true without a break."""
    found, since = 0.0, np.full(lifted.shape[1], np.nan)
    step = float(np.diff(times).mean()) if len(times) > 1 else 0.0
    for t, now in zip(times, lifted, strict=True):
        since = np.where(now, np.where(np.isnan(since), t, since), np.nan)
        if now.any():
            found = max(found, t - float(np.nanmin(since)) + step)
    return found


def stopping(log: Log, ordered: float) -> dict[str, Metric]:
    """How far and how long the base goes on after the order to stop at ``ordered`` [s], until it stands; no number if it never does."""
    t, base = log.times("base"), log.array("base")[:, :2]
    speed = np.append(np.linalg.norm(np.diff(base, axis=0), axis=1) / np.diff(t), 0.0)
    after = t >= ordered
    t, base, speed = t[after], base[after], speed[after]
    moving = np.flatnonzero(speed > STANDS)
    end = int(moving[-1]) + 1 if moving.size else 0
    stands = end < len(t) and t[-1] - t[end] >= REST
    way = float(np.linalg.norm(base - base[0], axis=1).max()) if len(t) else np.nan
    return {
        "stopping_distance": Metric(way if stands else np.nan, "m"),
        "stopping_time": Metric(float(t[end] - ordered) if stands else np.nan, "s"),
    }


def check_stands(robot: RobotModel, payload: float, kept: float = 0.0) -> None:
    """Raise :class:`InputError` for a robot that at rest at home, with ``payload`` [kg] at its end effector, tips over or does not keep its
    zero-moment point ``kept`` [m] within its support: a plan could only begin with a leap."""
    margin = StanceOf(robot)(robot.home, (0.0, 0.0, -payload * GRAVITY, 0.0, 0.0, 0.0)).polygon_margin
    if not margin > kept:
        raise InputError(
            f"tip-over: '{robot.description.name}' does not stand with {payload:g} kg at full reach: its zero-moment point is "
            f"{1e3 * margin:.0f} mm within its support, more than {1e3 * kept:g} mm are needed; valid: a smaller plant.payload, another direction"
        )


def build(settings: TipOverSettings, seed: int) -> Scenario:
    """One run."""
    robot = load_robot(settings.robot)
    base_part(robot, "tip-over")
    robot = reaching(robot, settings.direction, settings.legs)
    kept = settings.stability.margin if isinstance(settings.stability, SupportMarginSettings) else 0.0
    check_stands(robot, settings.plant.payload, kept)
    robot, mpc = settings.prepare(robot=robot)
    start, ordered = settings.settle_time, settings.settle_time + settings.ramp + settings.cruise
    length = settings.speed * (settings.ramp + settings.cruise + mpc.ocp.horizon)
    line = Line(length=length, direction=settings.direction, speed=settings.speed, ramp=settings.ramp)
    pose = mpc.reference["end_effector"].at(0.0)
    follow(robot, mpc, timed(line.curve(robot, pose[:3], pose[3:]), line.speed, line.ramp, start)[0])
    watch, waiting = LoadWatch(start), [ordered]

    def tick(t: float) -> None:
        """The order to stop: no plan sees it before."""
        if waiting and t >= waiting[0] - 1e-9:
            waiting.pop()
            here = mpc.reference["end_effector"].at(t)
            follow(robot, mpc, Reference.poses([t], [here[:3]], here[3:], hold=True))

    def metrics(log: Log) -> dict[str, Metric]:
        return {**watch.metrics(), **stopping(log, ordered)}

    rolling = [n for group in robot.base.rolling_groups for n in robot.input.groups[group]]
    wheels = robot.description.base.wheel_joints() or rolling
    return closed_loop(
        robot, mpc, ordered + settings.after, seed, settings, since=start,
        hooks=Hooks(tick=tick, metrics=metrics, plots=lambda log: watch.plots(wheels), truth=watch.see),
    )  # fmt: skip


EXPERIMENT = Experiment.of(
    "tip-over",
    "a robot with a load at full reach stops abruptly and must not tip over",
    TipOverSettings,
    build,
    DEFINITIONS,
)
