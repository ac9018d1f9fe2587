"""`swerve-calibrate`: a short reference drive with global poses, from which the wheels are calibrated.

No MPC: between strokes the base stands and the wheels turn to the next direction, then they roll. On hinged legs the straight
strokes go with open brakes: the legs give way to wheels that point beside their way, and their encoders show it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.brake_control import FLOATING, floating
from wbmpc.bases.swerve.calibration import WheelRecord, calibrate
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.model import SwerveGeometry, rolling_inverse_kinematics
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError, RunAborted
from wbmpc.estimation.wheel_calibration import WheelCalibration
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.result import Metric, MpcStatistics, Plot, RunResult, Series
from wbmpc.settings import ControlSettings, LocalisationSettings, Settings
from wbmpc.simulation.lockstep import Progress, watched
from wbmpc.simulation.perturbation import Perturbation
from wbmpc.studies.minniti2019.directions import refuse_directions
from wbmpc.types import SwerveCommand, SwerveMeasurement

NAME = "swerve-calibrate"
SUMMARY = "a short reference drive with global poses, for 'wbmpc calibrate' (steer zeros and wheel radii)"

IDEALISATIONS = [
    "global poses have independent normal noise; a real localisation has errors that last as well",
    "the robot may drive about 2 m in each direction",
    "open hinges turn freely: one that sticks looks like a wheel that points where it should",
]


class SwerveCalibrateSettings(Settings):
    """``speed`` [m/s] of the fastest wheel; ``stroke`` [m] of the straight parts; ``turn`` [rad] to the left, then right;
    ``pause`` [s] of standing before and after each; ``rounds`` of the whole; ``rest`` [s] before the first;
    ``open_brakes``: whether straight parts go with open brakes, where there are brakes and open legs hold the base."""

    robot: str = "swerve-ur10"
    speed: float = Field(0.4, ge=0.02, le=0.8)
    stroke: float = Field(2.0, gt=0, le=20)
    turn: float = Field(np.pi, gt=0, le=7)
    pause: float = Field(0.5, ge=0, le=60)
    rounds: int = Field(1, ge=1, le=20)
    rest: float = Field(5.0, ge=0, le=120)
    open_brakes: bool = True
    localisation: LocalisationSettings = LocalisationSettings()
    control: ControlSettings = ControlSettings()
    plant: Perturbation = Perturbation()


#: Directions of the straight strokes, in the body.
STRAIGHT = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
#: Largest steering speed [rad/s], gain of its servo [1/s], mean acceleration [m/s²].
STEER_SPEED, STEER_GAIN, ACCELERATION = 2.0, 5.0, 0.4
#: Open legs are led back by this share of their deviation for each metre on the way [1/m]; standing before that [s], and at
#: least so long after brakes have opened.
LEG_GAIN, OPENING, SURE = 2.0, 0.4, 0.3


class WheelLog:
    """Writes the channels that a calibration reads: one row for ``every`` messages."""

    def __init__(self, log: Log, every: int = 4) -> None:
        self.log, self.every = log, every
        self._count, self._gyro = 0, list[float]()

    def add(self, t: float, m: SwerveMeasurement, brake: np.ndarray | None = None) -> None:
        """Take in the message of time ``t`` [s] on the log's clock, and what brakes (n, 1 = open) were told before it."""
        self._gyro.append(float(m.gyro[2]))
        if m.place is not None:
            row = np.concatenate([m.place.pose, np.sqrt(np.diag(m.place.covariance))])
            self.log.add("place", m.place.time - m.time + t, row)
        if self._count % self.every == 0:
            self.log.add("steer", t, m.steer)
            self.log.add("wheel", t, m.wheel)
            if m.leg.size:
                self.log.add("leg", t, m.leg)
                self.log.add("brake", t, np.zeros(m.leg.size) if brake is None else brake)
            self.log.add("gyro", t, np.mean(self._gyro))
            self._gyro = []
        self._count += 1


class _Phase(NamedTuple):
    """``length`` [s] with the wheels at about ``steer`` (n), rolling ``twist`` (3) with smooth ramps of ``ramp`` [s] at both
    ends (0: standing, the wheels turned to that twist); ``brake`` (n): 1 open, 0 closed."""

    length: float
    steer: np.ndarray
    twist: np.ndarray
    ramp: float
    brake: np.ndarray

    def share(self, t: float) -> float:
        """Speed over full speed at ``t`` [s] of this phase."""
        rise = lambda s: 0.5 - 0.5 * np.cos(np.pi * min(max(s / self.ramp, 0.0), 1.0)) if self.ramp > 0.0 else 0.0
        return float(rise(t) * rise(self.length - t))


