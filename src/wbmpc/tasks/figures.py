"""What is measured and drawn of every general experiment."""

from __future__ import annotations

import numpy as np

from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.speeds import SpeedMPC
from wbmpc.result import Metric, Plot, Series

#: A drift over a shorter way [m] says nothing.
MIN_DISTANCE = 0.1


def travelled(base: np.ndarray) -> float:
    """Length [m] of the way of poses (n, 3)."""
    return float(np.hypot(*np.diff(base[:, :2], axis=0).T).sum())


def general_metrics(log: Log, robot: RobotModel, since: float, fell: bool) -> dict[str, Metric]:
    """Errors of the end effector against its reference from ``since`` [s] on, the base's way and its odometry, limits."""
    found = {"fell": Metric(float(fell), "1", goal=0.0)}
    if "end_effector_reference" in log.channels:
        found |= _tracking(log, since)
    base, estimated = log.array("base"), log.array("base_estimated")
    if "base" in robot.state:
        way = travelled(base)
        found["base_path_length"] = Metric(way, "m")
        if way > MIN_DISTANCE:
            found["odometry_drift_ratio"] = Metric(float(np.hypot(*(estimated - base)[-1, :2])) / way, "1")
    state, limits = log.array("state"), robot.limits
    outside = np.maximum(limits.state_lower - state, state - limits.state_upper)
    found["limit_violation_max"] = Metric(max(0.0, float(outside.max(initial=-np.inf))), "rad")
    return found


def _tracking(log: Log, since: float) -> dict[str, Metric]:
    use = log.times("end_effector") >= since
    if not use.any():
        use[-1] = True
    reference = log.array("end_effector_reference")
    estimated, world = (
        np.linalg.norm(log.array(n) - reference, axis=1)[use] for n in ("end_effector_estimated", "end_effector")
    )
    return {
        "end_effector_error_mean": Metric(float(estimated.mean()), "m"),
        "end_effector_error_max": Metric(float(estimated.max()), "m"),
        "end_effector_error_mean_world": Metric(float(world.mean()), "m"),
        "end_effector_error_max_world": Metric(float(world.max()), "m"),
        "rotation_error_max": Metric(float(log.array("rotation_error")[use].max()), "rad"),
    }


def general_plots(log: Log, mpc: MPC, robot: RobotModel, physics: bool) -> list[Plot]:
    """Paths seen from above, errors, inputs, solve times."""
    t, tool, base = log.times("end_effector"), log.array("end_effector"), log.array("base")
    paths = [Series("end effector", tool[:, 0], tool[:, 1]), Series("base", base[:, 0], base[:, 1])]
    plots = []
    if "end_effector_reference" in log.channels:
        reference = log.array("end_effector_reference")
        paths.insert(0, Series("reference", reference[:, 0], reference[:, 1], dashed=True))
        errors = [
            Series(name, t, 1e3 * np.linalg.norm(log.array(channel) - reference, axis=1))
            for name, channel in (("estimated frame", "end_effector_estimated"), ("world", "end_effector"))
        ]
        plots = [Plot("End effector error", "time [s]", "error [mm]", errors)]
    inputs, names = log.array("input"), mpc.ocp.dynamics.input.names
    if isinstance(mpc, SpeedMPC) and physics:
        names = robot.input.names
    solve = 1e3 * np.array(mpc.statistics.solve_times)
    return [
        Plot("Paths seen from above", "x [m]", "y [m]", paths, equal_axes=True),
        *plots,
        Plot("Planned inputs", "time [s]", "input [SI]", [Series(n, t, inputs[:, i]) for i, n in enumerate(names)]),
        Plot("Solve times", "MPC update", "time [ms]", [Series("solve", np.arange(solve.size), solve)]),
    ]
