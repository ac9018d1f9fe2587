"""`swerve-fixed`: a swerve base with fixed legs follows base motions; the MPC against controllers without a plan.

Pankert et al. 2022, section V: the authors' reason for an MPC on an ordinary four-wheel-steering base.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import swerve_mpc
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.experiment import Experiment, Loop, Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.driving import LidarPoses, closed_brakes
from wbmpc.studies.pankert2022.fixed_figures import metrics, plots
from wbmpc.studies.pankert2022.fixed_motions import Controller, Motion, SwerveFixedSettings, legs_at_home
from wbmpc.studies.pankert2022.rolling import FourWheelSteeringController, RollingController, RollingGains
from wbmpc.studies.pankert2022.side_slip import FlipController
from wbmpc.studies.pankert2022.standing import stand_still
from wbmpc.studies.pankert2022.wheel_flip import WheelFlipGuess, fast_enough
from wbmpc.studies.pankert2022.wheel_log import swerve_robot
from wbmpc.types import Timing

NAME = "swerve-fixed"
SUMMARY = "base motions of a swerve base with fixed legs: MPC against inverse kinematics and four-wheel steering"

IDEALIZATIONS = [
    "the contact points lie under the steer axes; tires are soft contacts, not a tire model",
    "the computation of the MPC and of the baselines takes a constant 10 ms",
    "baselines know the reference ahead of time too: they turn their wheels before they start",
]

Make = Callable[[RobotModel, np.ndarray, float, SwerveFixedSettings, Motion, EstimatorSettings], SwerveController]


def _mpc_controller(
    r: RobotModel, pose: np.ndarray, period: float, s: SwerveFixedSettings, _: Motion, known: EstimatorSettings
) -> SwerveController:
    kind = FlipController if fast_enough(r) else SwerveController
    return kind(r, pose, period, tracking=TrackingSettings(lag=s.actuator_time_constant), estimation=known)


def goals(
    motion: Motion, t: float, legs: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Base pose and its rate in world axes; ``legs`` (n) [rad] stay as they are."""
    pose, twist = motion.path.pose(t), motion.path.twist(t)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return (pose, np.array([c * twist[0] - s * twist[1], s * twist[0] + c * twist[1], twist[2]])), (legs, 0.0 * legs)


def baseline(kind: type[RollingController], name: Controller) -> Make:
    """A maker of a baseline's controller, with the gains of the settings."""

    def make(
        r: RobotModel, pose: np.ndarray, period: float, s: SwerveFixedSettings, p: Motion, known: EstimatorSettings
    ) -> SwerveController:
        aims = lambda t: goals(p, t, legs_at_home(r))
        gains = RollingGains(**getattr(s, name).model_dump(exclude={"kind"}), delay=s.mpc.computation_delay)
        return kind(r, pose, period, aims, gains, estimation=known)

    return make


CONTROLLERS: dict[Controller, Make] = {
    "mpc": _mpc_controller,
    "ik": baseline(RollingController, "ik"),
    "four_wheel": baseline(FourWheelSteeringController, "four_wheel"),
}


def build(settings: SwerveFixedSettings, seed: int) -> Scenario:
    """All controllers on the same reference and the same plant."""
    robot, log = swerve_robot(settings.robot), Log()
    reference = Motion.of(settings, seed)
    turns = fast_enough(robot)  # else the base stops for wheels that have to turn about
    guess = (WheelFlipGuess if turns else SteeringGuess)(robot, lambda t, _: reference.path.twist(t))
    mpc = swerve_mpc(robot, settings.mpc, settings.cost, guess, allow_side_slip=turns)
    reference.set(mpc, robot)
    mpc.reset(robot.home)
    known = settings.estimation(robot, seed)
    drives = {
        n: partial(drive, n, settings, seed, robot, reference, known, mpc if n == "mpc" else None, log)
        for n in settings.controllers
    }
    return Scenario(
        log, [Part(name, run, baseline="mpc" in drives and name != "mpc") for name, run in drives.items()],
        lambda run: metrics(log, reference, drives, run, isinstance(settings.localization, LidarPoses)), lambda run: plots(log, reference, drives),
        IDEALIZATIONS, compared=True,
    )  # fmt: skip


def drive(
    name: Controller,
    settings: SwerveFixedSettings,
    seed: int,
    robot: RobotModel,
    reference: Motion,
    known: EstimatorSettings,
    mpc: MPC | None,
    log: Log,
    progress: Progress | None = None,
) -> Outcome:
    """One controller over the whole reference; logs its poses as ``base_NAME`` and ``odometry_NAME``."""
    plant = SwervePlant(
        robot.description, robot.state.split(robot.home), settings.plant, seed, localization=settings.global_poses(seed)
    )
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.computation_delay)
    controller = CONTROLLERS[name](robot, plant.truth().pose, timing.period, settings, reference, known)
    if mpc is not None:
        controller.supervision.report = closed_brakes(robot, mpc)
    stand_still(plant, controller, timing, settings.settle_time)

    joints = robot.description.base.joint_groups()
    for part, group, unit in (("slip", "wheel", "m/s"), ("wheel", "wheel", "rad/s"), ("steer", "steer", "rad")):
        log.label(f"{part}_{name}", joints[group], unit)

    def record(t: float, command: Any, plans: Any) -> None:
        if round(t / timing.period) % 4:
            return
        truth = plant.truth()
        log.add(f"base_{name}", t, truth.pose)
        log.add(f"odometry_{name}", t, controller.estimator.odometry.pose)
        log.add(f"slip_{name}", t, truth.slip)
        log.add(f"wheel_{name}", t, command.wheel)
        log.add(f"steer_{name}", t, controller.measured.steer if controller.measured is not None else command.steer)

    return Loop(plant, controller, mpc, timing, float(reference.path.times[-1]), record).run(progress)


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveFixedSettings, build, DEFINITIONS[NAME])
