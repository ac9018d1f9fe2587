"""What a learned force is worth of a lean, compiled: see :class:`wbmpc.bases.ball.lean_control.LeanControl`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.bases.ball.compilation import step
from wbmpc.kernel.ir import Floats

#: Coordinates of ball and base, before those of the arm.
BASE = 5


class Lean(NamedTuple):
    """How a robot leans against forces (5) on ball and base; distances [m] of the lean's divergent component."""

    shift: Floats  # (2, 5), by how much it counts like more than it is, in the heading's axes
    whole: Floats  # (2, 5), what the wheels bear, in the heading's axes
    heading: Floats  # (5), room for a force
    leans: Floats  # (6): shift (2), along the world's axes; borne (2), along the heading's; component (2), along the world's


@step
def lean_offsets(lean: Lean, force: Floats, yaw: float) -> None:
    """``leans`` under a ``force`` (5, or more) in the world's axes at a heading ``yaw`` [rad]."""
    c, s, heading, leans = np.cos(yaw), np.sin(yaw), lean.heading, lean.leans
    for i in range(BASE):
        heading[i] = force[i]
    heading[0], heading[1] = c * force[0] + s * force[1], c * force[1] - s * force[0]
    for k in range(4):
        leans[k] = 0.0
    for i in range(BASE):
        for k in range(2):
            leans[k] += lean.shift[k * BASE + i] * heading[i]
            leans[2 + k] += lean.whole[k * BASE + i] * heading[i]
    x, y = leans[0], leans[1]
    leans[0], leans[1] = c * x - s * y, s * x + c * y
