"""The torque that drives give at speed: all of it up to a rated speed (the current's limit), then less, down to none at the no-load speed
(the voltage's). A drive that is turned faster still brakes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.step import bind
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


#: No-load speed over rated speed, where a robot's file says nothing else.
NO_LOAD = 1.25


class SpeedTorque:
    """The drives ``rated`` [rad/s] by name of actuator; those without a finite force limit in the ``model`` have none at speed either.

    ``apply()`` sets the force limits of the ``model`` by the speeds in ``data``, of a physics step whose first half is done.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rated: Mapping[str, float]) -> None:
        found = {model.actuator(name).id: speed for name, speed in rated.items() if np.isfinite(speed)}
        found = {k: speed for k, speed in found.items() if model.actuator_forcelimited[k]}
        drives = np.array(list(found), dtype=np.int64)
        arrays = {
            "drives": drives, "rated": np.array(list(found.values()), float), "velocity": data.actuator_velocity,
            "torque": model.actuator_forcerange[drives, 1].copy(), "force_range": model.actuator_forcerange,
            "reduced": np.zeros(1, dtype=np.int64),
        }  # fmt: skip
        self.apply: Callable[[], None] = bind(limit, arrays, n=len(drives), no_load=NO_LOAD).call
