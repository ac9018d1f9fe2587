"""Line searches on problems of one number, made so that a search that accepts too much never arrives. Truth: by hand.

Newton's steps of these problems overshoot, cycle, or creep; each says in its docstring what the search must reject.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from toys import Rows, ToyDynamics
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import SQP, Solution, Solver, Status
from wbmpc.solver.driver import begin, direction

MERIT = SQP(iterations=60, max_regularization=0.0)
FILTER = replace(MERIT, line_search="filter")
BOTH = pytest.mark.parametrize("chosen", [MERIT, FILTER], ids=["merit", "filter"])


def solve(residual: Callable[[ca.SX], ca.SX], start: float, chosen: SQP, row: Constraint | None = None) -> Solution:
    """Minimize ½ r(u)², or with a row that too, by one input over one interval of 1 s."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u), 1.0, 1)
    ocp.add(Cost("r", Rows(1, lambda s: residual(s.u)), 1.0))
    if row is not None:
        ocp.add(row)
    solver = Solver(ocp, chosen)
    solver.warm_start(np.array([[0.0], [start]]), np.array([[start]]))
    return solver.solve(np.zeros(1))


@BOTH
def test_steps_that_overshoot_further_every_time_are_cut(chosen: SQP) -> None:
    """Newton's steps on atan(u) diverge from |u| > 1.392: each is longer than the last one, and the cost rises."""
    found = solve(ca.atan, 3.0, chosen)
    assert found.status is Status.CONVERGED, found
    assert abs(found.u[0, 0]) < 1e-6
    assert (np.diff(found.log[:, 0]) <= 1e-12).all()  # without constraints costs never rise
    assert found.log[0, 4] < 1.0


@BOTH
def test_steps_that_win_next_to_nothing_are_cut(chosen: SQP) -> None:
    """r = u / (u² + ε²)^¼: the full step goes from u to −u / (1 + 2 ε²/u²), so with ε = u/224 the cost falls, but by 4e-5 of
    itself and not by the 2e-4 that Armijo's rule asks for; half of the step arrives at u/50 000."""
    start = 5.0
    found = solve(lambda u: u / (u * u + (start / 224.0) ** 2) ** 0.25, start, chosen)
    assert found.status is Status.CONVERGED, found
    assert found.iterations < 20
    assert abs(found.u[0, 0]) < 1e-6


def test_the_filter_remembers() -> None:
    """g = −2 + 2u + 5u³ − 4u⁴ = 0: Newton's steps go from 0 to 1 (g = −2 and 1) and from 1 to 0 forever, and come back to that
    cycle from nearby, for g″(0) = 0. The first step wins violation, the second one cost: only the memory of (cost, violation)
    at 0 shows that nothing was won."""
    curve = lambda u: -2.0 + 2.0 * u + 5.0 * u**3 - 4.0 * u**4
    row = Constraint("root", Rows(1, lambda s: curve(s.u)))
    cycle = solve(lambda u: u, 0.0, replace(FILTER, min_step=1.0, accept_min_step=True), row)
    np.testing.assert_allclose(cycle.log[[0, 2, 4], 1], 2.0, atol=1e-6)  # forced steps do cycle
    np.testing.assert_allclose(cycle.log[[1, 3, 5], 1], 1.0, atol=1e-6)
    found = solve(lambda u: u, 0.0, FILTER, row)
    roots = np.roots([-4.0, 5.0, 0.0, 2.0, -2.0])
    between = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real < 1.0)].real
    assert found.status is Status.CONVERGED, found
    np.testing.assert_allclose(found.u[0], between, atol=1e-6)


