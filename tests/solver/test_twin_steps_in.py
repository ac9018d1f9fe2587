"""What cannot be compiled is interpreted, and said. Truth: the same problem in operations that can be compiled (a cubic
spline through a parabola is the parabola)."""

from __future__ import annotations

import logging

import casadi as ca
import numpy as np
import pytest

from effort import some
from toys import Rows, ToyDynamics
from wbmpc.errors import UnsupportedOperation
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.solver import SQP, Solver, Status, solver
from wbmpc.types import Observation

KNOTS = np.linspace(-3.0, 3.0, 13)
PARABOLA = ca.interpolant("parabola", "bspline", [KNOTS], KNOTS**2)
START = np.array([1.0, 0.5])


def cart(drag=lambda v: v**2, *more: Cost | Constraint, curve=lambda x: x**2, **grid: object):  # type: ignore[no-untyped-def]
    """ẍ = u − drag, with a cost of ``curve`` of the place."""
    model = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0] - 0.1 * drag(x[1])))
    ocp = OptimalControlProblem(model, 1.0, 8, **grid)  # type: ignore[arg-type]
    ocp.add(Cost("curve", Rows(1, lambda s: curve(s.x[0])), 2.0, at="path+terminal"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 0.1))
    for term in more:
        ocp.add(term)
    return ocp


@pytest.mark.parametrize("where", some(["the dynamics", "term 'curve'"], [0]))
def test_a_lookup_table_is_interpreted_and_said_once(where: str, caplog: pytest.LogCaptureFixture) -> None:
    given = {"drag": PARABOLA} if where == "the dynamics" else {"curve": PARABOLA}
    solver._warn.cache_clear()  # another test may have had the same problem
    with caplog.at_level(logging.WARNING, "wbmpc"):
        found = [Solver(cart(**given)).solve(START) for _ in range(2)][-1]  # type: ignore[arg-type]
    reported = [r.getMessage() for r in caplog.records]
    assert (
        len(reported) == 1
        and reported[0].startswith(f"{where}: the SX operation OP_CALL")
        and "interpreter" in reported[0]
    )
    want = Solver(cart()).solve(START)
    assert found.status is want.status is Status.CONVERGED
    np.testing.assert_allclose(found.x, want.x, atol=1e-7)
    np.testing.assert_allclose(found.u, want.u, atol=1e-6)


def test_an_mpc_runs_on_the_twin() -> None:
    mpc, same = MPC(cart(PARABOLA)), MPC(cart())
    for t in (0.0, 0.02):
        got, want = (m.update(Observation(t, START)) for m in (mpc, same))
        np.testing.assert_allclose(got.u, want.u, atol=1e-6)


@pytest.mark.parametrize(
    ("settings", "grid", "missing"),
    [
        (SQP(line_search="filter"), {}, "filter line search"),
        (SQP(hessian="exact"), {}, "exact Hessian"),
        (SQP(), {"align_events": True}, "grid that follows events"),
    ],
)
def test_what_the_twin_lacks_is_rejected(settings: SQP, grid: dict[str, bool], missing: str) -> None:
    with pytest.raises(
        UnsupportedOperation, match=f"^the dynamics: .*OP_CALL.*, and the interpreted twin has no {missing}$"
    ):
        Solver(cart(PARABOLA, **grid), settings)


def test_the_twin_names_an_input_without_curvature() -> None:
    """Its Cholesky factor fails; a shift of the Hessian's diagonal cannot mend what the costs leave open."""
    ocp = cart(PARABOLA)
    del ocp.terms["input"]
    ocp.terms["curve"] = Cost("curve", Rows(1, lambda s: s.x[0] * np.nan), 1.0)
    found = Solver(ocp).solve(START)
    assert found.status is Status.NOT_FINITE and "term 'curve' at node 0; no term depends on input 'u.0'" in str(found)


def test_table_in_a_constraint_holds() -> None:
    """x² ≤ 1.2 from x = 1 with ẋ = 0.5 on: the table is at the limit when the parabola is."""
    bound = lambda curve: Constraint("bound", Rows(1, lambda s: 1.2 - curve(s.x[0])), sets.NonNegative(), hard=True)
    found, want = (
        Solver(cart(lambda v: v**2, bound(c))).solve(np.array([1.0, 2.0])) for c in (PARABOLA, lambda x: x**2)
    )
    assert found.status is want.status
    assert found.violations["bound"].value == pytest.approx(want.violations["bound"].value, abs=1e-5)
