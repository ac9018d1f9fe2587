"""What the ball robot's experiments share: settings, the closed loop, pushes, recorded channels, figures of the estimator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.optimize import least_squares

from wbmpc import lie
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import BodyCost, HandCost, RezeroCost, rezero_mpc, set_home_references
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.filter import BallFilter
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.push import PushEstimator
from wbmpc.bases.ball.settings import BallControllerSettings, leaning_of
from wbmpc.checks import whole
from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot, RunResult, Series
from wbmpc.robots import load_description
from wbmpc.settings import ExperimentSettings, finished
from wbmpc.simulation.lockstep import Ending, Progress, Timing, run_lockstep
from wbmpc.studies.minniti2019.baselines import (
    ACCURATE_RIVALS,
    Controller,
    Parts,
    RivalsSettings,
    TrackingSettings,
    make_controller,
    unread,
)
from wbmpc.types import Truth

IDEALISATIONS = [
    "encoders, gyro and accelerometer have noise, bias and 5 ms of age; the start (position, heading) is known, and the floor "
    "is flat; with estimator=truth the controller gets the simulator's state instead, 5 ms old, with noise",
    "the geometry and masses of Rezero's arm are assumed (not published)",
    "the omni wheels act as torques between ball and base; their traction limit is a clamp (limits.wheel_effort: 4 N m)",
    "the computation takes a constant 10 ms; drives follow torque with a first-order lag",
]


#: What the filter alone reads of the simulated sensors, and what only the state of the simulator has [of ``plant``].
INERTIAL = tuple(f"plant.{sensor}_{kind}" for sensor in ("gyro", "accel") for kind in ("noise", "bias", "walk"))
STATE_NOISE = tuple(f"plant.{kind}_noise" for kind in ("position", "angle", "speed", "rate"))


class RezeroSettings(BallControllerSettings, ExperimentSettings):
    """``robot``: a name or a file, of a base of type ball; the weights were found for Rezero.
    ``estimator``: the state from the sensors (filter), or from the simulator with noise (truth); ``payload`` [kg]: an
    unknown mass at the hand; ``controller``: the MPC, or a rival that has its estimator and the same limits of the drives,
    with its gains (``rival``); ``tracking`` of the MPC's plans. What the chosen controller does not read is refused."""

    robot: str = "rezero"
    estimator: Literal["filter", "truth"] = "filter"
    payload: float = Field(0.0, ge=0, le=5.0)
    controller: Controller = "mpc"
    rival: RivalsSettings = RivalsSettings()
    tracking: TrackingSettings = TrackingSettings()

    #: Settings that the experiment has no use for: to change them is refused. Those that it reads itself, whatever controls.
    unused: ClassVar[tuple[str, ...]] = ("cost.torque.force", "cost.torque.moment")
    own: ClassVar[tuple[str, ...]] = ()

    def _changed(self, name: str) -> bool:
        """Whether a setting is not as it is by default."""
        first, *rest = name.split(".")
        usual = reduce(getattr, rest, type(self).model_fields[first].default)
        return bool(reduce(getattr, rest, getattr(self, first)) != usual)

    def _asked(self, name: str) -> bool:
        """Whether somebody wants this: it is not as by default, and not 0, nothing of it."""
        value = reduce(getattr, name.split("."), self)
        return self._changed(name) and (value is False or value != 0)

    def idle(self) -> dict[str, str]:
        """Settings that nothing reads as the others are, by name, and which other one makes them so."""
        sensors = STATE_NOISE if self.estimator == "filter" else (*INERTIAL, "brace")
        out = dict.fromkeys(sensors, f"estimator={self.estimator}")
        if self.cost.lean == 0.0:
            out["brace"] = "cost.lean=0"
        if self.mpc.limits == "soft":
            out["cost.speed_slack"] = "mpc.limits=soft"
        if not self.observer:
            out |= dict.fromkeys(("weigh", "pushed_speed"), "observer=false")
        return out

    def controllers(self) -> tuple[Controller, ...]:
        """Those that run."""
        return (self.controller,)

    @model_validator(mode="after")
    def _used(self) -> Self:
        for name in filter(self._changed, self.unused):
            raise ValueError(f"{name}: this experiment does not use it")
        idle = frozenset.intersection(*(unread(c, self.tracking) for c in self.controllers()))
        for name in filter(self._changed, sorted(idle - set(self.own))):
            with_ = " and tracking.kind=actuators" if self.controller == "mpc" and name == "drive_dead_time" else ""
            raise ValueError(f"{name}: with controller={self.controller}{with_} nothing uses it")
        for name, other in self.idle().items():
            if self._asked(name):
                raise ValueError(f"{name}: with {other} nothing uses it")
        return self


