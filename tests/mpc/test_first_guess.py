"""First plans from trajectories beyond all bounds. Truth: an MPC that starts from the state held."""

from __future__ import annotations

import numpy as np
import pytest

import wbmpc as wb
from exported import trolley
from wbmpc.errors import RunAborted

X0 = np.array([0.3, 0.0])
SIZES = (1e12, 1e155, 1e300)


def course(mpc: wb.MPC, updates: int = 4) -> np.ndarray:
    """Inputs of a loop."""
    x, found = X0, []
    for k in range(updates):
        t = k * mpc.period
        found.append(mpc.update(wb.Observation(t, x))(t, x))
        x = mpc.simulate(x, found[-1], mpc.period)
    return np.array(found)


@pytest.fixture(scope="module")
def held() -> np.ndarray:
    mpc = trolley()
    mpc.reset(X0)
    return course(mpc)


@pytest.mark.parametrize("size", SIZES)
def test_a_huge_start_does_not_keep_the_mpc_from_its_first_plan(held: np.ndarray, size: float) -> None:
    """It raised RunAborted at every update until it was reset."""
    mpc = trolley()
    nodes = mpc.ocp.intervals
    mpc.reset(np.full((nodes + 1, 2), size), np.full((nodes, 2), size))
    np.testing.assert_array_equal(course(mpc), held)
    assert mpc.statistics.failures == 0


@pytest.mark.parametrize("size", SIZES)
def test_a_huge_guess_does_not_either(held: np.ndarray, size: float) -> None:
    """The guess is asked again before every later solve."""
    mpc = trolley()
    answers = []

    def guess(t: float, x0: np.ndarray, last: wb.Trajectory) -> wb.Trajectory | None:
        answers.append(t)
        return wb.Trajectory(last.start, last.grid, last.x + size, last.u) if t == 0.0 else None

    mpc.guess = guess
    mpc.reset(X0)
    np.testing.assert_array_equal(course(mpc), held)
    assert answers == [k * mpc.period for k in range(4)]


def test_a_state_that_nobody_can_be_in_is_forgotten_at_the_next_update(held: np.ndarray) -> None:
    mpc = trolley()
    with pytest.raises(RunAborted, match="the first solve"):
        mpc.update(wb.Observation(0.0, 1e300 * X0))
    np.testing.assert_array_equal(course(mpc), held)
