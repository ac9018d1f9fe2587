"""A robot behind a bus, as the real-time runner needs it: newest checked measurement, commands, a ramp to rest."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.logs import RateLimit
from wbmpc.ros2.base_adapter import BaseAdapter, Groups
from wbmpc.ros2.base_driver import HELD, BaseWay
from wbmpc.ros2.bus import SENSOR, SMALL, Node
from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.convert import error_message, seconds
from wbmpc.ros2.inertial_readings import InertialReadings
from wbmpc.ros2.joints import (
    OVERTAKEN,
    TURN_FACTOR,
    Inertial,
    JointReader,
    JointSample,
    Lag,
    Repetition,
    Series,
    Standstill,
    check_turn,
    read_imu,
)
from wbmpc.ros2.settings import RosSettings
from wbmpc.ros2.sources import OneSource, Source
from wbmpc.ros2.trajectory_client import senders
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.safety import SafeStop

_LOG = logging.getLogger("wbmpc")
#: How long zeros are sent after the ramp of a stop [s].
ZEROS = 1.0
#: How fast the difference of two machines' clocks may grow [s/s].
_CLOCK_DRIFT = 1e-4
#: While the robot is not commanded, one measurement in so many seconds is enough; so many messages wait for that at most.
_STANDING, _WAITING = 0.01, 4000


class BusRobot:
    """See :class:`wbmpc.runtime.stop_control.RobotInterface`. What is wrong with a message stops the robot once it is :meth:`arm`-ed; a robot
    that would fall (``adapter.must_keep_running``) goes on without that message, and ``fault`` says so until the next good one.

    With simulated time a measurement is as old as its stamp. By the wall clock it is as old as its arrival, if its stamp has
    moved on (clocks of two machines may differ, and a driver that hangs repeats itself); intervals are those of the stamps.
    ``commanded``: the last command by groups, from which a stop brakes.
    """

    def __init__(self, node: Node, adapter: BaseAdapter, settings: RosSettings, clock: WallClock | BusClock) -> None:
        if adapter.needs_imu and not settings.topics.imu:
            raise InputError("topics.imu: this robot needs an inertial unit")
        self.adapter, self.settings, self.clock = adapter, settings, clock
        self._limit = RateLimit()
        self._wrong: dict[str, str] = {}  # what is wrong with the newest message, by topic
        self._reader = JointReader(adapter.robot, settings, adapter.must_keep_running)
        self._inertial = InertialReadings(clock, settings.safety.watchdog)
        on_wheels = "base" in adapter.robot.input and not adapter.must_keep_running
        self._fastest = TURN_FACTOR * max(adapter.robot.description.limits.base_angular, 1.0) if on_wheels else np.inf
        # where a back end does not know whose a message is, who would fall takes it
        topics, ambiguous = settings.topics, adapter.must_keep_running
        self._joint_source = OneSource(topics.joint_states, self._forget_joints, ambiguous)
        self._imu_source = OneSource(topics.imu, self._inertial.forget, ambiguous)
        self._joints: tuple[JointSample, float] | None = None
        self._series, self._replaced, self._standstill = Series(), False, Standstill()
        self._repetition = Repetition()
        self._waiting: deque[tuple[JointSample, float]] = deque(maxlen=_WAITING)  # joint states that were not read
        self._behind = np.inf  # least time [s] from a stamp to its arrival
        self._lag, self._current_from = Lag(), -np.inf  # arrival [s] from which on messages come when they are sent
        self.lateness = self._reader.lateness
        self.sent = 0  # commands since the last start
        self._armed = False
        self._stopping: float | None = None
        self._written = -np.inf  # when the last command was sent
        self.commanded = adapter.rest()
        self._way = BaseWay(adapter.robot) if adapter.robot.description.base.takes_twist else None
        self._way_source = OneSource(topics.base_odom, self._forget_way)
        self._went = -np.inf  # when the base's driver last said how far it went
        self._senders = senders(node, adapter.robot, settings)
        self._listen(node)

    # ------------------------------------------------------------------ from the bus
    def _listen(self, node: Node) -> None:
        """The last that is done at the beginning: a message may come as soon as somebody listens."""
        topics, listen = self.settings.topics, partial(node.subscribe, qos=SENSOR, largest=SMALL, sourced=True)
        listen(topics.joint_states, "sensor_msgs/msg/JointState", self._take_joints)
        if topics.imu:
            listen(topics.imu, "sensor_msgs/msg/Imu", self._take_imu)
        if self._way is not None:
            listen(topics.base_odom, "nav_msgs/msg/Odometry", partial(self._take_way, self._way))

    def _take_joints(self, message: Any, source: Source | None = None) -> None:
        ours, last = self._reader.concerns(message), self._reader.last
        if not (self._joint_source.takes(source) if ours else self._joint_source.follows(source)):
            return
        try:
            sample = self._reader.read(message, self._now())
        except InputError as error:
            self._note("joints", error_message(error))
            if not self._armed:
                self._reader.reset()
            return
        if self._repeats(sample):
            self._reader.last = last  # it does not count
            return
        self._good("joints")
        previous, arrival = self._joints, time.perf_counter()
        if previous is not None:
            self._follow_series(previous[0], sample)
            if sample.stamp < previous[0].stamp:  # what is known is the delay of another clock, or of a wrong stamp
                self._behind = np.inf
        if isinstance(self.clock, BusClock):  # by the wall's it is not known: a driver's clock may be another one
            self.lateness.note(sample.stamp, self.clock.stamp())
        sample = replace(sample, series=self._series)
        if self._way is not None:  # both or neither: an estimate takes a way that stands for rest
            if not self._way_goes_on(sample.stamp, arrival):
                return
            sample = self._way.with_way(sample)
        if previous is None or sample.stamp != previous[0].stamp or sample.stamp == 0.0:
            grown = 0.0 if previous is None else _CLOCK_DRIFT * max(arrival - previous[1], 0.0)
            self._behind = min(arrival - sample.stamp, self._behind + grown)
            if previous is not None and sample.stamp != 0.0:
                late = self._lag.late(arrival - previous[1], sample.stamp - previous[0].stamp)
                self._current_from = np.inf if late else min(self._current_from, arrival)
            self._joints = sample, arrival
            self._waiting.append(self._joints)

    def _repeats(self, sample: JointSample) -> bool:
        """Whether joint states say nothing of a base that turns by them. Who balances watches the encoders of every joint."""
        if self.adapter.must_keep_running or self._way is not None:
            return False
        if not self._repetition.goes_on(sample, self._inertial.turning):
            return False
        if self._repetition.lasted(sample) > self.settings.safety.watchdog:
            topic = self.settings.topics.joint_states
            self._note("joints", f"the joint states on {topic} stand still, under new stamps, while the base turns")
        return True

    def _take_imu(self, message: Any, source: Source | None = None) -> None:
        if not self._imu_source.takes(source):
            return
        try:
            taken, at = read_imu(message), seconds(message.header.stamp)
            check_turn(taken, self._fastest)
            off = at - self.clock.stamp() if isinstance(self.clock, BusClock) else 0.0
            if abs(off) > self.settings.safety.watchdog and self.adapter.must_keep_running:
                raise InputError(f"imu: its stamp is {off:.3g} s off /clock")
        except InputError as error:
            self._note("imu", error_message(error))
            return
        self._good("imu")
        self._inertial.put(at, taken)

    def _take_way(self, way: BaseWay, message: Any, source: Source | None = None) -> None:
        if not self._way_source.takes(source):
            return
        try:
            way.read(message, self._now())
        except InputError as error:
            self._note("way", error_message(error))
            if not self._armed:
                way.reset()
            return
        self._good("way")
        self._went = time.perf_counter()

    def _forget_way(self) -> None:
        """The next message is another driver's, whose way begins where the last one's ended."""
        if self._way is not None:
            self._way.reset()

    def _forget_joints(self) -> None:
        """The next joint states are another publisher's: of another clock, and wherever they are."""
        self._reader.reset()
        self._behind = np.inf
        self._replaced = True

    def _follow_series(self, before: JointSample, now: JointSample) -> None:
        """Joint states of another publisher, or of a simulated time that went back to joints elsewhere, are of another series: their
        wheels count from elsewhere."""
        back = isinstance(self.clock, BusClock) and now.stamp < before.stamp - OVERTAKEN
        restarted = back and (self._replaced or self._reader.apart(before, now))
        if not (self._replaced or restarted):
            return
        self._series, self._replaced = Series(self._series.encoders + 1, self._series.simulations + restarted), False
        why = "their publisher was replaced: the odometry goes on without what wheels turned meanwhile"
        why = "their time went back: the odometry begins at its origin" if restarted else why
        topic = self.settings.topics.joint_states
        self._limit.log(_LOG, logging.WARNING, "series", f"the joint states on {topic} restart, {why}")

    @property
    def conflict(self) -> str:
        """That sensors have more than one publisher; empty if they have not."""
        return self._joint_source.conflict or self._imu_source.conflict or self._way_source.conflict

    @property
    def fault(self) -> str:
        """What is wrong with the messages; empty if nothing is."""
        return next(iter(self._wrong.values()), "")

    def _note(self, source: str, fault: str) -> None:
        if self._armed and self.adapter.must_keep_running and source not in self._wrong:
            self._limit.log(_LOG, logging.ERROR, source, f"{fault}; it does not count, the robot goes on")
        if not (self._armed and source in self._wrong):
            self._wrong[source] = fault

    def _good(self, source: str) -> None:
        if not self._armed or self.adapter.must_keep_running:
            self._wrong.pop(source, None)

    @property
    def has_imu(self) -> bool:
        """Whether there has been an inertial measurement."""
        return self._inertial.heard

    def waiting_reason(self) -> str:
        """Why the robot cannot be moved yet; empty if it can."""
        if self.fault:
            return self.fault
        if without_way := self._without_way():
            return without_way
        if self._joints is None:
            return f"no joint states on {self.settings.topics.joint_states} yet"
        age, limit = self.age(), self.settings.safety.watchdog
        if age < -limit:
            return f"the joint states on {self.settings.topics.joint_states} are stamped {-age:.3g} s ahead of /clock"
        if age > limit:
            return f"the joint states on {self.settings.topics.joint_states} have stopped for more than {limit:g} s"
        if self.adapter.needs_imu and not self._inertial.heard:
            return f"nothing on {self.settings.topics.imu} yet"
        return self.lateness.fault

    def _way_goes_on(self, stamp: float, arrival: float) -> bool:
        """Whether the base's driver has said lately how far it went, for joint states of ``stamp`` [s]."""
        assert self._way is not None
        at = self._way.stamp
        if at is None:
            return False
        return (stamp - at if isinstance(self.clock, BusClock) else arrival - self._went) <= HELD

    def _without_way(self) -> str:
        """Why it is not known how far a base that takes speeds goes; empty where it is."""
        topic, limit = self.settings.topics.base_odom, self.settings.safety.watchdog
        if self._way is None:
            return ""
        at = self._way.stamp
        if at is None:
            return f"nothing on {topic} yet"
        silent = self.clock.stamp() - at if isinstance(self.clock, BusClock) else time.perf_counter() - self._went
        return f"the messages on {topic} stopped {silent:.3g} s ago" if silent > limit else ""

    def age(self) -> float:
        """Of the last joint states [s]; infinite before the first."""
        if self._joints is None:
            return np.inf
        if isinstance(self.clock, BusClock):
            return self.clock.stamp() - self._joints[0].stamp
        return time.perf_counter() - self._joints[1]

    def is_current(self, t: float) -> bool:
        """Whether an estimate of a time t [s] of the runner's clock is no older than that: by arrivals, messages that waited look newer."""
        by_stamps = isinstance(self.clock, BusClock) or self.adapter.must_keep_running
        return by_stamps or t + self.clock.origin >= self._current_from

    def arm(self) -> None:
        """From now on faults count; the robot is at rest."""
        self._wrong, self._stopping, self._armed, self.sent, self._standstill = {}, None, True, 0, Standstill()
        for source in (self._joint_source, self._imu_source, self._way_source):
            source.settle()
        self.commanded = self.adapter.rest()

    def disarm(self) -> None:
        """Faults are reported only, and pass with the next good message."""
        self._armed = False
        self._reader.reset()

    # ------------------------------------------------------------------ for the runner
    def read(self) -> Any:
        """The newest measurement, its time on the runner's clock."""
        if self.fault and self._armed and not self.adapter.must_keep_running:
            raise SafeStop(self.fault)
        sources = self._joint_source, self._imu_source, self._way_source
        if self._armed and (replaced := next((s.replaced for s in sources if s.replaced), "") or self._without_way()):
            raise SafeStop(replaced)
        joints = self._joints
        if joints is None:
            raise SafeStop(f"no joint states on {self.settings.topics.joint_states}")
        sample, arrival = joints
        watched = self._armed and not self.adapter.must_keep_running  # whose monitor of encoders says more
        if watched and self._standstill.lasts(sample, self.commanded):
            topic = self.settings.topics.joint_states
            raise SafeStop(f"the joint states on {topic} stand still, under new stamps, while the drives are to move")
        self._waiting.clear()
        imu = self._inertial.averaged(sample.stamp)
        if imu is not None and self._armed:
            silent, limit = self._inertial.silent(), self.settings.safety.watchdog
            if silent > limit:
                raise SafeStop(f"the messages on {self.settings.topics.imu} stopped {silent:.3f} s ago")
            if silent < -limit:  # their end would not be noticed
                raise SafeStop(
                    f"the messages on {self.settings.topics.imu} are stamped {-silent:.3g} s ahead of /clock"
                )
        return self._measurement(sample, arrival, imu)

    def unread(self) -> Iterator[Any]:
        """Measurements of the joint states that came since the last ones that were read, oldest first: a robot that stands follows what
        others do with the robot. They are thinned out; nothing that the inertial unit said is lost by that."""
        last = stamp = -np.inf
        for left in range(len(self._waiting) - 1, -1, -1):
            sample, arrival = self._waiting.popleft()
            at = self._when(sample, arrival)
            if left and 0.0 <= at - last < _STANDING and sample.stamp - stamp < _STANDING:  # what waited comes at once
                continue
            last, stamp = at, sample.stamp
            yield self._measurement(sample, arrival, self._inertial.averaged(sample.stamp))

    def _measurement(self, sample: JointSample, arrival: float, imu: Inertial | None) -> Any:
        origin = self.clock.origin
        return self.adapter.measurement(self.clock.now(), self._when(sample, arrival) - origin, sample, imu, origin)

    def _now(self) -> float:
        """By what messages come [s]: the bus's time, or the wall's."""
        return self.clock.stamp() if isinstance(self.clock, BusClock) else time.perf_counter()

    def _when(self, sample: JointSample, arrival: float) -> float:
        """When joint states were read, on the clock behind the runner's."""
        if isinstance(self.clock, BusClock):
            return sample.stamp
        if not self.adapter.must_keep_running or sample.stamp == 0.0:
            return arrival
        return sample.stamp + self._behind - self.settings.state_age

    def write(self, command: Any) -> None:
        """Send a command to all controllers."""
        self.commanded, self._stopping, self._written = self.adapter.groups(command), None, time.perf_counter()
        self._send(self.commanded)

    def stop(self) -> None:
        """The last commands, ramped down, then zero, brakes closed, then, once disarmed, nothing: who else commands the robot is not
        disturbed. Armed it goes on: the runner stands by for a policy, and in lockstep a simulator waits for commands, however slow
        the machine is.

        To be called again and again.
        """
        now, ramp = time.perf_counter(), self.settings.safety.ramp
        restarted = getattr(self.clock, "went_back", False)
        if restarted:  # a simulated robot stands then: nothing is left of its speeds
            self.commanded = self.adapter.rest()
        if self._stopping is None:
            # from the last command on: to who has sent nothing for long the drives have stopped by themselves, but in lockstep they wait
            waits = self.settings.lockstep and now - self._written < self.settings.patience
            self._stopping = now if waits else max(self._written, now - ramp)
        if now - self._stopping > ramp + ZEROS and not self._armed:
            return
        left = max(1.0 - (now - self._stopping) / ramp, 0.0) if ramp > 0.0 else 0.0
        scaled = {g: left * v for g, v in self.commanded.items()}
        if "brake" in scaled:
            scaled["brake"] = self.commanded["brake"] if left > 0.0 else self.adapter.rest()["brake"]
        self._send(scaled)

    @property
    def ramping(self) -> bool:
        """Whether a stop has not brought the robot to rest yet."""
        since = self._stopping
        return since is not None and time.perf_counter() - since < self.settings.safety.ramp

    def rest(self) -> None:
        """Zero at once."""
        self._send(self.adapter.rest())

    def _send(self, values: Groups) -> None:
        self.sent += 1
        for sender in self._senders:
            sender.send(values)
