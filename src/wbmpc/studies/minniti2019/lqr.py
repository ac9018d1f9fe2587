"""Baselines of the MPC for a ball robot: linear-quadratic regulators about its equilibria, at the controller's rate.

They have the MPC's weights (end effector pose and twist, ball, rates, torques), its estimator, its estimated disturbance and its drives'
limits, but no horizon with limits: what they ask for is cut. References are equilibria. The gain-scheduled one takes its gains
from a grid of arm angles and turns with the base's heading; the plain one has the gain of home.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.model import ball_base
from wbmpc.checks import not_negative, numbers, positive
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy

if TYPE_CHECKING:
    from scipy.interpolate import RegularGridInterpolator


@dataclass(frozen=True)
class LqrWeights:
    """Per second, as the MPC's: ``end_effector`` (6): position [1/m²] and orientation [1/rad²]; ``twist`` (6) of the end effector; ``state`` (nx)
    deviations of the state; ``torque`` (nu)."""

    end_effector: Array
    twist: Array
    state: Array
    torque: Array

    def __post_init__(self) -> None:
        """Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        for name, size in (
            ("end_effector", 6),
            ("twist", 6),
            ("state", np.size(self.state)),
            ("torque", np.size(self.torque)),
        ):
            minimum = float(numbers("regulator's weights", name, getattr(self, name), size).min())
            (positive if name == "torque" else not_negative)("regulator's weights", **{name: minimum})


class RegulatorGains:
    """Gains K (nu, nx) of u = u₀ − K (x − x₀), discrete at ``period`` [s], about the equilibrium for some arm angles."""

    def __init__(self, robot: RobotModel, weights: LqrWeights, period: float) -> None:
        positive("regulator", period=period)
        self.robot, self.weights, self.period = robot, weights, period
        dynamics, n = robot.dynamics(), ball_base(robot).nq
        x, u = ca.SX.sym("x", robot.state.size), ca.SX.sym("u", robot.input.size)
        w = ca.SX.zeros(robot.parameters.size)
        _, jacobian = dynamics.jacobian(x, u, w, ca.SX(0, 1))
        linear, angular = robot.frame_velocity(x, u, robot.tool)
        end_effector = ca.jacobian(ca.vertcat(linear, angular), x[n:])
        self._linear = ca.Function("linear", [x, u], [ca.densify(jacobian), ca.densify(end_effector)])

    def at(self, arm: Array) -> Array:
        """The gain for arm angles [rad]."""
        from scipy.linalg import expm, solve_discrete_are  # slow to import

        x, u = ball_base(self.robot).numeric.equilibrium(arm)
        jacobian, end_effector = (np.array(v) for v in self._linear(x, u))
        size, s = x.size, self.weights
        a, b = jacobian[:, :size], jacobian[:, size:]
        both = expm(self.period * np.block([[a, b], [np.zeros((u.size, size + u.size))]]))
        still = np.zeros_like(end_effector)
        place, moves = (
            np.hstack([end_effector, still]),
            np.hstack([still, end_effector]),
        )  # at rest: the end effector's displacement is J δq
        q = place.T @ np.diag(s.end_effector) @ place + moves.T @ np.diag(s.twist) @ moves + np.diag(s.state)
        q, r = self.period * (q + 1e-6 * np.eye(size)), self.period * np.diag(s.torque)
        ad, bd = both[:size, :size], both[:size, size:]
        p = solve_discrete_are(ad, bd, q, r)
        return np.linalg.solve(r + bd.T @ p @ bd, bd.T @ p @ ad)

    def at_rest(self, arm: Array) -> Array:
        """(2 + nu, nq): how lean (pitch, roll) and torques at rest change with constant generalized forces, to first order."""
        x, u = ball_base(self.robot).numeric.equilibrium(arm)
        n = ball_base(self.robot).nq
        jacobian = np.array(self._linear(x, u)[0])[n:]
        slope = np.hstack([jacobian[:, 3:5], jacobian[:, x.size :]])
        change: Array = -np.linalg.pinv(slope) @ np.linalg.inv(ball_base(self.robot).numeric.mass_matrix(x[:n]))
        return change

    @cached_property
    def schedule(self) -> RegularGridInterpolator:
        """Gains over the arm's angles: three values of each joint, all but the first within ±1 rad of home."""
        from scipy.interpolate import RegularGridInterpolator

        home = self.robot.home[self.robot.state["arm"]]
        axes = [np.array([home[0]])] if home.size > 1 else []
        axes += [v + np.array([-0.8, 0.0, 0.8]) for v in home[len(axes) :]]
        values = np.array([self.at(np.array(arm)) for arm in product(*axes)])
        grid = values.reshape(*(len(a) for a in axes), *values.shape[1:])
        axes, grid = axes[-(home.size - 1) :] if home.size > 1 else axes, grid[0] if home.size > 1 else grid
        return RegularGridInterpolator(axes, grid, bounds_error=False, fill_value=None)


class LqrController(BallController):
    """A regulator in the MPC's place. ``target_state``: the equilibrium (nx) to be at, over time [s]; ``scheduled``: gains by arm
    angles, turned with the heading. ``maximum`` [m]: position errors beyond it are cut, as the MPC's pull no harder."""

    gains: RegulatorGains
    target_state: Callable[[float], Array]
    scheduled: bool = False
    maximum: float = 0.1

    def regulate(
        self, gains: RegulatorGains, target_state: Callable[[float], Array], scheduled: bool, maximum: float
    ) -> None:
        """What the regulator needs beside the controller's own."""
        self.gains, self.target_state, self.scheduled, self.maximum = gains, target_state, scheduled, maximum
        home = self.robot.home[self.robot.state["arm"]]
        self._home, self._shift = gains.at(home), gains.at_rest(home)
        self._rest: tuple[Array, Array] = (np.full(self.robot.state.size, np.nan), np.zeros(self.limit.size))

    def _equilibrium(self, t: float) -> tuple[Array, Array]:
        """State and torques to be at."""
        x = self.target_state(t)
        if not np.array_equal(x, self._rest[0]):
            self._rest = x, ball_base(self.robot).numeric.equilibrium(x[self.robot.state["arm"]], float(x[2]))[1]
        return self._rest

    def _gain(self, x: Array) -> Array:
        if not self.scheduled:
            return self._home
        arm = x[self.robot.state["arm"]]
        gain: Array = self.gains.schedule(arm[1:] if arm.size > 1 else arm)[0]
        return gain

    def _law(self, t: float, x: Array, policy: Policy | None, acts: bool = False) -> tuple[Array, Array]:
        n = ball_base(self.robot).nq
        target, torque = self._equilibrium(t)
        shift = self._shift @ self.learned.disturbance  # as the MPC's, its rest is that under the estimated disturbance
        error, torque = x - target, torque + shift[2:]
        error[3:5] -= shift[:2]
        error[:2] *= min(1.0, self.maximum / max(float(np.hypot(*error[:2])), 1e-9))
        if self.scheduled:
            c, s = np.cos(x[2]), np.sin(x[2])
            heading = np.array([[c, s], [-s, c]])
            error[:2], error[n : n + 2] = heading @ error[:2], heading @ error[n : n + 2]
        return torque, torque - self._gain(x) @ error
