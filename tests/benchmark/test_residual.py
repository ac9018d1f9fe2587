"""One measure of optimality for all solvers. Truth: SciPy's non-negative least squares, multipliers by hand, IPOPT's solution."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import nnls

from small_problems import cartpole, double_integrator
from wbmpc.benchmark.peers import EQUAL, Measure, least_squares, peer_statistics, prepare, solve_with, to_equal_residual
from wbmpc.benchmark.problems import suite_bench
from wbmpc.benchmark.program import Program
from wbmpc.benchmark.race import ours, several_iterations


def test_multipliers_of_signed_rows_are_those_of_scipy() -> None:
    """Rows at right angles: leaving out the negative ones is exact; a free row is one with both signs."""
    rng = np.random.default_rng(0)
    for _ in range(10):
        jacobian = np.linalg.qr(rng.normal(size=(9, 9)))[0][:6] * rng.uniform(0.5, 2.0, (6, 1))
        gradient, weights = rng.normal(size=9), np.array([0.0, 0.0, 0.3, 0.0, 2.0, 0.0])
        signed = np.array([False, False, True, True, True, True])
        y = least_squares(gradient, sp.csc_matrix(jacobian), weights, signed)
        matrix = np.vstack([jacobian.T, np.diag(weights)])
        both = np.hstack([matrix, -matrix[:, :2]])
        z, _ = nnls(both, np.concatenate([gradient, np.zeros(6)]))
        z[:2] -= z[6:]
        np.testing.assert_allclose(y, z[:6], atol=1e-9)


def test_dependent_rows() -> None:
    """The same row twice: what is left does not depend on how the multiplier is shared."""
    row = np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 0.0]])
    y = least_squares(np.array([3.0, 6.0, 0.5]), sp.csc_matrix(row), np.zeros(2), np.zeros(2, bool))
    np.testing.assert_allclose(np.array([3.0, 6.0, 0.5]) - row.T @ y, [0.0, 0.0, 0.5], atol=1e-9)


@pytest.fixture(scope="module")
def limited():  # type: ignore[no-untyped-def]
    """A double integrator at its limits: problem, peers' form, measure, our solution."""
    problem = suite_bench(double_integrator(12, hard=True))
    prepared = prepare(problem, compile_functions=False)
    return problem, prepared, Measure(prepared.program), ours(problem, 2)[:2]


def test_our_solution_and_ipopts_are_optimal(limited) -> None:  # type: ignore[no-untyped-def]
    problem, prepared, measure, (x, u) = limited
    assert np.abs(u).max() > 1.0 - 1e-6  # the limit is active: without multipliers of its rows there is no optimum
    assert measure(x, u, problem.x0).largest < 1e-7
    start = (np.tile(problem.x0, (13, 1)), np.zeros((12, 1)))
    states, inputs, _ = solve_with("ipopt", prepared, problem.x0, *start, repeat=1)
    assert measure(states, inputs, problem.x0).largest < 1e-6


def test_what_is_wrong_shows(limited) -> None:  # type: ignore[no-untyped-def]
    problem, _, measure, (x, u) = limited
    late = x.copy()
    late[5, 0] += 0.01
    assert measure(late, u, problem.x0).primal == pytest.approx(0.01, rel=1e-6)
    assert measure(x, u, problem.x0 + [0.02, 0.0]).primal == pytest.approx(0.02, rel=1e-6)
    over = measure(
        x, 1.5 * u, problem.x0
    ).primal  # half a unit beyond a limit: a quarter of the range, what rows are in
    assert over == pytest.approx(0.25, abs=1e-6)
    calm, rest = np.zeros_like(u), [problem.x0]  # consistent, within the limits, not optimal
    for h in np.diff(problem.solver.trajectory().grid):
        rest.append(rest[-1] + h * np.array([rest[-1][1], 0.0]))
    found = measure(np.array(rest), calm, problem.x0)
    assert found.primal < 1e-12 and found.dual > 1e-3
    nowhere = measure(np.full_like(x, np.nan), u, problem.x0)
    assert nowhere.largest == np.inf and nowhere.figure is None


def test_the_gradient_of_an_unlimited_optimum_by_hand() -> None:
    """min ½ Σ h |z|² … with the program's own numbers: y from the normal equations of all rows."""
    problem = suite_bench(double_integrator(6))
    program = Program(problem.solver)
    rng = np.random.default_rng(1)
    x, u = rng.normal(size=(7, 2)), rng.normal(size=(6, 1))
    z = np.concatenate([np.hstack([x[:-1], u]).ravel(), x[-1]])
    functions = program.functions()
    a = np.array(functions["nlp_jac_g"](z, problem.x0)[1].full())
    g = np.array(functions["nlp_grad_f"](z, problem.x0)).ravel()
    left = g - a.T @ np.linalg.solve(a @ a.T, a @ g)
    assert Measure(program)(x, u, problem.x0).dual == pytest.approx(np.abs(left).max(), rel=1e-8)


@pytest.mark.parametrize("needed", [1, 2, 5, 16])
def test_the_fewest_iterations_are_found(needed: int) -> None:
    tried: list[int] = []

    def attempt(k: int):  # type: ignore[no-untyped-def]
        tried.append(k)
        return float(k), np.array([1.0 if k < needed else 0.1 * EQUAL]), np.zeros(1)

    measure = lambda x, u: Measured(float(x[0]))
    assert to_equal_residual(attempt, 16, measure) == {"equal_iterations": needed, "equal_ms": float(needed)}
    assert len(tried) <= 6
    assert to_equal_residual(attempt, max(needed - 1, 0), measure) == {}


class Measured:
    def __init__(self, largest: float) -> None:
        self.largest = largest


def test_the_race_to_an_equal_residual() -> None:
    problem = suite_bench(cartpole(10))
    prepared = prepare(problem, compile_functions=False)
    measure = Measure(prepared.program)
    maximum = problem.solver.settings.iterations
    own = to_equal_residual(
        lambda k: several_iterations(problem, k, 1), maximum, lambda x, u: measure(x, u, problem.x0)
    )
    ms, x, u = several_iterations(problem, own["equal_iterations"], 1)
    assert ms > 0.0 and measure(x, u, problem.x0).largest <= EQUAL
    if own["equal_iterations"] > 1:
        _, x, u = several_iterations(problem, own["equal_iterations"] - 1, 1)
        assert measure(x, u, problem.x0).largest > EQUAL
    peer = peer_statistics("ipopt", prepared, problem, measure)
    assert peer["residual"] <= EQUAL and 1 <= peer["equal_iterations"] <= peer["iterations"]