class AccurateSettings(RezeroSettings):
    """A hand that is led accurately while the ball has a place of its own: stiff weights, for references that move slowly; so have
    the rivals."""

    brace: float = Field(0.0, ge=0, le=1.0)
    cost: RezeroCost = RezeroCost(
        hand=HandCost(weight=1000.0, orientation=2.0, roll=0.0), body=BodyCost(ball=150.0, yaw=20.0), lean=0.6
    )
    rival: RivalsSettings = ACCURATE_RIVALS


#: Where an accurate hand of Rezero starts, arm angles [rad]: it stays inside 85 % of its reach when the ball drives round it.
BENT_ARM = np.array([0.0, 0.5, 2.0])


def bent_arm(settings: RezeroSettings, robot: RobotModel) -> np.ndarray:
    """Where an accurate hand starts, arm angles (m) [rad]: bent; other robots at their home, which is theirs to choose."""
    return BENT_ARM if settings.robot == "rezero" else robot.home[robot.state["arm"]]


@dataclass(frozen=True)
class Push:
    """A force (3) [N] in world axes at the base's centre of mass, from ``start`` for ``length`` [s], whole controller periods."""

    start: float
    length: float
    force: tuple[float, float, float]


@dataclass(frozen=True)
class Task:
    """A start (arm angles), how long it goes on [s], references by term beside rest at the start, and pushes."""

    arm: np.ndarray
    duration: float
    references: dict[str, Reference] = field(default_factory=dict)
    pushes: tuple[Push, ...] = ()


def reaching(robot: RobotModel, times: np.ndarray, ball: np.ndarray, hand: np.ndarray, start: np.ndarray) -> Reference:
    """The body (n, nx) at rest over times (n) [s] with the ball at ``ball`` (n, 2) and the hand as near as it can be to ``hand``
    (n, 3) [m], from state ``start`` (nx) on, with its heading: the task of controllers that track the body alone."""
    arm, velocity = start[robot.state["arm"]], robot.state["base_velocity"].start

    def state(place: np.ndarray, angles: np.ndarray) -> np.ndarray:
        x = robot.equilibrium(angles, yaw=float(start[2]))[0]
        x[:2] = place
        return x

    states, angles = np.empty((times.size, start.size)), arm
    for k, (place, goal) in enumerate(zip(ball, hand, strict=True)):
        if k == 0 or not (np.array_equal(place, ball[k - 1]) and np.array_equal(goal, hand[k - 1])):
            away = lambda z, p=place, g=goal: np.concatenate([robot.pose(state(p, z))[0] - g, 1e-3 * (z - arm)])
            angles = least_squares(away, angles, diff_step=1e-5).x
        states[k] = state(place, angles)
    moves = np.gradient(states[:, :velocity], times, axis=0)
    states[:, velocity:] = moves
    return Reference(times, states)


def ball_robot(settings: RezeroSettings, payload: bool = False, contact: str = "none") -> RobotModel:
    """The robot of the settings with what an experiment needs of its model, whatever its file says of that.

    Raises :class:`InputError` for a base of another type.
    """
    kind = load_description(settings.robot).base.type
    if kind != "ball":
        raise InputError(f"robot: '{settings.robot}' has a base of type '{kind}'; valid: ball")
    return load_robot(settings.robot, contact=contact, contact_frame=(), payload=payload)


def robot_of(settings: RezeroSettings) -> RobotModel:
    """The ball robot as the controller of the settings models it: with a mass at the hand where that is estimated."""
    return ball_robot(settings, settings.weigh and settings.observer and settings.controller == "mpc")


