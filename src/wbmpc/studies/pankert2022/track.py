"""`swerve-track`: the hand follows a long sine while the base drives (Pankert et al. 2022, section IV-C, Fig. 9)."""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from wbmpc import lie
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import HandCost, SwerveCost, closed_brakes, swerve_mpc
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.estimation.wheel_odometry import ReleaseOdometry
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot, RunResult, Series
from wbmpc.settings import ExperimentSettings, LocalisationSettings, finished
from wbmpc.simulation.lockstep import Progress, Timing, run_lockstep
from wbmpc.studies.pankert2022.calibrate import WheelLog, calibrated, swerve_robot
from wbmpc.studies.paths import Approach, SinePath, nearest_distance
from wbmpc.types import SwerveCommand

NAME = "swerve-track"
SUMMARY = "the hand follows a 20.53 m sine while the swerve base drives (Pankert et al. 2022, Fig. 9)"

IDEALISATIONS = [
    "the rolling rows have a compliance of 1e-6: a plan may slip by about 1e-6 m/s",
    "the contact points lie under the steer axes; tyres are soft contacts, not a tyre model",
    "the arm's joints are velocity servos; the weight that is fed forward is that of the simulated arm",
    "encoders of one message are synchronous (the message as a whole is up to 2 ms old)",
    "the wheels are calibrated with a reference drive with independent normal noise of its poses and hinges that turn freely",
    "the computation takes a constant 10 ms; the arm's encoder offsets are not calibrated",
]


class SwerveTrackSettings(ExperimentSettings):
    """``periods`` of the sine (6 periods are the paper's 15.96 m), its ``amplitude`` [m] and ``variant`` (``vertical``: upright;
    ``peaks``: horizontal, with peaks 30 mm out of reach of an arm whose base stays on its line, instead of the amplitude, which
    is refused; ``localisation`` is refused where neither a reference drive nor the run has it); ``speed`` along it [m/s]
    (a hand that is elsewhere at home comes to its start first); ``use_gyro``, whose bias shows over ``rest`` [s] of
    standing (0: it shows under way, and the pose is corrected late); ``calibration`` of the wheels: drive (a reference drive with
    ``localisation`` first), none, or a file that 'wbmpc calibrate' wrote; ``global_poses``: whether the run itself has the
    ``localisation``; ``drive_lag`` [s] that the controller assumes; ``friction``, ``smoothing``: see
    :class:`wbmpc.bases.swerve.controller.SwerveController`."""

    cost: SwerveCost = SwerveCost(hand=HandCost(weight=4000.0))
    robot: str = "swerve-ur10"
    variant: Literal["horizontal", "vertical", "peaks"] = "horizontal"
    periods: int = Field(6, ge=1, le=20)
    speed: float = Field(0.255, ge=0.01, le=0.8)
    amplitude: float = Field(0.498, gt=0, le=0.6)
    use_gyro: bool = True
    calibration: str = "drive"
    global_poses: bool = False
    localisation: LocalisationSettings = LocalisationSettings()
    friction: bool = True
    smoothing: float = Field(0.025, ge=0, le=1)
    rest: float = Field(20.0, ge=0, le=120)
    drive_lag: float = Field(0.020, ge=0, le=0.5)

    @model_validator(mode="after")
    def _read(self) -> Self:
        """What the chosen variant, or a run without global poses, does not read is refused."""
        if self.variant == "peaks":
            self.refuse_unread("with variant=peaks", "amplitude")
        if not self.global_poses and self.calibration != "drive":
            self.refuse_unread("without global_poses or calibration=drive", "localisation")
        return self


#: Groups of joints whose speeds are logged and drawn against their limits.
SPEEDS = ("leg", "steer", "wheel", "arm")
#: A drift over a shorter way [m] says nothing.
LEAST_WAY = 0.1
#: Length of one period [m] (15.96 m for six) and heights, offsets of the hand's path [m].
PERIOD_LENGTH, HEIGHT, SIDE, AHEAD = 15.96 / 6, 0.80, 0.65, 0.30
#: How far [m] to the left of its base the UR10's tool comes at that height and so far ahead, pointing to the left; how far
#: beyond that the peaks of the variant of that name are.
REACH, BEYOND = 1.248, 0.030


