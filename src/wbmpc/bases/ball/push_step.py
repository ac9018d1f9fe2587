"""The drift of the lean under a push, compiled: see :class:`wbmpc.bases.ball.push.PushEstimator`."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.ball.compilation import step
from wbmpc.kernel.ir import Floats

#: Time constant [s] of the mean that is taken: three messages of the sensors at 400 Hz.
SMOOTH = 0.010


@step
def take_in(n: int, x: Floats, expected: Floats, slope: Floats, drift: Floats, found: Floats, h: float) -> bool:
    """``drift`` (2) [m/s] after a state ``x`` (2 n), h [s] after the one from which the model ``expected`` (2 n) another; ``slope`` (2, n):
    of the lean's divergent component by coordinates, over its pole. False, and nothing is changed, if it would not be finite;
    ``found``: room for it."""
    for k in range(2):
        rate = 0.0
        for i in range(n):
            rate += slope[k * n + i] * (x[n + i] - expected[n + i])
        found[k] = drift[k] + h / (h + SMOOTH) * (rate / h - drift[k])
    if not (np.isfinite(found[0]) and np.isfinite(found[1])):
        return False
    drift[0], drift[1] = found[0], found[1]
    return True
