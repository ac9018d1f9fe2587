"""Torques of a ball robot within its drives' limits: balance comes before yaw."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.torque_step import limit_torques
from wbmpc.kernel.step import Backend, bind
from wbmpc.model.robot import RobotModel

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
        arrays |= {"way": np.zeros(size), "lean": np.zeros(2), "turn": np.zeros(n), "limit": self.limit.copy()}
        #: everything by its name in :class:`wbmpc.bases.ball.torque_step.Torques`
        self.arrays = arrays | {"effect": effect.ravel(), "causes": np.linalg.pinv(effect).ravel()}
        self.constants = {"wheels": n, "size": size, "largest": robot.description.limits.spin_effort}
        self._limit = bind(limit_torques, self.arrays, backend, **self.constants)

    def limited(self, torque: Array, state: Array) -> Array:
        """Torques within the limits, for a base that leans as in the ``state`` (nx). Wheels that are clipped one by one would spin the ball.

        What leans stays as it is while some spin within its limit lets all wheels have it, and the spin nearest to the one
        asked for is taken; what leans is scaled as a whole only where there is none.
        """
        self.arrays["torque"][:] = torque
        self.arrays["lean"][:] = state[LEAN]
        self._limit()
        return self.arrays["out"].copy()
