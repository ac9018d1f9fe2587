"""The impedance of a door from the force on it and its motion: a Kalman filter. And where its hinge is.

I φ̈ + d φ̇ + c = τ of a door that opens, with the unknown inertia I, damping d and resistance c. c is closer plus dry friction: while
a door only opens, the two cannot be distinguished. States are angle, rate and 1 / I, d / I, c / I, in which the equation is nearly
linear (with I, d, c themselves the filter was sure of wrong values). At a steady rate only d φ̇ + c is seen; the covariance says
so. A door that rests or creeps says nothing: :meth:`DoorFilter.rest`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.checks import finite, not_negative, positive, positive_time
from wbmpc.errors import InputError


@dataclass(frozen=True)
class DoorNoise:
    """Standard deviations: measured ``angle`` [rad] and ``rate`` [rad/s] per sample; ``torque`` [N m/√Hz]: of what is known to
    act; ``walk`` [1/√s]: how the parameters wander, relative to the first guess; ``guess``: how wrong it may be (relative)."""

    angle: float = 2e-3
    rate: float = 0.05
    torque: float = 0.05
    walk: float = 0.02
    guess: float = 0.7

    def __post_init__(self) -> None:
        positive("door filter's noise", angle=self.angle, rate=self.rate)
        not_negative("door filter's noise", torque=self.torque, walk=self.walk, guess=self.guess)


class DoorFilter:
    """``guess`` (3): inertia [kg m²], damping [N m s/rad], resistance [N m] before anything was measured.

    ``state`` (5): angle [rad], rate [rad/s], 1 / I, d / I, c / I; ``covariance`` (5, 5). A parameter that comes out below a
    twentieth of its guess is held there (the noise may push it below zero).
    """

    def __init__(self, guess: ArrayLike, noise: DoorNoise | None = None) -> None:
        guess = np.asarray(guess, float)
        if guess.shape != (3,) or not (np.isfinite(guess).all() and np.all(guess > 0.0)):
            raise InputError(f"door filter: inertia, damping and resistance must be positive, got {guess}")
        self.noise = noise or DoorNoise()
        self._first = np.array([1.0, guess[1], guess[2]]) / guess[0]
        self.state = np.concatenate([[0.0, 0.0], self._first])
        n = self.noise
        self.covariance = np.diag([n.angle**2, n.rate**2, *(n.guess * self._first) ** 2])

    def _parameters(self) -> Array:
        bounded: Array = np.maximum(self.state[2:], 0.05 * self._first)
        return bounded

    @property
    def impedance(self) -> Array:
        """Inertia [kg m²], damping [N m s/rad], resistance [N m]."""
        a, b, c = self._parameters()
        return np.array([1.0, b, c]) / a

    @property
    def spread(self) -> Array:
        """Relative standard deviations (3) of inertia, damping and resistance, to first order."""
        a, b, c = self._parameters()
        slope = np.array([[-1.0 / a, 0.0, 0.0], [-1.0 / a, 1.0 / b, 0.0], [-1.0 / a, 0.0, 1.0 / c]])
        variance: Array = np.sqrt(np.diag(slope @ self.covariance[2:, 2:] @ slope.T))
        return variance

    def rest(self, angle: float, rate: float = 0.0) -> None:
        """The door rests or creeps at ``angle`` [rad], ``rate`` [rad/s]: what is known of its impedance stays as it is."""
        finite("door filter", angle=angle, rate=rate)
        self.state[:2] = angle, rate
        self.covariance[:2, :], self.covariance[:, :2] = 0.0, 0.0
        self.covariance[0, 0], self.covariance[1, 1] = self.noise.angle**2, self.noise.rate**2

    def shift(self, angle: float) -> None:
        """Angles are larger by ``angle`` [rad] from now on: the door's place is known better, the door has not moved."""
        finite("door filter", angle=angle)
        self.state[0] += angle

    def update(self, interval: float, torque: float, angle: float, rate: float) -> None:
        """``torque`` [N m] that acted over the last ``interval`` [s]; measured ``angle`` [rad] and ``rate`` [rad/s] now.

        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        positive_time("door filter", interval)
        finite("door filter", torque=torque, angle=angle, rate=rate)
        self._predict(interval, torque)
        n = self.noise
        for place, value, spread in ((0, angle, n.angle), (1, rate, n.rate)):
            column = self.covariance[:, place].copy()
            variance = column[place] + spread**2
            self.state = self.state + column / variance * (value - self.state[place])
            self.covariance = self.covariance - np.outer(column, column) / variance
        self.covariance = 0.5 * (self.covariance + self.covariance.T)

    def _predict(self, h: float, torque: float) -> None:
        a, b, c = self._parameters()
        rate = self.state[1]
        slope = np.eye(5)
        slope[0, 1] = h
        slope[1, 1:] += h * np.array([-b, torque, -rate, -1.0])
        self.state[:2] += h * np.array([rate, a * torque - b * rate - c])
        spread = np.concatenate([[0.0, a * self.noise.torque], self.noise.walk * self._first])
        self.covariance = slope @ self.covariance @ slope.T + h * np.diag(spread**2)


class LeverFit:
    """How far [m] from its hinge a door is pushed, from the way of an end effector on the panel: a circle.

    It touched the closed panel at p₀ = h + ℓ a − c n (hinge h, along the panel a, normal n, offset c), has slid along the panel by s since,
    and has moved by d: as far from h as the panel says, 2 ℓ aᵀd − q = 2 c nᵀd − |d|² with q = 2 ℓ s + s². That is linear in ℓ and q:
    recursive least squares from a first guess of standard deviation ``spread``. ``noise`` [m²] of that equation, for places that are 3 mm off
    for 0.1 s at a time, asked 400 times a second. Without q a tip that slides by 2 cm while it bounces looks like a door whose hinge is
    beside it. A round tip that does not turn with the door rolls along it, by its radius times the angle, about nᵀd / ℓ: all that is left
    of c on the right is then half the panel's thickness.
    """

    #: How far [m] a tip slides when it comes to a panel, about, how fast [m/s] along one that it has left, and how it creeps [m/√s] along one
    #: that it touches.
    LANDS, SLIDES, CREEPS = 0.01, 0.2, 0.003
    #: No door is pushed nearer to its hinge [m].
    SHORTEST = 0.1

    def __init__(self, guess: float, spread: float = 0.08, noise: float = 0.03) -> None:
        self.first, self._found = np.zeros(3), np.array([guess, 0.0])
        self._covariance, self._noise = np.diag([spread**2, (2.0 * guess * self.LANDS) ** 2]), noise**2

    @property
    def lever(self) -> float:
        """Of the place that was touched first."""
        return float(self._found[0])

    @property
    def now(self) -> float:
        """Of the place on the panel to which the end effector has slid; it may have rolled on."""
        lever, slid = self._found
        return math.sqrt(max(lever * lever + slid, self.SHORTEST**2))

    def update(
        self, interval: float, apart: float, end_effector: Array, along: Array, normal: Array, half: float
    ) -> None:
        """The end effector (3) [m] touches the panel there, ``interval`` [s] after the last update, and did not touch it for ``apart`` [s] of
        it; directions (3) are those of the closed panel, ``half`` [m] of whose thickness."""
        slide = (self.SLIDES * apart) ** 2 + self.CREEPS**2 * interval
        self._covariance[1, 1] += (2.0 * self._found[0]) ** 2 * slide
        d = end_effector - self.first
        row = np.array([2.0 * along[:2] @ d[:2], -1.0])
        seen = float(2.0 * half * normal[:2] @ d[:2] - d[:2] @ d[:2])
        column = self._covariance @ row
        gain = column / (row @ column + self._noise)
        self._found = self._found + gain * (seen - row @ self._found)
        self._covariance = self._covariance - np.outer(gain, column)
