"""Plots of a recording, from its topics alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbmpc.errors import InputError
from wbmpc.recording.quantities import Columns
from wbmpc.recording.reader import Recording
from wbmpc.result import Plot, Series
from wbmpc.units import scale, with_unit

#: What is measured in a unit, for labels.
_QUANTITIES = {
    "m": "position", "°": "angle", "m/s": "speed", "°/s": "speed", "m/s²": "acceleration", "N": "force", "N m": "torque", "s": "time",
}  # fmt: skip


def overview(recording: Recording) -> list[Plot]:
    """End effector, joints, commands, contact forces and solve times: whatever of them was recorded."""
    drawn = [
        _end_effector_path(recording), _end_effector_error(recording), *_joint_speeds(recording),
        _solve_times(recording),
    ]  # fmt: skip
    plots = [p for p in drawn if p is not None]
    plots += [p for name in _under(recording, "/command/") for p in _columns(recording, name, f"Command: {name[9:]}")]
    forces = [(name, recording.table(name)) for name in _under(recording, "/contact/")]
    if forces:
        lines = [Series(name[9:], t.times, t.columns["wrench.force.z"]) for name, t in forces]
        plots.append(Plot("Vertical contact forces", "time [s]", "force [N]", lines))
    return plots


def of_topics(recording: Recording, topics: Sequence[str]) -> list[Plot]:
    """The numbers of each topic: a plot for each unit that it has."""
    return [plot for name in topics for plot in _columns(recording, name, name)]


def _under(recording: Recording, prefix: str) -> list[str]:
    return [name for name in recording.topics if name.startswith(prefix)]


def _columns(recording: Recording, topic: str, title: str) -> list[Plot]:
    table = recording.table(topic)
    columns = {n: c for n, c in table.columns.items() if c.dtype.kind == "f"}
    if not columns:
        raise InputError(f"{recording.path}: topic '{topic}' holds no numbers to plot")
    about, found = Columns(recording), dict[str, list[Series]]()
    for name, column in columns.items():
        read = scale(about.unit(topic, name, len(columns)))
        line = Series(about.name(topic, name, len(columns)), table.times, read.factor * column)
        found.setdefault(read.unit, []).append(line)
    return [
        Plot(f"{title}, {unit}" if unit and len(found) > 1 else title, "time [s]", _label(topic, unit), lines)
        for unit, lines in found.items()
    ]


def _label(topic: str, unit: str) -> str:
    return with_unit(_QUANTITIES.get(unit, topic.rpartition("/")[2].replace("_", " ")), unit)


def positions(recording: Recording, topic: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (n,) and positions (n, 3) of a topic of poses; None if it is not there."""
    if topic not in recording.topics:
        return None
    table = recording.table(topic)
    return table.times, np.stack([table.columns[f"pose.position.{a}"] for a in "xyz"], axis=1)


def end_effector_error(recording: Recording) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (n,) and distances (n,) [m] of end effector and reference in the estimated frame; None without a reference."""
    end_effector, target = (
        positions(recording, "/end_effector_pose"),
        positions(recording, "/end_effector_reference"),
    )
    if end_effector is None or target is None:
        return None
    times, here, there = np.intersect1d(end_effector[0], target[0], return_indices=True)
    return times, np.linalg.norm(end_effector[1][here] - target[1][there], axis=1)


def _end_effector_path(recording: Recording) -> Plot | None:
    named = {"end effector": "/end_effector_pose", "end effector, reference": "/end_effector_reference"}
    found = {name: positions(recording, topic) for name, topic in named.items()}
    lines = [Series(n, p[1][:, 0], p[1][:, 1], "reference" in n) for n, p in found.items() if p is not None]
    return Plot("End effector from above, estimated frame", "x [m]", "y [m]", lines, equal_axes=True) if lines else None


def _end_effector_error(recording: Recording) -> Plot | None:
    error = end_effector_error(recording)
    if error is None:
        return None
    return Plot(
        "End effector error, estimated frame", "time [s]", "error [mm]", [Series("distance", error[0], 1e3 * error[1])]
    )


def _joint_speeds(recording: Recording) -> list[Plot]:
    """A plot for each group of joints and unit: all at once are more than there are colors."""
    if "/joint_states" not in recording.topics:
        return []
    table, about, found = recording.table("/joint_states"), Columns(recording), dict[tuple[str, str], list[Series]]()
    for name, column in table.columns.items():
        if name.startswith("velocity."):
            read = scale(about.unit("/joint_states", name, len(table.columns)))
            group = next((f": {g}" for g, names in about.groups.items() if name[9:] in names), "")
            found.setdefault((group, read.unit), []).append(Series(name[9:], table.times, read.factor * column))
    plots = found.items()
    return [Plot(f"Joint speeds{group}", "time [s]", with_unit("speed", unit), lines) for (group, unit), lines in plots]


def _solve_times(recording: Recording) -> Plot | None:
    if "/mpc/solve_time" not in recording.topics:
        return None
    table = recording.table("/mpc/solve_time")
    lines = [Series("solve", table.times, 1e3 * table.columns["data"])]
    if "/mpc/period" in recording.topics and table.times.size:
        ends, period = table.times[[0, -1]], 1e3 * recording["/mpc/period"].last()
        lines.append(Series("period", ends, np.full(2, period), dashed=True))
    return Plot("Solve times", "time [s]", "time [ms]", lines)
