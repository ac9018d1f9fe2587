"""The baseline of the paper's main argument: an instantaneous task-space controller (Minniti et al. 2019, section I).

At every tick it looks for the torques whose accelerations now come nearest to what two tasks want: the end effector's pose by a
proportional-derivative law, and the base's balance by an LQR about the stance that carries the end effector's goal. Bounded least
squares over the torques, M v̇ + h = S(q)ᵀ τ + d eliminated; nothing of the future is in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.model import ball_base
from wbmpc.checks import positive
from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.studies.minniti2019.separate import shortened

#: t [s] -> the end effector's position (3) [m] and quaternion (4) that are wanted.
Goal = Callable[[float], tuple[Array, Array]]


@dataclass(frozen=True)
class TaskGains:
    """End effector: natural frequency ``end_effector`` and ``turn`` [rad/s] of position and orientation (critically damped), largest errors of
    end effector and ball that count [m, rad]. Balance: weights of the LQR on ball position and speed, yaw, tilt and wheel torque.
    ``balance``: weight of a squared acceleration of ball [m/s²] and base [rad/s²] against one of the end effector; ``torque``: of
    torques [1/(N m)²]."""

    end_effector: float = 4.0
    turn: float = 4.0
    position_limit: float = 0.1
    turn_limit: float = 0.3
    ball_limit: float = 0.3
    ball: float = 80.0
    ball_speed: float = 10.0
    yaw: float = 10.0
    tilt: float = 50.0
    wheel_torque: float = 1.0
    balance: float = 1.0
    torque: float = 1e-4

    def __post_init__(self) -> None:
        """Raises :class:`InputError` (:class:`NotFinite`) for numbers that are not positive."""
        positive("task-space gains", **vars(self))


class TaskSpaceController(BallController):
    """Estimator, disturbance observer, prediction to now and clamps are those of the other ball-robot controllers; ``mpc`` is
    its model only. ``goal``: what the end effector is to do; ``home`` (nx): the stance about which it balances; ``stance``: where ball
    and base are to be (a state (nx) over time), left out: below the end effector's goal as at home."""

    stance: Callable[[float], Array] | None = None

    def __init__(
        self, robot: RobotModel, mpc: MPC, goal: Goal, gains: TaskGains, home: Array, torque: Array, *args: Any
    ) -> None:
        super().__init__(robot, mpc, torque, *args)
        self.goal, self.gains, self.home, self._rest = goal, gains, home, torque
        self._model = _functions(robot)
        self._from_ball = robot.pose(home)[0] - np.array([home[0], home[1], 0.0])
        self._lean = _lean_of_arm(robot, home)
        self._stiffness = _lean_stiffness(robot, home)
        self._gain = self._lqr()

    def _lqr(self) -> Array:
        """Accelerations (5) of ball and base for their deviations (10): K of v̇ = −K (z − z₀), by LQR on the wheels."""
        from scipy.linalg import solve_continuous_are  # slow to import

        n, g = ball_base(self.robot).nq, self.gains
        a, b = self._model["linear"](self.home, self._rest)
        some, wheels = [*range(5), *range(n, n + 5)], len(self.robot.input.groups["wheel"])
        a, b = a[np.ix_(some, some)], b[some][:, :wheels]
        q = np.diag([g.ball, g.ball, g.yaw, g.tilt, g.tilt, g.ball_speed, g.ball_speed, 1.0, 1.0, 1.0])
        p = solve_continuous_are(a, b, q, g.wheel_torque * np.eye(wheels))
        gain: Array = -(a - b @ (b.T @ p) / g.wheel_torque)[5:]
        return gain

    def _law(self, t: float, x: Array, policy: Policy | None, acts: bool = False) -> tuple[Array, Array]:
        """Torques of the bounded least squares."""
        torque = self._solve(t, x)
        return torque, torque

    def _solve(self, t: float, x: Array) -> Array:
        from scipy.optimize import lsq_linear

        n, g = ball_base(self.robot).nq, self.gains
        place, turned, velocity, jacobian, drift, map_, bias = self._model["now"](x)
        mass = ball_base(self.robot).numeric.mass_matrix(x[:n])
        free = np.linalg.solve(mass, self.learned.disturbance - bias.ravel())
        drive = np.linalg.solve(mass, map_)
        target = self._hand(t, place.ravel(), turned.ravel(), velocity.ravel()) - drift.ravel()
        rows = [jacobian @ drive, np.sqrt(g.balance) * drive[:5], np.sqrt(g.torque) * np.eye(drive.shape[1])]
        right = [
            target - jacobian @ free,
            np.sqrt(g.balance) * (self._balance(t, x) - free[:5]),
            np.sqrt(g.torque) * self._rest,
        ]
        found = lsq_linear(np.vstack(rows), np.concatenate(right), (-self.limit, self.limit), method="bvls")
        torque: Array = found.x
        return torque

    def _hand(self, t: float, place: Array, turned: Array, velocity: Array) -> Array:
        """Wanted linear and angular acceleration (6) of the end effector."""
        g = self.gains
        position, quaternion = self.goal(t)
        error = shortened(position - place, g.position_limit)
        turn = lie.quaternion_log(lie.quaternion_multiply(quaternion, lie.quaternion_conjugate(turned)))
        turn = shortened(np.asarray(turn, float).ravel(), g.turn_limit)
        linear = g.end_effector**2 * error - 2.0 * g.end_effector * velocity[:3]
        return np.concatenate([linear, g.turn**2 * turn - 2.0 * g.turn * velocity[3:]])

    def _balance(self, t: float, x: Array) -> Array:
        """Wanted acceleration (5) of ball and base: the LQR about the stance below the end effector's goal, at the lean that carries arm
        and estimated disturbance."""
        n = ball_base(self.robot).nq
        ball, yaw = (self.goal(t)[0] - self._from_ball)[:2], self.home[2]
        if self.stance is not None:
            ball, yaw = self.stance(t)[:2], self.stance(t)[2]
        lean = self.home[3:5] + self._lean @ (x[5:n] - self.home[5:n])
        lean = lean + np.linalg.solve(self._stiffness, self.learned.disturbance[3:5])
        away = x[:5] - np.concatenate([ball, [yaw], lean])
        away[:2] = shortened(away[:2], self.gains.ball_limit)
        target: Array = -self._gain @ np.concatenate([away, x[n : n + 5]])
        return target


