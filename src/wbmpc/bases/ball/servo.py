"""What a drive closes by itself between two commands: stiffness and damping about a moving set point, at the physics' rate."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from wbmpc.bases.ball.messages import BallCommand
from wbmpc.checks import numbers
from wbmpc.simulation.perturbation import quantise

Array = NDArray[np.float64]
#: Speeds are differences of encoder readings over this time [s].
WINDOW = 0.010


class ActuatorServo:
    """Encoders of ``counts`` per turn with constant ``offset`` (n) [rad], read at every physics step of ``timestep`` [s]."""

    def __init__(self, counts: int, offset: Array, timestep: float) -> None:
        self._counts, self._offset, self._h = counts, offset, timestep
        self._readings: deque[Array] = deque(maxlen=1 + round(WINDOW / timestep))

    def restart(self) -> None:
        """Forget all readings."""
        self._readings.clear()

    def read(self, angles: Array) -> None:
        """True angles (n) [rad] after a physics step."""
        self._readings.append(quantise(angles + self._offset, self._counts))

    def torque(self, command: BallCommand, since: float) -> Array:
        """Torques (n) [N m], ``since`` [s] after the command came; a command without gains is plain torque."""
        n = self._offset.size
        torque = numbers("command", "torque", command.torque, n)
        if command.stiffness.size == 0:
            return torque
        position, speed, stiffness, damping = (
            numbers("command", name, getattr(command, name), n)
            for name in ("position", "speed", "stiffness", "damping")
        )
        now, first = self._readings[-1], self._readings[0]
        rate = (now - first) / max((len(self._readings) - 1) * self._h, self._h)
        return torque + stiffness * (position + since * speed - now) + damping * (speed - rate)
