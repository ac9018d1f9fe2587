"""The tool seen from the base, compiled: see :meth:`wbmpc.simulation.world.World.frames`."""

from __future__ import annotations

from wbmpc.kernel.ir import Floats
from wbmpc.simulation.compilation import step


@step
def from_base(
    base: Floats, rotation: Floats, tool: Floats, tool_rotation: Floats, seen: Floats, turned: Floats
) -> None:
    """Position ``seen`` (3) and rotation ``turned`` (3, 3) in the base's axes of a ``tool``; both in world axes."""
    for i in range(3):
        seen[i] = 0.0
        for j in range(3):
            seen[i] += rotation[3 * j + i] * (tool[j] - base[j])
            turned[3 * i + j] = 0.0
            for k in range(3):
                turned[3 * i + j] += rotation[3 * k + i] * tool_rotation[3 * k + j]
