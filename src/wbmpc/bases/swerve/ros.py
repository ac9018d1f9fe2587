"""A swerve robot on a bus: speeds out, odometry from wheels and gyro, brakes and legs."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.common.ros import references_of
from wbmpc.bases.swerve.brake_control import BRAKE_DELAY, BrakeControl
from wbmpc.bases.swerve.brake_monitor import BrakeFault, BrakeMonitor, SwerveReadings
from wbmpc.bases.swerve.brake_supervision import SupervisionSettings, brake_monitor
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_mpc, swerve_problem
from wbmpc.bases.swerve.estimator import EstimatorSettings, SwerveEstimator
from wbmpc.bases.swerve.messages import SwerveCommand, SwerveMeasurement
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.ros_leg_control import LegControl
from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.bases.swerve.steering_planner import SteeringGuess
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import rolling_inverse_kinematics
from wbmpc.ocp import OptimalControlProblem, Reference
from wbmpc.ros2.base_adapter import (
    BaseAdapter,
    BaseCommands,
    Estimate,
    Fix,
    Groups,
    PendingChanges,
    obstacles_of,
    planar_estimate,
)
from wbmpc.ros2.convert import nearest_angle
from wbmpc.ros2.goals import Planner, Task
from wbmpc.ros2.joints import AT_ONCE, Inertial, JointSample, OnBus, Series, Waited, by_arrivals
from wbmpc.ros2.settings import drive_groups
from wbmpc.solver import Trajectory

if TYPE_CHECKING:
    from wbmpc.ros2.control import ControlNode

#: The monitor of brakes takes so many ticks at once at most: 10 s of them.
BACKLOG = 1000
#: Speed of legs in a guess [rad/s]; wheels point along a leg's circle within this [rad].
SWING, STRAIGHT = 0.3, 0.03

#: Angles of legs that do not move.
_NO_LEGS = np.zeros(0)


@dataclass(frozen=True)
class BusMeasurement(OnBus, SwerveMeasurement):
    """Of a bus."""


class BusEstimator(SwerveEstimator):
    """On a bus: another localization's poses come from ``fix``, and clocks restart. ``seen``: the newest measurement with the pose
    that belongs to it, for other threads; ``placed``: whether some pose has said where the robot is."""

    seen: tuple[SwerveMeasurement, Array] | None = None
    fix: Callable[[], Fix | None] | None = None
    placed = False
    _origin: float | None = None  # of the last measurement
    _series: Series | None = None
    _at_once = False

    def __init__(self, *args: Any, **keys: Any) -> None:
        super().__init__(*args, **keys)
        self._waited = Waited()

    def process(self, measurement: SwerveMeasurement) -> None:
        """Take in the encoders of this tick, and another localization's pose if there is a new one."""
        self._follow_series(measurement)
        self._follow_clock(measurement)
        super().process(measurement)
        fix = self.fix() if self.fix is not None else None
        if fix is not None:
            self.correct(*fix)
        self.seen = measurement, self.odometry.pose

    def _follow_clock(self, measurement: SwerveMeasurement) -> None:
        """The runner's clock restarts with each run, and the estimate goes on."""
        origin = getattr(measurement, "origin", 0.0)
        if self._origin is not None and origin != self._origin:
            self.odometry.move_clock(self._origin - origin)
        self._origin = origin
        if measurement.time < self.odometry.time:  # the bus's own time went back
            self.odometry.bridge(measurement.time)

    def _follow_series(self, measurement: SwerveMeasurement) -> None:
        """Encoders that restart move nothing; a simulated robot that restarts is where its odometry begins."""
        series, known = getattr(measurement, "series", None), self._series
        self._series = series
        if series == known or series is None or known is None:
            return
        self.measured = None
        self.wheels_alone.restart()
        self.odometry.restart_encoders()
        if series.simulations != known.simulations:
            self.odometry.place(np.zeros(3))
        self.placed = False  # the next pose of another localization says where it is

    def interval(self, previous: SwerveMeasurement, now: SwerveMeasurement) -> float:
        """By their arrivals; by their stamps where the second message has waited: then the first one was so much earlier."""
        self._at_once, arrivals = False, super().interval(previous, now)
        if previous is now or not (isinstance(previous, BusMeasurement) and isinstance(now, BusMeasurement)):
            return arrivals
        arrivals, stamps = now.time + now.origin - previous.time - previous.origin, now.stamp - previous.stamp
        self._at_once = arrivals < AT_ONCE * stamps
        passed = self._waited.interval(arrivals, stamps)
        if passed != arrivals:
            self.odometry.move_clock(arrivals - passed)
        return passed

    def mean_rate(self, previous: SwerveMeasurement, now: SwerveMeasurement, h: float) -> float | None:
        """As the inertial unit's messages between the two say."""
        if not (isinstance(previous, BusMeasurement) and isinstance(now, BusMeasurement)):
            return None
        return by_arrivals(now.turning, now.stamp - previous.stamp, h)

    def _wheel_weights(self, h: float, leg: Array, turning: float | None) -> Array | None:
        """As usual; over hardly any time no speed shows which wheels slip, and all count."""
        if not self._at_once:
            return super()._wheel_weights(h, leg, turning)
        self._coasting = None
        return None

    def carry_on(self, other: BusEstimator) -> None:
        """Go on with what another one has estimated."""
        self.seen, self.odometry = other.seen, other.odometry
        self.placed, self._origin, self._series = other.placed, other._origin, other._series
        self._waited = other._waited

    def correct(self, t: float, pose: Array, covariance: Array) -> None:
        """A pose without a covariance is exact; the first one says where the robot is."""
        exact = not covariance.any()
        if self.placed and not exact:
            self.odometry.correct(t, pose, covariance)
            return
        self.placed = True
        place = [pose[0], pose[1], nearest_angle(pose[2], self.odometry.pose[2])]
        self.odometry.place(place, None if exact else covariance)


