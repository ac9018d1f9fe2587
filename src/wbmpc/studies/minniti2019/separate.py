"""The paper's baseline: base and arm controlled by themselves (Minniti et al. 2019, section IV-C), and what can be added to it.

A base MPC that knows only ball and base and assumes that the arm stands still in its nominal configuration; a joint-level PID
for the arm, whose goal is the inverse kinematics of the end effector's task at the present pose of the base. Two things may be added:
the disturbance observer on the base's rows (integral action: an arm that has moved is a constant tilting moment for it), and the
arm's motion in the base MPC's prediction (its moving center of mass and its reaction, fed forward).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.disturbance import DisturbanceObserver
from wbmpc.bases.ball.learned_forces import GATE
from wbmpc.bases.ball.messages import BallMeasurement
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.checks import not_negative, numbers, positive
from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import residuals
from wbmpc.types import Observation

#: Errors of the end effector beyond these [m, rad] pull no harder; Levenberg's damping [1/rad²]: an arm that is stretched out towards a
#: goal beyond its reach stays so.
FAR, DAMPING = (0.1, 0.3), 10.0


def shortened(vector: Array, limit: float) -> Array:
    """The ``vector``, or one of the same direction that is ``limit`` long where it is longer."""
    return vector * min(1.0, limit / max(float(np.linalg.norm(vector)), 1e-12))


class EndEffectorInverse:
    """Arm angles at which the end effector is nearest to a pose, for the base where it is: regularized Gauss-Newton from the last ones.

    Least squares of position and orientation error with ``weight`` (6) [1/m², 1/rad²; axes of the wanted end effector] and of the arm's
    distance from a posture with ``posture`` [1/rad²].
    """

    def __init__(self, robot: RobotModel, weight: Array, posture: float) -> None:
        not_negative("inverse kinematics", weight=float(numbers("inverse kinematics", "weight", weight, 6).min()))
        positive("inverse kinematics", posture=posture)
        limits, arm = robot.limits, robot.state["arm"]
        self._root, self._posture = np.sqrt(weight), posture
        self._arm, self._lower, self._upper = arm, limits.state_lower[arm], limits.state_upper[arm]
        x, pose = ca.SX.sym("x", robot.state.size), ca.SX.sym("pose", 7)
        none = ca.SX(0, 1)
        error = residuals.FramePose(robot, robot.tool, axes="reference")(
            residuals.Symbols(x, none, none, none, pose, x, none)
        )
        slope = ca.jacobian(error, x[arm.start : arm.stop])
        self._error = Numeric(ca.Function("error", [x, pose], [ca.densify(error), ca.densify(slope)]))

    def __call__(self, x: Array, pose: Array, rest: Array, guess: Array, steps: int = 3) -> Array:
        """Angles (m) [rad] for the base of state x (nx), the end effector at ``pose`` (7), the arm near ``rest`` (m)."""
        x, found = x.copy(), guess.copy()
        for _ in range(steps):
            x[self._arm] = found
            error, slope = self._error(x, pose)
            error[:3], error[3:] = shortened(error[:3], FAR[0]), shortened(error[3:], FAR[1])
            rows = self._root[:, None] * slope
            normal = rows.T @ rows + (self._posture + DAMPING) * np.eye(found.size)
            right = rows.T @ (self._root * error.ravel()) + self._posture * (found - rest)
            found = np.clip(found - np.linalg.solve(normal, right), self._lower, self._upper)
        return found


@dataclass
class ArmLoop:
    """A PID on each joint through the arm's inertia, with its weight: τ = g + M_aa (ω² e + ω² ``integral`` ∫ e − 2 ω q̇_a).

    ``pace`` ω [rad/s]; ``integral`` [1/s]; errors beyond ``maximum`` [rad] pull no harder, and the integral of an error that is
    larger stands still.
    """

    pace: float
    integral: float
    maximum: float = 0.3

    def __post_init__(self) -> None:
        """Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be."""
        positive("arm's loop", pace=self.pace, maximum=self.maximum)
        not_negative("arm's loop", integral=self.integral)
        self._sum: Array | float = 0.0

    def torque(self, mass: Array, weight: Array, error: Array, rate: Array, period: float = 0.0) -> Array:
        """Torques (m) [N m]; with a ``period`` [s] the integral moves on."""
        short = np.clip(error, -self.maximum, self.maximum)
        self._sum = self._sum + period * self.integral * np.where(np.abs(error) < self.maximum, error, 0.0)
        out: Array = weight + mass @ (self.pace**2 * (short + self._sum) - 2.0 * self.pace * rate)
        return out


class SeparateController(BallController):
    """``mpc``: the whole robot's, as a model for the prediction over the delay and for its references only; ``planner``: the base
    MPC (:class:`wbmpc.studies.minniti2019.held_arm.ServoedArm`). ``aware``: whether it knows of the arm's motion. ``observer``
    (of the other controllers): the disturbance of the base's rows alone."""

    def __init__(
        self, robot: RobotModel, mpc: MPC, torque: Array, period: float, drives: DriveSettings, observer: bool, *more: Any,
        planner: MPC, inverse: EndEffectorInverse, arm: ArmLoop, aware: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(robot, mpc, torque, period, drives, False, *more)
        self.planner, self.inverse, self.loop, self.aware = planner, inverse, arm, aware
        n, part = ball_base(robot).nq, robot.state["arm"]
        self._nominal, self._part, self._n = robot.home.copy(), part, n
        self._nominal[part] = mpc.reference["body"].at(0.0)[part]
        self._goal = self._nominal[part].copy()
        if observer:
            wheels = robot.input["wheel"]
            step = lambda x, u, h: planner.solver.simulate(x, u[wheels], h)
            self.learned.observer = DisturbanceObserver(step, self._base_mass, n, np.array(GATE))

    def _base_mass(self, q: Array) -> Array:
        """M with the base's columns alone: how the arm moves is no innovation."""
        mass = ball_base(self.robot).numeric.mass_matrix(q)
        mass[:, 5:] = 0.0
        return mass

    def believed(self, x: Array) -> Array:
        """The state (nx) as the base MPC has it."""
        if self.aware:
            return x
        x = x.copy()
        x[self._part], x[self._n + 5 :] = self._nominal[self._part], 0.0
        return x

    def _observe(self, measurement: BallMeasurement) -> None:
        self._aim(measurement.time, measurement.state)
        learned, x = self.learned, measurement.state
        if learned.observer is not None:
            past = self.sent.acted(self._late())
            found = learned.observer.update(measurement.time, self.believed(x), past, self.period)
            learned.check_finite(found, x)
            learned.disturbance = found
        self.planner.solver.set_parameters({
            "disturbance": learned.disturbance[:5],
            "goal": self._goal if self.aware else self._nominal[self._part], "pace": np.array([self.loop.pace]),
        })  # fmt: skip

    def _aim(self, t: float, x: Array) -> None:
        """The arm's goal at time t [s] for the base where it is."""
        rest = self.mpc.reference["body"].at(t)[self._part]
        self._goal = self.inverse(x, self.mpc.reference["end_effector"].at(t), rest, self._goal)

    def _law(self, t: float, x: Array, policy: Policy | None, acts: bool = False) -> tuple[Array, Array]:
        assert policy is not None
        n, believed = self._n, self.believed(x)
        weight = ball_base(self.robot).numeric.inverse_dynamics(x[:n], x[n:], np.zeros(n))[5:]
        arm = self.loop.torque(
            ball_base(self.robot).numeric.mass_matrix(x[:n])[5:, 5:], weight, self._goal - x[self._part], x[n + 5 :],
            self.period if acts else 0.0,
        )  # fmt: skip
        return np.concatenate([policy.feedforward(t), weight]), np.concatenate([policy.law(t, believed), arm])

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """What the base MPC knows at time ``until``; its references are those of the whole robot."""
        self.planner.reference["body"] = self.mpc.reference["body"]
        there = super().predict(t, until, plans)
        return Observation(there.t, self.believed(there.x))
