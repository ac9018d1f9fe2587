"""From a policy to drive commands of a swerve robot: steering servo, accelerations, wheel scaling, arm, dry friction.

The gains of the policy are not used: drives that follow speeds hold a kinematic plan without them, and feedback on wheels from
an estimated pose would break the rolling rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wbmpc.bases.swerve.drive_model import ArmDrives, DriveModel
from wbmpc.bases.swerve.estimator import SwerveEstimator
from wbmpc.bases.swerve.messages import SwerveCommand, SwerveMeasurement
from wbmpc.bases.swerve.side_slip import SideSlip
from wbmpc.checks import not_negative
from wbmpc.control.drives import DryFriction
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy

Array = NDArray[np.float64]
#: Steering errors [rad] that stop a base on its way, and that end a stop. The last is no smaller: the plan's angles move on
#: meanwhile, and a base that waits for the rest falls behind its reference.
MISALIGNED, ALIGNED = 0.45, 0.1
#: Gain [1/s] of the steering servo while it aligns wheels: the base waits for them.
ALIGN_GAIN = 15.0


@dataclass(frozen=True)
class TrackingSettings:
    """``lag`` [s] of the drives, first order: the plan leads the measured state by it; ``steer_gain`` [1/s] of the steering servo;
    ``planned_steering``: whether plans start from their own steering angles instead of the measured ones; ``friction``: whether
    what dry friction takes from wheels and steering is learned and given back; ``allow_side_slip``: plans let wheels slip sideways
    while they turn about, and the odometry hardly listens to those."""

    lag: float = 0.0
    steer_gain: float = 5.0
    planned_steering: bool = True
    friction: bool = False
    allow_side_slip: bool = False

    def __post_init__(self) -> None:
        not_negative("swerve robot's tracking", steer_gain=self.steer_gain, lag=self.lag)


class SwerveTracking:
    """The law at the controller's ``period`` [s]. ``wheel_scale`` (n): the model's wheel radius over each wheel's own.

    ``target`` (nu): what plan and steering servo ask for, before it is scaled; ``sent`` (nu): what of it accelerations allow;
    ``clamped``: whether the last wheels were slowed down to their limits; ``aligning``: wheels point elsewhere than planned
    (turned by hand, or knocked), so that the base stands until they do not.
    """

    def __init__(self, robot: RobotModel, period: float, settings: TrackingSettings, wheel_scale: Array) -> None:
        self.robot, self.period, self.settings, self._wheel_scale = robot, period, settings, wheel_scale
        steer, modules = robot.state["steer"], robot.base.geometry.modules
        self._steer_range = robot.limits.state_lower[steer], robot.limits.state_upper[steer]
        # inputs that go one share of the way
        self._together = np.delete(np.arange(robot.input.size), robot.input["steer"])
        groups = ("wheel", "steer") if settings.friction else ()
        self.friction = {g: DryFriction(modules, period, settings.lag) for g in groups}
        self.drives = DriveModel(robot, period, settings.lag, settings.planned_steering)
        self.arm = ArmDrives(len(robot.input.groups["arm"]), period, settings.lag)
        self.side_slip = SideSlip(robot, period) if settings.allow_side_slip else None
        self.target, self.sent = np.zeros((2, robot.input.size))
        self.clamped = self.aligning = False

    def learn_friction(self, previous: SwerveMeasurement, now: SwerveMeasurement) -> None:
        """What dry friction takes, from one message to the next."""
        for group, drives in self.friction.items():
            drives.learn(getattr(now, group) - getattr(previous, group), now.time - previous.time)

    def rest(self) -> None:
        """A stop: the next commands start from rest."""
        self.arm.follow(np.zeros(self.arm.sag.size))
        self.target, self.sent = np.zeros((2, self.robot.input.size))
        self.clamped = self.aligning = False
        self.drives.follow(self.sent)
        for drives in self.friction.values():
            drives.command(np.zeros(drives.droop.size), np.inf, np.inf)

    def command(
        self, t: float, policy: Policy, estimator: SwerveEstimator, brake: Array
    ) -> tuple[SwerveCommand, Array]:
        """Drive speeds at t [s] under ``brake`` (n, 1 = open), and the rates (n) [rad/s] of legs that go with them."""
        inputs = self.robot.input
        planned, error = self._steering_error(t, policy, estimator)
        u = self.held(policy.feedforward(t + self.settings.lag))
        if self.side_slip is not None:
            self.side_slip.update(estimator.hinge_angles, planned, u)
        u[inputs["steer"]] = self._steer(u[inputs["steer"]], error)
        self.target = u
        self.sent = sent = self.reachable(self.sent, u, brake)
        self.drives.follow(sent)
        wheel, excess = self._scaled_wheels(sent)
        legs = sent[inputs["leg"]] * min(1.0, 1.0 / max(excess, 1e-12)) if "leg" in inputs else np.zeros(0)
        self._drive_arm(sent[inputs["arm"]])
        wheel, steer = self._driven("wheel", wheel), self._driven("steer", sent[inputs["steer"]])
        return SwerveCommand(wheel, steer, self.arm.command, brake), legs

    def _steering_error(self, t: float, policy: Policy, estimator: SwerveEstimator) -> tuple[Array, Array]:
        """Planned angles (n) [rad], and how far wheels are from them; whether wheels are aligned first."""
        # a plan whose limits give way may lie beyond the joints' range, where no wheel can be waited for
        planned = np.clip(policy.state(t + self.settings.lag)[self.robot.state["steer"]], *self._steer_range)
        # what lagging drives still owe counts as done, or a wheel that turns fast would seem to be behind
        error = planned - estimator.steer - self.settings.lag * self.drives.turning
        off = float(np.abs(error).max()) if self.settings.planned_steering else 0.0
        self.aligning = off > (ALIGNED if self.aligning else MISALIGNED)
        return planned, error

    def _steer(self, rate: Array, error: Array) -> Array:
        """The steering servo (n) [rad/s]: the plan's ``rate``, and what closes the ``error`` (n) [rad]."""
        maximum = self.robot.limits.actuator_upper[self.robot.input["steer"]]
        gain = self.settings.steer_gain
        gain = max(gain, ALIGN_GAIN) if self.aligning else gain
        return np.clip(rate + gain * error, -maximum, maximum)

    def _scaled_wheels(self, sent: Array) -> tuple[Array, float]:
        """Wheel speeds (n) [rad/s], and by what factor they were too fast.

        Too fast for one wheel: the whole motion is slowed down, or the wheels drag each other."""
        wheel = sent[self.robot.input["wheel"]] * self._wheel_scale
        excess = float(np.max(np.abs(wheel) / self.robot.limits.input_upper[self.robot.input["wheel"]]))
        self.clamped = excess > 1.0
        return wheel / max(1.0, excess), excess

    def _drive_arm(self, sent: Array) -> None:
        """The arm's commands: without the sag, within limits of speed and acceleration."""
        limits, part = self.robot.limits, self.robot.input["arm"]
        limit, change = limits.input_upper[part], limits.input_rate[part]
        arm = np.clip(sent - self.arm.sag, -limit, limit)
        last = self.arm.command
        self.arm.follow(last + np.clip(arm - last, -change * self.period, change * self.period))

    def _driven(self, group: str, target: Array) -> Array:
        """The command to drives (n) [rad/s] with what friction takes of it."""
        if group not in self.friction:
            return target
        limits, index = self.robot.limits, self.robot.input[group]
        step = limits.input_rate[index] * self.period
        return self.friction[group].command(target, limits.actuator_upper[index], step)

    def held(self, u: Array) -> Array:
        """An input (nu) as it will act: while wheels are aligned the base stands."""
        if self.aligning:
            for group in ("base", "leg", "wheel"):
                if group in self.robot.input:
                    u[self.robot.input[group]] = 0.0
        return u

    def reachable(self, sent: Array, u: Array, brake: Array) -> Array:
        """The way from the last command ``sent`` (nu) towards u (nu) as far as accelerations allow within a period.

        All but the steering goes the same share of it: one wheel that lags behind would drag the others. The steering goes as
        fast as it can: it follows planned angles. A closed brake stops its leg as hard as it likes.
        """
        inputs = self.robot.input
        step, maximum = u - sent, self.robot.limits.input_rate * self.period
        if "leg" in inputs:
            maximum[inputs["leg"]] = np.where(brake > 0.5, maximum[inputs["leg"]], np.inf)
        excess = np.maximum(np.abs(step) / maximum, 1.0)
        excess[self._together] = excess[self._together].max()
        return sent + step / excess