def _lean_of_arm(robot: RobotModel, home: Array) -> Array:
    """How pitch and roll of the equilibrium change with the arm's angles, (2, m)."""
    arm = home[robot.state["arm"]]
    step = lambda k: np.eye(arm.size)[k] * 1e-3
    columns = [
        (
            ball_base(robot).numeric.equilibrium(arm + step(k))[0]
            - ball_base(robot).numeric.equilibrium(arm - step(k))[0]
        )[3:5]
        / 2e-3
        for k in range(arm.size)
    ]
    return np.array(columns).T


def _lean_stiffness(robot: RobotModel, home: Array) -> Array:
    """How gravity's generalized forces on pitch and roll change with them, (2, 2) [N m/rad]."""
    n = ball_base(robot).nq
    weight = lambda step: ball_base(robot).numeric.inverse_dynamics(home[:n] + step, np.zeros(n), np.zeros(n))[3:5]
    steps = [np.eye(n)[k] * 1e-4 for k in (3, 4)]
    return np.array([(weight(s) - weight(-s)) / 2e-4 for s in steps]).T


def _functions(robot: RobotModel) -> dict[str, Numeric]:
    n, m = ball_base(robot).nq, robot.input.size
    x, u = ca.SX.sym("x", robot.state.size), ca.SX.sym("u", m)
    q, v = x[:n], x[n:]
    w, mode = ca.SX(robot.parameters.size, 1), ca.SX(robot.mode.size, 1)
    pose, velocity = robot.frame_pose(x, robot.tool), ca.vertcat(*robot.frame_velocity(x, u, robot.tool))
    jacobian = ca.jacobian(velocity, v)
    force = ball_base(robot).generalized_force(q, u, w)
    bias = ball_base(robot).inverse_dynamics(q, v, ca.SX(n, 1))
    now = [pose.position, pose.quaternion, velocity, jacobian, ca.jtimes(velocity, q, v), ca.jacobian(force, u), bias]
    f = robot.dynamics()(x, u, w, mode)
    return {
        "now": Numeric(ca.Function("now", [x], [ca.densify(ca.SX(e)) for e in now])),
        "linear": Numeric(ca.Function("linear", [x, u], [ca.densify(ca.jacobian(f, v)) for v in (x, u)])),
    }
