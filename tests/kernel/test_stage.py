"""Compiled stage functions. Truth: CasADi's interpreter at the same random points."""

from __future__ import annotations

import numpy as np
import pytest

from toys import call_scalar, pendulum, random_stage, rezero_solver, swerve_solver
from wbmpc.kernel.compiled import output_maps

MAKERS = {"swerve": swerve_solver, "rezero": rezero_solver, "pendulum": pendulum}


@pytest.fixture(scope="module", params=MAKERS)
def solver(request):  # type: ignore[no-untyped-def]
    return MAKERS[request.param]()


def expected(function, arguments, maps, size):  # type: ignore[no-untyped-def]
    """What the compiled function stores: CasADi's non-zeros at the mapped places; elsewhere NaN."""
    out = []
    for value, places in zip(function.call([np.asarray(a) for a in arguments]), maps, strict=True):
        array = np.full(size, np.nan)
        for number, offsets in zip(value.nonzeros(), places, strict=True):
            array[offsets] = number
        out.append(array)
    return out


def check(solver, name: str, function, arguments) -> None:  # type: ignore[no-untyped-def]
    sizes = solver.kernel.sizes
    maps = output_maps({**solver.problem.values, **solver.problem.derivatives}, sizes)[name]
    size = sizes.nz * sizes.lz + sizes.equality_buffer() + 8
    got = call_scalar(solver.kernel.address(name), arguments, [size] * function.n_out())
    for a, b in zip(got, expected(function, arguments, maps, size), strict=True):
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
        scale = max(1.0, np.nanmax(np.abs(b))) if np.isfinite(b).any() else 1.0
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-12 * scale)


def test_all_stage_functions(solver) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(3)
    for _ in range(5):
        x, u, p, w = random_stage(solver, rng)
        for name in ("dynamics", "cost", "equality"):
            check(solver, name, solver.problem.values[name], [x, u, p, w])
        check(solver, "terminal", solver.problem.values["terminal"], [x, p, w])
        for name in ("dynamics_jacobian", "equality_jacobian"):
            check(solver, name, solver.problem.derivatives[name], [x, u, p, w])
        check(solver, "cost_quadratic", solver.problem.derivatives["cost_quadratic"], [x, u, p, w, np.array([0.07])])
        check(solver, "terminal_quadratic", solver.problem.derivatives["terminal_quadratic"], [x, p, w])


def test_matrix_layout(solver) -> None:  # type: ignore[no-untyped-def]
    """The places of the solver's matrices, read back as dense arrays: [x, 1, u] columns."""
    problem, s = solver.problem, solver.kernel.sizes
    x, u, p, w = random_stage(solver, np.random.default_rng(4))
    index = [*range(s.nx), *range(s.first, s.nz)]
    f = problem.derivatives["dynamics_jacobian"]
    got = np.nan_to_num(call_scalar(solver.kernel.address("dynamics_jacobian"), [x, u, p, w], [s.nx, s.nx * s.lz])[1])
    np.testing.assert_allclose(got.reshape(s.nx, s.lz)[:, index], np.array(f(x, u, p, w)[1]), rtol=1e-9, atol=1e-11)
    size = s.nz * s.lz
    arguments = [x, u, p, w, np.array([0.3])]
    value, gradient, hessian = problem.derivatives["cost_quadratic"](*[np.asarray(a) for a in arguments])
    out = call_scalar(solver.kernel.address("cost_quadratic"), arguments, [1, size, size])
    full = np.array(hessian) + np.triu(np.array(hessian), 1).T
    matrix = np.nan_to_num(out[2]).reshape(s.nz, s.lz)
    scale = 1e-11 * (1.0 + np.abs(full).max())
    np.testing.assert_allclose(matrix[: s.nx, : s.nx], full[: s.nx, : s.nx], rtol=1e-9, atol=scale)
    lower = np.tril(matrix[np.ix_(index, index)])
    np.testing.assert_allclose(lower, np.tril(full), rtol=1e-9, atol=scale)
    column = np.nan_to_num(out[1]).reshape(s.nz, s.lz)
    np.testing.assert_allclose(column[index, s.nx], np.array(gradient).ravel(), rtol=1e-9, atol=scale)
    np.testing.assert_allclose(column[s.nx, : s.nx], np.array(gradient).ravel()[: s.nx], rtol=1e-9, atol=scale)
    assert out[0][0] == pytest.approx(float(value), rel=1e-10)
