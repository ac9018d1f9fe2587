"""What a learned force is worth of a lean, compiled: see :class:`wbmpc.bases.ball.lean_control.LeanControl`."""

from __future__ import annotations

import numpy as np

from wbmpc.bases.ball.compilation import step
from wbmpc.kernel.ir import Floats

#: Coordinates of ball and base, before those of the arm.
BASE = 5


@step
def lean_offsets(shift: Floats, whole: Floats, force: Floats, heading: Floats, out: Floats, yaw: float) -> None:
    """Of a ``force`` (5) in the world's axes: ``shift`` (2, 5) times it along the world's axes, and ``whole`` (2, 5) times it along
    those of the base's ``heading`` at ``yaw`` [rad], in ``out`` (4)."""
    c, s = np.cos(yaw), np.sin(yaw)
    for i in range(BASE):
        heading[i] = force[i]
    heading[0], heading[1] = c * force[0] + s * force[1], c * force[1] - s * force[0]
    for k in range(4):
        out[k] = 0.0
    for i in range(BASE):
        for k in range(2):
            out[k] += shift[k * BASE + i] * heading[i]
            out[2 + k] += whole[k * BASE + i] * heading[i]
    x, y = out[0], out[1]
    out[0], out[1] = c * x - s * y, s * x + c * y
