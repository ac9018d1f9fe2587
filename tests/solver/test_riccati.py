"""One iteration on linear quadratic problems. Truth: the dense KKT system, and SciPy's algebraic Riccati equation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.linalg import solve_discrete_are
from scipy.sparse.linalg import spsolve

from effort import draws, some
from toys import LinearQuadratic
from wbmpc.solver import SQP, Solver


@dataclass(frozen=True)
class Step:
    """Guess plus the full step (the line search may take less of it), first gain and value function."""

    x: np.ndarray
    u: np.ndarray
    gain: np.ndarray
    value: np.ndarray


def one_step(lq: LinearQuadratic, backend: str = "compiled") -> Step:
    solver = Solver(lq.problem(), SQP(iterations=1, compute_kkt=False, backend=backend), use_cache=False)
    solver.warm_start(0.1 * np.ones(lq.nx), 0.2 * np.ones(lq.nu))
    nx = lq.nx
    if backend == "interpreted":
        found = solver._backend.twin.iterate(lq.x0)
        return Step(0.1 + found["dx"], 0.2 + found["du"], solver.ws.k[0], found["value"])
    solver.iterate(lq.x0)
    return Step(0.1 + solver.ws.dx[:, :nx], 0.2 + solver.ws.du, solver.ws.k[0, :, :nx], solver.ws.value[:nx, :nx])


def check_against_kkt(lq: LinearQuadratic, step: Step, tolerance: float = 1e-7) -> None:
    x, u = lq.kkt(lq.x0)
    # the feedback gain is the derivative of the first input by the initial state
    columns = [(lq.kkt(lq.x0 + d)[1][0] - u[0]) for d in np.eye(lq.nx)]
    gain = np.array(columns).T
    scale = 1.0 + max(np.abs(x).max(), np.abs(u).max(), np.abs(gain).max())
    assert np.abs(step.x - x).max() < tolerance * scale
    assert np.abs(step.u - u).max() < tolerance * scale
    assert np.abs(step.gain - gain).max() < 10 * tolerance * scale


# the same examples every time: how exact the softness lets it be depends on the numbers drawn
@settings(max_examples=draws(5, 25), deadline=None, derandomize=True)
@given(st.integers(1, 9), st.integers(1, 9), st.data())
def test_against_dense_kkt(nx: int, nu: int, data: st.DataObject) -> None:
    ng = data.draw(st.integers(0, min(nu, 8)))
    lq = LinearQuadratic(nx, nu, ng, n=4, seed=data.draw(st.integers(0, 999)))
    check_against_kkt(lq, one_step(lq), 1e-6)


def sparse_kkt(lq: LinearQuadratic) -> tuple[np.ndarray, np.ndarray]:
    """Solution (x, u) of the KKT system of a problem with independent rows, however long its horizon."""
    n, nx, nz, ng = lq.n, lq.nx, lq.nx + lq.nu, len(lq.e_offset)
    h, pick = np.diff(lq.grid), sparse.eye(n + 1, format="csr")
    cost = sparse.kron(sparse.diags(h), lq.rows.T @ np.diag(lq.weight) @ lq.rows)
    hessian = sparse.block_diag([cost, 3.0 * lq.end_rows.T @ lq.end_rows])
    slope = lq.rows.T @ (lq.weight * lq.offset)
    gradient = np.concatenate([*(slope * t for t in h), 3.0 * lq.end_rows.T @ lq.end_offset])
    here = lambda k: sparse.hstack([sparse.kron(pick[k, :n], sparse.eye(nz)), sparse.csr_matrix((nz, nx))])
    state = lambda k: sparse.csr_matrix((np.ones(nx), (range(nx), k * nz + np.arange(nx))), (nx, n * nz + nx))
    left, right = [state(0)], [lq.x0]
    for k, step in enumerate(h):
        a, b, c = lq.discrete(step)
        left += [state(k + 1) - sparse.csr_matrix(np.hstack([a, b])) @ here(k)]
        right += [c]
        if ng:
            left, right = [*left, sparse.csr_matrix(lq.e_rows) @ here(k)], [*right, -lq.e_offset]
    g = sparse.vstack(left)
    z = spsolve(sparse.bmat([[hessian, g.T], [g, None]], format="csc"), np.concatenate([-gradient, *right]))
    nodes = z[: n * nz].reshape(n, nz)
    return np.vstack([nodes[:, :nx], z[n * nz : n * nz + nx]]), nodes[:, nx:]


@settings(max_examples=draws(3, 9), deadline=None, derandomize=True)
@given(st.sampled_from([1, 2, 400]), st.integers(1, 5), st.integers(1, 5), st.data())
def test_short_and_long_horizons(n: int, nx: int, nu: int, data: st.DataObject) -> None:
    """No constraints, and more rows than needed: each up to three times, together more than there are inputs."""
    ng, times = data.draw(st.integers(0, nu)), data.draw(st.integers(0, 2))
    seed = data.draw(st.integers(0, 999))
    make = lambda repeat: LinearQuadratic(nx, nu, ng, n=n, seed=seed, repeat=repeat)
    lq, once = make(times * ng), make(0)
    for problem in (lq, once):
        problem.grid = problem.grid * (0.1 if n < 3 else 2.0) / problem.grid[-1]  # random models are unstable
    step, (x, u) = one_step(lq), sparse_kkt(once)
    assert len(lq.e_offset) == (1 + times) * ng and step.u.shape == (n, nu)
    scale = 1.0 + max(np.abs(x).max(), np.abs(u).max())
    assert np.abs(step.x - x).max() < 1e-6 * scale
    assert np.abs(step.u - u).max() < 1e-5 * scale


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize(
    ("nx", "nu", "ng"),
    some([(3, 2, 0), (3, 2, 1), (7, 8, 5), (8, 7, 7), (15, 9, 8), (17, 9, 9), (9, 16, 9)], range(4)),
)
def test_sizes_around_the_vector_length(backend: str, nx: int, nu: int, ng: int) -> None:
    lq = LinearQuadratic(nx, nu, ng, n=3, seed=4)
    check_against_kkt(lq, one_step(lq, backend))


@pytest.mark.parametrize("integrator", ["rk2", "rk4"])
def test_integrators(integrator: str) -> None:
    lq = LinearQuadratic(4, 3, 1, seed=2, integrator=integrator)
    check_against_kkt(lq, one_step(lq))


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("repeat", [1, 3])
def test_dependent_consistent_rows(backend: str, repeat: int) -> None:
    lq = LinearQuadratic(5, 4, 3, seed=1, repeat=repeat)
    check_against_kkt(lq, one_step(lq, backend), 1e-5)


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
def test_softness(backend: str) -> None:
    """A soft row may be softness times its multiplier: −c I in the KKT matrix."""
    lq = LinearQuadratic(4, 3, 2, seed=5, softness=0.3)
    check_against_kkt(lq, one_step(lq, backend))
    rigid = LinearQuadratic(4, 3, 2, seed=5)
    assert np.abs(lq.kkt(lq.x0)[1] - rigid.kkt(lq.x0)[1]).max() > 1e-3


def test_infinite_horizon() -> None:
    lq = LinearQuadratic(4, 2, 0, n=400, seed=7)
    lq.grid = np.linspace(0.0, 40.0, 401)
    step = one_step(lq)
    a, b, _ = lq.discrete(0.1)
    m = 0.1 * lq.rows.T @ np.diag(lq.weight) @ lq.rows
    p = solve_discrete_are(a, b, m[:4, :4], m[4:, 4:], s=m[:4, 4:])
    gain = -np.linalg.solve(m[4:, 4:] + b.T @ p @ b, b.T @ p @ a + m[4:, :4])
    assert np.abs(step.value - p).max() < 1e-9 * np.abs(p).max()
    assert np.abs(step.gain - gain).max() < 1e-9 * np.abs(gain).max()
