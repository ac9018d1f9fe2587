"""Torques of a ball robot within its drives' limits: balance comes before yaw."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.compilation import step
from wbmpc.bases.ball.model import ball_base
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import Backend, bind
from wbmpc.model.robot import RobotModel

#: A wheel that hardly changes the spin counts as if it did by this share of it.
MIN_TURN = 1e-9


@step
def limit_torques(
    n: int, size: int, torque: Floats, out: Floats, lean: Floats, effect: Floats, causes: Floats, turn: Floats,
    limit: Floats, at: Floats, room: Floats, largest: float,
) -> None:  # fmt: skip
    """``torque`` (size) [N m] of n wheels and joints within ``limit`` (size), into ``out``; at most ``largest`` of spin, which is what
    the wheels' ``effect`` (3, n) on the ball has about the vertical of a base with this ``lean`` (2) [rad], pitch and roll. ``turn`` (n):
    what ``causes`` (n, 3) one of spin and nothing else. Spins that wheel i can have beside c times what leans are -c at_i ± room_i; so is
    what there may be of it."""
    x, level = -np.sin(lean[0]), np.cos(lean[0])
    y, z = level * np.sin(lean[1]), level * np.cos(lean[1])
    spin = 0.0
    for i in range(n):
        spin += (effect[i] * x + effect[n + i] * y + effect[2 * n + i] * z) * torque[i]
        turn[i] = causes[3 * i] * x + causes[3 * i + 1] * y + causes[3 * i + 2] * z
        if abs(turn[i]) < MIN_TURN:
            turn[i] = MIN_TURN
    at[n], room[n] = 0.0, largest
    for i in range(n):
        out[i] = torque[i] - spin * turn[i]
        at[i], room[i] = out[i] / turn[i], limit[i] / abs(turn[i])
    scale = 1.0
    for i in range(n + 1):  # they overlap if every two of them do
        for j in range(n + 1):
            scale = min(scale, (room[i] + room[j]) / max(at[i] - at[j], 1e-12))
    low, high = -scale * at[0] - room[0], -scale * at[0] + room[0]
    for i in range(1, n + 1):
        low, high = max(low, -scale * at[i] - room[i]), min(high, -scale * at[i] + room[i])
    spin = min(max(spin, low), high)
    for i in range(n):  # only rounding is clipped
        out[i] = min(max(scale * out[i] + spin * turn[i], -limit[i]), limit[i])
    for i in range(n, size):
        out[i] = min(max(torque[i], -limit[i]), limit[i])


#: Where pitch and roll are in a state.
LEAN = slice(3, 5)


class TorqueLimits:
    """Of ``size`` drives, the wheels first. ``limit`` (n + m) [N m]; ``spin`` (n): torque about the vertical that the wheels' do to
    the ball under a base that stands upright."""

    def __init__(self, robot: RobotModel, size: int, backend: Backend = "compiled") -> None:
        effect = ball_base(robot).wheel_torque_map()
        self.limit: Array = np.array(robot.limits.input_upper[:size], float)
        self.spin: Array = effect[2]
        n = self.spin.size
        arrays = {"torque": np.zeros(size), "out": np.zeros(size), "at": np.zeros(n + 1), "room": np.zeros(n + 1)}
        arrays |= {"lean": np.zeros(2), "turn": np.zeros(n), "limit": self.limit.copy()}
        self._arrays = arrays | {"effect": effect.ravel(), "causes": np.linalg.pinv(effect).ravel()}
        largest = robot.description.limits.spin_effort
        self._limit = bind(limit_torques, self._arrays, backend, n=n, size=size, largest=largest)

    def limited(self, torque: Array, state: Array) -> Array:
        """Torques within the limits, for a base that leans as in the ``state`` (nx). Wheels that are clipped one by one would spin the ball.

        What leans stays as it is while some spin within its limit lets all wheels have it, and the spin nearest to the one
        asked for is taken; what leans is scaled as a whole only where there is none.
        """
        self._arrays["torque"][:] = torque
        self._arrays["lean"][:] = state[LEAN]
        self._limit()
        return self._arrays["out"].copy()