class DeferredMonitor:
    """Keeps the ``ticks`` of a brake monitor for the node's own thread: NumPy's searches let the interpreter go, which a tick of the
    controller does not."""

    def __init__(self, monitor: BrakeMonitor) -> None:
        self.monitor = monitor
        self.ticks: deque[SwerveReadings] = deque(maxlen=BACKLOG)

    @property
    def real(self) -> list[BrakeFault]:
        return self.monitor.real

    def update(self, readings: SwerveReadings, /) -> list[BrakeFault]:
        """Nothing is found yet."""
        self.ticks.append(readings)
        return []

    def restart_clock(self) -> None:
        self.monitor.restart_clock()

    def judged(self) -> Iterator[BrakeFault]:
        """What the monitor finds in the ticks that were kept."""
        while self.ticks:
            yield from self.monitor.update(self.ticks.popleft())


class BusSwerveController(SwerveController):
    """A swerve robot's controller on a bus. ``to_hold``: until when [s] legs are held, the newest for the planner, kept for the
    node's own thread, to which commanded brakes belong."""

    Estimator = BusEstimator
    estimator: BusEstimator

    def __init__(
        self, robot: RobotModel, pose: Array, period: float, brakes: BrakeControl | None, *,
        tracking: TrackingSettings | None = None, estimation: EstimatorSettings | None = None,
        monitor: BrakeMonitor | None = None, guard: bool = True,
    ) -> None:  # fmt: skip
        self.to_hold: deque[Array] = deque(maxlen=1)
        monitor = monitor or brake_monitor(robot)
        self.deferred = None if monitor is None else DeferredMonitor(monitor)
        settings = SupervisionSettings(guard, self.deferred, hold=lambda until: self.to_hold.append(until.copy()))
        super().__init__(robot, pose, period, brakes, tracking=tracking, estimation=estimation, supervision=settings)
        self._alone = threading.Lock()  # a tick may still run while the node's thread takes over

    def measure(self, measurement: SwerveMeasurement) -> None:
        with self._alone:
            super().measure(measurement)

    def carry_on(self, other: BusSwerveController) -> None:
        """Go on with what another controller has estimated."""
        self.estimator.carry_on(other.estimator)
        self._alone = other._alone


