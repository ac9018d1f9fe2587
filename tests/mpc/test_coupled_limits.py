"""Rows of several inputs beside bounds of single ones, where a plan is outside of bounds that move. Truth: rows and bounds as they were written,
around an input that is known to be inside of all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbmpc.mpc.policy import InputLimits


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_bounds_and_rows_hold_together_wherever_the_plan_is(seed: int, by_feedback: bool) -> None:
    rng = np.random.default_rng(seed)
    n, r = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    inside, planned, asked = rng.normal(size=n), 3.0 * rng.normal(size=n), 10.0 * rng.normal(size=n)
    lower, upper = inside - rng.uniform(0.2, 2.0, n), inside + rng.uniform(0.2, 2.0, n)
    matrix = rng.normal(size=(r, n))
    slack = rng.uniform(0.2, 1.0, r) * np.linalg.norm(matrix, axis=1)
    offset = slack - matrix @ inside
    limits = InputLimits(lower, upper, matrix, np.zeros(r))
    given_input = asked if by_feedback else planned
    u = limits.hold(given_input.copy(), planned if by_feedback else None, offset=offset)
    assert (u >= lower).all() and (u <= upper).all()
    assert (matrix @ u + offset).min() > -1e-6
    if (given_input >= lower).all() and (given_input <= upper).all() and (matrix @ given_input + offset).min() >= 0.0:
        np.testing.assert_array_equal(u, given_input)


def test_the_nearest_input_that_may_still_move_takes_over() -> None:
    """A plan of (2, -0.8) with u0 at most 1 and u0 + u1 at least 1: u1 has to be 0."""
    limits = InputLimits(np.full(2, -1.0), np.ones(2), np.ones((1, 2)), np.array([-1.0]))
    assert limits.hold(np.array([2.0, -0.8])) == pytest.approx([1.0, 0.0], abs=1e-9)
    assert limits.count == 1
