"""How much wheels slip, from what they contradict each other."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.compilation import compiled
from wbmpc.kernel.ir import Floats

#: Windows over which squares are averaged; ratio of squares that is sudden; speed [m/s] of a base that moves.
MEMORY, SUDDEN, MOVING, FEW = 10.0, 6.0, 1e-3, 6.0
#: How many windows there are, each half as long as the one before; what is left of slip's square in the longest when it lasts a
#: quarter of it: 1 / 1.25 of white slip's.
WINDOWS, LASTING = 4, 1.25


class Slip(IntEnum):
    """Entries of the memory of :func:`slip_intensity`: one for each window, then single numbers."""

    UNSEEN = 0
    SQUARES = 4
    WEIGHT = 8
    SPEED = 12
    MOVED = 13
    NOW = 14  # mean square [m²/s²] of the residual's speed over the longest window
    INTENSITY = 15
    SIZE = 16


def slip_memory() -> Array:
    """The memory before the first interval."""
    memory = np.zeros(Slip.SIZE)
    memory[Slip.UNSEEN : Slip.UNSEEN + WINDOWS] = 1.0
    return memory


@compiled
def slip_intensity(
    slip: Floats, mean: Floats, n: int, residual: Floats, weights: Floats, rolled: Floats, window: float, h: float
) -> float:
    """Intensity [m²/s] of the wheels' slip, each component, from what they contradict each other: ``residual`` (n, 2) [m] of the
    last h [s], in which they ``rolled`` (n) [m]; ``mean`` (windows, n, 2) is memory as ``slip`` is.

    The residual's speed is averaged over the ``window`` w [s] (encoder counts cancel, slip that lasts less long than w is left
    with intensity / (2 w)); its square over ten windows of motion, for one has few degrees of freedom and would make lucky
    intervals look exact. A contradiction that is far above that counts at once. Shorter windows have more degrees of freedom in the
    same time, and see less of slip that lasts: the largest of their answers is the least wrong. Before enough was seen, the mean
    square over k degrees of freedom is taken for 1 + 2 / k of itself, as a variance that is known from k squares.
    """
    freedoms, speed = 2.0 * n - 3.0, 0.0
    for i in range(n):
        speed += abs(rolled[i]) / (n * h)
    decay = np.exp(-h / window)
    slip[Slip.SPEED] = decay * slip[Slip.SPEED] + (1.0 - decay) * speed
    moving, fade = slip[Slip.SPEED] > MOVING, decay ** (1.0 / MEMORY)
    if moving:
        slip[Slip.MOVED] = min(slip[Slip.MOVED] + h, 2.0 * MEMORY * window)
    now, first, usual_first, largest, share = 0.0, 0.0, 0.0, 0.0, 1.0
    for k in range(WINDOWS):
        decay = np.exp(-h / (share * window))
        total = 0.0
        for j in range(2 * n):
            e = k * 2 * n + j
            mean[e] = decay * mean[e] + (1.0 - decay) * (weights[j // 2] * residual[j] / h)
            total += mean[e] ** 2
        # the mean starts from 0: it is short of this share of its variance
        slip[Slip.UNSEEN + k] = slip[Slip.UNSEEN + k] * decay**2
        square, unseen = total / freedoms, slip[Slip.UNSEEN + k]
        white = h * (1.0 + decay) / (1.0 - decay)  # intensity over mean square of a window: 2 w
        if k == 0:
            now, first = square / (1.0 - unseen), white
        if moving:
            squares = fade * slip[Slip.SQUARES + k] + (1.0 - fade) * square
            weight = fade * slip[Slip.WEIGHT + k] + (1.0 - fade) * (1.0 - unseen)
            slip[Slip.SQUARES + k], slip[Slip.WEIGHT + k] = squares, weight
            usual = squares / weight
            if k == 0:
                usual_first = usual
            known = 1.0 + FEW * share * window / (freedoms * slip[Slip.MOVED])
            largest = max(largest, white * usual * known)
        share *= 0.5
    if moving and not now > SUDDEN * usual_first:
        now = usual_first
    slip[Slip.NOW] = now
    slip[Slip.INTENSITY] = LASTING * max(first * now, largest)
    return slip[Slip.INTENSITY]
