"""What experiments record of a ball robot at every tick, in one call."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.truth_step import estimated, truth
from wbmpc.kernel.step import Backend, bind
from wbmpc.log import Log, Rows


class TruthRecord:
    """Writes what a ``plant`` really does, and where its end effector is for an estimated state, into a ``log``: channels "state" (nx),
    "hand" (3) [m], "hand_quaternion" (4), "tilt" [rad]; where there is an estimator "estimate" (nx), "hand_estimated",
    "hand_quaternion_estimated"; and ``others``, channels by their width (None: one number), which are given with each row. ``backend``:
    machine code, or the same source as ordinary Python."""

    def __init__(
        self,
        log: Log,
        plant: BallPlant,
        others: Mapping[str, int | None],
        estimator: bool,
        backend: Backend = "compiled",
    ) -> None:
        self._plant, nx = plant, 10 + 2 * len(plant.description.arm.joints)
        widths: dict[str, int | None] = {"state": nx, "hand": 3, "hand_quaternion": 4, "tilt": None}
        if estimator:
            widths |= {"estimate": nx, "hand_estimated": 3, "hand_quaternion_estimated": 4}
        self._rows: Rows = log.together({**widths, **others})
        self.values = self._rows.values
        room = {"seen": np.zeros(3)} | {name: np.zeros(9) for name in ("turned", "believed", "product")}
        own = self.values | room | plant.memory
        self._truth = bind(truth, own, backend, m=len(plant.description.arm.joints), height=plant.base.ball_radius)
        self._estimated = bind(estimated, own, backend) if estimator else None

    def add(self, t: float, estimate: Array | None = None) -> None:
        """A row at time t [s] of the present; the others' :attr:`values` have been written. ``estimate`` (nx): what an estimator believes."""
        world = self._plant.world
        world.refresh()
        self._truth(world.counted_yaw)
        if self._estimated is not None:
            self.values["estimate"][:] = estimate
            self._estimated()
        self._rows.add(t)
