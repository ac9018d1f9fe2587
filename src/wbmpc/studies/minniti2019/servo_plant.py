"""Drives of a ball robot that close a loop between two commands: stiffness and damping about a moving set point, at the physics' rate."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.checks import numbers
from wbmpc.simulation.perturbation import quantize
from wbmpc.studies.minniti2019.tracking_control import ServoCommand

#: Speeds are differences of encoder readings over this time [s].
WINDOW = 0.010


class ServoPlant(BallPlant):
    """A ball robot whose drives take a :class:`ServoCommand` too. They read their encoders at every physics step."""

    def __init__(self, *args: Any, **keys: Any) -> None:
        super().__init__(*args, **keys)
        offset = self.draw.arm_offset
        self._servo_offset = np.concatenate([np.zeros(self._ctrl.size - offset.size), offset])
        self._window = round(WINDOW / self.timestep)
        self._history = deque(self._history, maxlen=max(self._history.maxlen or 1, 1 + self._window))

    def step(self, command: BallCommand, steps: int = 1) -> None:
        """Hold torques, or set points, for ``steps`` physics steps; drives clip at their limits."""
        if not isinstance(command, ServoCommand):
            super().step(command, steps)
            return
        for k in range(steps):
            self._given = self._servo_torque(command, k * self.timestep)
            self.world.advance(self._drive, 1, self._record)
        self.world.check()

    def _servo_torque(self, command: ServoCommand, since: float) -> Array:
        """Torques (n) [N m] of a command with gains, ``since`` [s] after it came."""
        steps = min(len(self._history) - 1, self._window)
        torque, position, speed, stiffness, damping = (
            numbers("command", name, getattr(command, name), self._ctrl.size)
            for name in ("torque", "position", "speed", "stiffness", "damping")
        )
        now, before = (self._read(self._history[k]) for k in (-1, -1 - steps))
        rate = (now - before) / max(steps * self.timestep, self.timestep)
        return torque + stiffness * (position + since * speed - now) + damping * (speed - rate)

    def _read(self, measured: Array) -> Array:
        """What the drives' encoders (n) [rad] say of something that sensors have seen."""
        one = self.sensors.seen(measured)
        angles = np.concatenate([one.wheel, one.q[self._arm_q]])
        return quantize(angles + self._servo_offset, self.perturbation.arm_counts)
