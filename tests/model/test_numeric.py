"""Functions of numbers. Truth: CasADi's own call."""

from __future__ import annotations

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
