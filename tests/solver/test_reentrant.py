"""Calls that come while another one is under way, as those of a signal's handler. Truth: the same calls, one after the other."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

import wbmpc as wb
from interrupting import interrupted
from toys import LinearQuadratic
from wbmpc.errors import SolverBusy
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.library import Library
from wbmpc.model.numeric import Numeric
from wbmpc.solver import SQP, Solver

Call = Callable[[float], np.ndarray]


def policy() -> wb.Policy:
    rng = np.random.default_rng(0)
    return wb.Policy(
        np.linspace(0.0, 1.0, 6), rng.normal(size=(6, 3)), rng.normal(size=(5, 2)), rng.normal(size=(5, 2, 3))
    )


def evaluations() -> dict[str, Call]:
    plan, lq = policy(), LinearQuadratic(8, 4, 0, n=10)
    x, solver = ca.SX.sym("x", 3), Solver(lq.problem(), SQP(iterations=2))
    numeric = Numeric(ca.Function("f", [x], [ca.sin(x)]))
    return {
        "policy": lambda t: plan(t, np.full(3, t)),
        "law": lambda t: plan.law(t, np.full(3, t)),
        "function": lambda t: numeric(np.full(3, t))[0],
        "simulate": lambda t: solver.simulate(t * lq.x0, np.full(4, t), 0.1),
    }


@pytest.mark.parametrize("name", ["policy", "law", "function", "simulate"])
def test_a_handler_in_the_middle_of_an_evaluation_changes_nothing(name: str) -> None:
    """It does the same for other numbers: the call that it interrupted returned its result."""
    call = evaluations()[name]
    mine, its = call(0.1), call(0.7)
    assert not np.allclose(mine, its)

    def handler() -> None:
        np.testing.assert_array_equal(call(0.7), its)

    step, more = 0, True
    while more:
        step += 1
        found, more = interrupted(lambda: call(0.1), handler, step)
        np.testing.assert_array_equal(found, mine)
    assert step > 50


def test_a_handler_of_another_size_in_the_middle_of_a_policy_changes_nothing() -> None:
    """All policies share their working memory."""
    small, large = policy(), wb.Policy(np.arange(3.0), np.ones((3, 9)), np.ones((2, 4)), np.ones((2, 4, 9)))
    mine, its = small(0.3, np.ones(3)), large(0.3, np.zeros(9))

    def handler() -> None:
        np.testing.assert_array_equal(large(0.3, np.zeros(9)), its)

    step, more = 0, True
    while more:
        step += 1
        found, more = interrupted(lambda: small(0.3, np.ones(3)), handler, step)
        np.testing.assert_array_equal(found, mine)


def test_a_handler_that_needs_what_is_being_compiled_is_an_error_at_once() -> None:
    """It waited forever for the call that it had interrupted."""
    library = Library("interrupted")

    @library.step
    def double(x: Floats) -> None:
        x[0] = 2.0 * x[0]

    came = []

    def handler() -> None:
        with pytest.raises(SolverBusy, match=r"'interrupted' is being compiled.*a signal's handler"):
            double(np.ones(1))
        came.append(1)

    emit, numbers = library.optimized, np.array([3.0])
    library.optimized = lambda: (handler(), emit())[1]  # type: ignore[method-assign]
    double(numbers)
    assert came and numbers[0] == 6.0
    double(numbers)
    assert numbers[0] == 12.0
