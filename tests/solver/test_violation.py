"""The certificate of infeasibility. Truth: how far a mass gets from rest to rest within a second under |u| ≤ 1: 1/4, by
acceleration over the first half and deceleration over the second."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from toys import Rows, ToyDynamics
from wbmpc.model.ode import Ode
from wbmpc.ocp import Constraint, Cost, Mode, ModeSchedule, OptimalControlProblem, Reference, residuals, sets
from wbmpc.solver import SQP, Solver, Status
from wbmpc.solver.infeasibility import Finding, least_violation

MASS = Ode({"x": ["p", "v"]}, {"u": ["a"]}, lambda x, u: ca.vertcat(x[1], u[0]))


def rest_to_rest(distance: float, intervals: int = 10, **settings: Any) -> Solver:
    ocp = OptimalControlProblem(MASS, 1.0, intervals)
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 1.0))
    ocp.add(Constraint("bounds", Rows(1, lambda s: s.u), sets.Box(-1.0, 1.0), hard=True))
    ocp.add(Constraint("there", Rows(2, lambda s: s.x - ca.DM([distance, 0.0])), at="terminal"))
    return Solver(ocp, SQP(**settings))


@pytest.mark.parametrize(("distance", "want"), [(0.24, Finding.MET), (0.26, Finding.INFEASIBLE)])
def test_what_inputs_allow_is_found_from_any_iterate(distance: float, want: Finding) -> None:
    rng, solver = np.random.default_rng(2), rest_to_rest(distance)
    solver.iterate(np.zeros(2))
    for _ in range(5):
        solver.warm_start(rng.normal(size=(11, 2)), 3.0 * rng.normal(size=(10, 1)))
        assert least_violation(solver) is want


@pytest.mark.parametrize("intervals", [10, 50, 100])
@pytest.mark.parametrize(("distance", "want"), [(0.24, Status.CONVERGED), (0.26, Status.INFEASIBLE)])
def test_a_solve_says_so(distance: float, want: Status, intervals: int) -> None:
    assert rest_to_rest(distance, intervals).solve(np.zeros(2)).status is want


def test_the_interpreted_twin_says_so() -> None:
    assert rest_to_rest(0.26, 4, backend="interpreted").solve(np.zeros(2)).status is Status.INFEASIBLE


@pytest.mark.parametrize(
    ("strength", "mode", "t0", "want"),
    [
        (1.0, "go", 0.0, Finding.MET),
        (0.9, "go", 0.0, Finding.INFEASIBLE),
        (0.9, "stay", 0.0, Finding.MET),
        (1.0, "go", 5.0, Finding.INFEASIBLE),
        (1.2, "go", 5.0, Finding.MET),
    ],
)
def test_parameters_modes_and_references_are_those_of_the_solve(
    strength: float, mode: str, t0: float, want: Finding
) -> None:
    """A mass that ``strength`` accelerates gets a quarter of it far; it is to get 0.24 far, from 5 s on 0.28, in mode "go"."""
    mass = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], w[0] * u[0]), 1)
    ocp = OptimalControlProblem(mass, 1.0, 10, modes=("go", "stay"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 1.0))
    ocp.add(Constraint("bounds", Rows(1, lambda s: s.u), sets.Box(-1.0, 1.0), hard=True))
    there = residuals.Expression(2, lambda s: s.x - s.reference, 2)
    ocp.add(Constraint("there", there, at="terminal", modes=("go",)))
    solver = Solver(ocp, SQP())
    solver.set_schedule(ModeSchedule((Mode(mode),)))
    solver.set_parameters(np.array([strength]))
    solver.set_reference("there", Reference(np.array([5.9, 6.0]), np.array([[0.24, 0.0], [0.28, 0.0]])))
    solver.iterate(np.zeros(2), t0)
    assert least_violation(solver) is want
