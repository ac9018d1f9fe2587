"""A reference drive with global poses, from which the wheels are calibrated.

No MPC: between strokes the base stands and the wheels turn to the next direction, then they roll. On hinged legs the straight
strokes go with open brakes: the legs give way to wheels that point beside their way, and their encoders show it.

What is left of zeros and radii falls with the length of the strokes and the root of their number. Defaults are of the order of the ten
rounds of a 4 m square in Borenstein and Feng, "Measurement and Correction of Systematic Odometry Errors in Mobile Robots", IEEE
Transactions on Robotics and Automation 12 (1996).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import Field

from wbmpc.bases.swerve.brake_control import FLOATING, floating
from wbmpc.bases.swerve.calibration import fit_wheels
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.perturbation import SoundBrakes, SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.rolling import Rolling
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.errors import RunAborted
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import ModuleGeometry, rolling_inverse_kinematics
from wbmpc.settings import ControlSettings, Robot, Settings
from wbmpc.simulation import tracked_arm
from wbmpc.simulation.kept_calibration import kept
from wbmpc.simulation.lockstep import Progress, preparation, watched
from wbmpc.simulation.settings import LidarSettings
from wbmpc.studies.pankert2022.directions import reject_directions
from wbmpc.studies.pankert2022.standing import hold_arm
from wbmpc.studies.pankert2022.wheel_log import WheelLog, record_of


class SwerveCalibrateSettings(Settings):
    """``speed`` [m/s] of the fastest wheel; ``stroke`` [m] of the straight parts; ``turn`` [rad] to the left, then right;
    ``pause`` [s] of standing before and after each; ``rounds`` of the whole; ``settle_time`` [s] before the first;
    ``lidar``: the source of the poses; ``tracked_poses`` of the arm
    at which its end effector is tracked after the drive;
    ``open_brakes``: whether straight parts go with open brakes, where there are brakes and open legs hold the base; ``toe`` [rad]:
    by which one wheel of four on closed brakes is steered off its direction on straight parts, another one each time: how far the
    base follows it shows which wheels carry the base."""

    robot: Robot = "swerve-ur10"
    speed: float = Field(0.4, ge=0.02, le=0.8)
    stroke: float = Field(4.0, gt=0, le=20)
    turn: float = Field(np.pi, gt=0, le=7)
    pause: float = Field(0.5, ge=0, le=60)
    rounds: int = Field(4, ge=1, le=20)
    settle_time: float = Field(5.0, ge=0, le=120)
    open_brakes: bool = True
    toe: float = Field(0.006, ge=0, le=0.02)
    lidar: LidarSettings = LidarSettings()
    tracked_poses: int = Field(0, ge=0, le=1000)
    control: ControlSettings = ControlSettings()
    plant: SwervePerturbation = SwervePerturbation()


#: Directions of the straight strokes, in the body.
STRAIGHT = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
#: Largest steering speed [rad/s], gain of its servo [1/s], mean acceleration [m/s²].
STEER_SPEED, STEER_GAIN, ACCELERATION = 2.0, 5.0, 0.4
#: Open legs are led back by this share of their deviation for each meter on the way [1/m]; standing before that [s], and at
#: least so long after brakes have opened.
LEG_GAIN, OPENING, SURE = 2.0, 0.4, 0.3


class _Phase(NamedTuple):
    """``length`` [s] with the wheels at about ``steer`` (n), rolling ``twist`` (3) with smooth ramps of ``ramp`` [s] at both
    ends (0: standing, the wheels turned to that twist); ``brake`` (n): 1 open, 0 closed; ``toe`` (n) [rad]: how far wheels are
    steered off that."""

    length: float
    steer: np.ndarray
    twist: np.ndarray
    ramp: float
    brake: np.ndarray
    toe: np.ndarray

    def share(self, t: float) -> float:
        """Speed over full speed at ``t`` [s] of this phase."""
        rise = lambda s: 0.5 - 0.5 * np.cos(np.pi * min(max(s / self.ramp, 0.0), 1.0)) if self.ramp > 0.0 else 0.0
        return float(rise(t) * rise(self.length - t))


def _strokes(geometry: ModuleGeometry, leg: np.ndarray, s: SwerveCalibrateSettings) -> list[tuple[np.ndarray, float]]:
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
    geometry, home = swerve_base(robot).geometry, robot.state.split(robot.home)
    leg, steer = home.get("leg", np.zeros(geometry.modules)), home["steer"]
    part = robot.state["steer"]
    minimum, maximum = robot.limits.state_lower[part] + 0.01, robot.limits.state_upper[part] - 0.01
    closed, ramp = np.zeros(geometry.modules), s.speed / ACCELERATION
    phases = [_Phase(s.settle_time, steer, np.zeros(3), 0.0, closed, closed)]
    opening, strokes = max(OPENING, s.plant.brake_delay + SURE), _strokes(geometry, leg, s)
    legs = np.tile(leg, (len(strokes), 1))
    reject_directions(robot, np.arange(len(strokes)), np.array([twist for twist, _ in strokes]), legs, 0.0 * legs)
    for k, (twist, length) in enumerate(strokes * s.rounds):
        target, _ = rolling_inverse_kinematics(geometry, leg, steer, twist)
        target = target - np.pi * (target > maximum) + np.pi * (target < minimum)
        turning = float(np.abs(target - steer).max()) / STEER_SPEED + 1.0
        steer, brake = target, closed if twist[2] or not s.open_brakes else _opened(geometry, leg, k)
        toe = np.zeros(geometry.modules)
        if geometry.modules == 4 and not twist[2] and not brake.any():
            # another wheel on each of the four straight strokes, and on each of them another one in the next round
            wheel = (k + k // len(strokes)) % 4
            toe[wheel] = s.toe if 2.0 * steer[wheel] < minimum[wheel] + maximum[wheel] else -s.toe
        phases += [
            _Phase(turning + s.pause, steer, twist, 0.0, closed, toe),
            _Phase(opening * float(brake.max()), steer, twist, 0.0, brake, toe),
            _Phase(length + ramp, steer, twist, min(ramp, 0.5 * (length + ramp)), brake, toe),
            _Phase(s.pause, steer, twist, 0.0, closed, toe),
        ]
    return phases


def _opened(geometry: ModuleGeometry, leg: np.ndarray, stroke: int) -> np.ndarray:
    """Brakes (n, 1 = open) of a stroke: all but one, which takes turns and holds the base's yaw. Four open legs in X hardly
    do, and show no more. All closed where there are no brakes, or where the open legs would not hold the base."""
    brake = np.ones(geometry.modules)
    brake[stroke % geometry.modules] = 0.0
    holds = geometry.legs_move and floating(geometry, leg, brake)[0] >= FLOATING
    return brake * float(holds)


def _rolled(
    rolling: Rolling, phase: _Phase, t: float, leg: np.ndarray, home: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steering angles and wheel speeds (n) at ``t`` [s] of a phase; legs (n) that swing are led back to their ``home``.

    By the way and not by time: a wheel that leads its leg would otherwise turn far at low speed. Without it the legs would fold
    or spread: a wheel that goes before its hinge swings its leg ever farther.
    """
    swing = LEG_GAIN * float(np.hypot(*phase.twist[:2])) * phase.brake * (home - leg)
    steer, wheel = rolling(leg, phase.steer, phase.twist, swing)
    return steer, wheel * phase.share(t)


