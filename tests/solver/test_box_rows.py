"""Rows of boxes in the solver's tables. Truth: the relaxed barrier's own formulas and the chain rule."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from wbmpc.ocp import RelaxedBarrier
from wbmpc.solver.reference_direction import barrier
from wbmpc.solver.workspace import box_table


def evaluate(function: Callable[[ca.SX], ca.SX], point: float) -> float:
    s = ca.SX.sym("s")
    return float(ca.Function("f", [s], [function(s)])(point))


def test_box_rows_of_the_solver_are_that_barrier() -> None:
    """Rows of the form s z + c, also with |s| ≠ 1: value, slope and curvature by finite differences and the chain rule."""
    rows = [(0, 1.0, 0.5, 0.2, 0.1), (0, -2.0, 1.0, 0.2, 0.1), (1, 3.0, 0.0, 0.05, 0.2)]
    table = box_table(rows)
    for z in (np.array([0.1, 0.3]), np.array([0.49, -0.4]), np.array([-0.6, 0.01])):
        value, gradient, curvature = barrier(table, z)
        terms = [(RelaxedBarrier(mu, d), i, s, s * z[i] + c) for i, s, c, mu, d in rows]
        assert value == pytest.approx(sum(evaluate(b.value, h) for b, _, _, h in terms), rel=1e-12)
        slope, curve = np.zeros(2), np.zeros(2)
        for b, i, s, h in terms:
            slope[i] += s * evaluate(b.gradient, h)
            curve[i] += s * s * evaluate(b.curvature, h)
        np.testing.assert_allclose(gradient, slope, rtol=1e-12)
        np.testing.assert_allclose(curvature, curve, rtol=1e-12)
