"""The solver's public trajectory, warm start and parameters. Truth: what was put in; the solution; the source text."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from toys import pendulum
from wbmpc.solver import Solver

ROOT = Path(__file__).parents[2]
#: A benchmark of single functions of the driver.
LEFT = {"benchmarks/translator_vs_numba.py"}


def solved() -> Solver:
    solver = pendulum("compiled")
    solver.solve(np.array([0.1, 0.3, 0.0, 0.0]))
    return solver


def test_a_trajectory_is_what_was_solved_and_starts_the_same_solve_again() -> None:
    solver = solved()
    solution, plan = solver.solution(1, 1, 0.0), solver.trajectory(start=2.5)
    np.testing.assert_array_equal(plan.x, solution.x)
    np.testing.assert_array_equal(plan.u, solution.u)
    np.testing.assert_array_equal(plan.times, 2.5 + solution.times)
    np.testing.assert_array_equal(solver.gain, solution.gain)
    plan.x[:], plan.u[:] = 7.0, 8.0  # a copy
    np.testing.assert_array_equal(solver.trajectory().x, solution.x)
    solver.warm_start(plan.x, plan.u)
    assert np.all(solver.trajectory().x == 7.0) and np.all(solver.trajectory().u == 8.0)


def test_views_follow_the_solver_and_cannot_be_written_to() -> None:
    solver = solved()
    plan = solver.trajectory(copy=False)
    solver.warm_start(np.arange(4.0))
    np.testing.assert_array_equal(plan.x[-1], [0.0, 1.0, 2.0, 3.0])
    for view in (plan.x, plan.u, plan.grid, solver.gain, solver.node_parameters, solver.constants, solver.parameters):
        with pytest.raises(ValueError, match="read-only"):
            view[...] = 0.0


@pytest.mark.parametrize(("part", "name"), [("k", "feedback gain"), ("x", "planned state"), ("u", "planned input")])
def test_what_is_not_finite_is_found_wherever_in_the_horizon(part: str, name: str) -> None:
    solver = solved()
    assert solver.non_finite_part() == ""
    getattr(solver.ws, part)[-1] = np.nan
    assert solver.non_finite_part() == name


def _touches_memory(path: Path) -> bool:
    text = path.read_text()
    if ".ws" not in text:  # parsing takes long
        return False
    tree = ast.parse(text)
    return any(isinstance(node, ast.Attribute) and node.attr == "ws" for node in ast.walk(tree))


def test_the_solvers_memory_is_private() -> None:
    """Nothing but the solver, the kernels, exports and their tests reads or writes ``Solver.ws``."""
    own = ("src/wbmpc/solver", "src/wbmpc/kernel", "src/wbmpc/embedded", "tests/solver", "tests/kernel")
    files = [
        p.relative_to(ROOT).as_posix()
        for d in ("src", "tests", "benchmarks", "examples")
        for p in (ROOT / d).rglob("*.py")
    ]
    found = {name for name in files if not name.startswith(own) and _touches_memory(ROOT / name)}
    assert found == LEFT
