"""A disturbance observer for robots with full dynamics: constant generalized forces that explain the motion.

The speed v̂ follows the model with the disturbance d̂; their innovation ṽ = v − v̂ corrects both:
v̂' = … + L1 ṽ, d̂' = L2 M(q) ṽ. L1 ṽ is the acceleration that d̂ does not explain, 1 / L1 late. A push is not a constant
disturbance: while ṽ is beyond the ``gate``, and for ``hold`` seconds after, d̂ stays as it is. But what goes on in one direction for
longer than a push, ``longest`` seconds, is a force that lasts (a person leans on the robot, a cable holds its ball up), or one
that has gone: d̂ then learns at full gain, whatever the gate says, until ``settled`` seconds after ṽ last went
on like that. A plan that does not know of such a force, or believes in one that has gone, leans wrongly for as long. (To go on
learning at every sign of motion makes a robot with an unknown 1 kg in its end effector swing against its own observer.)

At the start nothing has been learned, and the first disturbances are errors of the robot's own masses and its load: for ``longest`` seconds d̂ learns
:data:`~wbmpc.bases.ball.disturbance_step.EAGER` times as fast, whatever the gate says.

Nor is the inertia of a load that is not modeled: while the robot accelerates, its force comes and goes with the motion. An observer
that follows it, nearly as fast as the controller acts on it, makes the two swing against each other (1 kg in the end effector, a step of
0.4 m: 45 mm beyond the goal and a swing of 1.2 Hz that has not decayed four seconds later). So d̂ learns slowly while the
model says that the robot accelerates or turns: L2 / (1 + (|v̇| / ``calm``)² + …), first for the ball's acceleration, then for the
tilt rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wbmpc.bases.ball.disturbance_step import Clock, observe
from wbmpc.checks import finite, not_negative, numbers, positive_time, scales
from wbmpc.errors import InputError
from wbmpc.kernel.step import Backend, bind


@dataclass
class DisturbanceObserver:
    """``step(x, u, h)``: the model's state after h seconds; ``mass(q)``: M. Units: SI. ``gate`` (1 to ``size``): largest innovations of the
    first speeds that are none of a push. ``backend``: machine code
    (:mod:`wbmpc.bases.ball.disturbance_step`), or the same source as ordinary Python."""

    step: Callable[[np.ndarray, np.ndarray, float], np.ndarray]
    mass: Callable[[np.ndarray], np.ndarray]
    size: int
    gate: np.ndarray
    speed_gain: float = 25.0
    force_gain: float = 75.0
    hold: float = 1.0
    longest: float = 0.5
    settled: float = 1.0
    calm: tuple[float, float] = (0.5, 0.2)  # m/s², rad/s
    backend: Backend = "compiled"

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
        n, gates = self.size, self.gate.size
        sizes = {
            "velocity": n,
            "speed": n,
            "after": n,
            "mass": n * n,
            "force": n,
            "felt": gates,
            "mean": gates,
            "innovation": n,
        }
        self._arrays = {name: np.zeros(length) for name, length in sizes.items()} | {
            "gate": np.array(self.gate, float), "clock": np.array([-np.inf, -np.inf, np.inf, -np.inf]),
            "settings": np.array([self.speed_gain, self.force_gain, self.hold, self.longest, self.settled, *self.calm], float),
        }  # fmt: skip
        self._observe = bind(observe, self._arrays, self.backend, size=n, gates=gates)
        self._state = np.zeros(2 * n)
        self.started = False  # whether there has been a state
        self.learning = 1.0  # how much of a constant disturbance the last update can have learned

    @property
    def force(self) -> np.ndarray:
        """The estimate (nq)."""
        return self._arrays["force"].copy()

    @force.setter
    def force(self, value: np.ndarray) -> None:
        self._arrays["force"][:] = value

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Its arrays by their names in :mod:`wbmpc.bases.ball.disturbance_step`, for other steps to read and to change."""
        return self._arrays

    def update(self, t: float, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """Estimate (nq,) after a measured state x (2 nq) at time t [s]; the input u acts from then for h [s].

        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        n, a = self.size, self._arrays
        finite("disturbance observer", t=t)
        positive_time("disturbance observer", h)
        x = numbers("disturbance observer", "state", x, 2 * n)
        u = numbers("disturbance observer", "input", u, np.size(u))
        a["velocity"][:] = x[n:]
        if not self.started:
            a["speed"][:], self.started = x[n:], True
            a["clock"][Clock.NEW_UNTIL] = t + self.longest
        self._state[:n], self._state[n:] = x[:n], a["speed"]
        a["after"][:] = self.step(self._state.copy(), u, h)[n : 2 * n]
        a["mass"][:] = self.mass(x[:n]).reshape(-1)
        self.learning = self._observe(t, h)
        return self.force
