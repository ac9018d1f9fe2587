"""Eight nodes at a time, whatever their number. Truth: the interpreted twin (NumPy and CasADi's interpreter, node by node)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from toys import hardened_pendulum, pendulum
from wbmpc.ocp import Mode, ModeSchedule
from wbmpc.solver import SQP, InteriorPoint, Solver

START = np.array([0.2, 0.5, 0.3, -0.4])
PARTLY = SQP(iterations=3, compute_kkt=False, interior_point=InteriorPoint(max_extra_iterations=0))


def scene(solver: Solver, n: int) -> Solver:
    """A schedule with two modes, a parameter, and a guess in which no two nodes are alike."""
    solver.set_schedule(ModeSchedule((Mode("a", {"m": [0.0]}), Mode("b", {"m": [1.0]})), (0.5,)))
    rng = np.random.default_rng(n)
    solver.warm_start(0.3 * rng.normal(size=(n + 1, 4)), 0.5 * rng.normal(size=(n, 2)))
    return solver


def steps(solver: Solver, n: int) -> np.ndarray:
    solution = scene(solver, n).solve(START)
    return np.concatenate([solution.log[:, :5].ravel(), solution.x.ravel(), solution.u.ravel(), solution.gain.ravel()])


@pytest.mark.parametrize("n", range(1, 18))
def test_every_remainder(n: int) -> None:
    """Three iterations with equality rows, soft boxes and general rows: log, trajectories and gains."""
    ours, twin = (
        pendulum(b, "rk4" if n % 2 else "rk2", n, iterations=3, compute_kkt=False) for b in ("compiled", "interpreted")
    )
    np.testing.assert_allclose(steps(ours, n), steps(twin, n), rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("n", [1, 7, 8, 9, 16])
def test_every_remainder_with_hard_rows(n: int) -> None:
    ours, twin = (hardened_pendulum(replace(PARTLY, backend=b), n=n) for b in ("compiled", "interpreted"))
    np.testing.assert_allclose(steps(ours, n), steps(twin, n), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("n", [5, 8, 11])
def test_the_same_twice(n: int) -> None:
    """Bit by bit: nothing that an earlier solve has left in the eight lanes counts."""
    solver = hardened_pendulum(n=n)
    first = steps(solver, n)
    solver.warm_start(np.full((n + 1, 4), 0.1), np.zeros((n, 2)))
    solver.solve(-START)
    solver.reset()
    assert first.tobytes() == steps(solver, n).tobytes()
    assert first.tobytes() == steps(hardened_pendulum(n=n), n).tobytes()
