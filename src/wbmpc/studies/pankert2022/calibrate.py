"""`swerve-calibrate`: a reference drive with global poses, from which the wheels are calibrated."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.swerve.calibration import WheelFit, fit_wheels
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Outcome, Scenario
from wbmpc.log import Log
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.lockstep import Ending, Progress
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.metrics import rms, traveled
from wbmpc.studies.pankert2022.reference_drive import SwerveCalibrateSettings, drive, track_arm
from wbmpc.studies.pankert2022.wheel_log import record_of, swerve_robot

NAME = "swerve-calibrate"
SUMMARY = "a reference drive with global poses, for 'wbmpc calibrate' (steer zeros and wheel radii)"

IDEALIZATIONS = [
    "global poses have independent normal noise; a real localization has errors that last as well",
    "the robot may drive about 4 m in each direction",
    "open hinges turn freely: one that sticks looks like a wheel that points where it should",
    "the floor is flat: the wheels that carry a rigid base in the drive do so later",
]


def build(settings: SwerveCalibrateSettings, seed: int) -> Scenario:
    """The drive, and what a calibration finds in it; the log is the input of 'wbmpc calibrate'."""
    robot, log, found = swerve_robot(settings.robot), Log(), list[WheelFit]()

    def run(progress: Progress | None) -> Outcome:
        controller, plant, reason = drive(robot, settings, seed, log, progress)
        if settings.tracked_poses:
            track_arm(robot, settings.plant, settings.tracked_poses, seed, log)
        try:
            if not reason:
                found.append(fit_wheels(swerve_base(robot).geometry, record_of(log)))
        except InputError as error:  # the drive is worth keeping
            reason = f"the calibration: {error}"
        return Outcome(Ending.of(plant, reason=reason), list(map(str, controller.faults)), controller)

    measured = lambda _: _metrics(log, found[0]) if found else {}
    return Scenario.single(log, run, measured, lambda _: _plots(log), IDEALIZATIONS)


def _metrics(log: Log, found: WheelFit) -> dict[str, Metric]:
    base, odometry, wheels = (log.array(n) for n in ("base", "base_odometry", "base_wheels"))
    way, (zero, zero_std) = traveled(base), found.mean_zero()
    return {
        "base_error_rms_world": Metric(rms((odometry - base)[:, :2]), "m", goal=0.010),
        "yaw_error_rms_world": Metric(rms((odometry - base)[:, 2]), "rad"),
        "base_path_length": Metric(way, "m"),
        "odometry_drift_ratio_wheels": Metric(float(np.hypot(*(wheels - base)[-1, :2])) / max(way, 1e-9), "1"),
        "steer_zero_mean": Metric(zero, "rad"),
        "steer_zero_mean_std": Metric(zero_std, "rad"),
        "wheel_radius_mean": Metric(float(found.calibration.wheel_radius[found.count].mean()), "m"),
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


EXPERIMENT = Experiment.of(NAME, SUMMARY, SwerveCalibrateSettings, build, DEFINITIONS[NAME])
