"""Baselines without MPC: base and leg references straight through the rolling inverse kinematics.

The twist that the reference asks for, corrected by the base's and the legs' errors, gives each wheel its heading and speed
(Pankert et al. 2022, equations 4 and 5, solved for the wheels). Limits are those of the drives, as
for the MPC; the whole motion is scaled to the fastest wheel and held back while wheels still turn. Gains:
``wbmpc tune swerve-tune-ik`` and its like, on the tuning seeds.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_supervision import Brakes, SupervisionSettings
from wbmpc.bases.swerve.estimator import EstimatorSettings
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.checks import not_negative
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import rolling_inverse_kinematics
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.studies.pankert2022.side_slip import SlipController

#: Gain [1/s] of the arm's joints.
ARM_GAIN = 4.0
#: Speed [m/s] of a contact below which its wheel is not turned.
SLOW = 0.01
#: How far [rad] a target must come back from the end of a range for a wheel that turns about to go back.
GOES_ON = 0.5
#: t [s] -> (base pose (3), its rate (3) in world axes), (leg angles (n), rates (n); empty for fixed legs).
Goals = Callable[[float], tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]]
#: Rate [m/s, rad/s] below which a reference counts as rest.
REST = 0.01


def scale_wheels(wheel: np.ndarray, limit: float) -> np.ndarray:
    """Wheel speeds (n) [rad/s] scaled together to ``limit``: wheels that are clipped one by one drag each other."""
    return wheel * min(1.0, limit / max(float(np.abs(wheel).max(initial=0.0)), 1e-12))


@dataclass(frozen=True)
class RollingGains:
    """Gains [1/s] of base pose, legs and steering; ``lead`` [s] by which the goals are read ahead, for the drives' lag;
    ``look_ahead`` [s]: a base at rest turns its wheels to the motion that begins so soon (0: it does not); ``delay`` [s]: by which a
    command acts after the measurement that it is made of."""

    base_gain: float = 1.5
    leg_gain: float = 2.0
    steer_gain: float = 8.0
    lead: float = 0.0
    look_ahead: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        not_negative("rolling controller", **asdict(self))


class RollingController(SlipController):
    """``goals``: what base and legs shall do. The arm stands still, or follows ``posture`` (t) -> (angles (m), rates (m)). The other
    arguments are those of :class:`wbmpc.bases.swerve.controller.SwerveController`."""

    posture: Callable[[float], tuple[np.ndarray, np.ndarray]] | None = None

    def __init__(
        self, robot: RobotModel, pose: np.ndarray, period: float, goals: Goals, gains: RollingGains | None = None,
        brakes: BrakeControl | Brakes | None = None, *, estimation: EstimatorSettings | None = None,
        supervision: SupervisionSettings | None = None,
    ) -> None:  # fmt: skip
        super().__init__(robot, pose, period, brakes, estimation=estimation, supervision=supervision)
        self.goals, self.gains = goals, gains or RollingGains()
        self._turns_about = np.zeros(swerve_base(robot).geometry.modules, bool)
        self._waiting: deque[SwerveCommand] = deque(maxlen=round(self.gains.delay / period) + 1)

    def command(self, t: float, plans: PolicyQueue) -> SwerveCommand:
        """What :meth:`drive` made of the measurement before the delay; plans are not used."""
        self._waiting.append(self.drive(t))
        return self._waiting[0]

    def drive(self, t: float) -> SwerveCommand:
        """Drive speeds for this tick from the last measurement."""
        m, geometry = self.measured, swerve_base(self.robot).geometry
        assert m is not None
        if m.leg.size:
            self.supervision.await_legs(t, self.estimator.leg)
        brake = self.brakes(t)
        measured = self.estimator.steer
        (pose, rate), legs = self.goals(t + self.gains.lead)
        leg, swing = self._legs(*legs, brake)
        resting = np.abs(rate).max() < REST and np.abs(swing).max(initial=0.0) < REST
        if resting and self.gains.look_ahead > 0.0:
            target, wheel = self._await(t, leg)
        else:
            twist = self.twist(pose - self.pose, rate)
            target, wheel = rolling_inverse_kinematics(geometry, leg, measured, twist, swing)
            target = np.where(np.abs(wheel) * geometry.wheel_radius < SLOW, measured, target)
        target, wheel = self._within(target, wheel)
        # wheels that point elsewhere would drag the base along: slow down until they have turned
        limit = self.robot.limits.actuator_upper
        wheel = scale_wheels(wheel, float(limit[self.robot.input["wheel"]].min()))
        wheel = wheel * float(np.cos(np.minimum(np.abs(target - measured), 0.5 * np.pi)).min())
        self.estimator.side_slip.announce(wheel * geometry.wheel_radius * np.sin(target - measured))
        steer_limit = limit[self.robot.input["steer"]]
        steer = np.clip(self.gains.steer_gain * (target - measured), -steer_limit, steer_limit)
        self.watch(t, brake, swing)
        return SwerveCommand(wheel * self.wheel_scale, steer, self._arm(t, self.estimator.arm), brake)

    def _arm(self, t: float, measured: np.ndarray) -> np.ndarray:
        """Speeds (m) [rad/s] of the arm's joints."""
        if self.posture is None:
            return np.zeros(measured.size)
        angles, rates = self.posture(t)
        return rates + ARM_GAIN * (angles - measured)

    def twist(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Body twist (3) for the pose error (3) and the reference's rate (3), both in world axes."""
        return self._in_base(rate + self.gains.base_gain * error)

    def _in_base(self, v: np.ndarray) -> np.ndarray:
        c, s = np.cos(self.pose[2]), np.sin(self.pose[2])
        return np.array([c * v[0] + s * v[1], -s * v[0] + c * v[1], v[2]])

    def _legs(self, target: np.ndarray, rate: np.ndarray, brake: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Measured leg angles (n) and the rates (n) [rad/s] at which the legs shall swing."""
        m, still = self.measured, np.zeros(swerve_base(self.robot).geometry.modules)
        assert m is not None
        if not m.leg.size:
            return still, still
        limit = self.robot.limits.input_upper[self.robot.input["leg"]]
        leg = self.estimator.leg
        return leg, brake * np.clip(rate + self.gains.leg_gain * (target - leg), -limit, limit)

    def _await(self, t: float, leg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Steering for the motion that comes, wheels at rest."""
        assert self.measured is not None
        soon = self.goals(t + self.gains.look_ahead)[0][1]
        aim = self._in_base(soon) if np.abs(soon).max() >= REST else np.zeros(3)
        target, _ = rolling_inverse_kinematics(swerve_base(self.robot).geometry, leg, self.estimator.steer, aim)
        return target, np.zeros(target.size)

    def _within(self, target: np.ndarray, wheel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Steering targets turned by half a turn, and wheels that run backwards, where the joint's range ends. A wheel that turns about goes
        on (:data:`GOES_ON`): at a target beside the end it would go to and fro for ever, with its target."""
        index = self.robot.state["steer"]
        low, high = self.robot.limits.state_lower[index], self.robot.limits.state_upper[index]
        beside = np.where(self._turns_about, GOES_ON, 0.0)
        turn = np.where(target > high - beside, -np.pi, np.where(target < low + beside, np.pi, 0.0))
        self._turns_about = turn != 0.0
        return target + turn, np.where(turn == 0.0, wheel, -wheel)


class FourWheelSteeringController(RollingController):
    """The classic four-wheel-steering base: forward speed and yaw rate only, no sideways motion.

    Tracking law of Kanayama et al. (ICRA 1990): v = v_r cos e_θ + k_x e_x, ω = ω_r + |v_r| (k_y e_y + k_θ sin e_θ).
    """

    def twist(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Body twist (3) whose sideways part is 0."""
        k, (ex, ey, yaw) = self.gains.base_gain, self._in_base(error)
        own = self.pose[2] + yaw
        speed = float(np.cos(own) * rate[0] + np.sin(own) * rate[1])  # along the reference's own axis
        turn = rate[2] + k * (k * speed * ey + max(abs(speed), 0.2) * np.sin(yaw))
        return np.array([speed * np.cos(yaw) + k * ex, 0.0, turn])
