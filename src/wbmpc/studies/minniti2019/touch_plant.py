"""A door or wall whose contact with the tip is recorded at every physics step: a hit with a hard tip is over between two messages."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from wbmpc.simulation.world import Array
from wbmpc.studies.force_tip import TIP_RADIUS, contacts_between
from wbmpc.studies.minniti2019.door_plant import DoorPlant

#: What a row of :attr:`TouchPlant.steps` has behind its time, and the units.
STEP_NAMES = ("force along the normal", "force across it", "speed towards the panel", "sliding along it", "sliding up")
STEP_UNITS = ("N", "N", "m/s", "m/s", "m/s")


class TouchPlant(DoorPlant):
    """``steps``: rows of time [s], force of the tip on the panel along its normal and across it [N], the tip's speed towards the panel
    [m/s], and how fast the tip slides on it, along it and up [m/s], one for each physics step. The arguments are those of
    :class:`DoorPlant`."""

    def __init__(self, *args: Any, **more: Any) -> None:
        self.steps: list[tuple[float, ...]] = []
        self._beyond = np.nan
        self._velocity = np.zeros(6)
        super().__init__(*args, **more)

    def _record(self) -> None:
        if hasattr(self, "_panel"):  # it is made
            self._add_step()
        super()._record()

    def _add_step(self) -> None:
        """Before anything looks for the contacts of the next step."""
        force, normal = self._panel_force(), self.normal
        push = float(force @ normal)
        beyond = self._beyond_along(normal)
        speed = (beyond - self._beyond) / self.timestep
        self._beyond = beyond
        across = float(np.linalg.norm(force - push * normal))
        self.steps.append((self.time, push, across, speed, *self._sliding(normal)))

    def _sliding(self, normal: Array) -> tuple[float, float]:
        """How fast [m/s] the tip moves against the panel with this ``normal`` (3) where they touch, or would touch, along it and up: of
        their two materials. Scalars: it is computed at each physics step."""
        data = self.data
        x, y, z = (data.geom_xpos[self._tip] + TIP_RADIUS * normal).tolist()
        if touching := contacts_between(data, self._tip, self._panel):
            x, y, z = data.contact[touching[-1]].pos.tolist()
        slides = [0.0, 0.0, 0.0]
        for geom, sign in ((self._tip, 1.0), (self._panel, -1.0)):
            mujoco.mj_objectVelocity(self.model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, self._velocity, 0)
            wx, wy, wz, vx, vy, vz = self._velocity.tolist()
            cx, cy, cz = data.geom_xpos[geom].tolist()
            rx, ry, rz = x - cx, y - cy, z - cz
            slides[0] += sign * (vx + wy * rz - wz * ry)
            slides[1] += sign * (vy + wz * rx - wx * rz)
            slides[2] += sign * (vz + wx * ry - wy * rx)
        nx, ny, _ = normal.tolist()
        return ny * slides[0] - nx * slides[1], slides[2]

    def _beyond_along(self, normal: Array) -> float:
        hinge = np.array([*self.door.hinge, 0.0])
        return float((self.data.geom_xpos[self._tip] - hinge) @ normal)

    def beyond(self) -> float:
        """How far [m] the tip's center is beyond the panel's middle plane."""
        return self._beyond_along(self.normal)

    def record(self) -> Array:
        """:attr:`steps` as an array (n, 6), from the first step on."""
        return np.array(self.steps).reshape(-1, 6)
