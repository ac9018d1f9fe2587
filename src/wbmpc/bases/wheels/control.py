"""Odometry and control of a mix of wheels: those of fixed wheels, with the wheel matrix at the present steering angles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.controller import PlanarController
from wbmpc.bases.planar_motion.messages import PlanarCommand, PlanarMeasurement
from wbmpc.bases.planar_motion.odometry import PlanarOdometry
from wbmpc.bases.planar_motion.wheel_errors import WheelErrors
from wbmpc.bases.wheels.model import WheelsBase, wheels_base
from wbmpc.checks import numbers
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy_queue import PolicyQueue

#: Gain [1/s] of the loop that brings measured steering angles to those of the plan.
STEERING_GAIN = 10.0
#: How far [rad] planned steering angles are from measured ones at most: steering that is held back, as by tires that slide, is where plans
#: go on from, which drive where it points. Beyond that wheels would push against each other for as long as the plan goes on.
MAX_STEER_LEAD = 0.3
#: Standard deviation [rad] of a wheel's slip over each radian that it turns.
SLIP = 0.01


class WheelsOdometry(PlanarOdometry):
    """Least-squares estimate of the motion from all wheels: driven wheels measure their rolling distance, tires have no side slip.
    ``covariance`` (3, 3) of the pose, due to slip of the wheels."""

    def __init__(self, base: WheelsBase, pose0: ArrayLike, wheels: WheelErrors | None = None) -> None:
        driven = sum(c.driven for c in base.wheel_contacts)
        tires = sum(c.roller is None for c in base.wheel_contacts)
        speeds = base.twist.shape[1]
        wheels = wheels or WheelErrors.unknown(driven, speeds)
        super().__init__(base.twist, np.zeros((driven + tires, speeds)), pose0, wheels)
        self._base, self._driven = base, driven
        self._shown = np.zeros(driven + tires)
        self._before: tuple[Array, Array] | None = None
        self.covariance: Array = np.zeros((3, 3))

    def turn(self, time: float, wheel: ArrayLike, steer: ArrayLike, yaw_rate: float | None) -> Array:
        """The pose after angles [rad] of driven wheels and of steering joints at ``time`` [s]; ``yaw_rate`` [rad/s] of a gyro."""
        w, s = (
            numbers("odometry", "wheel", wheel, self._driven),
            numbers("odometry", "steer", steer, self._base.steering),
        )
        w0, s0 = self._before or (w, s)
        self._before = (w.copy(), s.copy())
        roll, side = self._base.matrices(0.5 * (s + s0))
        speeds = self._twist.shape[1]
        rows = self.wheels.corrected(self._base.by_input(np.vstack([roll, side])))
        # rotation of the wheels without the part that steering alone causes
        self._shown = self._shown + np.concatenate([w - w0, np.zeros(len(side))]) - rows[:, speeds:] @ (s - s0)
        self._fit_to(rows[:, :speeds])
        rolled = float(np.abs(w - w0).max(initial=0.0))
        if rolled > 0.0:
            spread = self._twist @ self._fit * (SLIP * rolled)
            c, d = np.cos(self.pose[2]), np.sin(self.pose[2])
            turned = np.array([[c, -d, 0.0], [d, c, 0.0], [0.0, 0.0, 1.0]]) @ spread
            self.covariance = self.covariance + turned @ turned.T
        return self.update(time, self._shown, yaw_rate)

    def restart(self) -> None:
        """Forget the last angles, those of the steering too."""
        super().restart()
        self._before = None


class WheelsController(PlanarController):
    """The MPC's state has the **planned** steering angles, which keep its rolling rows consistent; a feedback loop removes the difference
    to the measured angles. Wheels turn as they have to where their steering is and as it really turns: one beside its steering axis
    that turned as planned would hold its steering back, by more than that can do against it."""

    odometry: WheelsOdometry

    def __init__(self, robot: RobotModel, pose: Array, period: float, lag: float = 0.0, **options: Any) -> None:
        super().__init__(robot, pose, period, lag, **options)
        steering = wheels_base(robot).steering
        self._size = robot.base.twist.shape[1] + steering
        self._moving = slice(0, self._size)
        self._steer = robot.input["steer"] if steering else slice(0, 0)
        self.planned: Array = np.zeros(steering)
        self._turning: Array = np.zeros(steering)  # rates of the steering as lagging drives have them
        self._placed = False  # whether planned angles have begun from measured ones

    @classmethod
    def make_odometry(cls, robot: RobotModel, pose: Array, wheels: WheelErrors | None = None) -> WheelsOdometry:
        """Wheel odometry of this base that starts at ``pose`` (3)."""
        return WheelsOdometry(wheels_base(robot), pose, wheels)

    def measure(self, measurement: PlanarMeasurement) -> None:
        """Take in the message of this tick. Raises :class:`InputError` for numbers that are not finite or of another length."""
        super().measure(measurement)
        if not self._placed:
            self.planned, self._placed = np.array(measurement.steer, float), True

    def state(self) -> Array:
        """Estimated base, planned steering, measured arm (nx)."""
        steer = {"steer": self.planned} if self.planned.size else {}
        return self.leveled(self.robot.state.vector({"base": self.pose, **steer, "arm": self.arm}))

    def _move(self, x: Array, u: Array, h: float) -> None:
        state, inputs = self.robot.state, self.robot.input
        x[state["base"]] = lie.se2_step(x[state["base"]], self.robot.base.twist @ u[inputs["base"]] * h)
        x[3:] += u[inputs["base"].stop :] * h

    def wheel_matrix(self) -> Array:
        """(n, m + s): rates of driven wheels by the base's input and the steering rates, at the planned steering angles."""
        return self._wheel_rows(self.planned)

    def _wheel_rows(self, steer: Array) -> Array:
        base = wheels_base(self.robot)
        rows = np.asarray(base.by_input(base.matrices(steer)[0]))
        return self.odometry.wheels.corrected(rows)

    def stop(self) -> PlanarCommand:
        super().stop()
        if self.measured is not None:
            self.planned = np.array(self.measured.steer, float) + self.lag * self._turning
        base = wheels_base(self.robot)
        driven = sum(c.driven for c in base.wheel_contacts)
        return PlanarCommand.stop(driven, len(self.robot.input.groups["arm"]), base.steering)

    def command(self, t: float, plans: PolicyQueue) -> PlanarCommand:
        """Drive speeds for this tick; a stop once the plan has run out."""
        command, n = super().command(t, plans), self.planned.size
        if command.steer.size == n:  # a stop, or nothing steers
            return command
        assert self.measured is not None
        limits, part = self.robot.limits, self._steer
        behind = self.planned - self.lag * self._turning - self.measured.steer
        moving = self.sent[self._moving].copy()
        moving[-n:] = np.clip(moving[-n:] + STEERING_GAIN * behind, limits.input_lower[part], limits.input_upper[part])
        wheel = self._wheel_rows(self.planned - behind) @ moving
        slower = max(1.0, float(np.max(np.abs(wheel) / wheels_base(self.robot).wheel_upper)))
        return PlanarCommand(wheel / slower, command.arm, moving[-n:] / slower)

    def _note(self, sent: Array) -> None:
        super()._note(sent)
        self.planned = self.planned + sent[self._steer] * self.period
        self._turning = self._turning + self._blend * (sent[self._steer] - self._turning)
        if self.measured is not None and self.measured.steer.size == self.planned.size:
            there = self.measured.steer + self.lag * self._turning
            self.planned = np.clip(self.planned, there - MAX_STEER_LEAD, there + MAX_STEER_LEAD)
        self._rates[self._steer] = self._changes[self._steer] = 0.0  # planned angles do not lag