def overshooting() -> OptimalControlProblem:
    """½ (1.5 + u²)² + ½ u²: at its minimum, u = 0, the curvature is 4 and Gauss-Newton's 1, so that a step α leaves 1 − 4 α."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: 0.0 * u), 1.0, 1)
    ocp.add(Cost("large", Rows(2, lambda s: ca.vertcat(1.5 + s.u**2, s.u)), 1.0))
    return ocp


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_forced_steps_that_overshoot_become_shorter(backend: str) -> None:
    """Full steps go from u to −3u; what is left after two of them shows that a quarter is right."""
    forced = SQP.real_time(12, min_step=1.0, backend=backend)
    solver = Solver(overshooting(), forced)
    solver.warm_start(np.zeros((2, 1)), np.array([[1e-3]]))
    found = solver.solve(np.zeros(1))
    np.testing.assert_allclose(found.log[:2, 3], [4e-3, 12e-3], rtol=1e-3)
    np.testing.assert_allclose(found.log[1:3, 4], 0.25, rtol=1e-3)
    assert abs(found.u[0, 0]) < 1e-9
    solver.warm_start(np.zeros((2, 1)), np.array([[1e-3]]))
    assert solver.solve(np.zeros(1)).log[0, 4] < 0.3  # the next solve starts from what this one found
    solver.reset()
    assert solver.solve(np.zeros(1)).log[0, 4] == 1.0


def test_noise_between_solves_shortens_nothing() -> None:
    """A measured state that jumps to and fro turns the direction too, but that is no overshooting."""
    ocp = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u), 1.0, 4)
    ocp.add(Cost("x", Rows(2, lambda s: ca.vertcat(s.x, s.u)), 1.0))
    solver = Solver(ocp, SQP.real_time(min_step=1.0))
    for k in range(10):
        assert solver.solve(np.array([(-1.0) ** k])).log[0, 4] == 1.0


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_in_real_time_a_push_is_answered_by_the_whole_step(backend: str) -> None:
    """A problem of squares with straight dynamics is solved by one step, however much the plan costs more after the push than the plan
    before it, whose start is wrong. Truth: the same problem from scratch, and Newton's method."""
    ocp = OptimalControlProblem(ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u)), 1.0, 10)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), [10.0, 1.0], at="path+terminal"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.1))
    solver = Solver(ocp, SQP.real_time(backend=backend))
    solver.warm_start(np.zeros(2))
    found, exact = solver.solve(np.array([0.3, -0.5])), Solver(ocp)
    exact.warm_start(np.zeros(2))
    want = exact.solve(np.array([0.3, -0.5]))
    assert want.status is Status.CONVERGED and found.log[0, 4] == 1.0 and solver.effort.trial_points == 1
    np.testing.assert_allclose(found.u, want.u, atol=1e-8)


def test_the_value_function_knows_the_curvature_of_a_step() -> None:
    """Real time keeps no Hessians and takes δzᵀ H δz from the recursion. Truth: their product with the step, node by node."""
    dynamics = ToyDynamics(2, 2, lambda x, u, w, m: ca.vertcat(x[1], u[0] - 4.0 * ca.sin(x[0])))
    ocp = OptimalControlProblem(dynamics, 1.0, 12)
    ocp.add(Cost("goal", Rows(2, lambda s: s.x - 1.0), 10.0, at="path+terminal"))
    ocp.add(Cost("input", Rows(2, lambda s: s.u), 0.1))
    ocp.add(Constraint("bounds", Rows(2, lambda s: s.u), sets.Box(-2.0, 2.0), hard=True))
    ocp.add(Constraint("power", Rows(1, lambda s: s.x[1] * s.u[0]), sets.Box(-1.0, 1.0), hard=True))
    ocp.add(Constraint("speed", Rows(1, lambda s: s.x[1]), sets.Box(-0.5, 0.5), hard=True, at="path+terminal"))
    ocp.add(Constraint("soft", Rows(1, lambda s: s.u[1] - s.x[0]), softness=0.1))
    ocp.add(Constraint("end", Rows(1, lambda s: ca.sin(s.x[0]) - 0.5), at="terminal"))
    x0, found = np.array([0.2, 0.4]), []
    for chosen in (SQP(compute_kkt=False), SQP()):
        solver = Solver(ocp, chosen)
        solver.warm_start(np.array([0.1, 0.3]), np.array([0.5, -0.5]))
        m, o = solver.ws.memory, solver.ws.table
        begin(m, o, x0, solver.numbers)
        found.append(direction(m, o, x0, solver.numbers, solver.log.reshape(-1), 0))
    (*_, curvature, size, slope), (*_, want, same_size, same_slope) = found
    assert (size, slope) == (same_size, same_slope) and want > 1.0
    np.testing.assert_allclose(curvature, want, rtol=1e-9)