class SwerveRosAdapter(BaseAdapter):
    """See :class:`wbmpc.ros2.base_adapter.BaseAdapter`. ``brakes`` of a run and ``legs`` (n) [rad], where they are to go (None: where they
    are)."""

    settings: SwerveRosSettings
    watches = "brakes"
    controller: BusSwerveController
    brakes: BrakeControl | None

    def __init__(self, robot: RobotModel, settings: SwerveRosSettings, period: float) -> None:
        self.robot, self.settings, self.period = robot, settings, period
        self.planner = Planner(robot, settings.speeds, settings.goals)
        self._steering = SteeringGuess(robot, self._preview)
        self.pending = PendingChanges(self._steering)
        self.obstacles = obstacles_of(settings)
        self.mpc = swerve_mpc(robot, settings.mpc, settings.cost, self.pending, obstacles=self.obstacles, guarded=True)
        self._twists: Reference | None = None
        self._has_imu = False
        self._rest = {g: np.zeros(len(names)) for g, names in drive_groups(robot).items()}
        self.brakes = self._new_brakes()
        self.controller = self._new_controller(np.zeros(3))
        self.legs: Array | None = None  # where the legs are to go [rad]
        robot.pose(robot.home)  # builds the function: not in a tick

    def _new_brakes(self) -> BrakeControl | None:
        """All closed."""
        has = "brake" in self.robot.mode
        return BrakeControl(self.robot, delay=BRAKE_DELAY, changed=self.pending.schedule) if has else None

    def _new_controller(self, pose: Array) -> BusSwerveController:
        s = self.settings
        gyro = s.use_gyro and self._has_imu
        controller = BusSwerveController(
            self.robot, pose, self.period, self.brakes, tracking=TrackingSettings(lag=s.actuator_time_constant),
            estimation=EstimatorSettings(use_gyro=gyro), monitor=brake_monitor(self.robot, s.bus_name), guard=s.leg_guard,
        )  # fmt: skip
        controller.estimator.fix = self.fix
        return controller

    def _preview(self, times: Array, pose: Array) -> Array:
        assert self._twists is not None
        twists = self._twists
        columns = [np.interp(times, twists.times, v) for v in twists.values[:, self.robot.input["base"]].T]
        return np.stack(columns, axis=1)

    @property
    def faults(self) -> list[str]:
        """Brakes that do not answer, until their next command, or until they do after all."""
        seen = self.snapshot()
        if self.brakes is None or seen is None:
            return []
        return [str(fault) for fault in self.brakes.doubted(seen[0])]

    def inspect(self) -> None:
        """Judge the brakes by the ticks since the last update; the plan counts with what is found."""
        controller = self.controller  # another thread begins the next run with another one
        if controller.deferred is None or self.brakes is None:
            return
        while controller.to_hold:
            self.brakes.hold(controller.to_hold.popleft())
        for fault in controller.deferred.judged():
            controller.supervision.note(fault)
            self.brakes.accept(fault)

    def problem(self, cost: SwerveCost) -> OptimalControlProblem:
        """The controller's problem with other weights."""
        return swerve_problem(self.robot, self.settings.mpc, cost, accelerations=True)

    def base_commands(self, control: ControlNode) -> BaseCommands:
        """To legs with brakes."""
        return BaseCommands() if self.brakes is None else LegControl(control, self)

    # ------------------------------------------------------------------ commands
    def rest(self) -> Groups:
        """Everything at rest, brakes closed."""
        return self._rest

    def groups(self, command: SwerveCommand) -> Groups:
        return {g: getattr(command, g) for g in self._rest}

    # ------------------------------------------------------------------ states
    def measurement(
        self, now: float, at: float, sample: JointSample, imu: Inertial | None, origin: float = 0.0
    ) -> BusMeasurement:
        """Joint states and the inertial unit, read at ``at`` [s] of the runner's clock, whose zero is at ``origin`` [s]."""
        self._has_imu, groups = imu is not None, {"leg": _NO_LEGS, **sample.groups}
        if imu is None:
            return BusMeasurement(at, **groups, origin=origin, series=sample.series, stamp=sample.stamp)  # type: ignore[arg-type]
        turning = None if imu.turning is None else float(imu.turning[2])
        return BusMeasurement(
            at, **groups, gyro=imu.gyro, accel=imu.accel, turning=turning, origin=origin,  # type: ignore[arg-type]
            series=sample.series, stamp=sample.stamp,
        )  # fmt: skip

    def stand(self, m: SwerveMeasurement) -> None:
        """Follow the wheels, and the gyro's bias, while the drives are not commanded."""
        controller = self.controller
        controller.estimator.use_gyro = self.settings.use_gyro and self._has_imu
        controller.estimator.fix = self.fix
        controller.measure(m)

    def snapshot(self) -> tuple[float, Array] | None:
        """Time [s] of the runner's clock and the state (nx) estimated for it; from any thread. None before the first."""
        if self.controller.estimator.seen is None:
            return None
        m, pose = self.controller.estimator.seen
        parts = {"base": pose, "leg": m.leg, "steer": m.steer, "wheel": m.wheel, "arm": m.arm}
        return self.on_runners_clock(m.time + getattr(m, "origin", 0.0)), self.robot.state.vector(
            {g: parts[g] for g in self.robot.state.groups}
        )

    def begin(self, x: Array) -> None:
        """A new run: the odometry goes on, the runner's clock starts at 0."""
        old, self.brakes, self.legs = self.controller, self._new_brakes(), None
        self.controller = self._new_controller(old.estimator.odometry.pose)
        self.controller.carry_on(old)
        self.mpc.reset(x)

    def swing(self, legs: Array) -> None:
        """Legs are to go to ``legs`` (n) [rad]. Wheels that do not point along a leg's circle cannot move it, and for small
        steps of the planner they never will: the plan starts from wheels that turn first."""
        self.legs = legs
        self.pending.guess(partial(swing_guess, self.robot, legs))

    def push(self, wrench: Array) -> None:
        """Drives that follow speeds cannot exert a wrench: it counts in the zero-moment point only."""

    def relocate(self) -> None:
        """The next pose of another localization counts whatever was known before."""
        self.controller.estimator.placed = False

    # ------------------------------------------------------------------ tasks
    def references(self, task: Task, x: Array) -> dict[str, Reference]:
        """Of a task; legs go where ``legs`` says, or stay."""
        found, states = references_of(task, self.robot), self.robot.state
        if "leg" in states:
            found["state"].values[:, states["leg"]] = x[states["leg"]] if self.legs is None else self.legs
        return found

    def follow(self, references: dict[str, Reference]) -> None:
        """Start a task."""
        self._twists = references["input"]
        self.pending.set(references)

    # ------------------------------------------------------------------ what is reported
    def estimate(self) -> Estimate | None:
        """Planar pose and twist; the rest is unknown."""
        seen = self.snapshot()
        if seen is None:
            return None
        odometry = self.controller.estimator.odometry
        pose, height = seen[1][self.robot.state["base"]], self.robot.base.body_height
        return planar_estimate(pose, odometry.twist, height, odometry.covariance, odometry.twist_covariance)


