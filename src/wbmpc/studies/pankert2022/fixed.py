"""`swerve-fixed`: a swerve base with fixed legs follows base motions; the MPC against controllers without a plan.

Pankert et al. 2022, section V: the authors' reason for an MPC on an ordinary four-wheel-steering base.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from wbmpc.bases.swerve.calibration_log import swerve_robot
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import HandCost, InputCost, StateCost, SwerveCost, closed_brakes, swerve_mpc
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.bases.swerve.wheel_flip import WheelFlipGuess, fast_enough
from wbmpc.experiments import Experiment
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot, RunResult, Series, no_comparison
from wbmpc.settings import ExperimentSettings, finished
from wbmpc.simulation.lockstep import Ending, Progress, Timing, part, run_lockstep
from wbmpc.studies.base_path import BasePath, Segment, in_turn, random_twists
from wbmpc.studies.pankert2022.directions import refuse_directions
from wbmpc.studies.pankert2022.rolling import FourWheelSteeringController, RollingController
from wbmpc.studies.pankert2022.track import stand_still

NAME = "swerve-fixed"
SUMMARY = "base motions of a swerve base with fixed legs: MPC against inverse kinematics and four-wheel steering"

IDEALISATIONS = [
    "errors are in the estimated frame: what steering zeros do to the odometry is the same for all controllers, but not what slip"
    " does, and the MPC lets wheels slip while they turn about",
    "the contact points lie under the steer axes; tyres are soft contacts, not a tyre model",
    "the computation of the MPC takes a constant 10 ms; the rivals' takes none",
    "rivals know the reference ahead of time too: they turn their wheels before they start",
]

Name = Literal["forward", "sideways", "diagonal", "turning", "combined"]
SEGMENTS: dict[Name, Segment] = {
    "forward": Segment((0.4, 0.0, 0.0), 6.0),
    "sideways": Segment((0.0, 0.4, 0.0), 6.0),
    "diagonal": Segment((0.3, -0.3, 0.0), 6.0),
    "turning": Segment((0.0, 0.0, 0.5), 6.0),
    "combined": Segment((0.3, 0.15, 0.3), 8.0),
}
#: Rest before the first segment and between segments, ramp of each [s].
START, PAUSE, RAMP = 1.0, 2.0, 1.0
#: A base that is asked to move faster than the first and moves slower than the second [m/s] stands still.
ASKED, STANDING = 0.05, 0.01
#: Lever [m] that turns a yaw rate into a speed.
LEVER = 0.4


class SwerveFixedSettings(ExperimentSettings):
    """``motions``: which, in this order, each once at most; ``random`` [s] of random twists after them (600 is the ten minutes of
    the protocol), up to ``speed`` [m/s] and ``yaw_rate`` [rad/s]; ``rest`` [s] of standing first, for the gyro's bias;
    ``drive_lag`` [s] that the MPC's controller assumes."""

    cost: SwerveCost = SwerveCost(
        hand=HandCost(weight=0.0, orientation=0.0),
        state=StateCost(position=10_000.0, yaw=3000.0, arm=1.0),
        input=InputCost(base=5.0),
    )
    robot: str = "swerve-fixed-ur10"
    motions: tuple[Name, ...] = tuple(SEGMENTS)
    random: float = Field(60.0, ge=0, le=3600)
    speed: float = Field(0.5, gt=0, le=1.0)
    yaw_rate: float = Field(0.4, ge=0, le=1.0)
    rest: float = Field(20.0, ge=0, le=120)
    drive_lag: float = Field(0.020, ge=0, le=0.5)

    @model_validator(mode="after")
    def _something_to_compare(self) -> Self:
        """A base that is asked nothing compares no controllers; of a motion twice the figures would be of the second alone."""
        if not self.motions and self.random == 0.0:
            raise ValueError("motions: none is left, and random is 0: there is nothing to follow")
        twice = [name for k, name in enumerate(self.motions) if name in self.motions[:k]]
        if twice:
            raise ValueError(f"motions: '{twice[0]}' stands there twice; valid: each once at most")
        return self


@dataclass(frozen=True)
class Motion:
    """The motions one after another, then random ones from where they end; ``spans`` [s] by name."""

    path: BasePath
    spans: dict[str, tuple[float, float]]

    @classmethod
    def of(cls, settings: SwerveFixedSettings, seed: int) -> Motion:
        first, times = in_turn([SEGMENTS[n] for n in settings.motions], START, PAUSE, RAMP)
        spans: dict[str, tuple[float, float]] = dict(zip(settings.motions, times, strict=True))
        twists = first.twists
        if settings.random > 0.0:
            more = random_twists(settings.random, settings.speed, settings.yaw_rate, seed)
            spans["random"] = (float(first.times[-1]), float(first.times[-1] + settings.random))
            twists = np.vstack([twists[:-1], more.twists])
        return cls(BasePath.of(np.vstack([twists, np.zeros((100, 3))])), spans)

    def set(self, mpc: MPC, robot: RobotModel) -> None:
        t = self.path.times[::2]
        legs = np.tile(legs_at_home(robot), (t.size, 1))
        refuse_directions(robot, t, self.path.twists[::2], legs, 0.0 * legs)
        states = np.tile(robot.home, (t.size, 1))
        states[:, robot.state["base"]] = self.path.poses[::2]
        inputs = np.zeros((t.size, robot.input.size))
        inputs[:, robot.input["base"]] = self.path.twists[::2]
        mpc.reference["state"] = Reference(t, states)
        mpc.reference["input"] = Reference(t, inputs)
        position, orientation = robot.pose(robot.home)
        mpc.reference["hand"] = Reference.poses(np.zeros(1), position[None], orientation[None])