def drive(
    robot: RobotModel,
    settings: SwerveCalibrateSettings,
    seed: int,
    log: Log,
    progress: Progress | None = None,
    *,
    odometry: bool = True,
) -> tuple[SwerveController, SwervePlant, str]:
    """The reference drive, recorded in ``log``: the controller with its odometry, the simulated robot, and why it ended early (empty: it
    did not). Without ``odometry`` only what a calibration reads is recorded: the drive does not depend on the rest."""
    plant = SwervePlant(
        robot.description, robot.state.split(robot.home), settings.plant, seed,
        localization=settings.lidar.source(seed),
    )  # fmt: skip
    steps = round(1.0 / settings.control.rate / plant.timestep)
    period, geometry = steps * plant.timestep, swerve_base(robot).geometry
    rolling = Rolling(geometry)
    controller = SwerveController(robot, plant.truth().pose, period)
    phases = _phases(robot, settings)
    swings = any(p.brake.any() for p in phases)
    wheels, total = WheelLog(log, robot), sum(p.length for p in phases)
    home, held = robot.state.split(robot.home), plant.measure().arm
    legs, brake = home.get("leg", np.zeros(geometry.modules)), phases[0].brake
    with watched(plant, period, total, progress, controller) as tick:
        for phase in phases:
            for k in range(round(phase.length / period)):
                m = plant.measure()
                if odometry:
                    controller.measure(m)
                    # open legs give way: nothing is planned for them
                    controller.watch(plant.time, brake, np.zeros(brake.size))
                wheels.add(plant.time, m, brake)
                if odometry and len(log.channels) and round(plant.time / period) % 4 == 0:
                    log.add("base", plant.time, plant.truth().pose)
                    log.add("base_odometry", plant.time, controller.estimator.odometry.pose)
                    log.add("base_wheels", plant.time, controller.estimator.wheels_alone.pose)
                brake = phase.brake
                steer, wheel = _rolled(rolling, phase, k * period, m.leg if swings else legs, legs)
                turning = np.clip(STEER_GAIN * (steer + phase.toe - m.steer), -STEER_SPEED, STEER_SPEED)
                command = SwerveCommand(wheel * controller.wheel_scale, turning, hold_arm(held, m.arm), brake)
                tick(plant.time, command)
                plant.step(command, steps)
                if plant.fell:
                    return controller, plant, f"the robot fell at {plant.time:.2f} s"
    return controller, plant, ""


def track_arm(robot: RobotModel, settings: SwervePerturbation, poses: int, seed: int, log: Log) -> None:
    """Record ``poses`` of the arm at rest: its encoders, and where a tracker sees its end effector in axes of the base."""
    plant = SwervePlant(robot.description, robot.state.split(robot.home), settings, seed, settle=0.0)
    read, seen = tracked_arm.track_arm(robot, plant, poses, seed)
    for k, (angles, place) in enumerate(zip(read, seen[robot.tool], strict=True)):
        log.add("tracked", float(k), np.concatenate([angles, place, [tracked_arm.TRACKER]]))


def _driven(robot: RobotModel, settings: SwerveCalibrateSettings, seed: int) -> WheelCalibration:
    """The calibration from a reference drive; :class:`RunAborted` for a drive that did not come to its end."""
    log = Log()
    *_, reason = drive(robot, settings, seed, log, preparation(), odometry=False)
    if reason:
        raise RunAborted(f"the reference drive for the calibration: {reason}")
    return fit_wheels(swerve_base(robot).geometry, record_of(log)).calibration


def calibrated(robot: RobotModel, plant: SwervePerturbation, lidar: LidarSettings, seed: int) -> WheelCalibration:
    """What a reference drive of this plant shows of its wheels."""
    sound = plant.model_copy(update={"brake_fault": SoundBrakes()})  # a brake fails in the run, not before it
    settings = SwerveCalibrateSettings(plant=sound, lidar=lidar)
    return WheelCalibration(**kept(robot, settings, seed, lambda: vars(_driven(robot, settings, seed))))
