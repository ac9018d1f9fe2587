"""Torques of a ball robot within its drives' limits: balance comes before yaw."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.compilation import compiled, step
from wbmpc.bases.ball.model import ball_base
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind
from wbmpc.model.robot import RobotModel

#: A wheel that hardly changes the spin counts as if it did by this share of it.
MIN_TURN = 1e-9


class Torques(NamedTuple):
    """What is asked of wheels and joints, ``size`` drives together, and what of it is within limits; N m."""

    wheels: int
    size: int
    torque: Floats  # (size), as asked for
    out: Floats  # (size), within the limits
    lean: Floats  # (2) [rad] of the base, pitch and roll
    effect: Floats  # (3, wheels), of the wheels' torques on the ball
    causes: Floats  # (wheels, 3), the wheels' torques for one on the ball
    turn: Floats  # (wheels), those for one of spin and nothing else
    limit: Floats  # (size)
    at: Floats  # (wheels + 1)
    room: Floats  # (wheels + 1)
    largest: float  # spin, about the vertical
    way: Floats  # (size), how far drives go


@step
def limit_torques(drives: Torques) -> None:
    """Spins that wheel i can have beside c times what leans are -c at_i ± room_i; so is what there may be of it."""
    n, torque, out, turn, limit, at, room = (
        drives.wheels,
        drives.torque,
        drives.out,
        drives.turn,
        drives.limit,
        drives.at,
        drives.room,
    )
    x, level = -np.sin(drives.lean[0]), np.cos(drives.lean[0])
    y, z = level * np.sin(drives.lean[1]), level * np.cos(drives.lean[1])
    spin = 0.0
    for i in range(n):
        spin += (drives.effect[i] * x + drives.effect[n + i] * y + drives.effect[2 * n + i] * z) * torque[i]
        turn[i] = drives.causes[3 * i] * x + drives.causes[3 * i + 1] * y + drives.causes[3 * i + 2] * z
        if abs(turn[i]) < MIN_TURN:
            turn[i] = MIN_TURN
    at[n], room[n] = 0.0, drives.largest
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
    for i in range(n, drives.size):
        out[i] = min(max(torque[i], -limit[i]), limit[i])


@compiled
def approach(drives: Torques, rows: Floats, row: int, blend: float) -> None:
    """The ``way`` of drives from what they give in a ``row``, so much of it to what is within limits. (Who adds it rounds as
    :meth:`wbmpc.bases.ball.sent_torques.SentTorques.follow` does.)"""
    for i in range(drives.size):
        drives.way[i] = blend * (drives.out[i] - rows[row * drives.size + i])


#: Where pitch and roll are in a state.
LEAN = slice(3, 5)


class TorqueLimits:
    """Of ``size`` drives, the wheels first. ``limit`` (n + m) [N m]; ``spin`` (n): torque about the vertical that the wheels' do to
    the ball under a base that stands upright."""

    def __init__(self, robot: RobotModel, size: int) -> None:
        effect = ball_base(robot).wheel_torque_map()
        self.limit: Array = np.array(robot.limits.input_upper[:size], float)
        self.spin: Array = effect[2]
        n = self.spin.size
        arrays = {"torque": np.zeros(size), "out": np.zeros(size), "at": np.zeros(n + 1), "room": np.zeros(n + 1)}
        arrays |= {"way": np.zeros(size), "lean": np.zeros(2), "turn": np.zeros(n), "limit": self.limit.copy()}
        #: everything by its name in :class:`wbmpc.bases.ball.torque_limits.Torques`
        self.arrays = arrays | {"effect": effect.ravel(), "causes": np.linalg.pinv(effect).ravel()}
        self.constants = {"wheels": n, "size": size, "largest": robot.description.limits.spin_effort}
        self._limit = bind(limit_torques, self.arrays, **self.constants)

    def limited(self, torque: Array, state: Array) -> Array:
        """Torques within the limits, for a base that leans as in the ``state`` (nx). Wheels that are clipped one by one would spin the ball.

        What leans stays as it is while some spin within its limit lets all wheels have it, and the spin nearest to the one
        asked for is taken; what leans is scaled as a whole only where there is none.
        """
        self.arrays["torque"][:] = torque
        self.arrays["lean"][:] = state[LEAN]
        self._limit()
        return self.arrays["out"].copy()