Make = Callable[[RobotModel, np.ndarray, float, SwerveFixedSettings, Motion], SwerveController]


def _mpc_agent(r: RobotModel, pose: np.ndarray, period: float, s: SwerveFixedSettings, _: Motion) -> SwerveController:
    return SwerveController(r, pose, period, lag=s.drive_lag, scrubbing=fast_enough(r))


def legs_at_home(robot: RobotModel) -> np.ndarray:
    """Leg angles (n) [rad] at which hinged legs are held; 0 for fixed ones."""
    return robot.home[robot.state["leg"]] if "leg" in robot.state else np.zeros(robot.base.geometry.modules)


def goals(
    motion: Motion, t: float, legs: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Base pose and its rate in world axes; ``legs`` (n) [rad] stay as they are."""
    pose, twist = motion.path.pose(t), motion.path.twist(t)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return (pose, np.array([c * twist[0] - s * twist[1], s * twist[0] + c * twist[1], twist[2]])), (legs, 0.0 * legs)


#: From ``benchmarks/rivals.py``, a coordinate search of 31 sets of gains for each. Inverse kinematics: all motions and random
#: twists of 20 s, seeds 0 and 1 (with an earlier odometry). Four wheels: forward and turning (what it can do), seed 0, 0.56 mm
#: rms (by hand: 4.1).
GAINS: dict[str, dict[str, float]] = {
    "ik": {"base_gain": 12.0, "steer_gain": 30.0, "lead": 0.0, "look_ahead": 2.0},
    "four_wheel": {"base_gain": 16.0, "steer_gain": 10.0, "lead": 0.0, "look_ahead": 0.5},
}


def rival(kind: type[RollingController], **gains: float) -> Make:
    """A maker of a rival's agent."""

    def make(r: RobotModel, pose: np.ndarray, period: float, s: SwerveFixedSettings, p: Motion) -> SwerveController:
        return kind(r, pose, period, lambda t: goals(p, t, legs_at_home(r)), **gains)  # type: ignore[arg-type]

    return make


CONTROLLERS: dict[str, Make] = {
    "mpc": _mpc_agent,
    "ik": rival(RollingController, **GAINS["ik"]),
    "four_wheel": rival(FourWheelSteeringController, **GAINS["four_wheel"]),
}


def run(settings: SwerveFixedSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """All controllers on the same reference and the same plant."""
    robot = swerve_robot(settings.robot)
    reference = Motion.of(settings, seed)
    turns = fast_enough(robot)  # else the base stops for wheels that have to turn about
    guess = (WheelFlipGuess if turns else SteeringGuess)(robot, lambda t, _: reference.path.twist(t))
    mpc = swerve_mpc(robot, settings.mpc, settings.cost, guess, scrubbing=turns)
    reference.set(mpc, robot)
    mpc.reset(robot.home)
    log, ending, faults, whole = Log(), Ending(), list[str](), list[str]()
    for k, name in enumerate(CONTROLLERS):
        own = part(progress, k, len(CONTROLLERS), name)
        ended, found = drive(name, settings, seed, robot, reference, mpc if name == "mpc" else None, log, own)
        faults += [f"{name}: {fault}" for fault in found]
        if not ended.reason:
            whole.append(name)
        elif ended.interrupted or name == "mpc":
            ending = replace(ended, reason=f"{name}: {ended.reason}")
        else:  # the rival's failure, not the run's
            faults.append(f"{name}: {ended.reason}; nothing is compared with it")
        if ended.interrupted:
            break
    return finished(
        NAME, seed, settings, ending, mpc, log,
        metrics=lambda: _metrics(log, reference, whole, ending.interrupted), plots=lambda: _plots(log, reference),
        idealisations=IDEALISATIONS, faults=faults,
    )  # fmt: skip


def drive(
    name: str,
    settings: SwerveFixedSettings,
    seed: int,
    robot: RobotModel,
    reference: Motion,
    mpc: MPC | None,
    log: Log,
    progress: Progress | None = None,
) -> tuple[Ending, list[str]]:
    """One controller over the whole reference; logs its poses as ``base_NAME`` and ``odometry_NAME``. How it ended, and the
    faults that it found."""
    plant = SwervePlant(robot.description, robot.state.split(robot.home), settings.plant, seed)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.delay)
    agent = CONTROLLERS[name](robot, plant.truth().pose, timing.period, settings, reference)
    if mpc is not None:
        agent.faulty = closed_brakes(robot, mpc)
    stand_still(plant, agent, timing, settings.rest)

    def record(t: float, command: Any, plans: Any) -> None:
        if round(t / timing.period) % 4:
            return
        truth = plant.truth()
        log.add(f"base_{name}", t, truth.pose)
        log.add(f"odometry_{name}", t, agent.odometry.pose)
        log.add(f"slip_{name}", t, truth.slip)
        log.add(f"wheel_{name}", t, command.wheel)
        log.add(f"steer_{name}", t, agent.measured.steer if agent.measured is not None else command.steer)

    ending = run_lockstep(plant, agent, mpc, timing, float(reference.path.times[-1]), record, progress)
    return ending, agent.faults


def errors(log: Log, name: str, reference: Motion, of: str = "odometry") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), position errors (n,) [m] and yaw errors (n,) [rad] in the estimated frame; ``of`` the "base": in the world."""
    t, pose = log.times(f"{of}_{name}"), log.array(f"{of}_{name}")
    difference = pose - reference.path.pose(t)
    return t, np.hypot(difference[:, 0], difference[:, 1]), difference[:, 2]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def standstill(log: Log, name: str, reference: Motion) -> float:
    """Longest time [s] for which a base that was asked to move stood still (true motion, over 0.1 s)."""
    t, pose = log.times(f"base_{name}"), log.array(f"base_{name}")
    twist = reference.path.twist(t)
    asked = np.hypot(twist[:, 0], twist[:, 1]) + LEVER * np.abs(twist[:, 2])
    back = np.maximum(np.searchsorted(t, t - 0.1), 0)
    way = pose - pose[back]
    moved = (np.hypot(way[:, 0], way[:, 1]) + LEVER * np.abs(way[:, 2])) / np.maximum(t - t[back], 1e-3)
    still, longest, since = (asked > ASKED) & (moved < STANDING), 0.0, None
    for now, flag in zip(t, still, strict=True):
        since = (now if since is None else since) if flag else None
        longest = max(longest, now - since if since is not None else 0.0)
    return longest


def _metrics(log: Log, reference: Motion, whole: Sequence[str], interrupted: bool) -> dict[str, Metric]:
    """Of the MPC, and of rivals that got to the end of the ``whole`` run: the part before a fall says nothing to compare with.
    ``interrupted``: by the user, which says nothing about those that are missing."""
    done = [n for n in CONTROLLERS if (n == "mpc" or n in whole) and f"odometry_{n}" in log.channels]
    rms = {n: _rms(errors(log, n, reference)[1]) for n in done}
    out = {f"tracking_error_rms_{n}": Metric(v, "m") for n, v in rms.items()}
    if {"mpc", "ik"} <= set(whole):
        out["tracking_error_ratio"] = Metric(rms["mpc"] / rms["ik"], "1", goal=0.5)
    elif "mpc" in whole and not interrupted:
        out["tracking_error_ratio"] = no_comparison(0.5)
    for n in done:
        t, position, yaw = errors(log, n, reference)
        out[f"yaw_error_rms_{n}"] = Metric(_rms(yaw), "rad")
        out[f"tracking_error_rms_world_{n}"] = Metric(_rms(errors(log, n, reference, "base")[1]), "m")
        for segment, (a, b) in reference.spans.items():
            use = (t >= a) & (t <= b + PAUSE)
            if use.any():
                out[f"tracking_error_rms_{n}_{segment}"] = Metric(_rms(position[use]), "m")
        out[f"wheel_slip_max_{n}"] = Metric(float(log.array(f"slip_{n}").max()), "m/s")
    if "mpc" in done:
        out["longest_standstill"] = Metric(standstill(log, "mpc", reference), "s", goal=1.0)
    return out


def _plots(log: Log, reference: Motion) -> list[Plot]:
    done = [n for n in CONTROLLERS if f"odometry_{n}" in log.channels]
    found = {n: errors(log, n, reference) for n in done}
    path = reference.path.poses[::20]
    return [
        Plot("Base path", "x [m]", "y [m]", [
            Series("reference", path[:, 0], path[:, 1], dashed=True),
            *(Series(n, *log.array(f"odometry_{n}")[::4, :2].T) for n in done),
        ], equal_axes=True),
        Plot("Position error", "time [s]", "error [mm]", [
            Series(n, t, 1e3 * e) for n, (t, e, _) in found.items() if n != "four_wheel"
        ]),
        Plot("Position error, all controllers", "time [s]", "error [m]", [
            Series(n, t, e) for n, (t, e, _) in found.items()
        ]),
        Plot("Yaw error", "time [s]", "error [deg]", [Series(n, t, np.rad2deg(y)) for n, (t, _, y) in found.items()]),
    ]  # fmt: skip


EXPERIMENT = Experiment(NAME, SUMMARY, SwerveFixedSettings, run)
