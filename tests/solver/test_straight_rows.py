"""Straight hard rows of several inputs in real time. Truth: the rows evaluated again; rows that no number meets, by hand."""

from __future__ import annotations

import re

import casadi as ca
import numpy as np
import pytest

from toys import Rows, ToyDynamics
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import SQP, Solver, Status
from wbmpc.solver.memory_layout import StateField
from wbmpc.types import Observation

#: What an input may be outside [range of the row].
SHARE, PLANES = 1e-3, 6


def planes(seed: int) -> tuple[OptimalControlProblem, np.ndarray]:
    """Random bilinear dynamics, PLANES rows A u ≤ b with b among the parameters, around the origin; and A."""
    r = np.random.default_rng(seed)
    a, slopes = r.normal(size=(4, 4)), r.normal(size=(PLANES, 3))
    b = r.normal(size=(4, 3))
    f = lambda x, u, w, m: ca.DM(a) @ x + ca.DM(b) @ u + 0.3 * x * u[0]
    ocp = OptimalControlProblem(ToyDynamics(4, 3, f, parameters=PLANES), 1.0, 12)
    ocp.add(Cost("x", Rows(4, lambda s: s.x), 10.0, at="path+terminal"))
    ocp.add(Cost("u", Rows(3, lambda s: s.u), 0.01))
    rows = Rows(PLANES, lambda s: s.parameters - ca.DM(slopes) @ s.u)
    ocp.add(Constraint("planes", rows, sets.NonNegative(), hard=True))
    return ocp, slopes


def test_plans_that_are_used_are_within_rows_that_jump() -> None:
    """Every solve finds the planes elsewhere, and the state knocked."""
    rejected, solves = 0, 0
    for seed in range(8):
        ocp, slopes = planes(seed)
        mpc, r = MPC(ocp, rate=20.0), np.random.default_rng(100 + seed)
        mpc.solver.set_parameters(np.ones(PLANES))
        mpc.reset(np.zeros(4))
        for k in range(25):
            bound = r.uniform(0.3, 1.0, PLANES)
            mpc.solver.set_parameters(bound)
            usable, solves = mpc.advance(Observation(0.05 * k, r.normal(size=4))), solves + 1
            outside = (mpc.solver.ws.u @ slopes.T - bound).max()
            assert outside <= SHARE or not usable, (seed, k, outside)
            rejected += not usable
            if not usable:
                mpc.reset(np.zeros(4))
    assert rejected < 0.1 * solves


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_rows_that_no_input_meets_are_reported_by_name(backend: str) -> None:
    """u0 + u1 ≥ 1 and u0 + u1 ≤ 0.4."""
    ocp = OptimalControlProblem(ToyDynamics(2, 2, lambda x, u, w, m: u), 1.0, 6)
    ocp.add(Cost("all", Rows(4, lambda s: ca.vertcat(s.x, s.u)), 1.0))
    ocp.add(Constraint("least", Rows(1, lambda s: s.u[0] + s.u[1] - 1.0), sets.NonNegative(), hard=True))
    ocp.add(Constraint("most", Rows(1, lambda s: 0.4 - s.u[0] - s.u[1]), sets.NonNegative(), hard=True))
    solver = Solver(ocp, SQP.real_time(backend=backend))
    found = solver.solve(np.ones(2))
    assert found.status in (Status.INFEASIBLE, Status.INPUT_INFEASIBLE)
    worst = max(found.violations.items(), key=lambda v: v[1].value)
    assert f"{worst[0]}.all[0] by {worst[1].value:.3g} at node" in found.detail
    assert worst[1].value >= 0.3
    mpc = MPC(ocp, SQP.real_time(backend=backend))
    mpc.reset(np.ones(2))
    assert not mpc.advance(Observation(0.0, np.ones(2)))


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_a_rejected_plan_names_what_it_is_rejected_for(backend: str) -> None:
    """A row of inputs alone, one with a state and one of a state: the last two are missed by more."""
    ocp = OptimalControlProblem(ToyDynamics(2, 2, lambda x, u, w, m: u), 1.0, 6)
    ocp.add(Cost("all", Rows(4, lambda s: ca.vertcat(s.x, s.u)), 1.0))
    ocp.add(Constraint("most", Rows(1, lambda s: 0.4 - s.u[0] - s.u[1]), sets.NonNegative(), hard=True))
    ocp.add(Constraint("mixed", Rows(1, lambda s: s.x[0] + s.u[0] - 4.0), sets.NonNegative(), hard=True, slack=1.0))
    ocp.add(Constraint("far", Rows(1, lambda s: s.x[1] - 4.0), sets.NonNegative(), hard=True, slack=1.0))
    solver = Solver(ocp, SQP.real_time(backend=backend))
    solver.iterate(np.ones(2), 0.0, 0.0)
    worst = solver.violation_message(solver.status(0))
    assert "mixed" in worst or "far" in worst
    state, names = solver.ws.state, [row.name for row in solver.problem.path.rows]
    most = next(k for k, name in enumerate(names) if name.startswith("most"))
    state[[StateField.INPUT_VIOLATION, StateField.INPUT_VIOLATION_ROW]] = 0.05, 2 * solver.ws.rows_h.shape[1] + most
    assert re.search(r"most.* at node 2$", solver.violation_message(Status.INPUT_INFEASIBLE))
    assert solver.violation_message(solver.status(0)) == worst
