"""What is measured and drawn of every general experiment; of its joints: :mod:`wbmpc.tasks.joint_figures`."""

from __future__ import annotations

import numpy as np

from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Metric, Plot, Series

#: A drift over a shorter way [m] says nothing.
MIN_DISTANCE = 0.1


def traveled(base: np.ndarray) -> float:
    """Length [m] of the way of poses (n, 3)."""
    return float(np.hypot(*np.diff(base[:, :2], axis=0).T).sum())


def general_metrics(log: Log, robot: RobotModel, since: float, fell: bool) -> dict[str, Metric]:
    """Errors of the end effector against its reference from ``since`` [s] on, the base's way and its odometry, limits."""
    found = {"fell": Metric(float(fell), "1", goal=0.0)}
    if "end_effector_reference" in log.channels:
        found |= _tracking(log, since)
    base, estimated = log.array("base"), log.array("base_estimated")
    if "base" in robot.state:
        way = traveled(base)
        found["base_path_length"] = Metric(way, "m")
        if way > MIN_DISTANCE:
            found["odometry_drift_ratio"] = Metric(float(np.hypot(*(estimated - base)[-1, :2])) / way, "1")
    state, limits = log.array("state"), robot.limits
    outside = np.maximum(limits.state_lower - state, state - limits.state_upper)
    limited = np.isfinite(limits.state_lower) | np.isfinite(limits.state_upper)
    largest = {
        unit: float(own.max(initial=0.0))
        for unit in robot.state.units
        if (own := outside[:, limited & (np.array(robot.state.units) == unit)]).size
    }
    if "rad" in largest:
        found["limit_violation_max"] = Metric(largest["rad"], "rad")
    if "m" in largest:
        found["slide_limit_violation_max"] = Metric(largest["m"], "m")
    return found


def _tracking(log: Log, since: float) -> dict[str, Metric]:
    use = log.times("end_effector") >= since
    if not use.any():
        use[-1] = True
    reference, found = log.array("end_effector_reference"), dict[str, Metric]()
    for kind, figure in (("mean", np.mean), ("max", np.max)):
        for ending, name in (("", "end_effector_estimated"), ("_world", "end_effector")):
            errors = np.linalg.norm(log.array(name) - reference, axis=1)[use]
            found[f"end_effector_error_{kind}{ending}"] = Metric(float(figure(errors)), "m")
    return found | {"rotation_error_max": Metric(float(log.array("rotation_error")[use].max()), "rad")}


def general_plots(log: Log) -> list[Plot]:
    """Paths seen from above, and errors."""
    t, tool, base = log.times("end_effector"), log.array("end_effector"), log.array("base")
    paths = [Series("end effector", tool[:, 0], tool[:, 1], color=0), Series("base", base[:, 0], base[:, 1], color=2)]
    plots = []
    if "end_effector_reference" in log.channels:
        reference = log.array("end_effector_reference")
        paths.insert(1, Series("end effector, reference", reference[:, 0], reference[:, 1], dashed=True))
        errors = [
            Series(name, t, 1e3 * np.linalg.norm(log.array(channel) - reference, axis=1))
            for name, channel in (("estimated frame", "end_effector_estimated"), ("world", "end_effector"))
        ]
        turned = Series("estimated frame", log.times("rotation_error"), np.degrees(log.array("rotation_error")))
        plots = [
            Plot("End effector error", "time [s]", "error [mm]", errors),
            Plot("End effector orientation error", "time [s]", "error [°]", [turned]),
        ]
    return [Plot("Paths seen from above", "x [m]", "y [m]", paths, equal_axes=True), *plots]
