"""A mass in the end effector of a ball robot, weighed: what of an estimated disturbance looks like its weight is taken for it.

A disturbance observer finds the generalized forces d that hold the robot where the model says it should move. A constant d is
right only where it was found: the weight of a mass at the tool turns with the robot and changes with the arm, and the mass has
inertia. So the part of d that is the weight w(q) = Jᵀ(0, 0, −g) of a mass becomes that mass, which the model has as a
parameter: m' = RATE wᵀ W d / (wᵀ W w) and d' = −m' w. At the posture where that happens the model's forces stay as they
are. W = 1 / SPREAD², by how much d is off where there is no mass: the model's own errors of mass and center of mass, large in
the base's lean, small in the arm's joints.

The errors d has without a mass last, so that no time averages them away: they are a mass of standard deviation 1 / √(wᵀ W w).
The arm has to observe it: its joints' part of wᵀ W w, w_aᵀ W_a w_a, is to be the larger one, and enough for a mass within
SURE by itself. Where it is not (an end effector above its shoulder, an arm of vertical axes alone) the disturbance stays what it is:
a lean that a displaced center of mass causes would be taken for a mass, which then turns with the arm.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.payload_step import AFTER, CALM, SPREADS, Load, update_mass
from wbmpc.kernel.step import Step, bind


class PayloadEstimator:
    """``weight(q)``: generalized forces (nq) [N, N m] of 1 kg at the tool. ``mass`` [kg]: the estimate, from zero to
    :data:`~wbmpc.bases.ball.payload_step.MAXIMUM`."""

    def __init__(self, weight: Callable[[Array], Array], mass: float = 0.0) -> None:
        self.weight = weight
        self._own = {"load": np.zeros(len(Load)), "spreads": np.array(SPREADS)}
        self._own["load"][[Load.MASS, Load.CALM, Load.LEFT]] = mass, CALM, AFTER
        self._update: Step | None = None

    @property
    def mass(self) -> float:
        """See the class."""
        return float(self._own["load"][Load.MASS])

    def observe(self, q: Array, observed: dict[str, Array], learning: float, h: float) -> None:
        """Weigh for ``h`` [s] at joint positions q (nq) what a disturbance observer has found, whose arrays ``observed`` are (always
        the same ones), at once where a load comes or goes; its ``force`` goes without what became mass.
        ``learning``: see :class:`wbmpc.bases.ball.disturbance.DisturbanceObserver`."""
        own = self.bound(observed)
        own["weight"][:] = self.weight(q)
        if self._update is None:
            self._update = bind(update_mass, observed | own, size=observed["force"].size)
        self._update(learning, h)

    def bound(self, observed: dict[str, Array]) -> dict[str, Array]:
        """Its arrays by their names in :func:`wbmpc.bases.ball.payload_step.update_mass`, of the step that uses them, beside those of the
        observer (``observed``)."""
        if "weight" not in self._own:
            self._own |= {name: np.zeros(observed["force"].size) for name in ("weight", "model", "believed", "apart")}
        return self._own
