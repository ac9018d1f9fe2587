"""CasADi functions as machine code that are evaluated for many arguments. Truth: CasADi's interpreter."""

from __future__ import annotations

import pickle

import casadi as ca
import numpy as np

from wbmpc.kernel.function import CompiledFunction

X = ca.SX.sym("x", 3)
FUNCTION = ca.Function("f", [X], [ca.densify(ca.vertcat(ca.sin(X[0]) * X[1], X[2] / (1.0 + X[0] ** 2)))])


def test_an_evaluator_is_the_function_with_memory_of_its_own() -> None:
    rng = np.random.default_rng(0)
    function = CompiledFunction(FUNCTION)
    evaluator, other = function.evaluator(4), function.evaluator(4)
    for count in (4, 2, 1):
        given = rng.normal(size=(count, 3))
        truth = np.array([np.array(FUNCTION(row)).ravel() for row in given])
        evaluator.arguments[:count] = given
        np.testing.assert_allclose(evaluator(count), truth, rtol=1e-14)
        np.testing.assert_allclose(function(given), truth, rtol=1e-14)
    kept = evaluator(1).copy()
    other.arguments[:] = 1.0
    other(4)
    np.testing.assert_array_equal(evaluator(1), kept)


def test_a_copy_has_its_own_code() -> None:
    """Machine code and addresses do not leave their process."""
    copy = pickle.loads(pickle.dumps(CompiledFunction(ca.Function("f", [X], [X])).evaluator(2)))
    copy.arguments[:] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    np.testing.assert_array_equal(copy(2), copy.arguments)
