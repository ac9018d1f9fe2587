"""What `swerve-track` measures and draws."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Metric, Plot, Series
from wbmpc.studies.pankert2022.metrics import in_both_frames, largest, mean, rms, traveled
from wbmpc.studies.pankert2022.track_references import TrackReferences
from wbmpc.tasks.paths import nearest_distance

#: Groups of joints whose speeds are logged and drawn against their limits.
SPEEDS = ("leg", "steer", "wheel", "arm")
#: A drift over a shorter way [m] says nothing.
MIN_DISTANCE = 0.1


def metrics(log: Log, references: TrackReferences) -> dict[str, Metric]:
    t = log.times("hand")
    use = t >= references.counted
    reference = log.array("hand_reference")
    counts = use.any()
    if not counts:  # the run ended before anything counts
        use[-1] = True
    frames = ("hand", "hand_odometry")
    off = tuple((log.array(n) - reference)[use] if counts else np.full((1, 3), np.nan) for n in frames)
    nearest = tuple(nearest_distance(log.array(n)[use], references.curve()) for n in frames)
    turned = tuple(log.array(n)[use] for n in ("hand_rotation_world", "hand_rotation"))
    names = ("base", "base_odometry", "base_wheels", "base_release")
    base, odometry, wheels, release = (log.array(n) for n in names)
    way = traveled(base)
    moved = way if way > MIN_DISTANCE else float("nan")
    drift = lambda pose: float(np.hypot(*(pose - base)[-1, :2])) / moved
    end_effector_travel = float(np.sum(np.linalg.norm(np.diff(reference, axis=0), axis=1)))
    return {
        **in_both_frames("hand_error_mean", mean, off, "m", goal=0.003, paper=0.0167, estimated="_odometry"),
        **in_both_frames("hand_error_max", largest, off, "m", estimated="_odometry"),
        **in_both_frames("hand_error_mean_nearest", mean, nearest, "m", paper=0.0167),
        **in_both_frames("hand_orientation_error_max", largest, turned, "rad"),
        "path_length": Metric(
            end_effector_travel, "m", paper=20.53 if abs(references.path.arc_length - 20.53) < 0.01 else None
        ),
        "base_path_length": Metric(way, "m", paper=15.96 if abs(references.path.length - 15.96) < 0.01 else None),
        "base_error_rms_world": Metric(rms((odometry - base)[:, :2]), "m"),
        "odometry_drift_ratio": Metric(drift(odometry), "1", paper=0.161 / 15.96, goal=0.001),
        "odometry_drift_ratio_wheels": Metric(drift(wheels), "1", paper=0.161 / 15.96, goal=0.003),
        "odometry_drift_ratio_release": Metric(drift(release), "1"),
        "wheel_slip_max": Metric(float(log.array("wheel_slip")[use].max()), "m/s"),
    }


def _speed_ratios(log: Log, robot: RobotModel) -> list[Series]:
    """By group of joints the largest true speed over its limit."""
    t, speed = log.times("drive_speed"), np.abs(log.array("drive_speed"))
    series, start = [], 0
    for group in (g for g in SPEEDS if g in robot.input):
        limit = robot.limits.input_upper[robot.input[group]]
        series.append(Series(group, t, 100 * (speed[:, start : start + limit.size] / limit).max(axis=1)))
        start += limit.size
    return series


def plots(log: Log, robot: Any, references: TrackReferences) -> list[Plot]:
    t, end_effector, reference = log.times("hand"), log.array("hand"), log.array("hand_reference")
    estimated, base, odometry = log.array("hand_odometry"), log.array("base"), log.array("base_odometry")
    curve = references.curve()[::40]
    axis, name = (2, "z [m]") if references.vertical else (1, "y [m]")
    error = lambda p: 1e3 * np.linalg.norm(p - reference, axis=1)
    return [
        Plot("End effector path and its reference", "x [m]", name, [
            Series("reference", curve[:, 0], curve[:, axis], dashed=True),
            Series("estimated frame", estimated[:, 0], estimated[:, axis]),
            Series("world", end_effector[:, 0], end_effector[:, axis]),
        ], equal_axes=True),
        Plot("End effector error", "time [s]", "error [mm]", [
            Series("estimated frame", t, error(estimated)), Series("world", t, error(end_effector)),
        ]),
        Plot("Base path", "x [m]", "y [m]", [
            Series("true", base[:, 0], base[:, 1]), Series("odometry", odometry[:, 0], odometry[:, 1], dashed=True),
        ], equal_axes=True),
        Plot("Joint speeds over their limits", "time [s]", "largest |speed| / limit [%]", _speed_ratios(log, robot)),
    ]  # fmt: skip
