"""Joints of any robot over a run: planned against actual, with their limits; and by how much limits were left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.base import System
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Plot, Series
from wbmpc.simulation.scene import drive_limits, joint_units
from wbmpc.types import Truth
from wbmpc.units import by_unit, force_unit, rate_unit, with_unit

#: Units that plots are read in, and how many of them the model's are.
_READ = {"m": (1e3, "mm"), "rad": (np.degrees(1.0), "°"), "rad/s": (np.degrees(1.0), "°/s")}


class JointRecord:
    """Records the joints of one closed loop in ``log`` and draws them: planned states, joint speeds, drive forces and the plan's
    violation of constraints, beside the loop's own "state" and "input". ``run``: begins the channels' names where a log has several
    loops, as "tour."."""

    def __init__(self, log: Log, robot: RobotModel, system: System, run: str = "") -> None:
        self._log, self._robot, self._mpc, self._run = log, robot, system.mpc, run
        self._data = system.plant.data if system.plant.has_physics else None
        own, layout = robot.state, system.mpc.dynamics.state
        self._own = np.concatenate([np.arange(layout.size)[layout[group]] for group in own.groups])
        joints = set(robot.description.joints())
        #: Groups of the state that are positions of joints.
        self._groups = {
            g: names for g, names in own.groups.items() if set(names) <= joints and not g.endswith("_velocity")
        }
        self._named = [name for names in self._groups.values() for name in names]
        self._driven: dict[str, int] = {}
        #: (lower, upper) of what the drives of joints can do: of the simulated ones where the robot's file does not say.
        self._efforts: dict[str, tuple[float, float]] = {}
        if self._data is not None:
            model = system.plant.model
            known = {model.joint(i).name: int(model.jnt_dofadr[i]) for i in range(model.njnt)}
            given = {name: (-most, most) for name, most in robot.description.limits.effort.items()}
            self._efforts = {n: e for n, e in (drive_limits(model) | given).items() if n in known}
            self._driven = {n: known[n] for n in self._efforts}
            self._force_units = {n: force_unit(unit) for n, unit in joint_units(model).items()}
        inputs, driven = system.mpc.dynamics.input, list(self._driven)
        positions = [unit for g in self._groups for unit in own.unit_groups[g]]
        for channel, names, units in (
            ("state_planned", own.names, own.units), ("input", inputs.names, inputs.units),
            ("joint_speed", self._named, [rate_unit(unit) for unit in positions]),
            ("drive_force", driven, [self._force_units[n] for n in driven]),
        ):  # fmt: skip
            log.label(run + channel, names, units)

    def tick(self, t: float, truth: Truth, plans: Any) -> None:
        """Record time t [s]."""
        if f"{self._run}state" not in self._log.names:  # with the model alone it is that of the planner's dynamics
            whole = self._mpc.dynamics.state
            layout = whole if truth.state.size == whole.size else self._robot.state
            self._log.label(f"{self._run}state", layout.names, layout.units)
        self._add("state_planned", t, plans.current.state(t)[self._own])
        self._add("plan_violation", t, self._mpc.solve_info["violation"])
        if self._named and set(self._named) <= truth.joint_speeds.keys():
            self._add("joint_speed", t, [truth.joint_speeds[name] for name in self._named])
        if self._data is not None and self._driven:
            self._add("drive_force", t, self._data.qfrc_actuator[list(self._driven.values())])

    def _add(self, channel: str, t: float, row: Any) -> None:
        self._log.add(self._run + channel, t, row)

    def _rows(self, channel: str) -> tuple[Array, Array]:
        """Times (k) [s] and rows (k, n) of one of the loop's channels."""
        return self._log.times(self._run + channel), self._log.array(self._run + channel)

    def _has(self, channel: str) -> bool:
        return self._run + channel in self._log.channels

    # ------------------------------------------------------------------ plots
    def plots(self) -> list[Plot]:
        """Inputs, positions and drive forces with limits by group of joints, violations over time."""
        return [*self._inputs(), *self._positions(), *self._forces(), *self._violations()]

    def _inputs(self) -> list[Plot]:
        layout, limits = self._mpc.dynamics.input, self._robot.limits
        t, u = self._rows("input")
        own, plots = layout == self._robot.input, []
        for group, names in layout.groups.items():
            bounds = list(zip(limits.input_lower, limits.input_upper, strict=True)) if own else None
            speeds = own and group in self._groups and f"{group}_velocity" not in self._robot.state
            actual = self._actual_speeds(names) if speeds else {}
            for unit, places in by_unit(layout.unit_groups[group]).items():
                (factor, read_in), at = _READ.get(unit, (1.0, unit)), [layout[group].start + i for i in places]
                own_names = [names[i] for i in places]
                planned = dict(zip(own_names, factor * u[:, at].T, strict=True))
                moved = {name: factor * actual[name] for name in own_names if name in actual}
                limited = bounds and [(factor * bounds[i][0], factor * bounds[i][1]) for i in at]
                title = f"{'Speeds' if actual else 'Planned inputs'}: {group}"
                label = with_unit(
                    {"N m": "torque", "N": "force"}.get(unit, "speed" if unit.endswith("/s") else "input"), read_in
                )
                plots.append(Plot(title, "time [s]", label, _pairs(own_names, t, moved, planned, limited)))
        return plots

    def _actual_speeds(self, names: Sequence[str]) -> Mapping[str, Array]:
        if not self._has("joint_speed"):
            return {}
        return {n: y for n, y in zip(self._named, self._rows("joint_speed")[1].T, strict=True) if n in names}

    def _positions(self) -> list[Plot]:
        limits, (t, planned) = self._robot.limits, self._rows("state_planned")
        state, plots = self._state(t, planned.shape[1]), []
        for group, names in self._groups.items():
            start = self._robot.state[group].start
            for unit, places in by_unit(self._robot.state.unit_groups[group]).items():
                factor, shown = _READ.get(unit, (1.0, unit))
                at, own = [start + i for i in places], [names[i] for i in places]
                bounds = [(factor * limits.state_lower[i], factor * limits.state_upper[i]) for i in at]
                actual, plan = (dict(zip(own, factor * v[:, at].T, strict=True)) for v in (state, planned))
                lines = _pairs(own, t, actual, plan, bounds)
                plots.append(Plot(f"Joint positions: {group}", "time [s]", with_unit("position", shown), lines))
        return plots

    def _state(self, t: Array, width: int) -> Array:
        """The robot's own state (n, width) at times t (n), which may be recorded more often than what was planned."""
        times, rows = self._rows("state")
        rows = rows[np.searchsorted(times, t - 1e-9)]
        return rows if rows.shape[1] == width else rows[:, self._own]

    def _forces(self) -> list[Plot]:
        if not self._has("drive_force"):
            return []
        t, forces = self._rows("drive_force")
        rows = dict(zip(self._driven, forces.T, strict=True))
        description = self._robot.description
        groups = {"arm": description.arm.joints, **description.base.joint_groups()}
        listed = {name for members in groups.values() for name in members}
        groups["base"] = [name for name in description.base.wheel_joints() if name not in listed]
        groups["others"] = [name for name in self._driven if name not in {*listed, *groups["base"]}]
        plots = []
        for group, members in groups.items():
            names = [n for n in members if n in rows]
            for unit, places in by_unit([self._force_units[n] for n in names]).items():
                own = [names[i] for i in places]
                bounds = [self._efforts[n] for n in own]
                label = with_unit("torque" if unit == "N m" else "force", unit)
                plots.append(Plot(f"Drives: {group}", "time [s]", label, _pairs(own, t, rows, {}, bounds)))
        return plots

    def _violations(self) -> list[Plot]:
        limits, (t, planned) = self._robot.limits, self._rows("state_planned")
        state = self._state(t, planned.shape[1])
        plots = []
        for unit, places in by_unit(self._robot.state.units).items():
            (factor, shown), (low, high) = _READ.get(unit, (1.0, unit)), (limits.state_lower, limits.state_upper)
            at = [i for i in places if np.isfinite([low[i], high[i]]).any()]
            if at:
                lines = [
                    Series(name, t, factor * outside(rows[:, at], low[at], high[at]), "planned" in name)
                    for name, rows in (("state", state), ("state, planned", planned))
                ]
                plots.append(Plot("Outside of the joints' limits", "time [s]", with_unit("largest", shown), lines))
        violation = Series("constraints of the plan", t, self._rows("plan_violation")[1])
        return [*plots, Plot("Violation of the plan's constraints", "time [s]", "1-norm", [violation])]


def outside(rows: Array, lower: Array, upper: Array) -> Array:
    """By how much rows (n, k) are outside of limits (k): the largest of each row (n), 0 inside."""
    return np.maximum(np.maximum(lower - rows, rows - upper).max(axis=1, initial=-np.inf), 0.0)


def _pairs(
    names: Sequence[str], t: Array, actual: Mapping[str, Array], planned: Mapping[str, Array],
    limits: Sequence[tuple[float, float]] | None,
) -> list[Series]:  # fmt: skip
    """Lines of joints: what they did, and what was planned, dashed in the same color; or the one that there is."""
    lines = []
    for k, name in enumerate(names):
        bounds, label = None if limits is None else limits[k], name.removesuffix("_joint")
        if name in actual:
            lines.append(Series(label, t, actual[name], limits=bounds))
        if name in planned:
            both = name in actual
            named = f"{label}, planned" if both else label
            lines.append(Series(named, t, planned[name], both, limits=None if both else bounds))
    return lines
