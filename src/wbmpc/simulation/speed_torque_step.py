"""Force limits of drives at their present speeds, compiled: see :class:`wbmpc.simulation.speed_torque.SpeedTorque`."""

from __future__ import annotations

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.simulation.compilation import step


@step
def limit(
    n: int, drives: Integers, velocity: Floats, rated: Floats, torque: Floats, force_range: Floats, reduced: Integers,
    no_load: float,
) -> None:  # fmt: skip
    """The force limits (low, high) of n ``drives`` at their ``velocity`` [rad/s]; ``reduced`` (1): whether any of them is less than the
    whole ``torque`` (n) [N m]."""
    fast = 0
    for i in range(n):
        if abs(velocity[drives[i]]) > rated[i]:
            fast = 1
    if fast == 1 or reduced[0] == 1:
        for i in range(n):
            k, span = drives[i], (no_load - 1.0) * rated[i]
            low = (no_load * rated[i] + velocity[k]) / span
            high = (no_load * rated[i] - velocity[k]) / span
            force_range[2 * k] = -min(max(low, 0.0), 1.0) * torque[i]
            force_range[2 * k + 1] = min(max(high, 0.0), 1.0) * torque[i]
    reduced[0] = fast
