"""A mass in the end effector of a ball robot, weighed: what of an estimated disturbance looks like its weight is taken for it.

A disturbance observer finds the generalized forces d that hold the robot where the model says it should move. A constant d is
right only where it was found: the weight of a mass at the tool turns with the robot and changes with the arm, and the mass has
inertia. So the part of d that is the weight w(q) = Jᵀ(0, 0, −g) of a mass becomes that mass, which the model has as a
parameter: m' = ``rate`` wᵀ W d / (wᵀ W w) and d' = −m' w. At the posture where that happens the model's forces stay as they
are. W = 1 / ``spread``², by how much d is off where there is no mass: the model's own errors of mass and center of mass, large in
the base's lean, small in the arm's joints.

The errors d has without a mass last, so that no time averages them away: they are a mass of standard deviation 1 / √(wᵀ W w).
The arm has to observe it: its joints' part of wᵀ W w, w_aᵀ W_a w_a, is to be the larger one, and enough for a mass within
``sure`` by itself. Where it is not (an end effector above its shoulder, an arm of vertical axes alone) the disturbance stays what it is:
a lean that a displaced center of mass causes would be taken for a mass, which then turns with the arm.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.payload_step import AFTER, CALM, Load, Rule, learn, update_mass
from wbmpc.checks import finite, not_negative, numbers, positive
from wbmpc.errors import InputError
from wbmpc.kernel.step import Backend, Step, bind

_WHO = "payload estimator"


class PayloadEstimator:
    """``weight(q)``: generalized forces (nq) [N, N m] of 1 kg at the tool; ``rate`` [1/s]; ``spread`` of base and arm [N m];
    ``sure`` [kg]: nothing is weighed where the arm's torques alone determine a mass with a larger standard deviation.

    ``mass`` [kg]: the estimate, from zero to ``maximum``. Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be.
    """

    def __init__(
        self, weight: Callable[[Array], Array], rate: float = 2.0, spread: tuple[float, float] = (2.5, 0.6),
        maximum: float = 3.0, sure: float = 0.5, mass: float = 0.0, backend: Backend = "compiled",
    ) -> None:  # fmt: skip
        not_negative(_WHO, rate=rate, maximum=maximum, mass=mass)
        positive(_WHO, sure=sure)
        base, arm = numbers(_WHO, "spread", spread, 2)
        positive(_WHO, spread=min(base, arm))
        self.weight, self._backend = weight, backend
        load, rule = np.zeros(len(Load)), np.zeros(len(Rule))
        load[[Load.MASS, Load.CALM, Load.LEFT]] = mass, CALM, AFTER
        rule[[Rule.RATE, Rule.MAXIMUM, Rule.SURE]], rule[Rule.BASE_SPREAD], rule[Rule.ARM_SPREAD] = (
            (rate, maximum, sure), base, arm,
        )  # fmt: skip
        self._arrays: dict[str, Array] = {"load": load, "rule": rule}
        self._steps: dict[str, Step] = {}

    @property
    def mass(self) -> float:
        """See the class."""
        return float(self._arrays["load"][Load.MASS])

    def update(self, q: Array, force: Array, h: float) -> Array:
        """Weigh for ``h`` [s] (0: nothing is learned) at joint positions q (nq); the disturbance ``force`` (nq) without what became
        mass. Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        finite(_WHO, h=h)
        if h < 0.0:
            raise InputError(f"{_WHO}: 'h' must not be negative, got {h} s")
        n = np.size(q)
        q, force = numbers(_WHO, "q", q, n), numbers(_WHO, "force", force, n)
        a = self._load(self.weight(q), force)
        self._steps["learn"](h)
        return a["force"].copy()

    def _load(self, weight: Array, force: Array) -> dict[str, Array]:
        a, n = self._arrays, weight.size
        if "force" not in a or a["force"].size != n:
            a["weight"], a["force"] = np.zeros(n), np.zeros(n)
            self._steps["learn"] = bind(learn, a, self._backend, n=n)
        a["weight"][:], a["force"][:] = weight, force
        return a

    def observe(self, q: Array, observed: dict[str, Array], learning: float, h: float) -> None:
        """Weigh for ``h`` [s] at joint positions q (nq) what a disturbance observer has found, whose arrays ``observed`` are (always
        the same ones), at once where a load comes or goes; its ``force`` goes without what became mass.
        ``learning``: see :class:`wbmpc.bases.ball.disturbance.DisturbanceObserver`."""
        own = self.bound(observed)
        own["weight"][:] = self.weight(q)
        self._steps["update_mass"](learning, h)

    def bound(self, observed: dict[str, Array]) -> dict[str, Array]:
        """Its arrays by their names in :func:`wbmpc.bases.ball.payload_step.update_mass`, of the step that uses them, beside those of the
        observer (``observed``)."""
        n = observed["force"].size
        if "update_mass" not in self._steps:
            own = {name: np.zeros(n) for name in ("weight", "model", "believed", "apart")}
            self._own = own | {name: self._arrays[name] for name in ("load", "rule")}
            self._steps["update_mass"] = bind(update_mass, observed | self._own, self._backend, size=n)
        return self._own
