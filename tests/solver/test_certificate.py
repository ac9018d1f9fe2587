"""Problems that cannot be solved end, and say what did it. Truth: what was put into them."""

from __future__ import annotations

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from toys import Rows, ToyDynamics
from wbmpc.errors import InputError, RunAborted
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import ILQR, SLQ, SQP, InteriorPoint, Solution, Solver, Status, certificate
from wbmpc.types import Observation

SOLVERS = {"sqp": SQP(), "filter": SQP(line_search="filter"), "exact": SQP(hessian="exact"), "ilqr": ILQR()}
START = np.array([1.0, 0.0])
UP = Constraint("up", Rows(1, lambda s: s.u - 1.0), sets.NonNegative(), hard=True)
DOWN = Constraint("down", Rows(1, lambda s: -s.u - 1.0), sets.NonNegative(), hard=True)
WITHIN = Constraint("within", Rows(1, lambda s: s.u), sets.Box(-1.0, 1.0), hard=True)
THERE = Constraint("there", Rows(2, lambda s: s.x - ca.DM([10.0, 0.0])), at="terminal")


def cart(*terms: Cost | Constraint, dynamics: ToyDynamics | None = None, costs: bool = True) -> OptimalControlProblem:
    """ẍ = u to the origin within 1 s, and what makes it impossible."""
    model = dynamics or ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0]))
    ocp = OptimalControlProblem(model, 1.0, 20)
    if costs:
        ocp.add(Cost("state", Rows(2, lambda s: s.x), 1.0, at="path+terminal"))
        ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.1))
    for term in terms:
        ocp.add(term)
    return ocp


def solve(ocp: OptimalControlProblem, settings: SQP, x0: np.ndarray = START) -> Solution:
    return Solver(ocp, settings).solve(x0)


@pytest.mark.parametrize("algorithm", SOLVERS)
@pytest.mark.parametrize(
    ("terms", "named"),
    [
        ((UP, DOWN), "up|down"),
        ((Constraint("one", Rows(1, lambda s: s.u - 1.0)), Constraint("two", Rows(1, lambda s: s.u - 2.0))), "one|two"),
        ((WITHIN, THERE), r"there\.all\[0\] by (8\.[5-9]|9\.)\d* at node 20"),
        ((Constraint("never", Rows(1, lambda s: 0.0 * s.u + 1.0)),), "never.* by 1 at node"),
    ],
    ids=["inputs", "equalities", "out of reach", "constant"],
)
def test_contradictions_are_named(algorithm: str, terms: tuple[Constraint, ...], named: str) -> None:
    found = solve(cart(*terms), SOLVERS[algorithm])
    assert found.status is Status.INFEASIBLE
    assert re.search(f"largest violation: (?:{named})", str(found)), found


def test_what_cannot_be_moved_cannot_get_there() -> None:
    stuck = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(u[0], 0.0 * u[0]))
    found = solve(cart(THERE, dynamics=stuck), SQP(), np.array([1.0, 1.0]))
    assert found.status is Status.INFEASIBLE and "there.all[1] by 1 at node 20" in found.detail


@pytest.mark.parametrize(("iterations", "status"), [(5, Status.ITERATION_LIMIT), (400, Status.RELAXED)])
def test_a_limit_with_a_slack_is_never_infeasible(iterations: int, status: Status) -> None:
    """A trolley at twice its hard speed limit: with an L1 slack there is always a solution, however long it takes."""
    ocp = OptimalControlProblem(ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0])), 1.0, 200)
    ocp.add(Cost("state", Rows(2, lambda s: s.x - ca.DM([1.0, 0.0])), [10.0, 1.0], at="path+terminal"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.1))
    ocp.add(Constraint("force", Rows(1, lambda s: s.u), sets.Box(-2.0, 2.0), hard=True))
    ocp.add(Constraint("speed", Rows(1, lambda s: s.x[1]), sets.Box(-1.0, 1.0), hard=True))
    found = solve(ocp, SQP(iterations=iterations), np.array([0.0, 2.0]))
    assert found.status is status and found.violations["speed"].value > 0.9
    assert status is Status.ITERATION_LIMIT or "speed" in found.detail


@pytest.mark.parametrize("algorithm", SOLVERS)
def test_a_state_limit_that_gives_way_is_named(algorithm: str) -> None:
    held = Constraint("held", Rows(1, lambda s: s.x[0]), sets.Box(-0.5, 0.5), at="path+terminal", hard=True)
    found = solve(cart(WITHIN, held), SOLVERS[algorithm], np.array([2.0, 0.0]))
    assert found.status is Status.RELAXED
    assert "held.all[0] by 1.5 at node 1" in str(found)


@pytest.mark.parametrize("algorithm", SOLVERS)
@pytest.mark.parametrize(
    ("term", "place"),
    [
        (Cost("root", Rows(1, lambda s: ca.sqrt(s.x[0] - 1.5)), 1.0), "term 'root' at node"),
        (Cost("length", Rows(1, lambda s: ca.norm_2(s.x)), 1.0), "term 'length' at node"),
        (Constraint("ratio", Rows(1, lambda s: 1.0 / s.x[0] - 2.0), sets.NonNegative(), hard=True), "term 'ratio' at"),
        (Cost("end", Rows(1, lambda s: ca.log(s.x[0] - 9.0)), 1.0, at="terminal"), "terminal term 'end' at node 20"),
    ],
    ids=["outside its domain", "no derivative", "division by zero", "at the end"],
)
def test_terms_without_a_value_are_named(algorithm: str, term: Cost | Constraint, place: str) -> None:
    x0 = START if term.name in ("root", "end") else np.zeros(2)
    found = solve(cart(term), SOLVERS[algorithm], x0)
    assert found.status is Status.NOT_FINITE and place in str(found), found
    assert np.isnan(found.kkt)


