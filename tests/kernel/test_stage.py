"""Compiled stage functions, of one node and of eight. Truth: CasADi's interpreter at the same random points."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from toys import Rows, ToyDynamics, call_lanes, call_scalar, pendulum, random_stage, rezero_solver, swerve_solver
from wbmpc.kernel.compiled import lane_maps, matrix_groups, output_maps
from wbmpc.ocp import Cost, OptimalControlProblem
from wbmpc.solver import SQP, Solver, riccati
from wbmpc.solver import memory_layout as places


class Spinning(ToyDynamics):
    """A position and an attitude: ṡ = u₀ + q₁, q̇ = ½ q ⊗ (0, ω) with a spin that grows with the position."""

    unit_quaternions = (1,)

    def __init__(self) -> None:
        def f(x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
            a, v, spin = x[1], x[2:5], u[1:4] + 0.3 * x[0]
            return ca.vertcat(u[0] + v[0], -0.5 * ca.dot(v, spin), 0.5 * (a * spin + ca.cross(v, spin)))

        super().__init__(5, 4, f)


def spinning(integrator: str) -> Solver:
    """No reference, quadratic costs."""
    ocp = OptimalControlProblem(Spinning(), 1.0, 9, integrator=integrator)
    ocp.add(Cost("state", Rows(5, lambda s: s.x), 1.0, at="path+terminal"))
    ocp.add(Cost("input", Rows(4, lambda s: s.u), 0.1))
    return Solver(ocp, SQP(iterations=1))


MAKERS = {
    "swerve": swerve_solver,
    "rezero": rezero_solver,
    "pendulum": pendulum,
    "quaternion, rk2": lambda: spinning("rk2"),
    "quaternion, rk4": lambda: spinning("rk4"),
}


@pytest.fixture(scope="module", params=MAKERS)
def solver(request):  # type: ignore[no-untyped-def]
    return MAKERS[request.param]()


def expected(function, arguments, maps, size):  # type: ignore[no-untyped-def]
    """What the compiled function stores: CasADi's non-zeros at the mapped places; elsewhere NaN."""
    out = []
    for value, spots in zip(function.call([np.asarray(a) for a in arguments]), maps, strict=True):
        array = np.full(size, np.nan)
        for number, offsets in zip(value.nonzeros(), spots, strict=True):
            array[offsets] = number
        out.append(array)
    return out


def check(solver, name: str, function, arguments) -> None:  # type: ignore[no-untyped-def]
    """A function of one node."""
    sizes = solver.kernel.sizes
    maps = output_maps({**solver.problem.values, **solver.problem.derivatives}, sizes)[name]
    size = sizes.nz * sizes.lz + sizes.equality_buffer() + 8
    got = call_scalar(solver.kernel.address(name), arguments, [size] * function.n_out())
    compare(got, expected(function, arguments, maps, size))


def compare(got, want) -> None:  # type: ignore[no-untyped-def]
    for a, b in zip(got, want, strict=True):
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
        scale = max(1.0, np.nanmax(np.abs(b))) if np.isfinite(b).any() else 1.0
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-12 * scale)


def eight_stages(solver, seed: int):  # type: ignore[no-untyped-def]
    """Eight random nodes: x, u, p (8, …), the w that they share, h (8, 1)."""
    rng = np.random.default_rng(seed)
    nodes = [random_stage(solver, rng) for _ in range(8)]
    x, u, p = (np.array([n[i] for n in nodes]) for i in range(3))
    return [x, u, p, nodes[0][3], rng.uniform(0.01, 0.2, (8, 1))]


def test_functions_of_one_node(solver) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(3)
    for _ in range(5):
        x, u, p, w = random_stage(solver, rng)
        check(solver, "dynamics", solver.problem.values["dynamics"], [x, u, p, w])
        check(solver, "terminal", solver.problem.values["terminal"], [x, p, w])
        check(solver, "terminal_quadratic", solver.problem.derivatives["terminal_quadratic"], [x, p, w])


@pytest.mark.parametrize("name", ["dynamics", "cost", "equality", "rows"])
def test_values_of_eight_nodes(solver, name: str) -> None:  # type: ignore[no-untyped-def]
    function, arguments = solver.problem.values[name], eight_stages(solver, 5)[:4]
    size = function.nnz_out(0)
    (got,) = call_lanes(solver.kernel.address(f"lanes.{name}"), arguments, [size], shared=(3,))
    for k in range(8):
        own = [a if i == 3 else a[k] for i, a in enumerate(arguments)]
        compare([got[k]], [np.array(function(*own)).ravel()])


