"""A disturbance observer for robots with full dynamics: constant generalised forces that explain the motion.

The speed v̂ follows the model with the disturbance d̂; their innovation ṽ = v − v̂ corrects both:
v̂' = … + L1 ṽ, d̂' = L2 M(q) ṽ. A push is not a constant disturbance: while the innovation is large, and for ``hold``
seconds after, d̂ stays as it is. What is there again within ``again`` seconds (0: never) after such a hold, with the ball at rest,
is no push: a ball that a cable on the floor holds up feels 50 N for as long as the robot leans against it, and a plan that does not
know of them leans ever further. Then d̂ learns, at full gain, until nothing has been beyond the gate for ``lasting`` seconds.

Nor is the inertia of a load that nobody told of: while the robot accelerates, its force comes and goes with the motion. An observer
that follows it, nearly as fast as the controller acts on it, makes the two swing against each other (1 kg in the hand, a step of
0.4 m: 45 mm beyond the goal and a swing of 1.2 Hz that has not died out four seconds later). So d̂ learns slowly while the
model says that the robot accelerates or turns: L2 / (1 + (|v̇| / ``calm``)² + …), first for the ball's acceleration, then for the
tilt rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

#: A ball slower than this [m/s] is at rest.
AT_REST = 0.1


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
    again: float = 0.0
    lasting: float = 3.0
    calm: tuple[float, float] = (0.5, 0.2)  # m/s², rad/s

    def __post_init__(self) -> None:
        self.force = np.zeros(self.size)
        self._speed: np.ndarray | None = None
        self._held_until, self._lasts_until = -np.inf, -np.inf
        self.learning = 1.0  # how much of a constant disturbance the last update can have learnt

    def update(self, t: float, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """Estimate (nq,) after a measured state x (2 nq) at time t [s]; the input u acts from then for h [s]."""
        n = self.size
        q, v = x[:n], x[n:]
        if self._speed is None:
            self._speed = v.copy()
        innovation = v - self._speed
        if np.any(np.abs(innovation[: self.gate.size]) > self.gate):
            stuck = self._held_until <= t < self._held_until + self.again and np.hypot(*v[:2]) < AT_REST
            if t < self._lasts_until or stuck:
                self._lasts_until, self._held_until = t + self.lasting, -np.inf
            else:
                self._held_until = t + self.hold
        if t < self._held_until:
            self._speed = v.copy()
            innovation = np.zeros(n)
        before = self._speed
        after = self.step(np.concatenate([q, before]), u, h)
        self._speed = after[n:] + h * self.speed_gain * innovation
        acceleration = np.hypot(*(after[n : n + 2] - before[:2])) / h
        moving = (acceleration / self.calm[0]) ** 2 + (np.hypot(*v[3:5]) / self.calm[1]) ** 2
        gain, lasts = self.force_gain / (1.0 + moving), t < self._lasts_until
        self.force = self.force + h * (self.force_gain if lasts else gain) * (self.mass(q) @ innovation)
        self.learning = 0.0 if lasts or t < self._held_until else 1.0 / (1.0 + moving)
        return self.force
