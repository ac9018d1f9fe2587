"""One measure for all: how far a point is from the optimality conditions, for any solver and scaling.

Multipliers are not asked for, since every solver scales its own. They are those of least squares: for equalities g = 0 with
multipliers λ and inequalities h ≥ 0 with ν ≥ 0 they make ∇f − g_xᵀ λ − h_xᵀ ν and the products h ν as small as can be (Nocedal
and Wright 2006, section 18.3, for equalities alone). Any multipliers bound the distance from above, these do so tightly.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from wbmpc.arrays import Array
from wbmpc.benchmark.program import Program

#: Solvers are compared at points that are this close to the conditions (the tables say 1e-6).
EQUAL = 1e-6
#: Keeps the multipliers of dependent rows finite.
_DAMPING = 1e-12


class Residual(NamedTuple):
    """Largest violation of a row (of a limit: in units of its range), largest entry of the Lagrangian's gradient, largest
    product h ν."""

    primal: float
    dual: float
    complementarity: float

    @property
    def largest(self) -> float:
        return max(self)

    @property
    def figure(self) -> float | None:
        """The largest for a table; None for a point that is not finite."""
        return self.largest if np.isfinite(self.largest) else None


def least_squares(gradient: Array, jacobian: sp.csc_matrix, weights: Array, signed: Array) -> Array:
    """y that makes |∇f − Jᵀ y|² + |w y|² small, y ≥ 0 where ``signed``: (rows,). Negative ones are left out, in turn."""
    rows, free = jacobian.shape[0], np.ones(jacobian.shape[0], bool)
    y = np.zeros(rows)
    for _ in range(30):
        matrix = sp.vstack([jacobian[free].T, sp.diags(weights[free])], format="csc")
        equations = sp.bmat(
            [[sp.eye(matrix.shape[0]), matrix], [matrix.T, -_DAMPING * sp.eye(free.sum())]], format="csc"
        )
        right = np.concatenate([gradient, np.zeros(matrix.shape[1] + free.sum())])
        y[:] = 0.0
        y[free] = splu(equations).solve(right)[matrix.shape[0] :]
        negative = free & signed & (y < 0.0)
        if not negative.any():
            return y
        free &= ~negative
    return np.where(signed, np.maximum(y, 0.0), y)


class Measure:
    """The residual of points of one program."""

    def __init__(self, program: Program) -> None:
        arguments = [program.x, program.p]
        self._rows = ca.Function("rows", arguments, [program.constraints(), program.jacobian()])
        self._gradient = ca.Function("gradient", arguments, [program.gradient()])
        self._equality = program.equality()

    def __call__(self, x: Array, u: Array, x0: Array) -> Residual:
        """At states x (N + 1, nx) and inputs u (N, nu), for the measured state x0 (nx,)."""
        z = np.concatenate([np.hstack([x[:-1], u]).ravel(), x[-1]])
        if not np.isfinite(z).all():
            return Residual(np.inf, np.inf, np.inf)
        value, slope = self._rows(z, x0)
        rows, gradient = np.array(value).ravel(), np.array(ca.densify(self._gradient(z, x0))).ravel()
        jacobian = sp.csc_matrix(slope.sparse())
        weights = np.where(self._equality, 0.0, np.maximum(rows, 0.0))
        y = least_squares(gradient, jacobian, weights, ~self._equality)
        primal = np.where(self._equality, np.abs(rows), np.maximum(-rows, 0.0))
        left = gradient - jacobian.T @ y
        return Residual(*(float(np.abs(v).max(initial=0.0)) for v in (primal, left, weights * y)))


def to_equal_residual(
    attempt: Callable[[int], tuple[float, Array, Array]], maximum: int, measure: Callable[[Array, Array], Residual]
) -> dict[str, Any]:
    """Fewest iterations, up to ``maximum``, after which the residual is at most :data:`EQUAL`, by bisection, and their time.

    ``attempt(iterations)``: milliseconds and the point (x, u). Nothing when even ``maximum`` are not enough.
    """
    low, high, found = 0, maximum, attempt(maximum)
    if not measure(*found[1:]).largest <= EQUAL:
        return {}
    while high - low > 1:
        middle = (low + high) // 2
        tried = attempt(middle)
        if measure(*tried[1:]).largest <= EQUAL:
            high, found = middle, tried
        else:
            low = middle
    return {"equal_iterations": high, "equal_ms": found[0]}