@pytest.mark.parametrize("name", ["dynamics_jacobian", "cost_quadratic", "equality_jacobian", "rows_jacobian"])
def test_derivatives_of_eight_nodes(solver, name: str) -> None:  # type: ignore[no-untyped-def]
    """Also: the non-zeros are where the unpacking of the groups takes them from."""
    sizes, function = solver.kernel.sizes, solver.problem.derivatives[name]
    functions = {**solver.problem.values, **solver.problem.derivatives}
    whole = output_maps(functions, sizes)
    maps, size = (
        lane_maps(whole, matrix_groups(functions, whole, sizes))[name],
        sizes.nz * sizes.lz + sizes.equality_buffer() + 8,
    )
    arguments = eight_stages(solver, 6)[: function.n_in()]
    got = call_lanes(solver.kernel.address(f"lanes.{name}"), arguments, [size] * function.n_out(), shared=(3,))
    for k in range(8):
        own = [a if i == 3 else a[k] for i, a in enumerate(arguments)]
        compare([g[k] for g in got], expected(function, own, maps, size))


def test_matrix_layout(solver) -> None:  # type: ignore[no-untyped-def]
    """The solver's matrices after :func:`linearize_block`, read back as dense arrays with columns [x, 1, u]."""
    problem, s, ws = solver.problem, solver.kernel.sizes, solver.ws
    x, u, p, w, _ = eight_stages(solver, 4)
    n = min(8, len(ws.u))
    ws.x[:n], ws.u[:n], ws.p[:n, : p.shape[1]], ws.w[: w.size] = x[:n], u[:n], p[:n], w
    for block in (places.ROW_T, places.ROW_L, places.ROW_S, places.ROW_Y):
        own = ws.memory[ws.table[block] :][: n * ws.table[places.ROWS]]
        own[:] = np.random.default_rng(block).uniform(0.1, 1.0, own.size)
    riccati.linearize_block(ws.memory, ws.table, 0, n, 0)
    index = [*range(s.nx), *range(s.first, s.nz)]
    at = lambda place, rows, k: ws.memory[ws.table[place] + k * rows * s.lz :][: rows * s.lz].reshape(rows, s.lz)
    quadratic, rows = problem.derivatives["cost_quadratic"], problem.derivatives["rows_jacobian"]
    for k in range(n):
        h = ws.grid[k + 1] - ws.grid[k]
        _, gradient, hessian = quadratic(x[k], u[k], p[k], w, h)
        full = np.array(hessian) + np.triu(np.array(hessian), 1).T
        matrix, column = at(places.H, s.nz, k), np.array(gradient).ravel()
        scale = 1e-11 * (1.0 + np.abs(full).max())
        if s.nr:
            first = ws.table[places.ROW_C] + k * ws.table[places.ROWS] + ws.table[places.ROW_BOXES]
            jacobian, sigma = np.array(rows(x[k], u[k], p[k], w)[1]), ws.memory[first : first + s.nr]
            assert k == 0 or np.all(sigma > 0.0)
            full += jacobian.T @ (h * sigma[:, None] * jacobian)
            scale = 1e-11 * (1.0 + np.abs(full).max())
        else:
            np.testing.assert_allclose(matrix[: s.nx, : s.nx], full[: s.nx, : s.nx], rtol=1e-9, atol=scale)
        lower = np.tril(matrix[np.ix_(index, index)])
        np.testing.assert_allclose(lower, np.tril(full), rtol=1e-9, atol=scale)
        np.testing.assert_allclose(matrix[index, s.nx], column, rtol=1e-9, atol=scale)
        np.testing.assert_allclose(matrix[s.nx, : s.nx], column[: s.nx], rtol=1e-9, atol=scale)
        ab, truth = (
            at(places.AB, s.nx + 1, k),
            step_with_jacobian(problem, x[k], u[k], p[k], w, ws.grid[k + 1] - ws.grid[k]),
        )
        np.testing.assert_allclose(ab[: s.nx][:, index], truth[1], rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(ab[: s.nx, s.nx], truth[0] - ws.x[k + 1], rtol=1e-9, atol=1e-11)


def step_with_jacobian(problem, x, u, p, w, h):  # type: ignore[no-untyped-def]
    """End of a Runge-Kutta step and its derivative by (x, u), of CasADi's own graph of the whole step."""
    z = ca.MX.sym("z", problem.nx + problem.nu)
    start, given = z[: problem.nx], z[problem.nx :]
    f = lambda state: problem.values["dynamics"](state, given, p, w)
    if problem.ocp.integrator == "rk4":
        k1 = f(start)
        k2 = f(start + h / 2 * k1)
        k3 = f(start + h / 2 * k2)
        end = start + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(start + h * k3))
    else:
        end = start + h * f(start + h / 2 * f(start))
    for q in problem.ocp.dynamics.unit_quaternions:
        end[q : q + 4] = end[q : q + 4] / ca.norm_2(end[q : q + 4])
    both = ca.Function("step", [z], [end, ca.jacobian(end, z)])(np.concatenate([x, u]))
    return np.array(both[0]).ravel(), np.array(both[1])