def test_dynamics_without_a_value_are_named() -> None:
    broken = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0] * ca.sqrt(x[0] - 2.0)))
    found = solve(cart(dynamics=broken), SQP())
    assert found.status is Status.NOT_FINITE and "the dynamics at node 0" in found.detail


def test_a_step_that_leaves_the_domain_of_the_dynamics_names_state_and_node() -> None:
    edge = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0] * ca.sqrt(1.0 - x[0] ** 2)))
    found = solve(cart(Cost("far", Rows(1, lambda s: s.x[0] - 3.0), 100.0), dynamics=edge), SQP(), np.zeros(2))
    # to stay at rest meets everything, so that it is not infeasible
    assert found.status is Status.LINE_SEARCH_FAILED
    stated = re.search(r"by (\S+) at node (\d+)", found.detail)
    assert stated
    gap, node = float(stated[1]), int(stated[2])
    x, u, h = found.x[node - 1], found.u[node - 1, 0], 0.05
    slope = lambda x: np.array([x[1], u * np.sqrt(1.0 - x[0] ** 2)])
    missed = x + h * slope(x + 0.5 * h * slope(x)) - found.x[node]
    assert f"'x.{np.argmax(np.abs(missed))}' by" in found.detail
    assert gap == pytest.approx(np.abs(missed).max(), rel=1e-2)


def test_numbers_that_are_too_large_name_the_term() -> None:
    found = solve(cart(Cost("big", Rows(1, lambda s: 1e12 * (s.x[0] - 1.0)), 1.0)), SQP(), np.zeros(2))
    assert found.status is Status.DIVERGED and "largest term: term 'big' = 5e+23 at node 0" in found.detail


def test_a_cost_without_a_lower_bound_ends() -> None:
    class Concave:
        """−r²: unbounded below; Gauss-Newton takes the curvature for positive."""

        value = staticmethod(lambda r: -0.5 * r * r)
        gradient = staticmethod(lambda r: -r)
        curvature = staticmethod(lambda r: ca.SX.ones(r.shape))

    ocp = cart(Cost("away", Rows(1, lambda s: s.x[0]), 100.0, norm=Concave(), at="path+terminal"))
    for settings in (SQP(iterations=500), ILQR(iterations=500)):
        found = solve(ocp, settings)
        assert found.status is Status.DIVERGED, found
        assert "'away'" in found.detail


def test_an_unstable_model_that_leaves_the_numbers_names_its_state() -> None:
    escape = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[0] ** 3 + x[1], u[0]))
    found = solve(cart(dynamics=escape), ILQR(), np.array([50.0, 0.0]))
    assert found.status in (Status.NOT_FINITE, Status.DIVERGED)
    assert "'x.0'" in found.detail


def test_inputs_without_any_term_are_named() -> None:
    found = solve(cart(costs=False), ILQR())
    assert found.status is Status.NOT_FINITE and "no term depends on input 'u.0'" in found.detail


def test_a_first_solve_of_an_mpc_that_fails_says_why() -> None:
    for terms, x0, message in (
        ((UP, DOWN), START, r"cannot all be met.*\(largest violation: (up|down)"),
        (
            (Cost("root", Rows(1, lambda s: ca.sqrt(s.x[0] - 1.5)), 1.0),),
            START,
            r"not finite \(term 'root' at node 0\)",
        ),
    ):
        with pytest.raises(RunAborted, match=f"the first solve failed: .*{message}"):
            MPC(cart(*terms)).update(Observation(0.0, x0))


def test_a_guess_beyond_all_numbers_is_reported_and_the_next_one_solves() -> None:
    solver = Solver(cart(), SQP())
    solver.warm_start(np.full((21, 2), 1e300))
    assert solver.solve(START).status is Status.NOT_FINITE
    solver.warm_start(np.zeros(2))
    solver.reset()
    assert solver.solve(START).status is Status.CONVERGED


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: solve(cart(), SQP(), "ab"), "initial state: (2 )?numbers are needed"),  # type: ignore[arg-type]
        (lambda: Solver(cart(), SQP()).solve(START, np.nan), "start of the horizon: the time must be finite, got nan"),
        (lambda: SQP(iterations=2.5), "iterations must be a whole number, at least 1, got 2.5"),  # type: ignore[arg-type]
        (lambda: SQP(iterations=True), "iterations must be a whole number"),
        (lambda: SQP(min_step=2.0), "min_step must be at most 1, got 2"),
        (lambda: SQP(max_regularization=-1.0), "max_regularization must not be negative, got -1"),
        (lambda: SQP(max_regularization=np.nan), "max_regularization must not be negative, got nan"),
        (
            lambda: InteriorPoint(max_extra_iterations=-1),
            "max_extra_iterations must be a whole number, at least 0, got -1",
        ),
        (lambda: SLQ(step=np.nan), "SLQ: step must be positive, got nan"),
    ],
)
def test_settings_are_checked(make, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=message):
        make()


def test_a_row_without_a_slack_must_hold_beside_one_that_gives_way() -> None:
    """The second can be missed, which makes no problem infeasible; the first cannot."""
    limit = Constraint("limit", Rows(2, lambda s: 0.5 - s.x), sets.NonNegative(), hard=True, slack=[np.inf, 1e3])
    problem = Solver(cart(limit), use_cache=False).problem
    assert certificate.rows_that_must_hold(problem)["limit"].tolist() == [True, False]
    assert not certificate.gives_way(problem, limit)
    assert certificate.gives_way(problem, replace(limit, slack=[10.0, 1e3]))
