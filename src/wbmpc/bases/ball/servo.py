"""What a drive closes by itself between two commands: stiffness and damping about a moving set point, at the physics' rate."""

from __future__ import annotations

from wbmpc.arrays import Array
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.checks import numbers
from wbmpc.simulation.perturbation import quantize

#: Speeds are differences of encoder readings over this time [s].
WINDOW = 0.010


class ActuatorServo:
    """Encoders of ``counts`` per turn with constant ``offset`` (n) [rad], read at every physics step of ``timestep`` [s]."""

    def __init__(self, counts: int, offset: Array, timestep: float) -> None:
        self._counts, self._offset, self._h = counts, offset, timestep
        #: over how many physics steps speeds are found
        self.steps = round(WINDOW / timestep)

    def feedforward(self, command: BallCommand) -> Array:
        """The command's plain torques (n) [N m]."""
        return numbers("command", "torque", command.torque, self._offset.size)

    def torque(self, command: BallCommand, since: float, angles: Array, before: Array, steps: int) -> Array:
        """Torques (n) [N m] of a command with gains, ``since`` [s] after it came: true ``angles`` (n) [rad] now, and ``before``, so many
        ``steps`` ago."""
        n = self._offset.size
        position, speed, stiffness, damping = (
            numbers("command", name, getattr(command, name), n)
            for name in ("position", "speed", "stiffness", "damping")
        )
        now, first = (quantize(a + self._offset, self._counts) for a in (angles, before))
        rate = (now - first) / max(steps * self._h, self._h)
        return self.feedforward(command) + stiffness * (position + since * speed - now) + damping * (speed - rate)
