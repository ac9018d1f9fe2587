"""Compiled code that notices when the Gauss-Newton Hessian converges too slowly, so that the exact one takes over.

Gauss-Newton steps contract the error linearly, by a factor that grows with the residuals and multipliers at the solution times the
second derivatives that are left out (Messerer, Baumgärtner and Diehl 2021, "Survey of sequential convex programming and generalized
Gauss-Newton methods", section 4); where it is near one, or above, a method with second derivatives takes over, as the hybrid methods
for least squares do (Fletcher and Xu 1987, "Hybrid methods for nonlinear least squares"). Here the factor is measured: the smallest
error of ``stall_window`` iterations beside that of those before. Where as many more such iterations as the solve has left would not bring
the error to the tolerance, Gauss-Newton has stalled.
"""

from __future__ import annotations

import numpy as np

from wbmpc.solver.compilation import Floats, Integers, compiled
from wbmpc.solver.memory_layout import EXACT, STATE, Setting, StateField
from wbmpc.solver.settings import THRESHOLDS


@compiled
def forget_errors(m: Floats, o: Integers) -> None:
    """No error has been seen."""
    m[o[STATE] + StateField.SMALLEST_ERROR], m[o[STATE] + StateField.LAST_SMALLEST_ERROR] = np.inf, np.inf


@compiled
def stalled(m: Floats, o: Integers, s: Floats, errors: tuple[float, float], it: int) -> bool:
    """Whether Gauss-Newton has stalled after ``it`` iterations. ``errors``: (KKT residual, violation) of the last one."""
    if s[Setting.DETECT_STALL] == 0.0 or o[EXACT] > 0:
        return False
    state = o[STATE]
    kkt, violation = errors
    error = max(
        max(kkt, violation),
        max(m[state + StateField.MAX_ROW_RESIDUAL], m[state + StateField.MAX_COMPLEMENTARITY]),
    )
    smallest = min(error, m[state + StateField.SMALLEST_ERROR])
    m[state + StateField.SMALLEST_ERROR] = smallest
    if it % THRESHOLDS.stall_window > 0:
        return False
    previous = m[state + StateField.LAST_SMALLEST_ERROR]
    m[state + StateField.LAST_SMALLEST_ERROR], m[state + StateField.SMALLEST_ERROR] = min(smallest, previous), np.inf
    if not previous < np.inf:
        return False
    if not smallest < previous:
        return True
    left = s[Setting.ITERATIONS] - it
    return THRESHOLDS.stall_window * np.log(max(smallest / s[Setting.TOLERANCE], 1.0)) > left * np.log(
        previous / smallest
    )
