"""A robot on wheels of a base, on a ROS 2 bus: speeds out, odometry from wheels and gyro."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.common.ros import SpeedRosAdapter, references_of
from wbmpc.bases.common.ros_settings import PlanarRosSettings
from wbmpc.bases.planar_motion.controller import PlanarController
from wbmpc.bases.planar_motion.messages import PlanarCommand, PlanarMeasurement
from wbmpc.bases.planar_motion.model import planar_base
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Cost, OptimalControlProblem, Reference
from wbmpc.ros2.base_adapter import Estimate, Fix, Groups, Weights, planar_estimate
from wbmpc.ros2.convert import nearest_angle
from wbmpc.ros2.goals import Task
from wbmpc.ros2.joints import Inertial, JointSample, OnBus, Series, Waited, by_arrivals

#: Without messages for longer than this [s] there is a gap; encoders that moved by more than their largest speed over it, and this
#: [rad] besides, have restarted.
GAP, REST = 0.1, 0.5
#: Poses that are kept: another localization's is of the time of its stamp.
REMEMBERED = 400
#: Standard deviations: of the way [m after 1 m], of a turn [rad after 1 rad], what a gap adds [m, m, rad], of encoders that restart.
SLIP, TURN, UNSEEN = 0.01, 0.02, np.array([0.02, 0.02, 0.05])
#: A way counts from so far on [m or rad], for encoders tremble.
COUNTS = 0.01
#: Angles of steering joints that there are not.
_NO_STEERING = np.zeros(0)


@dataclass(frozen=True)
class BusMeasurement(OnBus, PlanarMeasurement):
    """Of a bus."""


class References(dict[str, Reference]):
    """Of a task; ``carried``: whether the base leads and the end effector goes along."""

    carried = False


class BusController(PlanarController):
    """What a bus brings along for a controller: gaps, encoders that restart, poses of another localization.

    ``seen``: the newest measurement with the pose that belongs to it, for other threads; ``covariance`` (3, 3) of the pose in the world.
    """

    seen: tuple[BusMeasurement, Array, Array] | None = None
    fix: Callable[[], Fix | None] | None = None
    placed = False
    _series: Series | None = None

    def __init__(self, *args: Any, **keys: Any) -> None:
        super().__init__(*args, **keys)
        self.covariance: Array = np.zeros((3, 3))
        self.speed: Array = np.zeros(3)
        self._was: deque[tuple[float, Array]] = deque(maxlen=REMEMBERED)  # times [s] that go on from run to run, poses
        self._counted = self.pose.copy()  # up to where the way is in the covariance
        # turn [rad] by which wheels and gyro contradict each other: up to where it is in the covariance, and what of it moves the pose
        self._apart, self._doubt = 0.0, 0.0
        self._waited, self._passed = Waited(), 0.0  # time [s] from the message before to the last one
        # when the last message that waited came: before that it is not known where the base was when
        self._waited_until = -np.inf

    def turning(self, previous: PlanarMeasurement, now: PlanarMeasurement) -> float | None:
        """As the inertial unit's messages between the two say; nothing where one of them has waited, for a bias turns with a time that is
        another one then."""
        if not (self.use_gyro and isinstance(previous, BusMeasurement) and isinstance(now, BusMeasurement)):
            return None
        arrivals, stamps = now.time - previous.time, now.stamp - previous.stamp
        if self._passed != arrivals or 0.0 < stamps < arrivals - GAP:
            return None
        return by_arrivals(now.turning, stamps, arrivals)

    def measure(self, measurement: BusMeasurement) -> None:  # type: ignore[override]
        """Take in the message of this tick, and another localization's pose if there is a new one."""
        self._follow_series(measurement.series)
        before, last = self.pose.copy(), self.measured
        # the runner's clock starts at zero with each run
        lasting = replace(measurement, time=measurement.time + measurement.origin)
        interval = self._interval(last, lasting)
        if last is not None and self._restarted(last, measurement, interval):
            self.odometry.restart()
            self.covariance = self.covariance + np.diag(UNSEEN**2)
        super().measure(lasting)
        self._note_motion(before, interval)
        if interval < 0.0:  # of a clock that was restarted
            self._was.clear()
            self._waited_until = -np.inf
        came = 0.0 if last is None else lasting.time - last.time
        waiting = isinstance(last, BusMeasurement) and (self._waited.others or interval != came)
        if waiting:
            self._was.clear()
            self._waited_until = lasting.time
        self._was.append((lasting.time, self.pose.copy()))
        fix = self.fix() if self.fix is not None else None
        # (one from before would count the way twice)
        if fix is not None and not waiting and fix[0] + measurement.origin > self._waited_until:
            self._correct(fix[0] + measurement.origin, fix[1], fix[2])
        self.seen = measurement, self.pose.copy(), self.speed

    def _interval(self, last: PlanarMeasurement | None, now: BusMeasurement) -> float:
        """Time [s] from one message to the next: by their arrivals, or as long as the second one has waited."""
        self._passed = 0.0
        if isinstance(last, BusMeasurement):
            self._passed = self._waited.interval(now.time - last.time, now.stamp - last.stamp)
        return self._passed

    def _follow_series(self, series: Series) -> None:
        """Encoders that restart move nothing; a simulated robot that restarts is where its odometry begins."""
        known, self._series = self._series, series
        if known is None or series == known:
            return
        self.measured, self.placed = None, False  # the next pose of another localization says where it is
        self.odometry.restart()
        self.covariance = self.covariance + np.diag(UNSEEN**2)
        if series.simulations != known.simulations:
            self._was.clear()
            self.odometry.place(np.zeros(3))
            self.covariance, self._counted, self._doubt = np.zeros((3, 3)), np.zeros(3), 0.0

    def _restarted(self, last: PlanarMeasurement, now: PlanarMeasurement, interval: float) -> bool:
        upper = planar_base(self.robot).wheel_upper
        upper = np.where(np.isfinite(upper), upper, 1e3)
        return bool(np.any(np.abs(now.wheel - last.wheel) > 2.0 * upper * max(interval, 0.0) + REST))

    def _note_motion(self, before: Array, interval: float) -> None:
        moved = lie.se2_log(before, self.pose)
        if interval > GAP:
            self.covariance = self.covariance + np.diag((UNSEEN * interval) ** 2)
        elif interval < 0.0:  # a wrong stamp, before or now, or another clock
            self.covariance = self.covariance + np.diag(UNSEEN**2)
        self._count_way()
        self._count_contradiction()
        self.speed = moved / interval if 0.0 < interval <= GAP else np.zeros(3)

    def _count_way(self) -> None:
        """What the heading is off turns the way, and errors of short ways are independent, however many messages they took."""
        dx, dy, turn = self.pose - self._counted
        way = float(np.hypot(dx, dy))
        if max(way, abs(turn)) < COUNTS:
            return
        turned = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        spread = np.array([SLIP**2 * way, SLIP**2 * way, TURN**2 * abs(turn)])
        self.covariance = turned @ self.covariance @ turned.T + np.diag(spread)
        self._counted = self.pose.copy()

    def _count_contradiction(self) -> None:
        """Gyro or wheels turn the pose wrongly where they contradict each other, by up to all of it, and it adds up."""
        apart, before = self.odometry.gyro.apart, self._doubt
        if apart == self._apart:
            return
        self._doubt, self._apart = before + apart - self._apart, apart
        grown = max(self._doubt**2 - before**2, 0.0)
        self.covariance = self.covariance + grown * np.diag([self.odometry.lever**2, self.odometry.lever**2, 1.0])

    def _correct(self, t: float, pose: Array, covariance: Array) -> None:
        """By both covariances, where the base was at t [s]: what it has driven since stays. A pose without a covariance is exact and of
        now, and so is the first one, which says where the robot is."""
        exact = not covariance.any()
        sure = exact or not self.placed
        if not sure and t > self._was[-1][0] + GAP:  # joint states of that time wait behind this one
            return
        then = self.pose.copy() if sure else min(self._was, key=lambda seen: abs(seen[0] - t))[1]
        error = np.array([*(pose[:2] - then[:2]), nearest_angle(pose[2], then[2]) - then[2]])
        gain = np.eye(3) if sure else self.covariance @ np.linalg.pinv(self.covariance + covariance)
        self._move_way(then, gain @ error)
        self.placed = True
        before = self.covariance[2, 2]
        self.covariance = covariance.copy() if sure else (np.eye(3) - gain) @ self.covariance
        self._doubt *= 0.0 if sure or before == 0.0 else self.covariance[2, 2] / before
        if sure:  # the covariance is of the pose of now: the way before it is none of it
            self._counted = self.pose.copy()

    def _move_way(self, then: Array, by: Array) -> None:
        """The pose ``then`` (3) was off ``by`` (3), and with it the whole way, before and since: the next late pose must not find the same
        error again."""
        moved = lambda p: then + [by[0], by[1], 0.0] + lie.se2_compose([0.0, 0.0, by[2]], p - then)
        self._was = deque(((t, moved(p)) for t, p in self._was), REMEMBERED)
        self.odometry.place(moved(self.pose))
        self._counted = moved(self._counted)  # the way since has yet to be counted, however short it is