class _References:
    """Hand and base paths over time. The hand first comes from where it is at the robot's home to the path's start."""

    def __init__(self, settings: SwerveTrackSettings, robot: RobotModel) -> None:
        s = settings
        amplitude = REACH + BEYOND - SIDE if s.variant == "peaks" else s.amplitude
        self.vertical = s.variant == "vertical"
        self.approach = Approach(robot.pose(robot.home), (np.array([AHEAD, SIDE, HEIGHT]), HAND_ORIENTATION))
        begin = self.approach.duration + 0.5
        self.path = SinePath(amplitude, PERIOD_LENGTH * s.periods, s.periods, s.speed, start=begin, ramp=2.0)
        self.duration = float(np.ceil((self.path.end + 0.5) * 10.0) / 10.0)

    @property
    def counted(self) -> float:
        """From when on errors count [s]: 2 s after the approach."""
        return self.approach.duration + 2.0

    def hand(self, t: np.ndarray) -> np.ndarray:
        """Positions (n, 3) [m] of the hand's reference at times t (n,) [s]."""
        along, across = self.path.point(t)
        return self._place(along, across) + self.approach.offset(t)[0]

    def orientation(self, t: np.ndarray) -> np.ndarray:
        """Quaternions (n, 4) of the hand's reference at times t (n,) [s]."""
        return self.approach.offset(t)[1]

    def _place(self, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        side, up = (0.0 * across, across) if self.vertical else (across, 0.0 * across)
        return np.stack([along + AHEAD, SIDE + side, HEIGHT + up], axis=1)

    def curve(self) -> np.ndarray:
        return self._place(*self.path.curve())

    def base(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position along x [m] and speed [m/s]: the sine's mean line, as fast as the arc goes."""
        s, rate = self.path.arc(t)
        share = self.path.length / self.path.arc_length
        return s * share, rate * share

    def set(self, mpc: MPC, home: np.ndarray, lift: float = 0.0) -> None:
        """``lift`` [m]: by what the hand goes higher over the model's base than over the floor."""
        robot_state, robot_input = mpc.ocp.dynamics.state, mpc.ocp.dynamics.input
        t = np.arange(0.0, self.duration + 0.02, 0.02)
        mpc.reference["hand"] = Reference.poses(t, self.hand(t) + [0.0, 0.0, lift], self.orientation(t))
        x, speed = self.base(t)
        states = np.tile(home, (t.size, 1))
        states[:, robot_state["base"]] = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
        mpc.reference["state"] = Reference(t, states)
        inputs = np.zeros((t.size, robot_input.size))
        inputs[:, robot_input["base"].start] = speed
        mpc.reference["input"] = Reference(t, inputs)


#: The tool's axis points to the left of the base.
HAND_ROTATION = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
HAND_ORIENTATION = lie.rotation_to_quaternion(HAND_ROTATION)


def run(settings: SwerveTrackSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """One run; docs/reference/metrics.md says what each metric means."""
    robot = swerve_robot(settings.robot)
    references = _References(settings, robot)
    mpc = swerve_mpc(robot, settings.mpc, settings.cost)
    source = settings.localisation.source(seed) if settings.global_poses else None
    plant = SwervePlant(robot.description, robot.state.split(robot.home), settings.plant, seed, localisation=source)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.delay)
    # after everything that refuses bad settings at once
    calibration = calibrated(robot, settings.calibration, settings.plant, settings.localisation, seed)
    pose0 = plant.truth().pose
    agent = SwerveController(
        robot,
        pose0,
        timing.period,
        lag=settings.drive_lag,
        calibration=calibration,
        use_gyro=settings.use_gyro,
        faulty=closed_brakes(robot, mpc),
        friction=settings.friction,
        smoothing=settings.smoothing,
    )
    # the model's base has one height: what the true one lacks of it, the hand makes up for
    references.set(mpc, robot.home, -calibration.rise(robot.base.geometry))
    stand_still(plant, agent, timing, settings.rest)
    release = ReleaseOdometry(robot.base.geometry, pose0, timing.period)
    mpc.reset(robot.home)
    log = Log()
    wheels, driven = WheelLog(log), [n for g in SPEEDS for n in robot.input.groups.get(g, ())]

    def record(t: float, command: Any, plans: Any) -> None:
        m = agent.measured
        assert m is not None
        release.update(m.leg, m.steer, m.wheel)
        wheels.add(t, m)
        if round(t / timing.period) % 4:
            return
        truth = plant.truth()
        pose = agent.pose
        log.add("base", t, truth.pose)
        log.add("base_odometry", t, pose)
        log.add("base_std", t, np.sqrt(np.diag(agent.odometry.covariance)))
        log.add("base_wheels", t, agent.wheels_alone.pose)
        log.add("base_release", t, release.pose)
        log.add("hand", t, truth.tool)
        log.add("hand_odometry", t, in_frame(pose, truth.tool_in_base, truth.tool[2]))
        wanted = lie.quaternion_to_rotation(references.orientation(np.array([t]))[0])
        log.add("hand_rotation", t, lie.rotation_angle(_turn(pose[2]) @ truth.tool_rotation_in_base, wanted))
        log.add("hand_reference", t, references.hand(np.array([t]))[0])
        log.add("input", t, plans.current.feedforward(t))
        log.add("wheel_command", t, command.wheel)
        log.add("arm", t, m.arm)
        log.add("wheel_slip", t, truth.slip)
        log.add("joint_speed", t, [truth.joint_speeds[n] for n in driven])

    ending = run_lockstep(plant, agent, mpc, timing, references.duration, record, progress)
    return finished(
        NAME, seed, settings, ending, mpc, log,
        metrics=lambda: _metrics(log, references), plots=lambda: _plots(log, robot, mpc, references),
        idealisations=IDEALISATIONS, faults=agent.faults,
    )  # fmt: skip


def stand_still(plant: SwervePlant, agent: SwerveController, timing: Timing, seconds: float) -> None:
    """Let the robot stand with closed brakes while the gyro shows its bias; ends before the run's time 0."""
    for _ in range(round(seconds / timing.period)):
        agent.measure(plant.measure())
        plant.step(
            SwerveCommand.stop(len(agent.robot.base.geometry.hinge), len(agent.robot.input.groups["arm"])), timing.steps
        )


def _turn(yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def in_frame(pose: np.ndarray, tool_in_base: np.ndarray, height: float) -> np.ndarray:
    """The hand in the estimated frame: estimated base pose, true forward kinematics."""
    placed = _turn(pose[2]) @ tool_in_base
    return np.array([pose[0] + placed[0], pose[1] + placed[1], height])


def _metrics(log: Log, references: _References) -> dict[str, Metric]:
    t = log.times("hand")
    use = t >= references.counted
    reference = log.array("hand_reference")
    estimated = np.linalg.norm(log.array("hand_odometry") - reference, axis=1)
    world = np.linalg.norm(log.array("hand") - reference, axis=1)
    if not use.any():  # the run ended before anything counts
        estimated, world = (np.full(t.size, np.nan) for _ in range(2))
        use[-1] = True
    nearest = nearest_distance(log.array("hand_odometry")[use], references.curve())
    names = ("base", "base_odometry", "base_wheels", "base_release")
    base, odometry, wheels, release = (log.array(n) for n in names)
    travelled = float(np.sum(np.hypot(*np.diff(base[:, :2], axis=0).T)))
    moved = travelled if travelled > LEAST_WAY else float("nan")
    drift = lambda pose: float(np.hypot(*(pose - base)[-1, :2])) / moved
    hand_travel = float(np.sum(np.linalg.norm(np.diff(reference, axis=0), axis=1)))
    return {
        "hand_error_mean_odometry": Metric(float(estimated[use].mean()), "m", paper=0.0167, goal=0.002),
        "hand_error_max_odometry": Metric(float(estimated[use].max()), "m"),
        "hand_error_mean_nearest": Metric(float(nearest.mean()), "m", paper=0.0167),
        "hand_error_mean_world": Metric(float(world[use].mean()), "m", goal=0.020),
        "hand_orientation_error_max": Metric(float(log.array("hand_rotation")[use].max()), "rad"),
        "path_length": Metric(
            hand_travel, "m", paper=20.53 if abs(references.path.arc_length - 20.53) < 0.01 else None
        ),
        "base_path_length": Metric(travelled, "m", paper=15.96 if abs(references.path.length - 15.96) < 0.01 else None),
        "base_error_rms_world": Metric(float(np.sqrt(np.mean(np.sum((odometry - base)[:, :2] ** 2, axis=1)))), "m"),
        "odometry_drift_ratio": Metric(drift(odometry), "1", paper=0.161 / 15.96, goal=0.003),
        "odometry_drift_ratio_wheels": Metric(drift(wheels), "1", paper=0.161 / 15.96),
        "odometry_drift_ratio_release": Metric(drift(release), "1"),
        "wheel_slip_max": Metric(float(log.array("wheel_slip")[use].max()), "m/s"),
    }


def _speed_ratios(log: Log, robot: RobotModel) -> list[Series]:
    """By group of joints the largest true speed over its limit."""
    t, speed = log.times("joint_speed"), np.abs(log.array("joint_speed"))
    series, start = [], 0
    for group in (g for g in SPEEDS if g in robot.input):
        limit = robot.limits.input_upper[robot.input[group]]
        series.append(Series(group, t, (speed[:, start : start + limit.size] / limit).max(axis=1)))
        start += limit.size
    return series


def _plots(log: Log, robot: Any, mpc: MPC, references: _References) -> list[Plot]:
    t, hand, reference = log.times("hand"), log.array("hand"), log.array("hand_reference")
    estimated, base, odometry = log.array("hand_odometry"), log.array("base"), log.array("base_odometry")
    curve = references.curve()[::40]
    axis, name = (2, "z [m]") if references.vertical else (1, "y [m]")
    solve = 1e3 * np.array(mpc.statistics.solve_times)
    error = lambda p: 1e3 * np.linalg.norm(p - reference, axis=1)
    return [
        Plot("Hand path and its reference", "x [m]", name, [
            Series("reference", curve[:, 0], curve[:, axis], dashed=True),
            Series("hand, estimated frame", estimated[:, 0], estimated[:, axis]),
            Series("hand, world", hand[:, 0], hand[:, axis]),
        ], equal_axes=True),
        Plot("Hand error", "time [s]", "error [mm]", [
            Series("estimated frame", t, error(estimated)), Series("world", t, error(hand)),
        ]),
        Plot("Base path", "x [m]", "y [m]", [
            Series("true", base[:, 0], base[:, 1]), Series("odometry", odometry[:, 0], odometry[:, 1], dashed=True),
        ], equal_axes=True),
        Plot("Joint speeds over their limits", "time [s]", "largest |speed| / limit", _speed_ratios(log, robot)),
        Plot("Solve times", "MPC update", "time [ms]", [Series("solve", np.arange(solve.size), solve)]),
    ]  # fmt: skip
