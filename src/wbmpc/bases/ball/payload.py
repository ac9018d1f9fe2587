"""A mass in the end effector of a ball robot, weighed: what of an estimated disturbance looks like its weight is taken for it.

A disturbance observer finds the generalised forces d that hold the robot where the model says it should move. A constant d is
right only where it was found: the weight of a mass at the tool turns with the robot and changes with the arm, and the mass has
inertia. So the part of d that is the weight w(q) = Jᵀ(0, 0, −g) of a mass becomes that mass, which the model has as a
parameter: m' = ``rate`` wᵀ W d / (wᵀ W w) and d' = −m' w. At the posture where that happens the model's forces stay as they
are. W = 1 / ``spread``², by how much d is off where there is no mass: the model's own errors of mass and centre of mass, large in
the base's lean, small in the arm's joints.

The errors d has without a mass last, so that no time averages them away: they are a mass of standard deviation 1 / √(wᵀ W w).
The arm has to observe it: its joints' part of wᵀ W w, w_aᵀ W_a w_a, is to be the larger one, and enough for a mass within
``sure`` by itself. Where it is not (an end effector above its shoulder, an arm of vertical axes alone) the disturbance stays what it is:
a lean that a displaced centre of mass causes would be taken for a mass, which then turns with the arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import finite, not_negative, numbers, positive
from wbmpc.errors import InputError

Array = NDArray[np.float64]


@dataclass
class PayloadEstimator:
    """``weight(q)``: generalised forces (nq) [N, N m] of 1 kg at the tool; ``rate`` [1/s]; ``spread`` of base and arm [N m];
    ``sure`` [kg]: nothing is weighed where the arm's torques alone determine a mass with a larger standard deviation.

    ``mass`` [kg]: the estimate, from zero to ``maximum``.
    """

    weight: Callable[[Array], Array]
    rate: float = 2.0
    spread: tuple[float, float] = (2.5, 0.6)
    maximum: float = 3.0
    sure: float = 0.5
    mass: float = 0.0

    def __post_init__(self) -> None:
        """Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        who = "payload estimator"
        not_negative(who, rate=self.rate, maximum=self.maximum, mass=self.mass)
        positive(who, sure=self.sure)
        base, arm = numbers(who, "spread", self.spread, 2)
        positive(who, spread=min(base, arm))
        self._square = np.zeros(0)

    def update(self, q: Array, force: Array, h: float) -> Array:
        """Weigh for ``h`` [s] (0: nothing is learnt) at joint positions q (nq); the disturbance ``force`` (nq) without what became
        mass. Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        finite("payload estimator", h=h)
        if h < 0.0:
            raise InputError(f"payload estimator: 'h' must not be negative, got {h} s")
        n = np.size(q)
        q, force = numbers("payload estimator", "q", q, n), numbers("payload estimator", "force", force, n)
        weight = self.weight(q)
        if not self.by_arm(weight):
            return force
        scaled = weight / self._square
        return self.change(h * self.rate * float(scaled @ force) / float(scaled @ weight), 1.0, weight, force)

    def by_arm(self, weight: Array) -> bool:
        """Whether the arm observes a mass whose weight of 1 kg is ``weight`` (nq), by itself and better than the base."""
        n = weight.size
        if self._square.size != n:
            self._square = np.array([self.spread[0]] * 5 + [self.spread[1]] * (n - 5)) ** 2
        each = weight**2 / self._square
        return bool(each[5:].sum() >= max(0.5 * each.sum(), self.sure**-2))

    def change(self, by: float, known: float, weight: Array, force: Array) -> Array:
        """Change the mass ``by`` [kg]; the disturbance ``force`` (nq), which had the ``known`` share of it, without that."""
        previous = self.mass
        self.mass = min(max(previous + by, 0.0), self.maximum)
        return np.asarray(force - known * (self.mass - previous) * weight)
