"""From encoders, gyro and global poses to the state of a swerve robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.swerve.drives import ArmDrives, DriveModel
from wbmpc.bases.swerve.fused_odometry import FusedOdometry
from wbmpc.bases.swerve.inertial_velocity import InertialVelocity
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.odometry_filter import OdometryNoise
from wbmpc.bases.swerve.slipping_wheels import SlippingWheels
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry
from wbmpc.model.robot import RobotModel

#: Weight in the odometry of a wheel that slips.
SLIP_WEIGHT = 1e-3
#: A wheel whose zero and radius are so many times less certain than those of the best known wheel counts by the ratio of their variances.
UNKNOWN = 10.0


def known_weights(wheels: WheelCalibration) -> Array | None:
    """Weights (n) in the odometry by what is known of the ``wheels``; None: all about as well. (One that hung in the air when it was
    calibrated hangs in the air later, too: it says what it was commanded, and not where the base goes.)"""
    variance = np.maximum(np.sum(np.square(wheels.std), axis=0), 1e-12)
    share = variance.min() / variance
    return np.where(share < UNKNOWN**-2, share, 1.0) if share.min() < UNKNOWN**-2 else None


@dataclass(frozen=True)
class EstimatorSettings:
    """``calibration``: what is known of the wheels (None: nothing); ``noise`` of wheels and gyro; ``use_gyro``: whether the odometry
    has one; ``reject_slipping_wheels``: whether it gives little weight to wheels whose way the accelerometer (:class:`InertialVelocity`) or,
    without one, the others contradict (:class:`SlippingWheels`);
    ``arm_offset`` (m) [rad] of the arm's encoders (None: 0)."""

    calibration: WheelCalibration | None = None
    arm_offset: Array | None = None
    noise: OdometryNoise | None = None
    use_gyro: bool = True
    reject_slipping_wheels: bool = True