def _strokes(geometry: SwerveGeometry, leg: np.ndarray, s: SwerveCalibrateSettings) -> list[tuple[np.ndarray, float]]:
    """Body twists (3) of the strokes, whose fastest wheel has the speed asked for, and their lengths [s] at full speed.

    With closed brakes no drive with these leg angles shows more of the zeros than their sum and their sums weighed with the
    wheels' places (docs/explanation/swerve.md): more directions would only repeat it.
    """
    out = [(np.array([x, y, 0.0]) * s.speed, s.stroke / s.speed) for x, y in STRAIGHT]
    axes = geometry.steer_axes(leg)
    middle = axes.mean(axis=0)
    rate = s.speed / float(np.max(np.linalg.norm(axes - middle, axis=1)))
    turn = rate * np.array([middle[1], -middle[0], 1.0])
    return [*out, (turn, s.turn / rate), (-turn, s.turn / rate)]


def _phases(robot: RobotModel, s: SwerveCalibrateSettings) -> list[_Phase]:
    geometry, home = robot.base.geometry, robot.state.split(robot.home)
    leg, steer = home.get("leg", np.zeros(geometry.modules)), home["steer"]
    part = robot.state["steer"]
    least, most = robot.limits.state_lower[part] + 0.01, robot.limits.state_upper[part] - 0.01
    closed, ramp = np.zeros(geometry.modules), s.speed / ACCELERATION
    phases = [_Phase(s.rest, steer, np.zeros(3), 0.0, closed)]
    opening, strokes = max(OPENING, s.plant.brake_delay + SURE), _strokes(geometry, leg, s)
    legs = np.tile(leg, (len(strokes), 1))
    refuse_directions(robot, np.arange(len(strokes)), np.array([twist for twist, _ in strokes]), legs, 0.0 * legs)
    for k, (twist, length) in enumerate(strokes * s.rounds):
        target, _ = rolling_inverse_kinematics(geometry, leg, steer, twist)
        target = target - np.pi * (target > most) + np.pi * (target < least)
        turning = float(np.abs(target - steer).max()) / STEER_SPEED + 1.0
        steer, brake = target, closed if twist[2] or not s.open_brakes else _opened(geometry, leg, k)
        phases += [
            _Phase(turning + s.pause, steer, twist, 0.0, closed),
            _Phase(opening * float(brake.max()), steer, twist, 0.0, brake),
            _Phase(length + ramp, steer, twist, min(ramp, 0.5 * (length + ramp)), brake),
            _Phase(s.pause, steer, twist, 0.0, closed),
        ]
    return phases


def _opened(geometry: SwerveGeometry, leg: np.ndarray, stroke: int) -> np.ndarray:
    """Brakes (n, 1 = open) of a stroke: all but one, which takes turns and holds the base's yaw. Four open legs in X hardly
    do, and show no more. All closed where there are no brakes, or where the open legs would not hold the base."""
    brake = np.ones(geometry.modules)
    brake[stroke % geometry.modules] = 0.0
    holds = geometry.has_hinge and floating(geometry, leg, brake)[0] >= FLOATING
    return brake * float(holds)


