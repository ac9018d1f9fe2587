"""A door or wall whose contact with the tip is recorded at every physics step: a hit with a hard tip is over between two messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc.simulation.world import Array
from wbmpc.studies.minniti2019.door_plant import DoorPlant


class TouchPlant(DoorPlant):
    """``steps``: rows of time [s], force of the tip on the panel along its normal and across it [N], and the tip's speed towards the panel
    [m/s], one for each physics step. The arguments are those of :class:`DoorPlant`."""

    def __init__(self, *args: Any, **more: Any) -> None:
        self.steps: list[tuple[float, float, float, float]] = []
        self._beyond = np.nan
        super().__init__(*args, **more)

    def _record(self) -> None:
        if hasattr(self, "_panel"):  # it is made
            self._add_step()
        super()._record()

    def _add_step(self) -> None:
        """Before anything looks for the contacts of the next step."""
        force, normal = self._panel_force(), self.normal
        push = float(force @ normal)
        beyond = self.beyond()
        speed = (beyond - self._beyond) / self.timestep
        self._beyond = beyond
        across = float(np.linalg.norm(force - push * normal))
        self.steps.append((self.time, push, across, speed))

    def beyond(self) -> float:
        """How far [m] the tip's center is beyond the panel's middle plane."""
        hinge = np.array([*self.door.hinge, 0.0])
        return float((self.data.geom_xpos[self._tip] - hinge) @ self.normal)

    def record(self) -> Array:
        """:attr:`steps` as an array (n, 4), from the first step on."""
        return np.array(self.steps).reshape(-1, 4)
