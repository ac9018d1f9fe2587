"""The odometry of a process that was held up while somebody else drives the base. Truth: wheels that roll without slip, at a speed set by
hand."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from itertools import groupby, product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from listening import Listening, vector

from effort import some
from wbmpc.bases import base_type
from wbmpc.bases.wheels.control import wheels_base
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics
from wbmpc.ros2.joints import Lag, Waited
from wbmpc.ros2.localization import ExternalPose, PoseSource
from wbmpc.ros2.robot import BusRobot
from wbmpc.ros2.settings import RosSettings, joint_groups, settings_of
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.safety import SafeStop

PERIOD, SPEED, BIAS = 0.0025, 0.8, 0.01
#: One of each type of base that drives.
EACH_BASE = "swerve-ur10", "differential-ur10", "mecanum-ur10", "tidybot", "pr2"


class Driven:
    """Messages of a robot whose base goes straight ahead."""

    def __init__(self, robot: RobotModel, settings: RosSettings) -> None:
        self.topics, self.twist = settings.topics, robot.description.base.takes_twist
        groups, x = joint_groups(robot), robot.home
        self.names = [settings.bus_name(n) for names in groups.values() for n in names]
        rates = {g: np.zeros(len(names)) for g, names in groups.items()}
        angles = {g: x[robot.state[g]] if g in robot.state.groups else np.zeros(len(n)) for g, n in groups.items()}
        if "leg" in groups:
            leg, steer = angles["leg"], angles["steer"]
            angles["steer"], rates["wheel"] = rolling_inverse_kinematics(
                robot.base.geometry, leg, steer, (1.0, 0.0, 0.0)
            )
        elif "steer" in groups:
            base = wheels_base(robot)
            rates["wheel"] = np.asarray(base.by_input(base.matrices(angles["steer"])[0]))[:, 0]
        elif not self.twist:
            rates["wheel"] = robot.base.rates[:, 0]
        self.angles, self.rates = (np.concatenate(list(by.values())) for by in (angles, rates))

    def at(self, stamp: float, way: float, speed: float) -> dict[str, Any]:
        """Inertial unit, then the base's driver where there is one, then joints."""
        header = SimpleNamespace(stamp=SimpleNamespace(sec=int(stamp), nanosec=round(stamp % 1.0 * 1e9)), frame_id="")
        pose = SimpleNamespace(position=vector(way), orientation=SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0))
        twist = SimpleNamespace(linear=vector(speed), angular=vector())
        imu = SimpleNamespace(header=header, angular_velocity=vector(z=BIAS), linear_acceleration=vector(z=9.81))
        odometry = SimpleNamespace(header=header, pose=SimpleNamespace(pose=pose), twist=SimpleNamespace(twist=twist))
        joints = SimpleNamespace(header=header, name=self.names, position=self.angles + self.rates * way)
        driver = {self.topics.base_odom: odometry} if self.twist else {}
        return {self.topics.imu: imu, **driver, self.topics.joint_states: joints}

    def come(self, bus: Listening, now: list[float], held: range, more: int) -> Iterator[int]:
        """The numbers of the periods whose messages have come, up to ``more`` after a hold-up: the first hundred of it come at its end, at
        once; for the others there was no room. ``now`` [s] is set to when they come. The base starts in period 800."""
        for k in range(held.stop + more):
            now[0] = 100.0 + (held.stop * PERIOD + 1e-5 * (k - held.stop) if k in held else k * PERIOD)
            if k in held and k - held.start > 100:
                continue
            way = SPEED * PERIOD * max(k - 800, 0)
            for topic, message in self.at(7.0 + k * PERIOD, way, SPEED if k > 800 else 0.0).items():
                bus.take[topic](message, None)
            yield k


