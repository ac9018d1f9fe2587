"""The paper's tracking controller: feed-forward and PD in actuator coordinates, closed in the drives (Minniti et al. 2019, eq. 10).

τ = τ_ff + K_p (ψ_ff − ψ) + K_d (ψ̇_ff − ψ̇) for wheels and arm joints. The arm's ψ_ff is the plan's. Wheels have no planned angle:
theirs is the integral of the planned speeds ψ̇_ff = W(q_ff) v_ff. That integral knows nothing of where the wheels are, and what
it is off (other radii, slip, a plan that was not followed) would add up forever; so it leaks towards the measured angle:
d/dt ψ_ff = W v_ff + (ψ − ψ_ff) / T with T = ``leak_time_constant``. Its error e = ψ_ff − ψ obeys ė = (ψ̇_ff − ψ̇) − e / T and stays
below T times the largest error of speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.messages import BallCommand, BallMeasurement
from wbmpc.bases.ball.model import ball_base
from wbmpc.errors import InputError
from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue


@dataclass(frozen=True)
class ActuatorGains:
    """K_p [N m/rad] and K_d [N m s/rad] of wheels and arm joints; ``leak_time_constant`` [s] (infinite: plain integration)."""

    wheel_stiffness: float = 0.2
    wheel_damping: float = 0.02
    arm_stiffness: float = 20.0
    arm_damping: float = 1.0
    leak_time_constant: float = 0.25

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name == "leak_time_constant" and not value > 0.0:
                raise InputError(f"tracking: {name} must be positive, got {value}")
            if name != "leak_time_constant" and not 0.0 <= value < np.inf:
                raise InputError(f"tracking: {name} must be at least 0 and finite, got {value}")


@dataclass(frozen=True)
class ServoCommand(BallCommand):
    """With ``stiffness`` [N m/rad] and ``damping`` [N m s/rad] the drives add what these ask for about ``position`` [rad], which moves on
    with ``speed`` [rad/s]."""

    position: Array
    speed: Array
    stiffness: Array
    damping: Array


class TrackingController(BallController):
    """``wheel_error`` (n) [rad]: ψ_ff − ψ of the wheels at the last command."""

    def __init__(self, robot: RobotModel, mpc: MPC, *args: Any, gains: ActuatorGains) -> None:
        super().__init__(robot, mpc, *args)
        n, base, size = len(robot.input.groups["wheel"]), ball_base(robot), robot.state.size
        x = ca.SX.sym("x", size)
        self._speeds = Numeric(ca.Function("speeds", [x], [base.wheel_speeds(x[: base.nq], x[base.nq :])]))
        self.leak_time_constant, self._n, self._arm = gains.leak_time_constant, n, robot.state["arm"]
        each = lambda wheel, arm: np.array([wheel] * n + [arm] * (self.limit.size - n))
        self.stiffness = each(gains.wheel_stiffness, gains.arm_stiffness)
        self.damping = each(gains.wheel_damping, gains.arm_damping)
        self._wheel = np.zeros(n)
        self._integral: Array | None = None
        self.wheel_error = np.zeros(n)

    def speeds(self, x: Array) -> Array:
        """Actuator speeds (n + m) [rad/s] in a state (nx)."""
        return np.concatenate([self._speeds(x)[0].ravel(), x[ball_base(self.robot).nq + 5 :]])

    def _observe(self, measurement: BallMeasurement) -> None:
        super()._observe(measurement)
        self._wheel = measurement.wheel + measurement.age * self.speeds(measurement.state)[: self._n]
        if self._integral is None:
            self._integral = self._wheel.copy()
        self.wheel_error = self._integral - self._wheel

    def _law(self, t: float, x: Array, policy: Policy | None, acts: bool = False) -> tuple[Array, Array]:
        assert policy is not None
        feedforward, planned = policy.feedforward(t)[: self.limit.size], policy.state(t)
        away = np.concatenate([self.wheel_error, planned[self._arm] - x[self._arm]])
        moving = self.speeds(planned) - self.speeds(x)
        return feedforward, feedforward + self.stiffness * away + self.damping * moving

    def command(self, t: float, plans: PolicyQueue) -> BallCommand:
        """What the drives follow until the next command; ``sent`` remembers what they should have given."""
        super().command(t, plans)
        assert plans.current is not None and self._integral is not None
        planned = plans.current.state(t)
        speed = self.speeds(planned)
        position = np.concatenate([self._integral, planned[self._arm]])
        self._integral = self._integral + self.period * (speed[: self._n] - self.wheel_error / self.leak_time_constant)
        return ServoCommand(
            self.limits.limited(self.feedforward, planned), position, speed, self.stiffness, self.damping
        )