def swing_guess(robot: RobotModel, legs: Array, x0: Array, trajectory: Trajectory) -> Trajectory:
    """Trajectories of a base that stands while its wheels turn to the legs' circles and the legs then go to ``legs`` (n)."""
    state, inputs, geometry = robot.state, robot.input, swerve_base(robot).geometry
    x, u, steer, leg = trajectory.x, trajectory.u, x0[state["steer"]].copy(), x0[state["leg"]].copy()
    lower, upper = robot.limits.state_lower[state["steer"]], robot.limits.state_upper[state["steer"]]
    maximum = 0.6 * robot.limits.input_upper[inputs["steer"]]
    for k, h in enumerate(np.diff(trajectory.grid)):
        rate = np.clip((legs - leg) / max(h, 0.5), -SWING, SWING)
        target, _ = rolling_inverse_kinematics(geometry, leg, steer, np.zeros(3), rate)
        target = np.where(target > upper, target - np.pi, np.where(target < lower, target + np.pi, target))
        turn = np.clip((target - steer) / h, -maximum, maximum)
        if np.abs(target - steer).max() > STRAIGHT:
            rate = np.zeros_like(rate)
        x[k, state["base"]], x[k, state["leg"]], x[k, state["steer"]] = x0[state["base"]], leg, steer
        u[k, inputs["base"]], u[k, inputs["leg"]], u[k, inputs["steer"]] = 0.0, rate, turn
        _, u[k, inputs["wheel"]] = rolling_inverse_kinematics(geometry, leg, steer, np.zeros(3), rate)
        leg, steer = leg + rate * h, steer + turn * h
    x[-1, state["base"]], x[-1, state["leg"]], x[-1, state["steer"]] = x0[state["base"]], leg, steer
    return trajectory