@pytest.mark.parametrize("seconds", [0.06, 0.3, 2.0])
@pytest.mark.parametrize("name", ["swerve-ur10", "differential-ur10", "mecanum-ur10", "tidybot", "pr2"])
def test_what_waited_is_no_current_estimate(name: str, seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Odometry is published with the time at which its joint states came. Those of the beginning of a hold-up come at its end."""
    robot = load_robot(name)
    settings = settings_of(robot)()
    adapter = base_type(robot.description.base.type).ros(robot, settings, PERIOD)
    bus, held, now = Listening(), range(1200, 1200 + round(seconds / PERIOD)), [0.0]
    robot_io = BusRobot(bus, adapter, settings, WallClock(0.0))  # type: ignore[arg-type]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    messages, silent, shown = Driven(robot, settings), 0, 0
    for k in messages.come(bus, now, held, 100):
        for measurement in robot_io.unread():
            adapter.stand(measurement)
        if (seen := adapter.snapshot()) is not None and k > 1000:
            true = SPEED * ((seen[0] - 100.0) - 800 * PERIOD)
            is_current = robot_io.is_current(seen[0])
            assert not is_current or abs(seen[1][robot.state["base"]][0] - true) < 0.025, k - held.stop
            silent, shown = silent + (not is_current), shown + (is_current and k > held.stop + 20)
    assert silent > 10 and shown > 70


@pytest.mark.parametrize("rate", [5.0, 20.0, 40.0, 100.0, 500.0])
@pytest.mark.parametrize(("jitter", "drift"), [(0.0, 1e-4), (0.0, -1e-4), (0.03, 1e-4)])
def test_joint_states_of_slow_robots_and_busy_networks_are_current(rate: float, jitter: float, drift: float) -> None:
    """An hour of a clock that drifts, or minutes of a network that delays each message by up to ``jitter`` [s]: no message waits long. By hand."""
    count = 3000 if jitter else 20000
    stamps = np.arange(count) / rate
    arrivals = np.maximum.accumulate((1.0 + drift) * stamps + jitter * np.random.default_rng(0).random(count))
    lag = Lag()
    late = [lag.late(*both) for both in zip(np.diff(arrivals), np.diff(stamps), strict=True)]
    longest = max((sum(1 for _ in run) for one, run in groupby(late) if one), default=0)
    assert np.mean(late) <= (0.3 if jitter else 0.0)
    assert longest / rate < max(0.15, 4.0 / rate)
    assert lag.late(2.0, 1.0 / rate)


def located(stamp: float, way: float, frame: str) -> Any:
    """A pose of another localization."""
    header = SimpleNamespace(stamp=SimpleNamespace(sec=int(stamp), nanosec=round(stamp % 1.0 * 1e9)), frame_id=frame)
    pose = SimpleNamespace(position=vector(way), orientation=SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0))
    return SimpleNamespace(header=header, pose=SimpleNamespace(pose=pose, covariance=(1e-4 * np.eye(6)).ravel()))


@pytest.mark.parametrize(("name", "seconds"), some(list(product(EACH_BASE, (0.3, 2.0, 10.0))), [0, 2, 3, 5, 6, 9, 14]))
def test_the_way_of_the_time_in_which_a_process_was_held_up_counts(
    name: str, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When it goes on the first messages of that time come at once, then the newest ones: for the others there was no room."""
    robot = load_robot(name)
    settings = settings_of(robot)()
    adapter = base_type(robot.description.base.type).ros(robot, settings, PERIOD)
    bus, held, now = Listening(), range(1200, 1200 + round(seconds / PERIOD)), [0.0]
    robot_io = BusRobot(bus, adapter, settings, WallClock())  # type: ignore[arg-type]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    messages = Driven(robot, settings)
    for k in messages.come(bus, now, held, 400):
        if k not in held and k % 4 == 0:
            for measurement in robot_io.unread():
                adapter.stand(measurement)
    seen, estimate = adapter.snapshot(), adapter.estimate()
    assert seen is not None and estimate is not None
    assert seen[1][robot.state["base"]] == pytest.approx([SPEED * PERIOD * (k - 800), 0.0, 0.0], abs=0.02)
    assert 0.005 < np.sqrt(estimate.covariance[0, 0]) < 0.15 * SPEED * seconds + 0.05


@pytest.mark.parametrize(("name", "seconds"), some(list(product(EACH_BASE, (0.3, 2.0))), [0, 1, 2, 5, 7, 8]))
def test_poses_that_waited_are_of_their_stamps(name: str, seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another localization of 30 Hz, right to a centimeter, 0.1 s old: what waited of it and of all joint states comes at once. Whatever
    a pose says of the way since the silence began is not counted by the wheels once more."""
    robot = load_robot(name)
    settings = settings_of(robot)(topics={"pose": "/pose"})
    adapter = base_type(robot.description.base.type).ros(robot, settings, PERIOD)
    bus, held, now = Listening(), range(1200, 1200 + round(seconds / PERIOD)), [0.0]
    robot_io = BusRobot(bus, adapter, settings, WallClock())  # type: ignore[arg-type]
    source = PoseSource(bus, settings, lambda: now[0], lambda: now[0])  # type: ignore[arg-type]
    control = SimpleNamespace(settings=settings, source=source, adapter=adapter, clock=robot_io.clock, running=False)
    adapter.fix = ExternalPose(control).take  # type: ignore[arg-type]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    messages, late, worst = Driven(robot, settings), 40, 0.0
    way_at = lambda k: SPEED * PERIOD * max(k - 800, 0)
    for k in range(held.stop + 400):
        now[0] = 100.0 + (held.stop * PERIOD + 1e-5 * (k - held.stop) if k in held else k * PERIOD)
        if k % 13 == 0:
            source._take(located(100.0 + (k - late) * PERIOD, way_at(k - late), settings.frames.world))
        for topic, message in messages.at(7.0 + k * PERIOD, way_at(k), SPEED if k > 800 else 0.0).items():
            bus.take[topic](message, None)
        if k in held or k % 4:
            continue
        for measurement in robot_io.unread():
            adapter.stand(measurement)
        seen = adapter.snapshot()
        assert seen is not None
        worst = max(worst, float(np.abs(seen[1][robot.state["base"]] - [way_at(k), 0.0, 0.0]).max()))
    assert worst < 0.03


@pytest.mark.parametrize("name", ["swerve-ur10", "differential-ur10"])
def test_odometry_goes_on_without_the_other_localization(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that stands for its node, driven by others, whose localization ends after 2 s: the same pose comes again and again, under its old
    stamp. Before the first pose nothing is said of where it is."""
    robot = load_robot(name)
    settings = settings_of(robot)(topics={"pose": "/pose"})
    adapter = base_type(robot.description.base.type).ros(robot, settings, PERIOD)
    bus, now = Listening(), [0.0]
    robot_io = BusRobot(bus, adapter, settings, WallClock())  # type: ignore[arg-type]
    source = PoseSource(bus, settings, lambda: now[0], lambda: now[0])  # type: ignore[arg-type]
    control = SimpleNamespace(settings=settings, source=source, adapter=adapter, clock=robot_io.clock, running=False)
    adapter.fix = ExternalPose(control).take  # type: ignore[arg-type]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    messages, way_at = Driven(robot, settings), lambda k: SPEED * PERIOD * max(k - 400, 0)
    for k in range(1600):
        now[0] = 100.0 + k * PERIOD
        if k >= 100 and k % 13 == 0:
            at = min(k, 800)
            source._take(located(100.0 + at * PERIOD, way_at(at), settings.frames.world))
        for topic, message in messages.at(7.0 + k * PERIOD, way_at(k), SPEED if k > 400 else 0.0).items():
            bus.take[topic](message, None)
        if k % 4:
            continue
        for measurement in robot_io.unread():
            with suppress(SafeStop):
                adapter.stand(measurement)
        seen = adapter.snapshot()
        assert (seen is not None) is (k >= 104)
        if seen is not None:
            assert seen[1][robot.state["base"]] == pytest.approx([way_at(k), 0.0, 0.0], abs=0.03)
    assert source.lost()


def test_a_stamp_is_a_time_only_after_a_silence_that_has_room_for_it() -> None:
    """By hand: messages that come at once after 2 s, one of a clock that was set ahead, bursts after 40 ms."""
    waited = Waited()
    assert waited.interval(2.0, 0.01) == 2.0
    assert [waited.interval(1e-4, s) for s in (0.01, 1.5)] == [0.01, 1.5]
    assert waited.interval(1e-4, 3.0) == 1e-4
    assert waited.interval(0.0025, 0.0025) == 0.0025
    burst = Waited()
    assert [burst.interval(a, 0.0025) for a in (0.04, 1e-4, 1e-4)] == [0.04, 1e-4, 1e-4]


def test_a_clock_that_is_set_long_after_a_silence_is_no_time() -> None:
    """By hand: a driver that stood still for 30 s goes on with its stamps, comes in time, then its clock is set ahead by 20 s. And one of the
    messages that waited takes 1 ms: the others still have."""
    waited = Waited()
    assert waited.interval(30.0, 0.01) == 30.0
    assert [waited.interval(0.01, 0.01) for _ in range(20)] == [0.01] * 20
    assert waited.interval(0.01, 20.0) == 0.01
    burst = Waited()
    assert [burst.interval(a, 0.0025) for a in (2.0, 1e-4, 1e-3, 1e-4)] == [2.0, 0.0025, 1e-3, 0.0025]
