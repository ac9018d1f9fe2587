"""A ball robot whose arm another controller moves: what a controller of the base alone knows (Minniti et al. 2019, section IV-C)."""

from __future__ import annotations

from typing import Any

import casadi as ca

from wbmpc.bases.ball.defaults import MpcCost, limit_torques
from wbmpc.bases.ball.model import ball_base
from wbmpc.errors import InputError
from wbmpc.model.kinematics import solve_spd
from wbmpc.model.layout import Layout
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Cost, OptimalControlProblem, residuals
from wbmpc.settings import MpcSettings


class ServoedArm:
    """Dynamics of a ball robot by its wheels; each arm joint goes to a goal as a critically damped servo lets it.

    State: the robot's own. Input: ``wheel`` torques [N m]. Parameters: ``goal`` [rad] of the joints, ``pace`` [rad/s] of the
    servos, ``disturbance`` (5) [N, N m] of the base. v̇_a = pace² (goal − q_a) − 2 pace v_a, and the base obeys its own rows of
    M v̇ + h = S(q)ᵀ τ + d. An arm that starts at its goal at rest stays there: the arm at a nominal configuration.
    """

    unit_quaternions: tuple[int, ...] = ()
    mode_bounds: dict[str, tuple[float, float]] = {}  # noqa: RUF012

    def __init__(self, robot: RobotModel) -> None:
        base = ball_base(robot)
        if base.base.payload:
            raise InputError(
                f"{robot.description.name}: a base whose arm others move has no mass at the end effector (base.payload)"
            )
        self._base, self._robot = base, robot
        self.state, self.mode = robot.state, Layout({})
        self.input = Layout({"wheel": robot.input.groups["wheel"]}, {"wheel": robot.input.unit_groups["wheel"]})
        pose, arm = robot.state.groups["base"], robot.state.groups["arm"]
        self.parameters = Layout({"disturbance": pose, "goal": arm, "pace": ("all",)})

    def view(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The robot's state and input; what torques move the arm is not known here (zero)."""
        return x, ca.vertcat(u, ca.SX.zeros(self._robot.input.size - u.shape[0]))

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ (nx)."""
        base, n = self._base, self._base.nq
        q, v = x[:n], x[n:]
        pace = w[self.parameters["pace"]]
        arm = pace**2 * (w[self.parameters["goal"]] - q[5:]) - 2.0 * pace * v[5:]
        known = ca.SX.zeros(self._robot.parameters.size)
        force = base.generalized_force(q, self.view(x, u)[1], known)[:5] + w[self.parameters["disturbance"]]
        right = force - base.inverse_dynamics(q, v, ca.vertcat(ca.SX.zeros(5), arm))[:5]
        return ca.vertcat(v, solve_spd(base.mass_matrix(q)[:5, :5], right), arm)

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian (nx, nx + nu) by [x; u]: that of the base's rows, solved with one factor of their M."""
        base, n = self._base, self._base.nq
        f, outer = self(x, u, w, m), ca.vertcat(x, u)
        q, v, a = x[:n], x[n:], ca.SX.sym("a", 5)
        arm = f[n + 5 :]
        known = ca.SX.zeros(self._robot.parameters.size)
        residual = base.inverse_dynamics(q, v, ca.vertcat(a, arm))[:5]
        residual -= base.generalized_force(q, self.view(x, u)[1], known)[:5]
        slope = ca.substitute(ca.jacobian(residual, outer), a, f[n : n + 5])
        kinematic = ca.horzcat(ca.SX(n, n), ca.SX.eye(n), ca.SX(n, u.shape[0]))
        return f, ca.vertcat(kinematic, -solve_spd(base.mass_matrix(q)[:5, :5], slope), ca.jacobian(arm, outer))


def base_problem(robot: RobotModel, settings: MpcSettings, cost: MpcCost) -> OptimalControlProblem:
    """What is left of that problem for a base whose arm another controller moves (:class:`ServoedArm`): ball, yaw, rates and wheel
    torques, the same limits."""
    ocp = OptimalControlProblem(ServoedArm(robot), settings.horizon, settings.intervals)
    b = cost.body
    body: dict[str, Any] = {
        "base": [b.ball, b.ball, b.yaw, 0.0, 0.0],
        "base_velocity": [b.ball_speed, b.ball_speed, b.yaw_rate, b.tilt_rate, b.tilt_rate],
        "arm": 0.0,
        "arm_velocity": 0.0,
    }
    end = {g: [cost.terminal * w for w in v] if isinstance(v, list) else 0.0 for g, v in body.items()}
    ocp.add(Cost("body", residuals.State(robot), body, at="path+terminal", terminal_weight=end))
    ocp.add(Cost("torque", residuals.Input(robot, ["wheel"], reference=None), cost.torque.wheel))
    limit_torques(ocp, robot, settings, cost.lean, ["wheel"])
    return ocp
