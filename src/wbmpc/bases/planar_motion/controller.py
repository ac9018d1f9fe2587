"""From policies to drive commands of a robot on fixed wheels, and from encoders to observations.

How much each wheel's encoder says of the way: a wheel that carries little slips where others roll.

Loads follow from masses of the robot's file, its posture and what its drives make of the commands. While wheels agree, weights of least
squares change nothing; where they contradict each other the ones with little load give way.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.planar_motion.messages import PlanarCommand, PlanarMeasurement
from wbmpc.bases.planar_motion.model import PlanarBase, planar_base
from wbmpc.bases.planar_motion.odometry import PlanarOdometry
from wbmpc.bases.planar_motion.tilt import LevelArm, TiltFilter
from wbmpc.bases.planar_motion.wheel_errors import WheelErrors
from wbmpc.checks import not_negative, numbers, positive
from wbmpc.control.direct import lag_share
from wbmpc.control.monitor import Fault, Monitor, found_by
from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.stability.robot import Support
from wbmpc.types import Observation

#: A wheel with a smaller share of the mean load counts as this; at home every foot of a file whose masses are used has more than that.
LEAST, STANDING = 0.02, 0.1


class WheelTrust:
    """Callable: weights (n) of the rows of a base's odometry, the square of their wheel's load over the mean."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, base = robot, planar_base(robot)
        nx, nu = robot.state.size, robot.input.size
        x, u, change = (ca.SX.sym(name, size) for name, size in (("x", nx), ("u", nu), ("change", nu)))
        support = Support(robot, x)
        x_rate = robot.dynamics()(x, u, ca.SX.zeros(robot.parameters.size), ca.SX.ones(robot.mode.size))
        loads = support.foot_loads(support.load(motion=(u, x_rate, change)))
        self._loads = Numeric(ca.Function("loads", [x, u, change], [ca.densify(loads)]))
        self._rows = base.feet_of_rows

    @classmethod
    def of(cls, robot: RobotModel) -> WheelTrust | None:
        """None of a robot whose wheels' loads are unknown: with fewer than three feet, or by whose masses one lifts at home."""
        base = robot.base
        if base.footprint is None or not isinstance(base, PlanarBase) or not base.feet_of_rows:
            return None
        found, rest = cls(robot), np.zeros(robot.input.size)
        shares = found.shares(robot.home, rest, rest)
        return found if np.isfinite(shares).all() and shares.min() > STANDING else None

    def shares(self, x: Array, u: Array, change: Array) -> Array:
        """Loads of all feet over their mean at a state x (nx), rates u (nu) that change by ``change`` (nu) per second."""
        loads = np.ravel(self._loads(x, u, change)[0])
        shares: Array = loads / np.mean(loads)
        return shares

    def __call__(self, x: Array, u: Array, change: Array) -> Array:
        """See the class; arguments as for :meth:`shares`."""
        return np.asarray(np.maximum(self.shares(x, u, change)[self._rows], LEAST) ** 2, float)


#: Interval [s] in which loads of wheels are computed: drives lag by more.
WEIGHED = 0.01


