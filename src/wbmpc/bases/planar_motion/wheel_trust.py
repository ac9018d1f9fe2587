"""How much each wheel's encoder says of the way: a wheel that carries little slips where others roll.

Loads follow from masses of the robot's file, its posture and what its drives make of the commands. While wheels agree, weights of least
squares change nothing; where they contradict each other the ones with little load give way.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.model import PlanarBase, planar_base
from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel
from wbmpc.stability.robot import Support

#: A wheel with a smaller share of the mean load counts as this; at home every foot of a file whose masses are used has more than that.
LEAST, STANDING = 0.02, 0.1


class WheelTrust:
    """Callable: weights (n) of the rows of a base's odometry, the square of their wheel's load over the mean."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, base = robot, planar_base(robot)
        nx, nu = robot.state.size, robot.input.size
        x, u, change = (ca.SX.sym(name, size) for name, size in (("x", nx), ("u", nu), ("change", nu)))
        support = Support(robot, x)
        x_rate = robot.dynamics()(x, u, ca.SX.zeros(robot.parameters.size), ca.SX.ones(robot.mode.size))
        loads = support.foot_loads(support.load(motion=(u, x_rate, change)))
        self._loads = Numeric(ca.Function("loads", [x, u, change], [ca.densify(loads)]))
        self._rows = base.feet_of_rows

    @classmethod
    def of(cls, robot: RobotModel) -> WheelTrust | None:
        """None of a robot whose wheels' loads are unknown: with fewer than three feet, or by whose masses one lifts at home."""
        base = robot.base
        if base.footprint is None or not isinstance(base, PlanarBase) or not base.feet_of_rows:
            return None
        found, rest = cls(robot), np.zeros(robot.input.size)
        shares = found.shares(robot.home, rest, rest)
        return found if np.isfinite(shares).all() and shares.min() > STANDING else None

    def shares(self, x: Array, u: Array, change: Array) -> Array:
        """Loads of all feet over their mean at a state x (nx), rates u (nu) that change by ``change`` (nu) per second."""
        loads = np.ravel(self._loads(x, u, change)[0])
        shares: Array = loads / np.mean(loads)
        return shares

    def __call__(self, x: Array, u: Array, change: Array) -> Array:
        """See the class; arguments as for :meth:`shares`."""
        return np.asarray(np.maximum(self.shares(x, u, change)[self._rows], LEAST) ** 2, float)
