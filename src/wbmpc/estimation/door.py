"""The impedance of a door from the force on it and its motion: an extended Kalman filter.

I φ̈ + d φ̇ + c = τ of a door that opens, with the unknown inertia I, damping d and resistance c. c is closer plus dry friction: while
a door only opens, the two cannot be told apart. The logarithms of the three are states, so that they stay positive, beside angle
and rate. At a steady rate only d φ̇ + c is seen; the covariance says so. A door that rests or creeps says nothing: :meth:`rest`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DoorNoise:
    """Standard deviations: measured ``angle`` [rad] and ``rate`` [rad/s] per sample; ``torque`` [N m/√Hz]: of what is known to
    act; ``walk`` [1/√s]: how the logarithms of the parameters wander; ``guess``: of the logarithms at the start."""

    angle: float = 2e-3
    rate: float = 0.05
    torque: float = 0.05
    walk: float = 0.02
    guess: float = 0.7


class DoorFilter:
    """``guess`` (3): inertia [kg m²], damping [N m s/rad], resistance [N m] before anything was measured."""

    def __init__(self, guess: ArrayLike, noise: DoorNoise | None = None) -> None:
        guess = np.asarray(guess, float)
        if guess.shape != (3,) or not (np.isfinite(guess).all() and np.all(guess > 0.0)):
            raise InputError(f"door filter: inertia, damping and resistance must be positive, got {guess}")
        self.noise = noise or DoorNoise()
        self.state = np.concatenate([[0.0, 0.0], np.log(guess)])
        n = self.noise
        self.covariance = np.diag([n.angle**2, n.rate**2, *[n.guess**2] * 3])

    @property
    def impedance(self) -> Array:
        """Inertia [kg m²], damping [N m s/rad], resistance [N m]."""
        return np.exp(self.state[2:])

    @property
    def spread(self) -> Array:
        """Standard deviations (3) of their logarithms: about relative errors."""
        return np.sqrt(np.diag(self.covariance)[2:])

    def rest(self, angle: float, rate: float = 0.0) -> None:
        """The door rests or creeps at ``angle`` [rad], ``rate`` [rad/s]: what is known of its impedance stays as it is."""
        self.state[:2] = angle, rate
        self.covariance[:2, :], self.covariance[:, :2] = 0.0, 0.0
        self.covariance[0, 0], self.covariance[1, 1] = self.noise.angle**2, self.noise.rate**2

    def update(self, interval: float, torque: float, angle: float, rate: float) -> None:
        """``torque`` [N m] that acted over the last ``interval`` [s]; measured ``angle`` [rad] and ``rate`` [rad/s] now."""
        self._predict(interval, torque)
        n = self.noise
        for place, value, spread in ((0, angle, n.angle), (1, rate, n.rate)):
            column = self.covariance[:, place].copy()
            variance = column[place] + spread**2
            gain = column / variance
            self.state = self.state + gain * (value - self.state[place])
            self.covariance = self.covariance - np.outer(gain, column)
        self.covariance = 0.5 * (self.covariance + self.covariance.T)

    def _predict(self, h: float, torque: float) -> None:
        inertia, damping, resistance = self.impedance
        rate = self.state[1]
        acceleration = (torque - damping * rate - resistance) / inertia
        slope = np.eye(5)
        slope[0, 1] = h
        slope[1, 1:] += h * np.array([-damping, -acceleration * inertia, -damping * rate, -resistance]) / inertia
        self.state[:2] += h * np.array([rate, acceleration])
        spread = np.zeros(5)
        spread[1] = self.noise.torque / inertia
        spread[2:] = self.noise.walk
        self.covariance = slope @ self.covariance @ slope.T + h * np.diag(spread**2)