class PlanarController:
    """Estimation, prediction and tracking of a robot on fixed wheels at the controller's rate.

    ``pose`` (x, y, yaw) at the start; ``period`` [s] of the controller; ``lag`` [s] of the drives, first order: the plan leads the
    measured state by it; ``use_gyro``: whether the odometry has one; ``wheels``: what is known of the wheels' errors.
    ``target`` (nu): what the plan asks for; ``sent`` (nu): what of
    it the last command was, after limits; ``clamped``: whether wheels were slowed down to their limits.
    ``monitors`` of measurements find ``faults``.
    """

    def __init__(
        self, robot: RobotModel, pose: Array, period: float, lag: float = 0.0, *, use_gyro: bool = True,
        wheels: WheelErrors | None = None,
    ) -> None:  # fmt: skip
        positive("controller", period=period)
        not_negative("controller", lag=lag)
        self.robot, self.period, self.lag, self.use_gyro = robot, period, lag, use_gyro
        self.odometry = self.make_odometry(robot, pose, wheels)
        footprint = robot.base.footprint
        soft = use_gyro and footprint is not None and not footprint.even
        self.tilt: TiltFilter | None = TiltFilter(robot.inertial_unit) if soft else None
        self._level: LevelArm | None = LevelArm(robot) if soft else None
        self._moving = robot.input["base"]  # the inputs that turn wheels
        self._blend = lag_share(period, lag)
        self._rates = np.zeros(robot.input.size)  # what lagging drives make of the commands
        self._changes = np.zeros(robot.input.size)  # how fast these change
        self._trust, self._weighed = WheelTrust.of(robot), -np.inf
        self.measured: PlanarMeasurement | None = None
        self.monitors: list[Monitor[PlanarMeasurement]] = []
        self.faults: list[Fault] = []
        self.clamped = False
        self.target, self.sent = np.zeros((2, robot.input.size))

    @classmethod
    def make_odometry(cls, robot: RobotModel, pose: Array, wheels: WheelErrors | None = None) -> PlanarOdometry:
        """What finds the way of this base by its wheels, from ``pose`` (3) on."""
        return PlanarOdometry(robot.base.twist, planar_base(robot).rates, pose, wheels)

    # ------------------------------------------------------------------ estimation
    def measure(self, measurement: PlanarMeasurement) -> None:
        """Process the message of this tick. Raises :class:`InputError` for numbers that are not finite or of another length."""
        numbers("controller", "arm", measurement.arm, len(self.robot.state.groups["arm"]))
        previous, self.measured = self.measured or measurement, measurement
        self.odometry.turn(measurement.time, measurement.wheel, measurement.steer, self.turning(previous, measurement))
        if self._trust is not None and abs(measurement.time - self._weighed) > WEIGHED - 1e-9:
            self._weighed = measurement.time
            self.odometry.weigh(self._trust(self._posture(measurement), self._rates, self._changes))
        self.note_lean(previous, measurement)
        self.faults += found_by(self.monitors, measurement)

    def _posture(self, measurement: PlanarMeasurement) -> Array:
        """A state (nx) with measured joints, the base anywhere."""
        steer = {"steer": measurement.steer} if "steer" in self.robot.state else {}
        return self.robot.state.vector({**steer, "arm": measurement.arm})

    def note_lean(self, previous: PlanarMeasurement, now: PlanarMeasurement) -> None:
        """How far the base leans on its casters, where messages of the inertial unit came."""
        if self.tilt is not None and now.accel.any():
            moving = (
                self.robot.base.twist @ self._rates[self.robot.input["base"]]
            )  # encoders are too coarse for accelerations
            self.tilt.update(now.time - previous.time, now.gyro, now.accel, moving)
            (x, y, _), (ahead, left) = self.tilt.turned, self.robot.base.twist[:2, 0]
            # hubs stay where they are, and what is under them swings
            self.odometry.ahead = planar_base(self.robot).geometry.radius * float(left * x - ahead * y)

    def turning(self, previous: PlanarMeasurement, now: PlanarMeasurement) -> float | None:
        """Mean yaw rate [rad/s] of the gyro between two messages; None where the odometry takes the wheels' alone."""
        return 0.5 * float(previous.gyro[2] + now.gyro[2]) if self.use_gyro else None

    @property
    def pose(self) -> Array:
        """(x, y, yaw) of the base as the odometry has it."""
        return self.odometry.pose

    @property
    def arm(self) -> Array:
        """Measured angles of the arm [rad]."""
        assert self.measured is not None
        return self.measured.arm

    def base_pose(self) -> Array:
        """Estimated pose (7) of the base in the frame of the odometry: position [m] at the nominal height, quaternion."""
        x, y, yaw = self.pose
        height, upright = self.robot.base.body_height, lie.quaternion_about((0.0, 0.0, 1.0), yaw)
        if self.tilt is None:
            return np.array([x, y, height, *upright])
        turned = self.tilt.turned
        size = float(np.linalg.norm(turned))
        lean = lie.quaternion_about(turned / size, size) if size > 0.0 else np.array([1.0, 0.0, 0.0, 0.0])
        aside = lie.quaternion_to_rotation(upright) @ np.cross(turned, [0.0, 0.0, height])
        return np.array([x + aside[0], y + aside[1], height, *lie.quaternion_multiply(upright, lean)])

    def state(self) -> Array:
        """Estimated state (nx), of a level base: see :mod:`wbmpc.bases.planar_motion.tilt`."""
        return self.leveled(self.robot.state.vector({"base": self.pose, "arm": self.arm}))

    def leveled(self, x: Array) -> Array:
        """A state (nx) whose arm makes up for the lean of the base."""
        if self.tilt is None or self._level is None or not self.tilt.turned.any():
            return x
        return self._level(x, self.tilt.turned)

    # ------------------------------------------------------------------ prediction
    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """The state at time ``until``, by the commands that will be sent from ``t`` on, and what the drives still owe of those that
        were. The plan's clock runs ahead of the wall's by the lag: what is commanded now acts that much later."""
        x, sent = self.state(), self.sent
        # a first-order drive still moves by lag times its present rate after the last command
        self._move(x, self._rates, self.lag)
        for k in range(round((until - t) / self.period)):
            now = t + (k + 0.5) * self.period
            policy = plans.at(now)
            if policy is None:
                break
            sent, _ = self._limited(sent, policy.feedforward(now + self.lag))
            self._move(x, sent, self.period)
        return Observation(until + self.lag, x)

    def _move(self, x: Array, u: Array, h: float) -> None:
        """Integrate input rates u (nu) over h [s] into the state x (nx), in place."""
        state, inputs = self.robot.state, self.robot.input
        x[state["base"]] = lie.se2_step(x[state["base"]], self.robot.base.twist @ u[inputs["base"]] * h)
        x[state["arm"]] += u[inputs["arm"]] * h

    # ------------------------------------------------------------------ commands
    def stop(self) -> PlanarCommand:
        """Everything at rest. The next plan's commands start from there, as fast as accelerations allow."""
        self._note(np.zeros(self.robot.input.size))
        self.target, self.clamped = np.zeros(self.robot.input.size), False
        return PlanarCommand.stop(len(planar_base(self.robot).rates), len(self.robot.input.groups["arm"]))

    def command(self, t: float, plans: PolicyQueue) -> PlanarCommand:
        """Drive speeds for this tick; a stop once the plan has run out.

        The plan's inputs as they are: drives that follow speeds hold a kinematic plan without the gains of the policy, and the
        next plan starts from the measured state.
        """
        policy, inputs = plans.current, self.robot.input
        assert policy is not None
        if t > policy.end:
            return self.stop()
        self.target = policy.feedforward(t + self.lag)
        sent, self.clamped = self._limited(self.sent, self.target)
        self._note(sent)
        return PlanarCommand(self.wheel_matrix() @ sent[self._moving], sent[inputs["arm"]].copy())

    def wheel_matrix(self) -> Array:
        """(n, m): wheel rates by the inputs that turn wheels."""
        return self.odometry.wheels.corrected(planar_base(self.robot).rates)

    def _note(self, sent: Array) -> None:
        self.sent = sent
        self._changes = self._blend / self.period * (sent - self._rates)
        self._rates = self._rates + self._changes * self.period

    def _limited(self, sent: Array, u: Array) -> tuple[Array, bool]:
        """The way from the last command ``sent`` (nu) towards u (nu) as far as accelerations allow within a period, all drives by
        the same share, and with the base's speeds scaled so that every wheel keeps its limit. Wheels that are limited one by one drag
        each other. Also whether they were scaled: not on the way to their limits. What u has beyond these is no way to go: it would
        slow the arm down for as long as it is asked for."""
        base, part, rates = planar_base(self.robot), self._moving, self.wheel_matrix()
        u, too_fast = self._within_wheels(u, rates)
        step = u - sent
        steps = np.abs(np.concatenate([rates @ step[part], step]))
        maximum = np.concatenate([base.wheel_acceleration, self.robot.limits.input_rate]) * self.period
        share = max(1.0, float(np.max(steps / maximum)))
        reached, scaled = self._within_wheels(sent + step / share, rates)
        return reached, scaled or (too_fast and share == 1.0)

    def _within_wheels(self, u: Array, rates: Array) -> tuple[Array, bool]:
        """An input (nu) with the base's speeds scaled so that every wheel keeps its limit; whether they had to be."""
        excess = float(np.max(np.abs(rates @ u[self._moving]) / planar_base(self.robot).wheel_upper))
        if excess <= 1.0:
            return u, False
        scaled = u.copy()
        scaled[self._moving] /= excess
        return scaled, True
