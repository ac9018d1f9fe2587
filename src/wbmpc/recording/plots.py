"""Plots of a recording, from its topics alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbmpc.errors import InputError
from wbmpc.recording.reader import Recording
from wbmpc.result import Plot, Series


def overview(recording: Recording) -> list[Plot]:
    """End effector, joints, commands, contact forces and solve times: whatever of them was recorded."""
    drawn = [
        _end_effector_path(recording),
        _end_effector_error(recording),
        _joint_speeds(recording),
        _solve_times(recording),
    ]
    plots = [p for p in drawn if p is not None]
    plots += [_columns(recording, name, f"Command: {name[9:]}", "") for name in _under(recording, "/command/")]
    forces = [(name, recording.table(name)) for name in _under(recording, "/contact/")]
    if forces:
        lines = [Series(name[9:], t.times, t.columns["wrench.force.z"]) for name, t in forces]
        plots.append(Plot("Vertical contact forces", "time [s]", "force [N]", lines))
    return plots


def of_topics(recording: Recording, topics: Sequence[str]) -> list[Plot]:
    """One plot of all numbers of each topic."""
    return [_columns(recording, name, name, "") for name in topics]


def _under(recording: Recording, prefix: str) -> list[str]:
    return [name for name in recording.topics if name.startswith(prefix)]


def _columns(recording: Recording, topic: str, title: str, unit: str) -> Plot:
    table = recording.table(topic)
    lines = [Series(n, table.times, c) for n, c in table.columns.items() if c.dtype.kind == "f"]
    if not lines:
        raise InputError(f"{recording.path}: topic '{topic}' holds no numbers to plot")
    return Plot(title, "time [s]", unit, lines)


def positions(recording: Recording, topic: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (n,) and positions (n, 3) of a topic of poses; None if it is not there."""
    if topic not in recording.topics:
        return None
    table = recording.table(topic)
    return table.times, np.stack([table.columns[f"pose.position.{a}"] for a in "xyz"], axis=1)


def end_effector_error(recording: Recording) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (n,) and distances (n,) [m] of end effector and reference in the estimated frame; None without a reference."""
    end_effector, target = positions(recording, "/hand/pose_odom"), positions(recording, "/hand/reference")
    if end_effector is None or target is None:
        return None
    times, here, there = np.intersect1d(end_effector[0], target[0], return_indices=True)
    return times, np.linalg.norm(end_effector[1][here] - target[1][there], axis=1)


def _end_effector_path(recording: Recording) -> Plot | None:
    named = {"hand": "/hand/pose_odom", "reference": "/hand/reference"}
    found = {name: positions(recording, topic) for name, topic in named.items()}
    lines = [Series(n, p[1][:, 0], p[1][:, 1], n == "reference") for n, p in found.items() if p is not None]
    return Plot("End effector from above, estimated frame", "x [m]", "y [m]", lines, equal_axes=True) if lines else None


def _end_effector_error(recording: Recording) -> Plot | None:
    error = end_effector_error(recording)
    if error is None:
        return None
    return Plot(
        "End effector error, estimated frame", "time [s]", "error [mm]", [Series("distance", error[0], 1e3 * error[1])]
    )


def _joint_speeds(recording: Recording) -> Plot | None:
    if "/joint_states" not in recording.topics:
        return None
    table = recording.table("/joint_states")
    lines = [Series(n[9:], table.times, c) for n, c in table.columns.items() if n.startswith("velocity.")]
    return Plot("Joint speeds", "time [s]", "speed [rad/s]", lines)


def _solve_times(recording: Recording) -> Plot | None:
    if "/mpc/solve_time" not in recording.topics:
        return None
    table = recording.table("/mpc/solve_time")
    lines = [Series("solve", table.times, 1e3 * table.columns["data"])]
    if "/mpc/period" in recording.topics and table.times.size:
        ends, period = table.times[[0, -1]], 1e3 * recording["/mpc/period"].last()
        lines.append(Series("period", ends, np.full(2, period), dashed=True))
    return Plot("Solve times", "time [s]", "time [ms]", lines)
