"""The torque that drives give at speed: all of it up to a rated speed (the current's limit), then less, down to none at the no-load speed
(the voltage's). A drive that is turned faster still brakes."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: No-load speed over rated speed, where a robot's file says nothing else.
NO_LOAD = 1.25


class SpeedTorque:
    """The drives ``rated`` [rad/s] by name of actuator; those without a finite force limit in the ``model`` have none at speed either."""

    def __init__(self, model: mujoco.MjModel, rated: Mapping[str, float]) -> None:
        found = {model.actuator(name).id: speed for name, speed in rated.items() if np.isfinite(speed)}
        found = {k: speed for k, speed in found.items() if model.actuator_forcelimited[k]}
        self._index, self._rated = np.array(list(found), dtype=int), np.array(list(found.values()))
        self._torque = model.actuator_forcerange[self._index, 1].copy()
        self._reduced = False

    def apply(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Set the force limits of this physics step."""
        speed = data.actuator_velocity[self._index]
        fast = bool((np.abs(speed) > self._rated).any())
        if not (fast or self._reduced):
            return
        left = (NO_LOAD * self._rated - np.array([-speed, speed])) / ((NO_LOAD - 1.0) * self._rated)
        low, high = np.clip(left, 0.0, 1.0) * self._torque
        model.actuator_forcerange[self._index] = np.column_stack([-low, high])
        self._reduced = fast
