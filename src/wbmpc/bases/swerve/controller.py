"""From policies to drive commands of a swerve robot, and from encoders to observations: a controller assembled from parts."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_monitor import SwerveReadings
from wbmpc.bases.swerve.brake_supervision import Brakes, BrakeSupervision, SupervisionSettings
from wbmpc.bases.swerve.estimator import EstimatorSettings, SwerveEstimator
from wbmpc.bases.swerve.messages import SwerveCommand, SwerveMeasurement
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.tracking import SwerveTracking, TrackingSettings
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.checks import positive
from wbmpc.control.monitor import Fault, Monitor
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import aligned_steering
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.types import Observation

#: Steering errors [rad] of a start from which wheels are aligned first.
CROOKED = 0.05


class SwerveController:
    """Estimation, prediction and tracking of a swerve robot that starts at ``pose`` (x, y, yaw), every ``period`` [s].

    ``brakes``: of the legs over time, or a function ``brakes(t)``: brake state (n) at a time, 1 = open; None: closed.
    Its parts: ``estimator``, ``tracking`` and ``supervision`` of brakes, each with settings of its own.

    The MPC's state holds the *planned* steering angles; a servo closes their difference to the measured ones. (With measured
    angles the rolling rows of four wheels are never exactly consistent, and their only exact solution is standstill.)
    """

    Estimator: ClassVar[type[SwerveEstimator]] = SwerveEstimator
    Tracking: ClassVar[type[SwerveTracking]] = SwerveTracking

    def __init__(
        self, robot: RobotModel, pose: Array, period: float, brakes: BrakeControl | Brakes | None = None, *,
        tracking: TrackingSettings | None = None, estimation: EstimatorSettings | None = None,
        supervision: SupervisionSettings | None = None,
    ) -> None:  # fmt: skip
        positive("swerve robot's controller", period=period)
        self.robot, self.period = robot, period
        estimation = estimation or EstimatorSettings()
        geometry = swerve_base(robot).geometry
        wheels = estimation.calibration or WheelCalibration.unknown(geometry)
        # the model has one radius for all wheels
        self.wheel_scale = geometry.wheel_radius / wheels.wheel_radius
        self.tracking = law = self.Tracking(robot, period, tracking or TrackingSettings(), self.wheel_scale)
        self.estimator = self.Estimator(robot, pose, estimation, law.drives, law.arm)
        self.supervision = BrakeSupervision(robot, period, brakes, supervision or SupervisionSettings())

    @property
    def measured(self) -> SwerveMeasurement | None:
        """The newest measurement."""
        return self.estimator.measured

    @property
    def pose(self) -> Array:
        """(x, y, yaw) of the base that is controlled."""
        return self.estimator.pose

    @property
    def clamped(self) -> bool:
        """Whether the wheels of the last command were slowed down to their limits."""
        return self.tracking.clamped

    @property
    def target(self) -> Array:
        """What plan and steering servo ask for (nu), before it is scaled."""
        return self.tracking.target

    @property
    def brakes(self) -> Brakes:
        """Brakes (n, 1 = open) over time, as commanded; a view may put its own in place, with which the guard of the legs rests."""
        return self.supervision.commanded

    @brakes.setter
    def brakes(self, brakes: BrakeControl | Brakes) -> None:
        self.supervision.follow(brakes)

    @property
    def slip(self) -> float | None:
        """Speed [m/s] of the fastest wheel against the base as the inertial unit has it; None without one."""
        return self.estimator.slip

    @property
    def monitors(self) -> list[Monitor[SwerveReadings]]:
        """That of brakes first."""
        return self.supervision.monitors

    @property
    def faults(self) -> list[Fault]:
        """What they found: brakes that do not answer."""
        return self.supervision.faults

    @property
    def holds(self) -> int:
        """How often a leg that went astray was held."""
        return self.supervision.holds

    def base_pose(self) -> Array:
        """Estimated pose (7) of the base in the frame of the odometry: position [m] at the nominal height, quaternion."""
        return self.estimator.base_pose()

    def state(self) -> Array:
        """Estimated state (nx), with the measured steering angles."""
        return self.estimator.state()

    def measure(self, measurement: SwerveMeasurement) -> None:
        """Take in the message of this tick."""
        previous = self.measured or measurement
        self.tracking.arm.learn(measurement.arm - previous.arm, measurement.time - previous.time)
        self.estimator.process(measurement)

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """The state at time ``until``, by the inputs that will be applied from ``t`` on, and what the drives still owe.

        The plan's clock runs ahead of the wall's by the lag: what is commanded now acts that much later.
        """
        tracking, brakes = self.tracking, self.supervision.open
        lag = tracking.settings.lag
        # A first-order drive still moves by lag times its present rate after the last command: the state leads by that.
        tracking.ahead(self._start(t, plans), brakes(t))
        for k in range(round((until - t) / self.period)):
            now = t + (k + 0.5) * self.period
            policy = plans.at(now)
            if policy is None:
                break
            tracking.predict(policy.feedforward(now + lag), brakes(now))
        return Observation(until + lag, tracking.predicted)

    def _start(self, t: float, plans: PolicyQueue) -> Array:
        """The estimated state (nx) with the steering angles that the plan has at t [s]."""
        x, steer, settings = self.estimator.state(), self.robot.state["steer"], self.tracking.settings
        if not settings.planned_steering:
            return x
        if plans.current is not None:
            x[steer] = plans.current.state(t + settings.lag)[steer]
            return x
        # Wheels that have no common center can only stand: the first plan starts from the nearest that have one.
        measured, leg = self.estimator.steer, self.estimator.leg
        aligned = aligned_steering(swerve_base(self.robot).geometry, leg if leg.size else 0.0, measured)
        if np.abs(aligned - measured).max() > CROOKED:
            x[steer] = aligned
        return x

    def stop(self) -> SwerveCommand:
        """Everything at rest, brakes closed. The next plan's commands start from there, as fast as accelerations allow."""
        self.supervision.stop(self.measured)
        self.tracking.rest()
        still = SwerveCommand.stop(swerve_base(self.robot).geometry.modules, len(self.robot.input.groups["arm"]))
        return still if "leg" in self.robot.input else replace(still, brake=np.zeros(0))

    def command(self, t: float, plans: PolicyQueue) -> SwerveCommand:
        """Drive speeds for this tick; a stop once the plan has run out."""
        policy = plans.current
        assert policy is not None and self.measured is not None
        if t > policy.end:
            still = self.stop()
            self.watch(t, still.brake, np.zeros(still.brake.size))
            return still
        if "leg" in self.robot.input:
            self.supervision.await_legs(t, self.estimator.leg)
            self.supervision.guard_legs(t, self.measured.leg, self.tracking.drives.rates[self.robot.input["leg"]])
        command, legs = self.tracking.command(t, policy, self.estimator, self.supervision.open(t))
        self.watch(t, command.brake, legs)
        return command

    def watch(self, t: float, brake: Array, rate: Array) -> None:
        """See :meth:`BrakeSupervision.watch`: the last measurement under ``brake`` (n, 1 = open) and leg rates (n) [rad/s]."""
        assert self.measured is not None
        self.supervision.watch(t, self.measured, brake, rate)
