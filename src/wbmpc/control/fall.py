"""The fall that can be foreseen: plans that pass through a lean which the wheels cannot stop any more."""

from __future__ import annotations

import casadi as ca
import numpy as np

from wbmpc.errors import FallForeseen
from wbmpc.model import RobotModel
from wbmpc.model.balance import Balance, load_offset
from wbmpc.mpc import Policy


class FallForecast:
    """Looks at every new plan of a ball robot's MPC and raises :class:`FallForeseen` when falling is certain.

    The lean is a hard limit of the problem, relaxed only where it cannot be held. A plan in which its divergent component goes
    beyond the wheels' reach (times ``share``) says that the optimiser, with all torques that there are, has found no other
    way; ``plans`` such plans in a row are needed, for one solve may be far from converged.
    """

    def __init__(self, robot: RobotModel, arm: np.ndarray, share: float = 1.0, plans: int = 4) -> None:
        balance = Balance.of(robot, arm)
        self.reach, self._plans, self._bad = share * float(balance.reach.max()), plans, 0
        n, x = robot.base.nq, ca.SX.sym("x", robot.state.size)
        w = ca.SX.zeros(robot.parameters.size)
        mass = ca.SX.sym("mass")
        if "payload" in robot.parameters:
            w[robot.parameters["payload"]] = mass
        offset = load_offset(robot.base, x[:n], w)
        component = offset + ca.jacobian(offset, x[:n]) @ x[n : 2 * n] / balance.pole
        self._component = ca.Function("component", [x, mass], [component])
        self._seen: Policy | None = None

    def look(self, policy: Policy, payload: float = 0.0) -> None:
        """Take in the plan in force (the same one again changes nothing); ``payload`` [kg] at the tool, if the model has it."""
        if policy is self._seen:
            return
        self._seen = policy
        most = float(
            np.linalg.norm(
                np.array(self._component(policy.x[1:, : self._component.size1_in(0)].T, payload)), axis=0
            ).max()
        )
        self._bad = self._bad + 1 if most > self.reach else 0
        if self._bad >= self._plans:
            raise FallForeseen(
                f"the robot will fall: {self._plans} plans in a row lean by {1e3 * most:.0f} mm at the centre of mass, and the "
                f"wheels can stop {1e3 * self.reach:.0f} mm; motors off"
            )
