"""From a ball robot's sensors to the state of its minimal model."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc import lie
from wbmpc.bases.ball.filter import BallFilter
from wbmpc.bases.ball.filter_state import BallGeometry, BallNoise
from wbmpc.bases.ball.gap import GAP
from wbmpc.bases.ball.model import BallBase
from wbmpc.checks import covariance as checked_covariance
from wbmpc.checks import finite, not_negative, numbers, positive, positive_time, scales
from wbmpc.errors import InputError
from wbmpc.estimation.fused_odometry import AHEAD
from wbmpc.model.robot import RobotModel

Array = NDArray[np.float64]
#: A robot stands still when ball and arm are slower than this [m/s, rad/s], for so long [s].
SLOW, STANDS = 0.05, 2.0
#: So long [s] the past is kept for poses that come late; older ones do not count.
HISTORY = 0.6
#: A joint's reading jumps if it is farther from the last one that counted, and from where the joint was going, than this often
#: its speed limit allows, and this [rad] more: an arm that is flung by a hit moves faster than its drives can (0.27 rad from one
#: message to the next, through its stops, under 900 N).
SPEED_FACTOR, SPEED_REST = 4.0, 0.2
#: Two steps [rad] in a row of this size, the same way, are a motion.
FLUNG = 0.03
#: An arm with a joint that is faster than this times its speed limit is flung, and turns the base with it: the inertial unit
#: is right then, however far from the message before. (Seen: 34 rad/s where the limit is 4, and 2 rad/s of yaw in 2.5 ms.)
FASTER = 2.0
#: Rates are in doubt after a reading this far [rad] from the expected one, and farther by what its age may err by [s].
SURPRISE, LATE = 1e-3, 2e-3


class JointTracker:
    """Angles (n) [rad] and rates (n) [rad/s] of joints from encoders alone: a Kalman filter of each joint, whose
    acceleration is white noise of density ``acceleration`` [rad/s²/√Hz]. Readings are ``age`` ± ``jitter`` [s] old.

    ``reading`` (n): the last ones that counted; a joint ``jumped`` (n) if its own did not: beyond what joints with a limit of their
    ``speed`` (n) [rad/s] can do in the time since, or with the jump before it: nearer to that than to where the joint was. So a
    step that is never undone never counts, however far the joint could have moved meanwhile; one that is undone, and a joint
    of which no message came for a while, count by their distance. Those of ``surprised`` (n) are far from what was expected:
    their rates are in doubt."""

    def __init__(
        self, angles: ArrayLike, encoder: float, age: float, jitter: float, acceleration: float = 3.0,
        speed: ArrayLike = np.inf,
    ) -> None:  # fmt: skip
        who = "joint tracker"
        not_negative(who, encoder=encoder, age=age, jitter=jitter)
        positive(who, acceleration=acceleration)
        self.angle = numbers(who, "angles", angles, np.size(angles)).copy()
        self.rate = np.zeros_like(self.angle)
        self._encoder, self._age, self._jitter, self._density = encoder, age, jitter, acceleration
        one = np.ones_like(self.angle)
        self._aa, self._ar, self._rr = 1e-2 * one, 0.0 * one, 1e-2 * one
        self.jumped = self.surprised = np.zeros(one.shape, dtype=bool)
        self.reading: Array | None = None
        self._uncounted = np.zeros(one.shape)  # [s] since a reading counted
        self._raw, self._step = (
            self.angle.copy(),
            np.zeros(one.shape),
        )  # the last reading, and its distance from the one before
        self._speed = scales(who, "speed", speed)
        self._fastest = SPEED_FACTOR * self._speed

    @property
    def flung(self) -> bool:
        """Whether something moves a joint faster than its drive can (:data:`FASTER`)."""
        return bool((np.abs(self.rate) > FASTER * self._speed).any())

    def update(self, interval: float, reading: Array) -> None:
        """``interval`` [s] since the ``reading`` (n) [rad] before. Raises :class:`InputError` for numbers that cannot be."""
        positive_time("joint tracker", interval)
        reading = numbers("joint tracker", "reading", reading, self.angle.size)
        if interval > GAP:
            self._restart(reading)
            return
        h, s = interval, self._density**2
        aa = self._aa + 2.0 * h * self._ar + h * h * self._rr + s * h**3 / 3.0
        ar, rr = self._ar + h * self._rr + s * h * h / 2.0, self._rr + s * h
        expected = self.angle + h * self.rate
        late = self._age * self.rate
        variance = aa + self._encoder**2 + (self._jitter * self.rate) ** 2
        wrong = reading + late - expected
        self.surprised = np.abs(wrong) > SURPRISE + LATE * np.abs(self.rate)
        if self.reading is None:  # the start is not known as well as what follows
            self.reading, self._raw = reading.copy(), reading.copy()
        # far from the motion that there was as well, and not on its way: an arm that is flung goes on
        off = np.minimum(np.abs(reading - self.reading), np.abs(wrong))
        self._uncounted = np.where(self.jumped, self._uncounted, 0.0) + h
        before, self._step = self._step, reading - self._raw
        self._raw = reading.copy()
        going = (np.minimum(np.abs(before), np.abs(self._step)) > FLUNG) & (before * self._step > 0.0)
        stays = self.jumped & (np.abs(self._step) < off)
        self.jumped = (stays | (off > (self._uncounted + LATE) * self._fastest + SPEED_REST)) & ~going
        self.reading = np.where(self.jumped, self.reading, reading)
        gain, gain_rate = (np.where(self.jumped, 0.0, share / variance) for share in (aa, ar))
        self.angle, self.rate = expected + gain * wrong, self.rate + gain_rate * wrong
        self._aa, self._ar, self._rr = (1.0 - gain) * aa, (1.0 - gain) * ar, rr - gain_rate * ar

    def _restart(self, reading: Array) -> None:
        """After a gap joints are where they are read, and nobody knows how fast."""
        one = np.ones_like(self.angle)
        self.angle, self.rate, self.reading, self._raw = reading.copy(), 0.0 * one, reading.copy(), reading.copy()
        self._aa, self._ar, self._rr = 1e-2 * one, 0.0 * one, one
        self.jumped, self.surprised = np.zeros(one.shape, dtype=bool), np.ones(one.shape, dtype=bool)
        self._uncounted, self._step = 0.0 * one, 0.0 * one


class BallEstimator:
    """The state (2 nq) of a ball robot's minimal model from encoders and inertial unit, without anything of the simulator.

    ``start`` (2 nq): where the robot stands when it is switched on, at rest; its position and heading define the world.
    ``balance`` [rad]: how well the lean at which the model balances is known. The first time that the robot has stood still for
    :data:`STANDS`, its lean is taken to be that one. (10 mm of the robot's centre of mass are 30 mrad; an accelerometer
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
        self._yaw = float(x[2])
        self._places: deque[tuple[float, Array]] = deque()

    def update(self, time: float, wheel: Array, arm: Array, gyro: Array, accel: Array, turning: float = 0.0) -> Array:
        """The state (2 nq) at ``time`` [s], at which the sensors were read; ``turning`` [N m]: what the wheels turned the ball
        with about the vertical. Messages that are not newer than the last one are ignored.

        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be; such a message counts as not given."""
        finite("ball robot's estimator", time=time)
        angles = numbers("ball robot's estimator", "arm", arm, self.arm.angle.size)
        interval = 0.0 if self._time is None else max(time - self._time, 0.0)
        self.filter.update(interval, wheel, gyro, accel, turning)
        if self._time is not None and interval == 0.0:
            return self.state
        self._time = time
        if interval > 0.0:
            self.arm.update(interval, angles)
            self._detect_balance(interval)
        state = self.state
        self._places.append((time, state[:3].copy()))
        while self._places[0][0] < time - HISTORY:
            self._places.popleft()
        return state

    def correct(self, time: float, pose: ArrayLike, covariance: ArrayLike) -> Array:
        """Take in another source's pose (x, y, yaw) of the base at ``time`` [s] with its covariance (3, 3), as of the update that
        is nearest to it; returns the state (2 nq) now. A pose that is older than :data:`HISTORY`, or of a future that no message
        has come from (:data:`wbmpc.estimation.fused_odometry.AHEAD`), does not count.

        Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be; nothing is taken in then."""
        finite("ball robot's estimator", time=time)
        pose = numbers("ball robot's estimator", "pose", pose, 3)
        covariance = checked_covariance("ball robot's estimator", covariance)
        if self._time is None or not self._time - HISTORY <= time <= self._time + AHEAD:
            return self.state
        then = min(self._places, key=lambda place: abs(place[0] - time))[1]
        wrong = pose - then
        wrong[2] = np.remainder(wrong[2] + np.pi, 2.0 * np.pi) - np.pi
        before = self.state[:3].copy()
        self.filter.know_place(wrong, covariance)
        state = self.state
        for _, place in self._places:  # what was wrong now was wrong then
            place += state[:3] - before
        return state

    def _detect_balance(self, interval: float) -> None:
        """Once: after standing still, the lean is that of the model's equilibrium for the present arm angles."""
        f = self.filter
        if self._balanced:
            return
        if np.abs(f.ball_velocity[:2]).max() > SLOW or np.abs(self.arm.rate).max(initial=0.0) > SLOW:
            self._stood = 0.0
            return
        self._stood += interval
        if self._stood >= STANDS:
            pitch, roll = self._robot.base.numeric.equilibrium(self.arm.angle)[0][3:5]
            f.know_lean(lie.euler_zyx_to_rotation(0.0, pitch, roll)[2], self._balance)
            self._balanced = True

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong with the last readings: the filter's ``faults`` (the inertial unit's jumps only while no arm that is flung
        explains them), and joints whose encoder ``jumps``."""
        names = self._robot.state.groups["arm"]
        own = tuple(f for f in self.filter.faults if f != "imu jumps" or not self.arm.flung)
        return own + tuple(f"{names[i]} jumps" for i in np.flatnonzero(self.arm.jumped))

    @property
    def state(self) -> Array:
        """The last estimate (2 nq), yaw not wrapped."""
        f = self.filter
        yaw, pitch, roll = lie.rotation_to_euler_zyx(f.state.rotation)
        self._yaw += float(np.remainder(yaw - self._yaw + np.pi, 2.0 * np.pi) - np.pi)
        rates = lie.euler_zyx_rates(pitch, roll, f.rate)
        x, y = f.state.position[:2]
        vx, vy = f.ball_velocity[:2]
        return np.array([x, y, self._yaw, pitch, roll, *self.arm.angle, vx, vy, *rates, *self.arm.rate])