def on_bus(kind: type[PlanarController]) -> type[PlanarController]:
    """A controller class with what a bus brings along."""
    return type(kind.__name__, (BusController, kind), {})


class PlanarRosAdapter(SpeedRosAdapter):
    """See :class:`wbmpc.ros2.base_adapter.BaseAdapter`. ``kind``: the controller of the base type."""

    watches = "wheels"
    controller: Any  # of the bus, and of the base type

    def __init__(
        self, robot: RobotModel, settings: PlanarRosSettings, period: float,
        kind: type[PlanarController] = PlanarController,
    ) -> None:  # fmt: skip
        super().__init__(robot, settings)
        self._led = self._weights_of_base(self.mpc.ocp)
        self.controller: Any = on_bus(kind)(robot, np.zeros(3), period, lag=settings.actuator_time_constant)

    def _weights_of_base(self, problem: OptimalControlProblem) -> dict[bool, Weights]:
        """Of the states where the base leads, with the weight of the end effector, and where it does not."""
        cost, effector = cast(Cost, problem.term("state")), cast(Cost, problem.term("end_effector"))
        plain, pose = list(cost.expand(cost.weight)), effector.expand(effector.weight)
        part, led = self.robot.state["base"].start, list(plain)
        led[part : part + 3] = [float(pose[0]), float(pose[1]), float(pose[5])]
        return {False: {("state", "path"): plain}, True: {("state", "path"): led}}

    def groups(self, command: PlanarCommand) -> Groups:
        steer = {"steer": command.steer} if command.steer.size else {}
        return {**self._rest, "wheel": command.wheel, "arm": command.arm, **steer}

    # ------------------------------------------------------------------ states
    def measurement(
        self, now: float, at: float, sample: JointSample, imu: Inertial | None, origin: float = 0.0
    ) -> BusMeasurement:
        """Joint states and the inertial unit, read at ``at`` [s] of the runner's clock, whose zero is at ``origin`` [s]."""
        wheel, arm = sample.groups["wheel"], sample.groups["arm"]
        steer = sample.groups.get("steer", _NO_STEERING)
        if imu is None:
            return BusMeasurement(at, wheel, arm, steer=steer, origin=origin, series=sample.series, stamp=sample.stamp)
        turning = None if imu.turning is None or not self.settings.use_gyro else float(imu.turning[2])
        return BusMeasurement(
            at, wheel, arm, imu.gyro, imu.accel, steer, turning=turning, origin=origin, series=sample.series,
            stamp=sample.stamp,
        )  # fmt: skip

    def stand(self, measurement: BusMeasurement) -> None:
        """Follow the wheels, and the gyro's bias, while the drives are not commanded."""
        self.controller.fix = self.fix
        self.controller.measure(measurement)

    def snapshot(self) -> tuple[float, Array] | None:
        """Time [s] of the runner's clock and the state (nx) estimated for it; from any thread. None before the first."""
        seen = self.controller.seen
        if seen is None:
            return None
        m, pose, _ = seen
        parts = {"base": pose, "steer": m.steer, "arm": m.arm}
        return self.on_runners_clock(m.time + m.origin), self.robot.state.vector(
            {g: parts[g] for g in self.robot.state.groups}
        )

    def relocate(self) -> None:
        """The next pose of another localization counts whatever was known before."""
        self.controller.placed = False

    # ------------------------------------------------------------------ tasks
    def references(self, task: Task, x: Array) -> References:
        """Of a task, and whether the base leads."""
        found = References(references_of(task, self.robot))
        found.carried = task.carried
        return found

    def follow(self, references: dict[str, Reference]) -> None:
        """Start a task."""
        self.pending.reweigh(self._led[getattr(references, "carried", False)])
        self.pending.set(references)

    # ------------------------------------------------------------------ what is reported
    def estimate(self) -> Estimate | None:
        """Planar pose and twist; the rest is unknown."""
        seen = self.controller.seen
        if seen is None:
            return None
        height, covariance = self.robot.base.body_height, self.controller.covariance
        return planar_estimate(seen[1], seen[2], height, covariance, 1e-4 * np.eye(3))
