"""A disturbance observer for robots with full dynamics: constant generalised forces that explain the motion.

The speed v̂ follows the model with the disturbance d̂; their innovation ṽ = v − v̂ corrects both:
v̂' = … + L1 ṽ, d̂' = L2 M(q) ṽ. L1 ṽ is the acceleration that d̂ does not explain, 1 / L1 late. A push is not a constant
disturbance: while ṽ is beyond the ``gate``, and for ``hold`` seconds after, d̂ stays as it is. But what goes on in one direction for
longer than a push, ``longest`` seconds, is a force that lasts (somebody leans on the robot, a cable holds its ball up), or one
that has gone: d̂ then learns at full gain, whatever the gate says, until ``settled`` seconds after ṽ last went
on like that. A plan that does not know of such a force, or believes in one that has gone, leans wrongly for as long. (To go on
learning at every sign of motion makes a robot with an unknown 1 kg in its end effector swing against its own observer.)

Nor is the inertia of a load that is not modeled: while the robot accelerates, its force comes and goes with the motion. An observer
that follows it, nearly as fast as the controller acts on it, makes the two swing against each other (1 kg in the end effector, a step of
0.4 m: 45 mm beyond the goal and a swing of 1.2 Hz that has not decayed four seconds later). So d̂ learns slowly while the
model says that the robot accelerates or turns: L2 / (1 + (|v̇| / ``calm``)² + …), first for the ball's acceleration, then for the
tilt rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from wbmpc.checks import finite, not_negative, numbers, positive_time, scales
from wbmpc.errors import InputError

#: The share of the gate from which on a steady innovation counts: no push needs to be distinguished from it, only noise.
STEADY = 0.35


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
    longest: float = 0.5
    settled: float = 1.0
    calm: tuple[float, float] = (0.5, 0.2)  # m/s², rad/s

    def __post_init__(self) -> None:
        """Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be; ``gate`` and ``calm`` may be infinite."""
        who = "disturbance observer"
        not_negative(who, speed_gain=self.speed_gain, force_gain=self.force_gain, hold=self.hold)
        not_negative(who, longest=self.longest, settled=self.settled)
        self.gate = scales(who, "gate", self.gate)
        if scales(who, "calm", self.calm).shape != (2,) or not 1 <= self.gate.size <= self.size:
            raise InputError(
                f"{who}: 'calm' needs 2 numbers, 'gate' 1 to {self.size}, got {self.calm} and {self.gate.tolist()}"
            )
        self.force = np.zeros(self.size)
        self._speed: np.ndarray | None = None
        self._held_until, self._lasts_until = -np.inf, -np.inf
        self._since, self._mean = np.inf, np.zeros(self.gate.size)
        self.learning = 1.0  # how much of a constant disturbance the last update can have learnt

    def update(self, t: float, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """Estimate (nq,) after a measured state x (2 nq) at time t [s]; the input u acts from then for h [s].

        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        n = self.size
        finite("disturbance observer", t=t)
        positive_time("disturbance observer", h)
        x = numbers("disturbance observer", "state", x, 2 * n)
        u = numbers("disturbance observer", "input", u, np.size(u))
        q, v = x[:n], x[n:]
        if self._speed is None:
            self._speed = v.copy()
        innovation = v - self._speed
        felt = innovation[: self.gate.size] / self.gate
        self._lasts(t, felt, h)
        if np.abs(felt).max() > 1.0:
            self._held_until = t + self.hold
        lasts = t < self._lasts_until
        held = t < self._held_until and not lasts
        previous = self._speed
        after = self.step(np.concatenate([q, previous]), u, h)
        self._speed = after[n:] + h * self.speed_gain * innovation
        acceleration = np.hypot(*(after[n : n + 2] - previous[:2])) / h
        moving = (acceleration / self.calm[0]) ** 2 + (np.hypot(*v[3:5]) / self.calm[1]) ** 2
        gain = 0.0 if held else self.force_gain if lasts else self.force_gain / (1.0 + moving)
        self.force = self.force + h * gain * (self.mass(q) @ innovation)
        self.learning = 0.0 if lasts or held else 1.0 / (1.0 + moving)
        return self.force

    def _lasts(self, t: float, felt: np.ndarray, h: float) -> None:
        """Whether the innovation ``felt``, as shares of the gate, is that of a force that lasts: for longer than a push it has
        been one and the same, within 60 degrees of its own mean since it began."""
        if np.abs(felt).max() <= STEADY:
            self._since = np.inf
            return
        length = np.linalg.norm(felt)
        if not np.isfinite(self._since) or felt @ self._mean < 0.5 * length * np.linalg.norm(self._mean):
            self._since, self._mean = t, felt.copy()
        self._mean += h / (t - self._since + h) * (felt - self._mean)
        if t - self._since >= self.longest:
            self._lasts_until = t + self.settled
