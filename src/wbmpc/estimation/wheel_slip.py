"""How much wheels slip, from what they contradict each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SlipIntensity:
    """Intensity [m²/s] of the wheels' slip, each component, from what they contradict each other.

    The residual's speed is averaged over the window w (encoder counts cancel, slip that lasts less long than w is left
    with intensity / (2 w)); its square over ten windows of motion, for one has few degrees of freedom and would make lucky
    intervals look exact. A contradiction that is far above that counts at once. Shorter windows have more degrees of freedom in the
    same time, and see less of slip that lasts: the largest of their answers is the least wrong. Before enough was seen, the mean
    square over k degrees of freedom is taken for 1 + 2 / k of itself, as a variance that is known from k squares.
    """

    #: windows over which squares are averaged; ratio of squares that is sudden; speed [m/s] of a base that moves
    MEMORY, SUDDEN, MOVING, FEW = 10.0, 6.0, 1e-3, 6.0
    #: Lengths of the windows over w; what is left of slip's square in w when it lasts a quarter of w: 1 / 1.25 of white slip's.
    WINDOWS, LASTING = np.array([1.0, 0.5, 0.25, 0.125]), 1.25

    def __init__(self, freedoms: int, window: float) -> None:
        self.freedoms, self.window = freedoms, window
        self.now = self.intensity = 0.0
        self._mean: Array | float = 0.0
        self._unseen, self._squares, self._weight = np.ones(4), np.zeros(4), np.zeros(4)
        self._speed = self._moved = 0.0

    def update(self, residual: Array, speed: float, h: float) -> float:
        """The intensity after h [s] with residual speeds (n, 2) and mean wheel speed [m/s]."""
        decay = np.exp(-h / (self.WINDOWS * self.window))
        self._mean = decay[:, None] * self._mean + (1.0 - decay)[:, None] * residual.ravel()
        self._speed = decay[0] * self._speed + (1.0 - decay[0]) * speed
        self._unseen *= decay**2  # the mean starts from 0: it is short of this share of its variance
        square = np.sum(self._mean**2, axis=1) / self.freedoms
        white = h * (1.0 + decay) / (1.0 - decay)  # intensity over mean square of a window: 2 w
        self.now = float(square[0] / (1.0 - self._unseen[0]))
        self.intensity = white[0] * self.now
        if self._speed > self.MOVING:
            fade = decay[0] ** (1.0 / self.MEMORY)
            self._moved = min(self._moved + h, 2.0 * self.MEMORY * self.window)
            self._squares = fade * self._squares + (1.0 - fade) * square
            self._weight = fade * self._weight + (1.0 - fade) * (1.0 - self._unseen)
            usual = self._squares / self._weight
            known = 1.0 + self.FEW * self.WINDOWS * self.window / (self.freedoms * self._moved)
            self.now = self.now if self.now > self.SUDDEN * usual[0] else float(usual[0])
            self.intensity = max(white[0] * self.now, float(np.max(white * usual * known)))
        self.intensity *= self.LASTING
        return self.intensity
