"""Exported controllers count events that find no node. Truth: counted by hand, and the same in Python."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np

import wbmpc as wb
from exported import Controller
from wbmpc.solver.controller import Result
from wbmpc.solver.controller_data import Figure

UP, DOWN = wb.Mode("up"), wb.Mode("down")


class Ball:
    """A ball that turns round at events."""

    def __init__(self) -> None:
        self.system = wb.Ode({"x": ["height", "speed"]}, {"u": ["thrust"]}, lambda x, u: ca.vertcat(x[1], u - 1.0))

    def __getattr__(self, name: str) -> object:
        return getattr(self.__dict__["system"], name)

    def __call__(self, *arguments: ca.SX) -> ca.SX:
        return self.system(*arguments)

    def jump(self, x: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        return ca.vertcat(x[0], -0.8 * x[1])


def exported(
    dynamics: object, aligned: bool, intervals: int, events: tuple[float, ...], folder: Path
) -> tuple[wb.MPC, Controller]:
    """A horizon of 1 s."""
    ocp = wb.OptimalControlProblem(dynamics, 1.0, intervals, align_events=aligned, modes=("up", "down"))  # type: ignore[arg-type]
    ocp.add(wb.Cost("state", wb.residuals.Expression(1, lambda s: s.x[0] - 1.0), 10.0, at="path+terminal"))
    ocp.add(wb.Cost("effort", wb.residuals.Expression(1, lambda s: s.u), 0.1))
    mpc = wb.MPC(ocp, rate=10.0)
    mpc.set_schedule(wb.ModeSchedule((UP, DOWN), (100.0,)))
    mpc.reset(np.array([1.0, 0.0]))
    made = Controller(wb.export(mpc, folder, prefix="ball", samples=10), folder)
    assert made.create() == Result.OK
    modes = [k % 2 for k in range(len(events) + 1)]
    mpc.solver.set_schedule(
        wb.ModeSchedule(tuple((UP, DOWN)[k] for k in modes), events)
    )  # MPC.set_schedule would reject it
    assert made("set_schedule", len(events), np.array(events), np.array(modes)) == Result.OK
    return mpc, made


def counted(mpc: wb.MPC, made: Controller, t: float) -> int:
    x, found = np.array([1.0, 0.0]), np.empty(len(Figure))
    assert made("update", t, x) == Result.OK
    mpc.update(wb.Observation(t, x))
    assert made("figures", found) == Result.OK
    assert found[Figure.EVENTS_WITHOUT_NODE] == mpc.events_without_node
    return int(found[Figure.EVENTS_WITHOUT_NODE])


def test_more_events_than_inner_nodes(tmp_path: Path) -> None:
    """Truth: events strictly within (t, t + 1), less 3."""
    events = (0.1, 0.25, 0.45, 0.6, 0.75, 0.9)
    system = wb.Ode({"x": ["height", "speed"]}, {"u": ["thrust"]}, lambda x, u: ca.vertcat(x[1], u))
    mpc, made = exported(system, True, 4, events, tmp_path)
    found = [counted(mpc, made, 0.1 * k) for k in range(10)]
    assert found == [max(sum(e > 0.1 * k + 1e-6 for e in events) - 3, 0) for k in range(10)]
    assert found[0] == 3 and found[-1] == 0


def test_jumps_within_one_interval(tmp_path: Path) -> None:
    """Truth: by hand, intervals of 0.1 s; an event on a node ends the interval before it."""
    mpc, made = exported(Ball(), False, 10, (0.31, 0.32), tmp_path)
    lost = {0.0: 1, 0.015: 0, 0.02: 1, 0.315: 0}
    assert {t: counted(mpc, made, t) for t in lost} == lost
