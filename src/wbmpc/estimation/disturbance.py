"""A disturbance observer for robots with full dynamics: constant generalised forces that explain the motion.

The speed v̂ follows the model with the disturbance d̂; their innovation ṽ = v − v̂ corrects both:
v̂' = … + L1 ṽ, d̂' = L2 M(q) ṽ. A push is not a constant disturbance: while the innovation is large, and for ``hold``
seconds after, d̂ stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np


@dataclass
class DisturbanceObserver:
    """``step(x, u, h)``: the model's state after h seconds; ``mass(q)``: M. Units: SI."""

    step: Callable[[np.ndarray, np.ndarray, float], np.ndarray]
    mass: Callable[[np.ndarray], np.ndarray]
    size: int
    speed_gain: float = 25.0
    force_gain: float = 75.0
    gate: np.ndarray = field(default_factory=lambda: np.array([0.06, 0.06, 0.25, 0.12, 0.12]))
    hold: float = 1.0

    def __post_init__(self) -> None:
        self.force = np.zeros(self.size)
        self._speed: np.ndarray | None = None
        self._held_until = -np.inf

    def update(self, t: float, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """Estimate (nq,) after a measured state x (2 nq) at time t [s]; the input u acts from then for h [s]."""
        n = self.size
        q, v = x[:n], x[n:]
        if self._speed is None:
            self._speed = v.copy()
        innovation = v - self._speed
        if np.any(np.abs(innovation[: self.gate.size]) > self.gate):
            self._held_until = t + self.hold
        if t < self._held_until:
            self._speed = v.copy()
            innovation = np.zeros(n)
        after = self.step(np.concatenate([q, self._speed]), u, h)
        self._speed = after[n:] + h * self.speed_gain * innovation
        self.force = self.force + h * self.force_gain * (self.mass(q) @ innovation)
        return self.force
