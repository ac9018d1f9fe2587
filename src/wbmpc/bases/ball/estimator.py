"""From a ball robot's sensors to the state of its minimal model."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.ball.filter import BallFilter
from wbmpc.bases.ball.filter_state import BallGeometry, BallNoise
from wbmpc.bases.ball.filter_step import minimal_state
from wbmpc.bases.ball.joint_tracker import JointTracker
from wbmpc.bases.ball.model import BallBase, ball_base
from wbmpc.checks import covariance as checked_covariance
from wbmpc.checks import finite, numbers, positive
from wbmpc.errors import InputError
from wbmpc.kernel.step import bind
from wbmpc.model.robot import RobotModel
from wbmpc.types import POSE_AHEAD

#: A robot stands still when ball and arm are slower than this [m/s, rad/s], for so long [s].
SLOW, STANDS = 0.05, 2.0
#: So long [s] the past is kept for poses that come late; older ones do not count.
HISTORY = 0.6


class BallEstimator:
    """The state (2 nq) of a ball robot's minimal model from encoders and inertial unit, without anything of the simulator.

    ``start`` (2 nq): where the robot stands when it is switched on, at rest; its position and heading define the world.
    ``balance`` [rad]: how well the lean at which the model balances is known. The first time that the robot has stood still for
    :data:`STANDS`, its lean is taken to be that one. (10 mm of the robot's center of mass are 30 mrad; an accelerometer
    bias of 0.01 m/s² is 1 mrad: it helps only against a bias that was not calibrated, or with a model that was.)
    """

    def __init__(
        self, robot: RobotModel, start: ArrayLike, noise: BallNoise | None = None, balance: float = 0.03
    ) -> None:
        if not isinstance(robot.base, BallBase):
            raise InputError(f"{robot.description.name}: this estimator needs a ball base")
        base, self.noise = robot.base, noise or BallNoise()
        positive("ball robot's estimator", balance=balance)
        x = numbers("ball robot's estimator", "start", start, 2 * base.nq)
        geometry = BallGeometry(base.radius, base.wheel_torque_map().T, base.mount)
        self.filter = BallFilter(geometry, x[0:2], lie.euler_zyx_to_rotation(*x[2:5]), self.noise, base.base.imu)
        n = self.noise
        speed = robot.limits.state_upper[robot.state["arm_velocity"]]
        self.arm = JointTracker(x[5 : base.nq], n.encoder, n.age, n.jitter, speed=speed)
        self._robot, self._balance, self._balanced = robot, balance, False
        self._stood = 0.0
        self._time: float | None = None
        m = base.nq - 5
        own = {"yaw": np.array([float(x[2])]), "out": np.zeros(2 * base.nq)}
        joints = {"angle": self.arm.arrays["angle"], "joint_rate": self.arm.arrays["rate"]}
        of_filter = {name: self.filter.arrays[name] for name in ("x", "rate", "mount")}
        self._minimal, self._out = bind(minimal_state, of_filter | joints | own, m=m), own["out"]
        self._places: deque[tuple[float, Array]] = deque()

    def update(self, time: float, wheel: Array, arm: Array, gyro: Array, accel: Array, turning: float = 0.0) -> Array:
        """The state (2 nq) at ``time`` [s], at which the sensors were read; ``turning`` [N m]: what the wheels turned the ball
        with about the vertical. Messages that are not newer than the last one are ignored.

        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be; such a message counts as not given."""
        finite("ball robot's estimator", time=time)
        angles = numbers("ball robot's estimator", "arm", arm, self.arm.size)
        interval = 0.0 if self._time is None else max(time - self._time, 0.0)
        self.filter.process(interval, wheel, gyro, accel, turning)
        if self._time is not None and interval == 0.0:
            return self.state
        self._time = time
        if interval > 0.0:
            self.arm.take_in(interval, angles)
        state = self.state
        if not self._balanced and interval > 0.0 and self._detect_balance(interval, state):
            state = self.state
        self._places.append((time, state[:3].copy()))
        while self._places[0][0] < time - HISTORY:
            self._places.popleft()
        return state

    def correct(self, time: float, pose: ArrayLike, covariance: ArrayLike) -> Array:
        """Take in another source's pose (x, y, yaw) of the base at ``time`` [s] with its covariance (3, 3), as of the update that
        is nearest to it; returns the state (2 nq) now. A pose that is older than :data:`HISTORY`, or of a future that no message
        has come from (:data:`wbmpc.types.POSE_AHEAD`), does not count.

        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be; nothing is taken in then."""
        finite("ball robot's estimator", time=time)
        pose = numbers("ball robot's estimator", "pose", pose, 3)
        covariance = checked_covariance("ball robot's estimator", covariance)
        if self._time is None or not self._time - HISTORY <= time <= self._time + POSE_AHEAD:
            return self.state
        then = min(self._places, key=lambda place: abs(place[0] - time))[1]
        wrong = pose - then
        wrong[2] = lie.wrapped(wrong[2])
        previous = self.state[:3].copy()
        self.filter.correct_pose(wrong, covariance)
        state = self.state
        for _, place in self._places:  # what was wrong now was wrong then
            place += state[:3] - previous
        return state

    def _detect_balance(self, interval: float, state: Array) -> bool:
        """Once: after standing still, the lean is that of the model's equilibrium for the present arm angles. Whether it was now."""
        x, y, _, _, _, *arm = state[5 + self.arm.size :].tolist()
        if abs(x) > SLOW or abs(y) > SLOW or max(map(abs, arm), default=0.0) > SLOW:
            self._stood = 0.0
            return False
        self._stood += interval
        if self._stood >= STANDS:
            pitch, roll = ball_base(self._robot).numeric.equilibrium(self.arm.angle)[0][3:5]
            self.filter.correct_lean(lie.euler_zyx_to_rotation(0.0, pitch, roll)[2], self._balance)
            self._balanced = True
        return self._balanced

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong with the last readings: the filter's ``faults`` (the inertial unit's jumps only while no arm that is flung
        explains them), and joints whose encoder ``jumps``."""
        if not (self.filter.faults or self.arm.any_jumped):
            return ()
        names, jumped = self._robot.state.groups["arm"], self.arm.jumped
        own = tuple(f for f in self.filter.faults if f != "imu jumps" or not self.arm.flung)
        return own + tuple(f"{names[i]} jumps" for i in np.flatnonzero(jumped))

    @property
    def state(self) -> Array:
        """The last estimate (2 nq), yaw not wrapped."""
        self._minimal()
        return self._out.copy()
