"""Problems nobody should write, and what is said about them. Truth: what was put into them, or the same problem in sane units.

Scales from 1e-8 to 1e8, functions without derivatives or values, constants as constraints, contradictions that only some
nodes or modes have, jumps without a value, grids that are too coarse or too fine.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from effort import THOROUGH, some, thorough
from toys import Rows, ToyDynamics
from wbmpc.errors import InputError
from wbmpc.ocp import (
    AugmentedLagrangian,
    Constraint,
    Cost,
    Mode,
    ModeSchedule,
    OptimalControlProblem,
    Reference,
    RelaxedBarrier,
    sets,
)
from wbmpc.solver import ILQR, SLQ, SQP, InteriorPoint, Solution, Solver, Status
from wbmpc.solver.diagnostics import _stuck

SOLVERS = {
    "sqp": SQP(), "filter": SQP(line_search="filter"), "exact": SQP(hessian="exact"), "ilqr": ILQR(), "slq": SLQ(step=0.025),
}  # fmt: skip
everywhere = pytest.mark.parametrize("algorithm", some(list(SOLVERS), [0, 3, 4]))
START = np.array([1.0, 0.0])
AT_LEAST, ZERO = sets.NonNegative(), sets.Zero()
INTEGRATOR = lambda x, u, w, m: ca.vertcat(x[1], u[0])


def row(name: str, f: Callable[..., ca.SX], inside: sets.Set = AT_LEAST, **more: object) -> Constraint:
    return Constraint(name, Rows(1, f), inside, **more)  # type: ignore[arg-type]


def cost(name: str, f: Callable[..., ca.SX], weight: float = 1.0) -> Cost:
    return Cost(name, Rows(1, f), weight)


def cart(
    *terms: Cost | Constraint, dynamics: ToyDynamics | None = None, scale: float = 1.0, intervals: int = 20
) -> OptimalControlProblem:
    """ẍ = u to the origin within 1 s; ``scale`` of the costs."""
    ocp = OptimalControlProblem(dynamics or ToyDynamics(2, 1, INTEGRATOR), 1.0, intervals)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), scale, at="path+terminal"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.1 * scale))
    for term in terms:
        ocp.add(term)
    return ocp


def solve(ocp: OptimalControlProblem, settings: SQP, x0: np.ndarray = START) -> Solution:
    return Solver(ocp, settings).solve(x0)


# ---------------------------------------------------------------------- scales
@everywhere
@pytest.mark.parametrize("scale", [1e-12, 1e-8, 1e8])
def test_the_unit_of_the_costs_does_not_matter(algorithm: str, scale: float) -> None:
    """With costs of 1e-12 the gradient is below every tolerance at the guess already: the step is not."""
    found, want = (solve(cart(scale=s), SOLVERS[algorithm]) for s in (scale, 1.0))
    assert found.status is Status.CONVERGED and found.detail == ""
    np.testing.assert_allclose(found.u, want.u, atol=1e-7)


@everywhere
@pytest.mark.parametrize("scale", [1e-8, 1e8])
@pytest.mark.parametrize(
    ("inside", "f", "more"),
    [
        (AT_LEAST, lambda s: s.u + 0.5, {"hard": True}),
        (ZERO, lambda s: s.u + 0.5 + 0.1 * s.x[1], {}),
        (ZERO, lambda s: s.u + 0.5 + 0.1 * s.x[1], {"softness": 1e-2}),
        (ZERO, lambda s: s.x[0] - 0.3, {"at": "terminal"}),
        (AT_LEAST, lambda s: s.u + 0.5, {"penalty": 1e2}),
        (ZERO, lambda s: s.u + 0.5 + 0.1 * s.x[1], {"penalty": 1e2}),
    ],
    ids=["input limit", "equality", "soft equality", "equality at the end", "multiplier", "equality with multiplier"],
)
def test_the_unit_of_a_row_does_not_matter(algorithm: str, scale: float, inside: sets.Set, f, more) -> None:  # type: ignore[no-untyped-def]
    given = dict(more)
    if "softness" in given:  # residual = softness · multiplier: the unit squared
        given["softness"] = given["softness"] * scale**2
    if "penalty" in given:  # ρ is per squared unit
        given["penalty"] = AugmentedLagrangian(given["penalty"] / scale**2)
        more = {"penalty": AugmentedLagrangian(more["penalty"])}
    terms = row("row", lambda s: scale * f(s), inside, **given), row("row", f, inside, **more)
    found, want = (solve(cart(t), SOLVERS[algorithm]) for t in terms)
    assert found.status is want.status is Status.CONVERGED
    np.testing.assert_allclose(found.u, want.u, atol=1e-5)


def test_a_state_limit_in_a_small_unit_says_that_it_gave_way() -> None:
    """Its L1 slack costs 1e3 per unit of the row: 1e-5 per meter, which the other costs outweigh."""
    found = solve(cart(row("low", lambda s: 1e-8 * (s.u + 0.5 + 0.1 * s.x[0]), hard=True)), SQP())
    assert found.status is Status.RELAXED
    assert re.search(r"low\.all\[0\] by 2\.\d+e-08 at node 0, which is 2\.\d+ in the variables", found.detail)


@pytest.mark.parametrize("scale", [1e-6, 1e-9, 1e6])
@pytest.mark.parametrize("f", [lambda s: s.x[0] ** 2 + s.u + 1.0, lambda s: ca.exp(s.u) + s.u - s.x[0]])
def test_a_curved_equality_has_the_same_optimum_in_any_unit(f: Callable[..., ca.SX], scale: float) -> None:
    """1e-6 (eᵘ + u − x₀) = 0 is met to 1e-6 by every sane u: the gradient is not constant, but small everywhere."""
    found, want = (solve(cart(row("row", lambda s, c=c: c * f(s), ZERO)), SQP()) for c in (scale, 1.0))
    assert found.status is want.status is Status.CONVERGED and found.detail == ""
    np.testing.assert_allclose(found.u, want.u, atol=1e-6)


def test_a_row_that_is_small_here_and_large_there_is_doubted() -> None:
    """Its gradient, 1e-5 to 1 in the points that are looked at, says nothing about its unit."""
    ocp = cart(row("tiny", lambda s: 1e-5 * (s.u + 1.0) * ca.exp(4.0 * s.x[1]), ZERO))
    found = solve(ocp, SQP())
    assert np.abs(found.u + 1.0).max() < 1e-2 or "in the variables" in found.detail, found


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("softness", [1e-6, 1e-2])
def test_a_soft_equality_converges_to_its_own_optimum(backend: str, softness: float) -> None:
    """r = u + 1/2 with softness c: the same as a cost of (1/c) r² / 2 per interval (docs/explanation/solver.md)."""
    soft = solve(cart(row("soft", lambda s: s.u + 0.5, ZERO, softness=softness)), SQP(backend=backend))  # type: ignore[arg-type]
    want = solve(cart(cost("soft", lambda s: s.u + 0.5, 20.0 / softness)), SQP())
    assert soft.status is want.status is Status.CONVERGED and soft.detail == ""
    assert soft.violations["soft"].value > 0.01 * softness
    np.testing.assert_allclose(soft.u, want.u, atol=1e-8)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("scale", [1e-4, 1e-8])
def test_limits_do_not_push_where_costs_are_in_a_tiny_unit(backend: str, scale: float) -> None:
    """μ is in units of the costs: 1e-9 of it is much beside a cost of 1e-8, which then stays in the middle of its limits."""
    limit = row("limit", lambda s: s.u, sets.Box(-2.0, 2.0), hard=True)
    found = solve(cart(limit, scale=scale), SQP(backend=backend))  # type: ignore[arg-type]
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.u, solve(cart(limit), SQP()).u, atol=2e-3)
    chosen = solve(
        cart(limit, scale=scale), SQP(interior_point=InteriorPoint(barrier=1e-9))
    )  # what is asked for is done
    assert (np.abs(chosen.u - found.u).max() > 0.1) == (scale < 1e-6)


# ---------------------------------------------------------------------- nothing to hold on to
@everywhere
def test_an_input_that_only_a_barrier_looks_at_diverges_by_name(algorithm: str) -> None:
    """−μ ln u has no least value; its gradient is below 1e-8 from u = 7e4 on."""
    two = ToyDynamics(2, 2, INTEGRATOR)
    ocp = OptimalControlProblem(two, 1.0, 20)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), 1.0, at="path+terminal"))
    ocp.add(cost("input", lambda s: s.u[0], 0.1))
    ocp.add(row("positive", lambda s: s.u[1]))
    found = solve(ocp, SOLVERS[algorithm])
    assert found.status is Status.DIVERGED
    assert re.search(r"largest: input 'u\.1' = \S+ at node \d+, largest term: term 'positive'", found.detail), found
    assert "largest step: input 'u.1'" in found.detail


@thorough
def test_the_twin_diverges_too() -> None:
    ocp = cart(row("positive", lambda s: s.u))
    del ocp.terms["input"], ocp.terms["state"]
    found = solve(ocp, SQP(backend="interpreted"))
    assert found.status is Status.DIVERGED and "term 'positive'" in found.detail


def test_a_start_beyond_all_numbers_names_state_and_term() -> None:
    found = solve(cart(), SQP(), np.array([1e300, 0.0]))
    assert found.status is Status.DIVERGED
    assert "the start has a state of 1e+300" in found.detail and "a step further: term 'state'" in found.detail


# ---------------------------------------------------------------------- contradictions
RHO = AugmentedLagrangian(1e2)


@everywhere
@pytest.mark.parametrize(
    ("terms", "named"),
    [
        (
            (row("up", lambda s: s.u - 1, penalty=RHO), row("down", lambda s: -s.u - 1, penalty=RHO)),
            "(up|down).* by 1 ",
        ),
        (
            (row("right", lambda s: s.x[0] - 3, penalty=RHO), row("left", lambda s: 2 - s.x[0], penalty=RHO)),
            "left|right",
        ),
        ((row("up", lambda s: s.u - 1, penalty=RHO), row("down", lambda s: -s.u - 1, hard=True)), "up.* by 2 "),
        ((row("one", lambda s: s.x[0] - 1, ZERO), row("two", lambda s: s.x[0] - 2, ZERO)), "one|two"),
        ((row("never", lambda s: ca.SX(-1.0), penalty=RHO),), "never.* by 1 "),
        ((row("zero", lambda s: ca.SX(1.0), ZERO),), "zero.* by 1 "),
    ],
    ids=["inputs", "states", "multiplier and limit", "equalities", "a constant", "a constant equality"],
)
def test_contradictions_of_multipliers_are_named(algorithm: str, terms: tuple[Constraint, ...], named: str) -> None:
    found = solve(cart(*terms), SOLVERS[algorithm])
    assert found.status is Status.INFEASIBLE
    assert re.search(f"largest violation: (?:{named})", found.detail), found


SOFT_GOAL = row("goal", lambda s: s.x[0] - 100, penalty=RelaxedBarrier(1e-3, 1e-2))
SOFT = row("soft", lambda s: s.u - 100, ZERO, softness=1e3)


@everywhere
@pytest.mark.parametrize("goal", [SOFT_GOAL, SOFT], ids=["barrier", "softness"])
@pytest.mark.parametrize(
    ("terms", "named"),
    [
        (
            (row("one", lambda s: s.u - 1, ZERO), row("two", lambda s: s.u - 1.5, ZERO)),
            r"(one|two).all\[0\] by 0\.\d+ ",
        ),
        ((row("up", lambda s: s.u - 1, hard=True), row("down", lambda s: -s.u - 1, hard=True)), "(up|down)"),
        ((row("end", lambda s: 0 * s.x[0] - 1, ZERO, at="terminal"),), r"end.all\[0\] by 1 at node [24]0"),
    ],
    ids=["equalities", "limits", "the end"],
)
def test_soft_terms_are_never_the_cause(
    algorithm: str, goal: Constraint, terms: tuple[Constraint, ...], named: str
) -> None:
    """A soft goal is missed by a hundred, what must hold by a unit: it is the latter that makes the problem infeasible."""
    found = solve(cart(*terms, goal), SOLVERS[algorithm])
    assert found.violations[goal.name].value > 50.0
    assert found.status is Status.INFEASIBLE, found
    assert re.match(f"largest violation: {named}", found.detail), found


@everywhere
@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize(
    "term",
    [
        row("kink", lambda s: ca.fabs(s.x[0]) * ca.sign(s.x[1] - 0.3) - 100, penalty=RelaxedBarrier(1.0, 1e-2)),
        row("soft", lambda s: s.u - 100 + ca.sin(3 * s.x[0]), ZERO, softness=1e3),
    ],
    ids=["barrier", "softness"],
)
def test_a_problem_of_soft_terms_alone_is_feasible(algorithm: str, backend: str, term: Constraint) -> None:
    """Whatever becomes of the iteration: every motion of the model meets what must hold. The twin, which is slow, has fewer nodes
    and steps, and one case by default."""
    settings, intervals = replace(SOLVERS[algorithm], backend=backend), 20
    if backend == "interpreted":
        if algorithm in ("filter", "exact"):
            pytest.skip("the twin has neither")
        if not THOROUGH and (algorithm, term.name) != ("sqp", "soft"):
            pytest.skip("a long run; set WBMPC_THOROUGH=1")
        intervals = 5
        if isinstance(settings, SLQ):
            settings = replace(settings, step=0.1)
    found = solve(cart(term, intervals=intervals), settings)
    assert found.status in (Status.CONVERGED, Status.LINE_SEARCH_FAILED, Status.ITERATION_LIMIT), found
    assert term.name not in found.detail


def test_rounding_is_not_stuck() -> None:
    """Gaps of 1e-15 that do not halve are no contradiction: this one was only stopped too early."""
    noise = np.full(20, 1e-15)
    assert not _stuck(noise, 1e-6) and _stuck(np.full(20, 1e-3), 1e-6)


@everywhere
def test_a_constant_limit_gives_way_by_name(algorithm: str) -> None:
    found = solve(cart(row("never", lambda s: 0 * s.x[0] - 1, hard=True)), SOLVERS[algorithm])
    assert found.status is Status.RELAXED and found.detail == "never.all[0] by 1 at node 1"
    np.testing.assert_allclose(found.u, solve(cart(), SOLVERS[algorithm]).u, atol=1e-6)


@pytest.mark.parametrize("algorithm", ["sqp", "ilqr"])
def test_a_contradiction_at_one_node_names_the_node(algorithm: str) -> None:
    compared = {"below": lambda s: s.reference - s.x[0], "above": lambda s: s.x[0] - s.reference}
    ocp = cart(*(Constraint(n, Rows(1, f, 1), AT_LEAST, hard=True) for n, f in compared.items()))
    solver, times = Solver(ocp, SOLVERS[algorithm]), [0.0, 0.49, 0.5, 0.51, 1.0]
    for name, far, near in (("below", 5.0, 0.0), ("above", -5.0, 1.0)):
        solver.set_reference(name, Reference(times, np.array([[far], [far], [near], [far], [far]])))  # type: ignore[arg-type]
    found = solver.solve(START)
    assert found.status is Status.RELAXED and re.search(r"(below|above)\.all\[0\] by \S+ at node 10$", found.detail)
    assert sum(found.violations[n].value for n in ("below", "above")) == pytest.approx(1.0, abs=1e-3)


@everywhere
def test_what_the_model_cannot_reach_at_the_end_is_named(algorithm: str) -> None:
    """The second state decays whatever the input does."""
    lame = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(u[0], -x[1]))
    found = solve(cart(row("end", lambda s: s.x[1] - 1, ZERO, at="terminal"), dynamics=lame), SOLVERS[algorithm])
    assert found.status is Status.INFEASIBLE and re.search(
        r"largest violation: end\.all\[0\] by 1 at node", found.detail
    )


@everywhere
def test_rows_that_repeat_each_other_change_nothing(algorithm: str) -> None:
    nine = [row(f"limit{i}", lambda s: s.u + 0.5 + 0.1 * s.x[1], hard=True) for i in range(9)]
    found, want = (solve(cart(*nine[:n]), SOLVERS[algorithm]) for n in (9, 1))
    assert found.status is want.status is Status.CONVERGED
    np.testing.assert_allclose(found.u, want.u, atol=1e-5)


# ---------------------------------------------------------------------- functions without values
@pytest.mark.parametrize("algorithm", ["sqp", "filter", "ilqr", "slq"])
@pytest.mark.parametrize(
    ("term", "named"),
    [
        (cost("power", lambda s: s.x[1] ** 1.5), "a step further term 'power' at node 1 is not finite"),
        (row("angle", lambda s: ca.acos(1.0001 * s.x[0]) - s.u, ZERO), "term 'angle' at node"),
        (cost("pole", lambda s: 1.0 / s.u), "term 'pole' at node 0"),
        (cost("nan", lambda s: s.x[0] * np.nan), "term 'nan' at node 0"),
        (cost("huge", lambda s: ca.exp(1000 * s.x[0])), "term 'huge'"),
        (row("infinite", lambda s: s.x[0] + np.inf, hard=True), "term 'infinite' at node 0"),
    ],
    ids=lambda v: v.name if isinstance(v, Cost | Constraint) else "",
)
def test_a_step_that_leaves_a_domain_names_the_term(algorithm: str, term: Cost | Constraint, named: str) -> None:
    found = solve(cart(term), SOLVERS[algorithm])
    assert found.status in (Status.LINE_SEARCH_FAILED, Status.NOT_FINITE, Status.DIVERGED)
    assert named in found.detail, found


def test_a_real_time_iteration_without_a_step_names_the_term() -> None:
    found = solve(cart(cost("power", lambda s: s.x[1] ** 1.5)), SQP.real_time())
    assert found.status is Status.LINE_SEARCH_FAILED and "term 'power' at node 1 is not finite" in found.detail


def test_second_derivatives_without_a_value_name_the_term() -> None:
    found = solve(cart(cost("power", lambda s: ca.fabs(s.x[1]) ** 1.5)), SQP(hessian="exact"))
    assert found.status is Status.NOT_FINITE and "term 'power' at node 0" in found.detail


def test_dry_friction_ends_with_a_motion_that_no_step_improves() -> None:
    """ẍ = u − 5 sign(ẋ): the linearization at rest knows nothing of it. A roll-out of the policy is a motion all the same."""
    dry = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0] - 5 * ca.sign(x[1])))
    found = solve(cart(dynamics=dry), SQP())
    assert found.status is Status.LINE_SEARCH_FAILED and found.violation < 1e-9
    assert (
        "the interval of 0.05 s at node 0 is too long for the integrator" in found.detail
    )  # friction is infinitely stiff


@everywhere
def test_a_discontinuous_cost_ends(algorithm: str) -> None:
    """A local solution, or the iteration limit with what still moves."""
    found = solve(cart(cost("step", lambda s: ca.if_else(s.x[0] > 0.8, 5.0, 0.0) + s.x[0])), SOLVERS[algorithm])
    assert found.status is Status.CONVERGED or re.search(
        r"largest step: (state|input) '\S+' by \S+ at node", found.detail
    )


# ---------------------------------------------------------------------- grids and events
class Jumping(ToyDynamics):
    def __init__(self, jump: Callable[[ca.SX, ca.SX], ca.SX]) -> None:
        super().__init__(2, 1, INTEGRATOR, mode=1)
        self._jump = jump

    def jump(self, x: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        return self._jump(x, m)


def switched(solver: Solver, *events: float) -> Solver:
    modes = [Mode(f"mode{i}", {"m": [float(i)]}) for i in range(len(events) + 1)]
    solver.set_schedule(ModeSchedule(tuple(modes), events))
    return solver


@pytest.mark.parametrize("algorithm", ["sqp", "ilqr", "slq"])
def test_a_jump_without_a_value_is_named(algorithm: str) -> None:
    jumping = Jumping(lambda x, m: ca.vertcat(x[0], x[1] / (m[0] - 1)))
    solver = switched(Solver(cart(dynamics=jumping), SOLVERS[algorithm]), 0.5)
    found, node = solver.solve(START), 20 if algorithm == "slq" else 10
    assert found.status is Status.NOT_FINITE
    named = f"the jump at node {node}" if algorithm == "sqp" else f"state 'x.1' at node {node} from the jump there"
    assert found.detail == named


def test_a_jump_that_cannot_be_prevented_is_no_gap() -> None:
    """The event throws the cart to 3, and the last interval cannot bring it back: the constraint is named, not the jump."""
    solver = Solver(
        cart(row("end", lambda s: s.x[0], ZERO, at="terminal"), dynamics=Jumping(lambda x, m: ca.vertcat(3, 0)))
    )
    found = switched(solver, 0.97).solve(START)
    assert found.status is Status.INFEASIBLE and found.detail == "largest violation: end.all[0] by 3 at node 20"


@pytest.mark.parametrize("algorithm", ["sqp", "ilqr", "slq"])
def test_events_outside_the_horizon_change_nothing(algorithm: str) -> None:
    thrown = Jumping(lambda x, m: x + 100.0)
    found = switched(Solver(cart(dynamics=thrown), SOLVERS[algorithm]), -5.0, -1.0, 3.0, 1e9).solve(START)
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.u, solve(cart(), SOLVERS[algorithm]).u, atol=1e-8)


@pytest.mark.parametrize("algorithm", ["sqp", "ilqr", "slq"])
def test_a_contradiction_of_a_later_mode_names_its_node(algorithm: str) -> None:
    low, high = (row(n, f, hard=True) for n, f in (("low", lambda s: s.u - 1), ("high", lambda s: -s.u - 1)))
    later = Constraint(low.name, low.residual, AT_LEAST, hard=True, modes=("mode1",))
    solver = Solver(cart(later, high, dynamics=Jumping(lambda x, m: x)), SOLVERS[algorithm])
    found = switched(solver, 0.5).solve(START)
    assert found.status is Status.INFEASIBLE and re.match(r"largest violation: (low|high)\.", found.detail)
    assert int(found.detail.split()[-1]) >= len(found.u) // 2


@pytest.mark.parametrize("integrator", ["rk2", "rk4"])
def test_an_interval_too_long_for_the_dynamics_is_reported(integrator: str) -> None:
    """ẏ = 60 (u − y) at 0.05 s: z = −3 grows 2.5 times (midpoint rule) and 1.375 times (classic rule) a step."""
    fast = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(-60 * x[0] + 60 * u[0], -x[1]))
    ocp = OptimalControlProblem(fast, 1.0, 20, integrator=integrator)  # type: ignore[arg-type]
    ocp.add(Cost("both", Rows(3, lambda s: ca.vertcat(s.x, s.u)), 1.0))
    found = solve(ocp, SQP())
    growth = {"rk2": 2.5, "rk4": 1.4}[integrator]
    assert (
        f"0.05 s at node 0 is too long for the integrator: a motion that decays within 0.017 s grows {growth} times"
        in str(found)
    )


@pytest.mark.parametrize("stable", [-10.0, 5.0])
def test_what_decays_slowly_or_grows_by_itself_is_not_blamed(stable: float) -> None:
    own = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(stable * x[0] + x[1] ** 2, u[0]))
    assert solve(cart(dynamics=own), SQP()).detail == ""


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sets.Box(np.inf, np.inf), "a lower bound of inf or an upper one of -inf allows nothing"),
        (lambda: Reference(np.array([]), np.zeros((0, 1))), "reference: at least one sample is needed"),
        (
            lambda: solve(OptimalControlProblem(ToyDynamics(2, 1, INTEGRATOR), 1e6, 5), SLQ()),
            "cuts a horizon of 1e.06 s into",
        ),
        (
            lambda: Solver(OptimalControlProblem(ToyDynamics(2, 0, lambda x, u, w, m: x), 1.0, 5)),
            "a state and an input are needed, got 2 states and 0 inputs",
        ),
    ],
    ids=["box", "reference", "slq", "no input"],
)
def test_what_cannot_be_meant_is_rejected(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()
