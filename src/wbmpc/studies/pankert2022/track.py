"""`swerve-track`: the end effector follows a long sine while the base drives (Pankert et al. 2022, section IV-C, Fig. 9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.bases.base import System
from wbmpc.bases.swerve.brake_supervision import SupervisionSettings
from wbmpc.bases.swerve.defaults import swerve_mpc
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.experiment import Experiment, Loop, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.driving import closed_brakes
from wbmpc.studies.pankert2022.metrics import in_frame, rotation_about_z
from wbmpc.studies.pankert2022.release_odometry import ReleaseOdometry
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.studies.pankert2022.track_control import TrackController, TrackEstimation, TrackTracking
from wbmpc.studies.pankert2022.track_figures import SPEEDS, metrics, plots
from wbmpc.studies.pankert2022.track_references import SwerveTrackSettings, TrackReferences
from wbmpc.studies.pankert2022.wheel_log import WheelLog, swerve_robot
from wbmpc.tasks.joint_figures import JointRecord
from wbmpc.types import Timing
from wbmpc.units import rate_unit

NAME = "swerve-track"
#: One row of the log for so many ticks.
ROWS = 4
SUMMARY = "the end effector follows a 20.53 m sine while the swerve base drives (Pankert et al. 2022, Fig. 9)"

IDEALIZATIONS = [
    "the rolling rows have a softness of 1e-6: a plan may slip by about 1e-6 m/s",
    "the contact points lie under the steer axes; tires are soft contacts, not a tire model",
    "the arm's joints are velocity servos; the weight that is fed forward is that of the simulated arm",
    "encoders of one message are synchronous (the message as a whole is up to 2 ms old)",
    "the wheels are calibrated with a reference drive with independent normal noise of its poses and hinges that turn freely",
    "the computation takes a constant 10 ms; the arm's encoder offsets are not calibrated",
]


def _label(log: Log, robot: RobotModel, driven: Sequence[str]) -> WheelLog:
    """Names of what is recorded; the part of the log that is of the wheels."""
    wheels, state, inputs = robot.description.base.joint_groups()["wheel"], robot.state, robot.input
    for channel, names, units in (
        ("state", state.names, state.units), ("input", inputs.names, inputs.units),
        ("arm", state.groups["arm"], state.unit_groups["arm"]), ("drive_speed", driven, [rate_unit(u) for u in robot.tree.units(driven)]),
        ("wheel_command", wheels, "rad/s"), ("wheel_slip", wheels, "m/s"),
    ):  # fmt: skip
        log.label(channel, names, units)
    return WheelLog(log, robot)


def build(settings: SwerveTrackSettings, seed: int) -> Scenario:
    """One run; docs/reference/metrics.md says what each metric means."""
    robot = swerve_robot(settings.robot)
    references = TrackReferences(settings, robot)
    mpc = swerve_mpc(robot, settings.mpc, settings.cost)
    plant = SwervePlant(
        robot.description, robot.state.split(robot.home), settings.plant, seed, localization=settings.global_poses(seed)
    )
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.computation_delay)
    # after everything that rejects bad settings at once
    estimation = TrackEstimation(**vars(settings.estimation(robot, seed)), smoothing=settings.smoothing)
    pose0 = plant.truth().pose
    controller = TrackController(
        robot, pose0, timing.period, tracking=TrackTracking(lag=settings.actuator_time_constant, friction=settings.friction),
        estimation=estimation, supervision=SupervisionSettings(report=closed_brakes(robot, mpc)),
    )  # fmt: skip
    # the model's base has one height: what the true one lacks of it, the end effector makes up for
    references.set(mpc, robot.home, -controller.estimator.calibration.rise(swerve_base(robot).geometry))
    stand_still(plant, controller, timing, settings.settle_time)
    release = ReleaseOdometry(swerve_base(robot).geometry, pose0, timing.period)
    mpc.reset(robot.home)
    log = Log()
    every = timing.period * np.arange(round(references.duration / timing.period))
    positions, turns = references.pose(every[::ROWS])
    driven = [n for g in SPEEDS for n in robot.input.groups.get(g, ())]
    wheels, joints = _label(log, robot, driven), JointRecord(log, robot, System(plant, controller, mpc, timing))

    def record(t: float, command: Any, plans: Any) -> None:
        m = controller.measured
        assert m is not None
        release.update(m.leg, m.steer, m.wheel)
        wheels.add(t, m)
        k, left = divmod(round(t / timing.period), ROWS)
        if left:
            return
        truth = plant.truth()
        pose = controller.pose
        log.add("base", t, truth.pose)
        log.add("state", t, truth.state)
        log.add("base_odometry", t, pose)
        log.add("base_std", t, np.sqrt(np.diag(controller.estimator.odometry.covariance)))
        log.add("base_wheels", t, controller.estimator.wheels_alone.pose)
        log.add("base_release", t, release.pose)
        log.add("hand", t, truth.tool)
        log.add("hand_odometry", t, in_frame(pose, truth.tool_in_base, truth.tool[2]))
        target = lie.quaternion_to_rotation(turns[k])
        log.add("hand_rotation", t, lie.rotation_angle(rotation_about_z(pose[2]) @ truth.tool_rotation_in_base, target))
        log.add("hand_rotation_world", t, lie.rotation_angle(truth.tool_rotation, target))
        log.add("hand_reference", t, positions[k])
        log.add("input", t, plans.current.feedforward(t))
        log.add("wheel_command", t, command.wheel)
        log.add("arm", t, m.arm)
        log.add("wheel_slip", t, truth.slip)
        log.add("drive_speed", t, [truth.joint_speeds[n] for n in driven])
        joints.tick(t, truth, plans)

    loop = Loop(plant, controller, mpc, timing, references.duration, record)
    return Scenario.single(
        log,
        loop.run,
        lambda run: metrics(log, references),
        lambda run: [*plots(log, robot, references), *joints.plots()],
        IDEALIZATIONS,
    )


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveTrackSettings, build, DEFINITIONS[NAME])
