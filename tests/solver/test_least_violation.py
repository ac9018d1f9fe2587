"""The certificate of infeasibility. Truth: how far a mass gets from rest to rest within a second under |u| ≤ 1: 1/4, by
acceleration over the first half and deceleration over the second."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from toys import Rows
from wbmpc.model.ode import Ode
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import SQP, Solver, Status
from wbmpc.solver.least_violation import Finding, least_violation

MASS = Ode({"x": ["p", "v"]}, {"u": ["a"]}, lambda x, u: ca.vertcat(x[1], u[0]))


def rest_to_rest(distance: float) -> Solver:
    ocp = OptimalControlProblem(MASS, 1.0, 10)
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 1.0))
    ocp.add(Constraint("bounds", Rows(1, lambda s: s.u), sets.Box(-1.0, 1.0), hard=True))
    ocp.add(Constraint("there", Rows(2, lambda s: s.x - ca.DM([distance, 0.0])), at="terminal"))
    return Solver(ocp, SQP())


@pytest.mark.parametrize(("distance", "want"), [(0.24, Finding.MET), (0.26, Finding.INFEASIBLE)])
def test_what_inputs_allow_is_found_from_any_iterate(distance: float, want: Finding) -> None:
    rng, solver = np.random.default_rng(2), rest_to_rest(distance)
    solver._run(np.zeros(2))
    for _ in range(5):
        solver.warm_start(rng.normal(size=(11, 2)), 3.0 * rng.normal(size=(10, 1)))
        rows = {"bounds": np.ones(1, bool), "there": np.ones(2, bool)}
        assert least_violation(solver, rows, 1e-6) is want


@pytest.mark.parametrize(("distance", "want"), [(0.24, Status.CONVERGED), (0.26, Status.INFEASIBLE)])
def test_a_solve_says_so(distance: float, want: Status) -> None:
    assert rest_to_rest(distance).solve(np.zeros(2)).status is want
