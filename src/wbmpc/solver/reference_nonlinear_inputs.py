"""The twin of :mod:`wbmpc.solver.nonlinear_input_constraints` in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.model.numeric import Numeric
from wbmpc.ocp import Transcription
from wbmpc.solver.settings import THRESHOLDS

if TYPE_CHECKING:
    from wbmpc.solver.reference_inequalities import RowState


def curvature(
    problem: Transcription, lagrangian: Numeric, rows: RowState, arguments: tuple[np.ndarray, ...], h: float
) -> np.ndarray:
    """−h l ∇²rows by the inputs in the size of z, or zeros where that is not positive semidefinite."""
    multipliers = np.where(rows.bounds_inputs, -rows.l, 0.0)[rows.boxes :]
    nothing = np.zeros(problem.equality.shape[0])
    (upper,) = lagrangian(*arguments, h, nothing, multipliers)
    whole = upper + np.triu(upper, 1).T
    rounding = 1e-9 * np.abs(np.diag(whole)).sum() + 1e-300
    convex = np.linalg.eigvalsh(whole[problem.nx :, problem.nx :]).min() > -rounding
    return whole if convex else np.zeros_like(whole)


def aims(rows: RowState, mu: float) -> np.ndarray:
    """Where corrections onto the rows of a node aim."""
    with np.errstate(divide="ignore", invalid="ignore"):
        general = THRESHOLDS.kept_slack * np.maximum(rows.t, np.minimum(mu / rows.l, THRESHOLDS.kept_slack))
    return np.where(
        np.arange(rows.t.size) < rows.boxes, np.minimum(THRESHOLDS.inside, THRESHOLDS.kept_slack * rows.t), general
    )


def hold_inputs(
    rows: RowState, held: np.ndarray, mu: float, x: np.ndarray, u: np.ndarray, functions: Callable[..., Any]
) -> tuple[np.ndarray, bool]:
    """Move the inputs u within the true ``held`` rows of a node, in place; returns the rows' values, and whether none is left outside.

    ``functions``: values and Jacobian of the general rows by [x; u], of (x, u).
    """
    minimum, best, aim = np.inf, u.copy(), aims(rows, mu)
    for sweep in range(THRESHOLDS.corrections):
        general, jacobian = functions(x, u)
        z = np.concatenate([x, u])
        h = rows.values(z, general)
        worst = np.max(-h[held], initial=0.0)
        if worst == 0.0:
            return h, True
        if worst < minimum:
            minimum, best = worst, u.copy()
        slopes = np.zeros((rows.boxes, z.size))
        slopes[np.arange(rows.boxes), rows.variable[: rows.boxes].astype(int)] = rows.sign[: rows.boxes]
        slopes = np.vstack([slopes, np.array(jacobian).reshape(-1, z.size)])[:, x.size :]
        change = np.zeros_like(u)
        for row in np.flatnonzero(held):
            ahead, square = h[row] + slopes[row] @ change, slopes[row] @ slopes[row]
            if ahead < 0.0 and square > 1e-12:
                change += slopes[row] * (0.5**sweep * aim[row] - ahead) / square
        u += change
    u[:] = best
    return rows.values(np.concatenate([x, u]), functions(x, u)[0]), False