def count_wheels(state: np.ndarray, torque: np.ndarray) -> int:
    """How many of recorded torques (n, drives) are the wheels', by the states (n, nx): the others are the arm's joints."""
    return int(torque.shape[1] - (state.shape[1] // 2 - 5))


def run_task(
    name: str,
    settings: RezeroSettings,
    seed: int,
    task: Task,
    metrics: Callable[[Log, Ending], dict[str, Metric]],
    plots: Callable[[Log], list[Plot]],
    idealisations: list[str],
    progress: Progress | None = None,
    before: Callable[[MPC, Timing, float], None] | None = None,
) -> RunResult:
    """One run: the MPC of the settings, a perturbed plant, the estimator in the loop. ``before`` is called at every tick.
    Raises :class:`InputError` for pushes that are no whole number of controller periods."""
    for push in task.pushes:
        whole("length", push.length, 1.0 / settings.control.rate, "controller periods")
    robot = robot_of(settings)
    home, torque = robot.equilibrium(task.arm)
    mpc = rezero_mpc(robot, settings.mpc, settings.cost)
    set_home_references(mpc, robot, torque, home)
    position, quaternion = robot.pose(home)
    mpc.reference["hand"] = Reference.poses([0.0], position, quaternion)
    for term, reference in task.references.items():
        mpc.reference[term] = reference
    plant = BallPlant(robot.description, home, torque, settings.plant, seed, payload=settings.payload)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.delay)
    estimator = BallEstimator(robot, home) if settings.estimator == "filter" else None
    agent, planner = make_controller(settings, Parts(robot, mpc, torque, timing.period, estimator, task.arm))
    if settings.brace > 0.0 and settings.controller == "mpc" and estimator is not None:
        # (states from the simulator with noise are all pushes)
        agent.shoves = PushEstimator(robot, task.arm, settings.brace)
    if settings.controller == "mpc":
        agent.leaning = leaning_of(settings, robot, task.arm)
    mpc.reset(home, torque)
    log = Log()

    def record(t: float, command: Any, plans: Any) -> None:
        if before is not None:
            before(mpc, timing, t)
        record_rezero(log, t, plant, agent, agent.torque)
        log.add("feedback", t, agent.wanted - agent.feedforward)
        if task.pushes:
            active = [p.force for p in task.pushes if p.start <= t + 1e-9 < p.start + p.length]
            plant.push(np.sum(active, axis=0) if active else np.zeros(3))

    def drawn() -> list[Plot]:
        if planner is None:
            return plots(log)
        solve = 1e3 * np.array(planner.statistics.solve_times)
        times = Plot("Solve times", "MPC update", "time [ms]", [Series("solve", np.arange(solve.size), solve)])
        return [*plots(log), times]

    ending = run_lockstep(plant, agent, planner, timing, task.duration, record, progress)
    return finished(
        name, seed, settings, ending, planner or mpc, log,
        metrics=lambda: {**metrics(log, ending), **estimator_metrics(log), **fault_metrics(agent)}, plots=drawn,
        idealisations=[*idealisations, *IDEALISATIONS], faults=agent.faults,
    )  # fmt: skip


def record_rezero(log: Log, t: float, plant: BallPlant, agent: BallController, torque: np.ndarray) -> None:
    """The channels of every experiment: truth, torques, disturbance and, with an estimator, what it believes."""
    truth = plant.truth()
    log.add("state", t, plant.state())
    log.add("hand", t, truth.tool)
    log.add("hand_quaternion", t, lie.rotation_to_quaternion(truth.tool_rotation))
    log.add("tilt", t, truth.tilt)
    log.add("torque", t, torque)
    log.add("disturbance", t, agent.disturbance)
    if agent.payload is not None:
        log.add("payload", t, agent.payload.mass)
    if agent.estimator is not None:
        _record_estimate(log, t, agent.state()[: truth.state.size], truth, agent.estimator.filter)


def _record_estimate(log: Log, t: float, state: np.ndarray, truth: Truth, estimator: BallFilter) -> None:
    """The estimated state now, and where the hand is for it: estimated pose of the base, true forward kinematics."""
    rotation = lie.euler_zyx_to_rotation(*state[2:5])
    log.add("hand_estimated", t, [state[0], state[1], 0.0] + rotation @ truth.tool_in_base)
    turned = lie.rotation_to_quaternion(rotation @ truth.tool_rotation_in_base)
    log.add("hand_quaternion_estimated", t, turned)
    log.add("estimate", t, state)
    log.add("rolling_fault", t, float(any(not f.startswith("imu") for f in estimator.faults)))


def hand_felt(log: Log) -> np.ndarray:
    """Hand positions (n, 3) [m] in the estimated frame (the true ones in runs without an estimator)."""
    return log.array("hand_estimated") if "hand_estimated" in log.channels else log.array("hand")


def hand_turn_felt(log: Log) -> np.ndarray:
    """Quaternions (n, 4) of the hand in the estimated frame (the true ones in runs without an estimator)."""
    return log.array("hand_quaternion_estimated" if "hand_quaternion_estimated" in log.channels else "hand_quaternion")


def ball_felt(log: Log) -> np.ndarray:
    """Ball positions (n, 2) [m] in the estimated frame (the true ones in runs without an estimator)."""
    return log.array("estimate" if "estimate" in log.channels else "state")[:, :2]


def estimator_metrics(log: Log) -> dict[str, Metric]:
    """Largest errors of the estimate, the share of messages in which the ball was found not to roll, the mass that was weighed."""
    if "estimate" not in log.channels:
        return {}
    weighed = {"payload_estimated": Metric(float(log.array("payload")[-1]), "kg")} if "payload" in log.channels else {}
    error = np.abs(log.array("estimate") - log.array("state"))
    return {
        "estimated_position_error_max": Metric(float(np.hypot(error[:, 0], error[:, 1]).max()), "m"),
        "estimated_tilt_error_max": Metric(float(error[:, 3:5].max()), "rad"),
        "estimated_yaw_error_max": Metric(float(error[:, 2].max()), "rad"),
        "rolling_fault_share": Metric(float(log.array("rolling_fault").mean()), "1"),
        **weighed,
    }


def fault_metrics(*agents: BallController) -> dict[str, Metric]:
    """How many encoders were found to stand still, and wheels to slip, by all agents of a run."""
    monitors = [a.monitor for a in agents if a.monitor is not None]
    return {"encoder_faults": Metric(float(sum(len(m.faults) for m in monitors)), "1")} if monitors else {}


def rms(vectors: np.ndarray) -> float:
    """Root mean square length of vectors (n, k); infinite for none."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1)))) if len(vectors) else float("inf")


def common_plots(log: Log, hand: np.ndarray, ball: np.ndarray) -> list[Plot]:
    """Ball, lean, hand error and torques; ``hand`` (3) or (n, 3) and ``ball`` (2) or (n, 2): where they should be [m]."""
    t, state, torque = log.times("state"), log.array("state"), log.array("torque")
    error = lambda a, b: 1e3 * np.linalg.norm(a - b, axis=1)
    return [
        Plot("Ball position", "time [s]", "position [m]", [Series(n, t, state[:, i]) for i, n in enumerate("xy")]),
        Plot("Roll and pitch of the base", "time [s]", "angle [deg]", [
            Series("pitch", t, np.rad2deg(state[:, 3])), Series("roll", t, np.rad2deg(state[:, 4])),
        ]),
        Plot("Ball path", "x [m]", "y [m]", [Series("ball", state[:, 0], state[:, 1])], equal_axes=True),
        Plot("Errors", "time [s]", "error [mm]", [
            Series("hand, world", t, error(log.array("hand"), hand)),
            Series("hand, estimated frame", t, error(hand_felt(log), hand)),
            Series("ball, world", t, error(state[:, :2], ball)),
        ]),
        Plot("Wheel torques", "time [s]", "torque [N m]", [
            Series(f"wheel {i}", t, torque[:, i]) for i in range(count_wheels(state, torque))
        ]),
    ]  # fmt: skip