class SwerveEstimator:
    """State of a swerve robot that starts at ``pose`` (x, y, yaw). While it stands, the gyro's bias is found.

    ``odometry`` of wheels and gyro; ``wheels_alone``: of the wheels. ``drives`` and ``arm_drives`` say how base and arm move between
    messages.
    """

    def __init__(
        self, robot: RobotModel, pose: Array, settings: EstimatorSettings, drives: DriveModel, arm_drives: ArmDrives
    ) -> None:
        self.robot, self.use_gyro = robot, settings.use_gyro
        self._drives, self._arm_drives = drives, arm_drives
        geometry = swerve_base(robot).geometry
        wheels = self.calibration = settings.calibration or WheelCalibration.unknown(geometry)
        self._known = known_weights(wheels)
        self.odometry = FusedOdometry(geometry, pose, calibration=wheels, noise=settings.noise)
        self.wheels_alone = WheelOdometry(
            geometry, pose, wheel_radius=wheels.wheel_radius, leg_offset=wheels.leg_offset,
            steer_offset=wheels.steer_offset,
        )  # fmt: skip
        self._odd = SlippingWheels(geometry, self.wheels_alone) if settings.reject_slipping_wheels else None
        self._inertial = (
            None if self._odd is None else InertialVelocity(self._odd.seen, robot.inertial_unit, self._known)
        )
        self._coasting: Array | None = None  # velocity (2) [m/s] by the inertial unit, while wheels slip
        self._arm_offset = settings.arm_offset
        self.measured: SwerveMeasurement | None = None

    def process(self, measurement: SwerveMeasurement) -> None:
        """Take in a message."""
        previous, self.measured = self.measured or measurement, measurement
        m = measurement
        h = self.interval(previous, m)
        turning = self.mean_rate(previous, m, h) if self.use_gyro else None
        sample = self._sample = self.wheels_alone.checked(m.leg, m.steer, m.wheel)
        self.wheels_alone.advance(sample)
        weights, known = self._wheel_weights(h, sample[0], turning), self._known
        if known is not None:
            weights = known if weights is None else weights * known
        self.odometry.advance(m.time, sample, turning, weights=weights, velocity=self._coasting)
        if m.place is not None:
            self.odometry.correct(m.place.time, m.place.pose, m.place.covariance)

    def interval(self, previous: SwerveMeasurement, now: SwerveMeasurement) -> float:
        """Time [s] from one message to the next."""
        return now.time - previous.time

    def mean_rate(self, previous: SwerveMeasurement, now: SwerveMeasurement, h: float) -> float | None:
        """The gyro's mean yaw rate [rad/s] from one message to the next, h [s] later; None if it says nothing."""
        return 0.5 * float(previous.gyro[2] + now.gyro[2])

    def slipping(self) -> NDArray[np.bool_] | None:
        """Wheels (n) that are known to slip, as a plan lets them; None: none."""
        return None

    def _wheel_weights(self, h: float, leg: Array, turning: float | None) -> Array | None:
        """Weights (n) of the wheels in the odometry over h [s] to a message; None: all count in full. ``leg`` (n) [rad], ``turning``
        [rad/s] of the gyro."""
        known = self.slipping()
        odd, inertial = self._odd, self._inertial
        if odd is None or inertial is None:
            return self._weights()
        rate = None if turning is None else turning - self.odometry.gyro_bias
        odd.update(h, leg, None if rate is None else rate * h, self._silent(known))
        assert self.measured is not None
        self._coasting = None
        if rate is None or not inertial.update(
            h, self.measured.gyro, self.measured.accel, rate, known, not odd.contradictory
        ):
            return self._weights()
        if not odd.contradictory and (known is None or not known.any()):
            return None
        self._coasting = inertial.velocity
        return np.maximum(inertial.weights, SLIP_WEIGHT)

    def _silent(self, slips: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        """Wheels (n) that have no say about others: those that slip, and those that do not carry the base."""
        if self._known is None:
            return slips
        return self._known < 0.5 if slips is None else slips | (self._known < 0.5)

    def _weights(self) -> Array | None:
        """The same where there is no accelerometer."""
        slipping = self.slipping()
        known = [False] * swerve_base(self.robot).geometry.modules if slipping is None else slipping.tolist()
        odd = known
        if self._odd is not None:
            odd = [k or left > 0.0 for k, left in zip(known, self._odd.odd.tolist(), strict=True)]
        # one sound wheel alone does not determine the motion: then what is known counts, if that leaves two
        for slips in (odd, known):
            if any(slips) and slips.count(False) > 1:
                return np.where(slips, SLIP_WEIGHT, 1.0)
        return None

    @property
    def slip(self) -> float | None:
        """Speed [m/s] of the fastest wheel against the base as the inertial unit has it; None without one."""
        return None if self._inertial is None else self._inertial.slip

    @property
    def pose(self) -> Array:
        """(x, y, yaw) of the base that is controlled."""
        return self.odometry.pose

    @property
    def arm(self) -> Array:
        """Measured angles (m) of the arm less their zeros."""
        assert self.measured is not None
        read = self.measured.arm
        return read if self._arm_offset is None else read - self._arm_offset

    @property
    def leg(self) -> Array:
        """Measured leg angles less their zeros (empty for fixed legs)."""
        assert self.measured is not None
        return self.measured.leg - self.calibration.leg_offset if self.measured.leg.size else self.measured.leg

    @property
    def hinge_angles(self) -> Array:
        """As ``leg``; zeros (n) for fixed legs."""
        assert self.measured is not None
        return self._sample[0]

    @property
    def steer(self) -> Array:
        """Measured steering angles (n) less their zeros."""
        assert self.measured is not None
        return self._sample[1]

    def state(self) -> Array:
        """Estimated state (nx), with the measured steering angles."""
        m = self.measured
        assert m is not None
        layout, x = self.robot.state, np.zeros(self.robot.state.size)
        x[layout["base"]], x[layout["steer"]], x[layout["arm"]] = self.pose, self.steer, self.arm
        for group, values in (("leg", self.leg), ("wheel", m.wheel)):
            if group in layout:
                x[layout[group]] = values
        return x

    def base_pose(self) -> Array:
        """Estimated pose (7) of the base in the frame of the odometry: position [m] at the nominal height, quaternion."""
        x, y, yaw = self.pose
        return np.array([x, y, self.robot.base.body_height, *lie.quaternion_about((0.0, 0.0, 1.0), yaw)])
