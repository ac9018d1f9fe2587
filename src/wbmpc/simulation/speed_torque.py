"""The torque that drives give at speed: all of it up to a rated speed (the current's limit), then less, down to none at the no-load speed
(the voltage's). A drive that is turned faster still brakes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from wbmpc.kernel.step import bind
from wbmpc.simulation.speed_torque_step import limit

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
