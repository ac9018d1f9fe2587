"""The twin of :mod:`wbmpc.solver.curved` in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.ocp import Transcription

if TYPE_CHECKING:
    from wbmpc.solver.reference_solver import RowState

CORRECTIONS, INSIDE, LEAST_SHARE = 30, 1e-6, 0.01


def curvature(problem: Transcription, rows: RowState, arguments: tuple[np.ndarray, ...], h: float) -> np.ndarray:
    """−h l ∇²rows by the inputs in the size of z, or zeros where that is not positive semidefinite."""
    multipliers = np.where(rows.bounds_inputs, -rows.l, 0.0)[rows.boxes :]
    nothing = np.zeros(problem.equality.shape[0])
    upper = np.array(problem.derivatives["lagrangian"](*arguments, h, nothing, multipliers))
    whole = upper + np.triu(upper, 1).T
    rounding = 1e-9 * np.abs(np.diag(whole)).sum() + 1e-300
    convex = np.linalg.eigvalsh(whole[problem.nx :, problem.nx :]).min() > -rounding
    return whole if convex else np.zeros_like(whole)


def hold_inputs(
    rows: RowState, x: np.ndarray, u: np.ndarray, functions: Callable[[np.ndarray, np.ndarray], Any]
) -> np.ndarray:
    """Move the inputs u within the true hard rows of a node, in place; returns the rows' values.

    ``functions``: values and Jacobian of the general rows by [x; u].
    """
    for sweep in range(CORRECTIONS + 1):
        general, jacobian = functions(x, u)
        z = np.concatenate([x, u])
        h = rows.values(z, general)
        if sweep == CORRECTIONS or not (rows.bounds_inputs & (h < 0.0)).any():
            return h
        slopes = np.zeros((rows.boxes, z.size))
        slopes[np.arange(rows.boxes), rows.place[: rows.boxes].astype(int)] = rows.sign[: rows.boxes]
        slopes = np.vstack([slopes, np.array(jacobian).reshape(-1, z.size)])[:, x.size :]
        change = np.zeros_like(u)
        for row in np.flatnonzero(rows.bounds_inputs):
            ahead, square = h[row] + slopes[row] @ change, slopes[row] @ slopes[row]
            if ahead < 0.0 and square > 1e-12:
                change += slopes[row] * (INSIDE - ahead) / square
        u += change
    raise AssertionError("not reached")
