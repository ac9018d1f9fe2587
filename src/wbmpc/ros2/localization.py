"""Another localization of the base: poses from the bus, how old they are, and a gate for those that jump.

Poses of another localization, compared with the robot's own motion before its estimator uses them.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import is_certain, is_covariance
from wbmpc.errors import InputError
from wbmpc.logs import RateLimit
from wbmpc.ros2.bus import Node
from wbmpc.ros2.convert import error_message, nearest_angle, planar, read_pose, seconds
from wbmpc.ros2.multi_type_subscriber import MultiTypeSubscriber
from wbmpc.ros2.settings import RosSettings
from wbmpc.ros2.sources import OneSource, Source
from wbmpc.runtime.safety import SafeStop

if TYPE_CHECKING:
    from wbmpc.ros2.control import ControlNode


class ExternalPose:
    """What the adapter asks for a pose at every control tick."""

    def __init__(self, control: ControlNode) -> None:
        self.control = control
        self._gate = PoseGate(control.settings.topics.pose, control.settings.safety.jump)

    def reset(self) -> None:
        """The robot may be anywhere."""
        self._gate.reset()

    def take(self) -> tuple[float, np.ndarray, np.ndarray] | None:
        """A new pose: its time [s] on the runner's clock, the pose (x, y, yaw), its covariance (3, 3). One that jumps while the
        robot moves does not count: a robot that can stop does (:class:`SafeStop`), and is placed by the next one."""
        control, adapter = self.control, self.control.adapter
        if control.running:
            seen = adapter.snapshot()
            if seen is not None:
                self._gate.note(seen[0], planar(*adapter.planner.base_pose(seen[1])))
        # a robot that would fall goes on without poses, and the odometry of one that stands does
        goes_on = adapter.must_keep_running or (not control.running and np.isfinite(control.source.at))
        taken = control.source.newest() if goes_on else control.source.take()
        if taken is None:
            return None
        pose = control.clock.now() - taken[0], *taken[1:]
        estimate = adapter.estimate()
        if not control.running or estimate is None:
            control.source.judge("")
            return pose
        jumped = self._gate.jumped(*pose, estimate.covariance[np.ix_([0, 1, 5], [0, 1, 5])])
        control.source.judge(jumped, adapter.must_keep_running)
        if jumped and not adapter.must_keep_running:
            adapter.relocate()
            raise SafeStop(jumped)
        return None if jumped else pose


_LOG = logging.getLogger("wbmpc")
Time = Callable[[], float]
#: Largest time [s] without a pose.
POSE_AGE = 0.5
_POSES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped")
#: Where the robot was is kept for as many ticks: a pose belongs to the time of its stamp.
_REMEMBERED = 400
#: Time that goes back by more than this [s] is a clock that was restarted, not rounding.
_ROUNDING = 1e-6
#: What is known no better is not known at all [m², rad²].
LARGEST_VARIANCE = 1e12
#: Less than this [m², rad²] is no variance: divided by it, numbers overflow.
_SMALLEST = 1e-18
#: A pose may be off by this many standard deviations besides.
_SPREAD = 3.0


class PoseSource:
    """Odometry or PoseWithCovarianceStamped, in the world frame.

    ``at``: when the last one came [s of ``now()``]; ``stamp()``: the bus's time [s]; a pose is as old as its stamp says.
    ``source``: whose poses count. ``fault``: what is wrong with those that come, ``jumped`` included; empty when they are right again.
    """

    def __init__(self, node: Node, settings: RosSettings, now: Time, stamp: Time) -> None:
        self.node, self.settings, self.now, self.stamp = node, settings, now, stamp
        self.at, self.jumped, self._wrong = -np.inf, "", ""
        self._stamped: float | None = None  # stamp [s] of the last one
        self._limit = RateLimit()
        self._good = -np.inf  # when the last one that counted came
        self._fix: tuple[float, Array, Array] | None = None  # of when [s of ``now()``]
        self.source = OneSource(settings.topics.pose)
        self._messages = MultiTypeSubscriber(
            node, settings.topics.pose, dict.fromkeys(_POSES, self._take), sourced=True
        )

    @property
    def fault(self) -> str:
        """What is wrong with the poses that come."""
        return self._wrong or self.jumped or self._messages.fault

    def update(self) -> None:
        """Subscribe in the type that is published."""
        self._messages.update()

    def take(self) -> tuple[float, Array, Array] | None:
        """As :meth:`newest`; raises :class:`SafeStop` if nothing has come for :data:`POSE_AGE`."""
        lost = self.lost()
        if lost:
            raise SafeStop(lost)
        return self.newest()

    def newest(self) -> tuple[float, Array, Array] | None:
        """The latest pose, returned once: age now [s], pose (x, y, yaw), covariance (3, 3), zero where the message has none."""
        fix, self._fix = self._fix, None
        return None if fix is None else (max(self.now() - fix[0], 0.0), *fix[1:])

    def lost(self) -> str:
        """Why there is no pose any more; empty if there is. One that jumped is none."""
        topic, silent = self.settings.topics.pose, self.now() - (self._good if self.jumped else self.at)
        if silent <= POSE_AGE:
            return ""
        why = f" ({self.fault})" if self.fault else ""
        return f"the pose on {topic} is {silent:.2f} s old, the limit is {POSE_AGE:g} s{why}"

    def judge(self, jumped: str, goes_on: bool = True) -> None:
        """What the gate said of the pose that was taken last; empty: it counts. A stop reports it itself."""
        if jumped and goes_on and not self.jumped:
            self._limit.log(_LOG, logging.ERROR, "jumped", f"{jumped}; it does not count")
        self.jumped = jumped
        if not jumped:
            self._good = self.now()

    def _take(self, message: Any, source: Source | None = None) -> None:
        if not self.source.takes(source):
            return
        try:
            self._read(message)
        except InputError as error:
            fault = error_message(error)
            if fault != self._wrong:
                self._limit.log(_LOG, logging.ERROR, "wrong", fault)
            self._wrong = fault
        else:
            self._wrong = ""

    def _read(self, message: Any) -> None:
        topic, world = self.settings.topics.pose, self.settings.frames.world
        if message.header.frame_id != world:
            raise InputError(f"{topic}: the pose is in frame '{message.header.frame_id}', '{world}' is needed")
        covariance = np.asarray(message.pose.covariance, float).reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
        pose = planar(*read_pose(message.pose.pose, topic))
        if not np.isfinite(covariance).all():
            raise InputError(f"{topic}: a number of the covariance is not finite")
        if np.abs(covariance).max() > LARGEST_VARIANCE:
            raise InputError(f"{topic}: a number of the covariance is too large; valid: at most {LARGEST_VARIANCE:g}")
        if not is_covariance(covariance):
            raise InputError(f"{topic}: a variance is negative")
        if covariance.any() and (np.diag(covariance).min() < _SMALLEST or is_certain(covariance)):
            # a filter that has taken it in could weigh no second one: that would end the run
            raise InputError(
                f"{topic}: the covariance is 0 in a direction, but not in all; valid: full rank, or 0 (exact)"
            )
        stamp, before = seconds(message.header.stamp), self._stamped
        self._stamped = stamp
        if stamp == before != 0.0:  # the same once more: no second measurement, and none of now
            return
        self.at, age = self.now(), self.stamp() - stamp
        # a stamp of another machine's clock, or none, says nothing: the pose is then of now
        self._fix = self.at - (age if 0.0 <= age < POSE_AGE else 0.0), pose, covariance


class PoseGate:
    """Compares poses with the robot's own motion, which the last poses that counted have corrected: wheels, gyro or inertial unit
    say how far it can have come. ``limit``: how far off [m, rad] a pose may be beyond :data:`_SPREAD` standard deviations."""

    def __init__(self, topic: str, limit: float) -> None:
        self._topic, self._limit = topic, limit
        self._was: deque[tuple[float, Array]] = deque(maxlen=_REMEMBERED)

    def reset(self) -> None:
        """The robot may be anywhere."""
        self._was.clear()

    def note(self, t: float, pose: Array) -> None:
        """The robot's own estimate (x, y, yaw) at t [s]. Times before the last one are of a clock that was restarted: what was
        before it is forgotten."""
        if self._was and t < self._was[-1][0] - _ROUNDING:
            self.reset()
        if not self._was or t > self._was[-1][0]:
            self._was.append((t, np.array(pose)))

    def jumped(self, t: float, pose: Array, covariance: Array, own: Array) -> str:
        """By how much a pose of time t [s] is farther from the estimate than both covariances (3, 3), the ``own`` one and the
        pose's, allow; empty if it is not."""
        if not self._was:
            return ""
        then = min(self._was, key=lambda place: abs(place[0] - t))[1]
        spread = covariance + own
        moved, turned = float(np.hypot(*(pose - then)[:2])), abs(nearest_angle(pose[2], then[2]) - then[2])
        variances = max(float(np.linalg.eigvalsh(spread[:2, :2])[-1]), 0.0), float(spread[2, 2])
        for off, variance, unit in ((moved, variances[0], "m"), (turned, variances[1], "rad")):
            maximum = self._limit + _SPREAD * float(np.sqrt(variance))
            if off > maximum:
                against = f"against the robot's own motion, {maximum:.2f} {unit} are allowed"
                return f"the pose on {self._topic} jumped by {off:.2f} {unit} {against}"
        return ""
