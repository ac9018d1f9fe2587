"""Functions of numbers. Truth: CasADi's own call."""

from __future__ import annotations

import pickle

import casadi as ca
import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.model.numeric import Numeric

X, P = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
FUNCTION = ca.Function("f", [X, P], [ca.sin(X) * P[0], X @ P.T, ca.dot(X, X)])


def test_results_are_casadis_and_stay_as_they_were() -> None:
    evaluate, rng = Numeric(FUNCTION), np.random.default_rng(0)
    given = [(rng.normal(size=3), rng.normal(size=2)) for _ in range(3)]
    found = [evaluate(*values) for values in given]  # all of them before any is looked at
    for values, results in zip(given, found, strict=True):
        for mine, theirs in zip(results, FUNCTION(*values), strict=True):
            np.testing.assert_array_equal(mine, theirs.full())


def test_the_number_of_values_is_checked() -> None:
    with pytest.raises(InputError, match="f: 2 numbers are needed, got 3"):
        Numeric(FUNCTION)(np.zeros(3), np.zeros(3))


def test_zeros_that_casadi_leaves_out_are_zeros_and_a_copy_has_memory_of_its_own() -> None:
    """A Jacobian with a pattern, rows that there are none of, a column without entries."""
    parts = [ca.jacobian(ca.sin(X[:2]) * P, X), ca.SX(0, 1), ca.SX(3, 1)]
    function, given = ca.Function("g", [X, P], parts), (np.array([0.1, -0.4, 2.0]), np.array([3.0, 0.7]))
    assert function.nnz_out(0) == 2
    evaluate = Numeric(function)
    copy = pickle.loads(pickle.dumps(evaluate))
    for found in (evaluate(*given), copy(*given)):
        for mine, theirs in zip(found, function(*given), strict=True):
            np.testing.assert_array_equal(mine, theirs.full())