def _rolling(
    geometry: SwerveGeometry, phase: _Phase, t: float, leg: np.ndarray, home: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steering angles and wheel speeds (n) at ``t`` [s] of a phase; legs (n) that swing are led back to their ``home``.

    By the way and not by time: a wheel that leads its leg would otherwise turn far at low speed. Without it the legs would fold
    or spread: a wheel that goes before its hinge swings its leg ever farther.
    """
    swing = LEG_GAIN * float(np.hypot(*phase.twist[:2])) * phase.brake * (home - leg)
    steer, wheel = rolling_inverse_kinematics(geometry, leg, phase.steer, phase.twist, swing)
    return steer, wheel * phase.share(t)


def swerve_robot(name: str) -> RobotModel:
    """The robot of that name or file, which must have a swerve base."""
    robot = load_robot(name)
    if robot.description.base.type != "swerve":
        raise InputError(f"robot: '{name}' has a base of type '{robot.description.base.type}'; valid: swerve")
    return robot


def drive(
    robot: RobotModel,
    settings: SwerveCalibrateSettings,
    seed: int,
    calibration: WheelCalibration | None = None,
    progress: Progress | None = None,
) -> tuple[Log, SwerveController, str]:
    """The reference drive: what was recorded, the agent with its odometry, and why it ended early (empty: it did not)."""
    plant = SwervePlant(
        robot.description, robot.state.split(robot.home), settings.plant, seed,
        localisation=settings.localisation.source(seed),
    )  # fmt: skip
    steps = round(1.0 / settings.control.rate / plant.timestep)
    period, geometry = steps * plant.timestep, robot.base.geometry
    agent = SwerveController(robot, plant.truth().pose, period, calibration=calibration)
    log, phases = Log(), _phases(robot, settings)
    swings = any(p.brake.any() for p in phases)
    wheels, total = WheelLog(log), sum(p.length for p in phases)
    home, arm = robot.state.split(robot.home), np.zeros(len(robot.input.groups["arm"]))
    legs, brake = home.get("leg", np.zeros(geometry.modules)), phases[0].brake
    with watched(plant, period, total, progress, agent) as tick:
        for phase in phases:
            for k in range(round(phase.length / period)):
                m = plant.measure()
                agent.measure(m)
                if agent.monitor is not None:  # open legs give way: nothing is planned for them
                    agent.watch(plant.time, brake, np.zeros(brake.size))
                wheels.add(plant.time, m, brake)
                if len(log.channels) and round(plant.time / period) % 4 == 0:
                    log.add("base", plant.time, plant.truth().pose)
                    log.add("base_odometry", plant.time, agent.odometry.pose)
                    log.add("base_wheels", plant.time, agent.wheels_alone.pose)
                brake = phase.brake
                steer, wheel = _rolling(geometry, phase, k * period, agent.leg if swings else legs, legs)
                turning = np.clip(STEER_GAIN * (steer - agent.steer), -STEER_SPEED, STEER_SPEED)
                command = SwerveCommand(wheel * agent.wheel_scale, turning, arm, brake)
                tick(plant.time, command)
                plant.step(command, steps)
                if plant.fell:
                    return log, agent, f"the robot fell at {plant.time:.2f} s"
    return log, agent, ""


def steer_joints(robot: RobotModel) -> list[str]:
    """The names by which a calibration file knows the modules."""
    return list(robot.state.groups["steer"])


def record_of(log: Log) -> WheelRecord:
    """What a calibration reads of a log."""
    return WheelRecord.of({c: log.array(c) for c in log.channels} | {f"{c}.time": log.times(c) for c in log.channels})


def calibrated(
    robot: RobotModel, how: str, plant: Perturbation, localisation: LocalisationSettings, seed: int
) -> WheelCalibration:
    """What an experiment knows of its wheels: ``how`` is "none", "drive" (a reference drive of this plant first), or a file."""
    geometry = robot.base.geometry
    if how == "none":
        return WheelCalibration.unknown(geometry)
    if how == "drive":
        sound = plant.model_copy(update={"brake_fault": "none"})  # a brake fails in the run, not before it
        log, _, reason = drive(robot, SwerveCalibrateSettings(plant=sound, localisation=localisation), seed)
        if reason:
            raise RunAborted(f"the reference drive for the calibration: {reason}")
        return calibrate(geometry, record_of(log))
    return WheelCalibration.load(how, geometry, steer_joints(robot))


def run(settings: SwerveCalibrateSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """The drive, and what a calibration finds in it; the log is the input of 'wbmpc calibrate'."""
    robot = swerve_robot(settings.robot)
    log, agent, reason = drive(robot, settings, seed, progress=progress)
    metrics: dict[str, Metric] = {}
    try:
        metrics = metrics if reason else _metrics(robot, log)
    except InputError as error:  # the drive is worth keeping
        reason = f"the calibration: {error}"
    return RunResult(
        NAME, seed, not reason, reason, metrics, MpcStatistics.of(1.0, []), log, _plots(log), IDEALISATIONS,
        settings.model_dump(mode="json"), faults=agent.faults,
    )  # fmt: skip


def _metrics(robot: RobotModel, log: Log) -> dict[str, Metric]:
    found = calibrate(robot.base.geometry, record_of(log))
    base, odometry, wheels = (log.array(n) for n in ("base", "base_odometry", "base_wheels"))
    way = float(np.sum(np.hypot(*np.diff(base[:, :2], axis=0).T)))
    return {
        "base_error_rms_world": Metric(
            float(np.sqrt(np.mean(np.sum((odometry - base)[:, :2] ** 2, axis=1)))), "m", goal=0.010
        ),
        "yaw_error_rms_world": Metric(float(np.sqrt(np.mean((odometry - base)[:, 2] ** 2))), "rad"),
        "base_path_length": Metric(way, "m"),
        "odometry_drift_ratio_wheels": Metric(float(np.hypot(*(wheels - base)[-1, :2])) / max(way, 1e-9), "1"),
        "steer_zero_mean": Metric(float(found.steer_zero.mean()), "rad"),
        "steer_zero_mean_std": Metric(float(np.sqrt(found.covariance[: found.modules, : found.modules].mean())), "rad"),
        "wheel_radius_mean": Metric(float(found.wheel_radius.mean()), "m"),
    }


def _plots(log: Log) -> list[Plot]:
    base, odometry, wheels = (log.array(n) for n in ("base", "base_odometry", "base_wheels"))
    place, t = log.array("place"), log.times("base")
    apart = lambda p: 1e3 * np.hypot(*(p - base)[:, :2].T)
    return [
        Plot("Base path", "x [m]", "y [m]", [
            Series("true", base[:, 0], base[:, 1]), Series("global poses", place[:, 0], place[:, 1], dashed=True),
        ], equal_axes=True),
        Plot("Error of the estimated position", "time [s]", "error [mm]", [
            Series("wheels, gyro and global poses", t, apart(odometry)), Series("wheels alone", t, apart(wheels)),
        ]),
    ]  # fmt: skip
