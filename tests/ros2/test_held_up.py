"""The odometry of a process that was held up while somebody else drives the base. Truth: wheels that roll without slip, at a speed set by
hand."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from effort import some
from wbmpc.bases import base_type
from wbmpc.bases.swerve.ros_leg_control import LegControl
from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.bases.wheels.control import wheels_base
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics
from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.control import ControlNode
from wbmpc.ros2.goals import Planner
from wbmpc.ros2.hold_ups import AGAIN, HoldUps
from wbmpc.ros2.joints import Waited
from wbmpc.ros2.localization import ExternalPose, PoseSource
from wbmpc.ros2.request_queue import RequestQueue
from wbmpc.ros2.robot import BusRobot
from wbmpc.ros2.settings import RosSettings, joint_groups, settings_of
from wbmpc.runtime.clock import VirtualClock, WallClock
from wbmpc.runtime.safety import RealTimeSettings, SafeStop
from wbmpc.runtime.stop_control import StopControl

PERIOD, SPEED, BIAS = 0.0025, 0.8, 0.01
#: One of each type of base that drives.
EACH_BASE = "swerve-ur10", "differential-ur10", "mecanum-ur10", "tidybot", "pr2"


class Listening:
    """A bus on which nothing comes but by hand: ``take`` by topic."""

    def __init__(self) -> None:
        self.take: dict[str, Callable[..., None]] = {}

    def subscribe(self, topic: str, kind: str, callback: Callable[..., None], *given: Any, **keys: Any) -> None:
        self.take[topic] = callback

    def publisher(self, *given: Any) -> Any:
        return SimpleNamespace(publish=lambda message: None)


def vector(x: float = 0.0, z: float = 0.0) -> Any:
    return SimpleNamespace(x=x, y=0.0, z=z)


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
    for k in range(held.stop + 400):
        way = SPEED * PERIOD * max(k - 800, 0)
        now[0] = 100.0 + (held.stop * PERIOD + 1e-5 * (k - held.stop) if k in held else k * PERIOD)
        if k in held and k - held.start > 100:
            continue
        for topic, message in messages.at(7.0 + k * PERIOD, way, SPEED if k > 800 else 0.0).items():
            bus.take[topic](message, None)
        if k not in held and k % 4 == 0:
            for measurement in robot_io.unread():
                adapter.stand(measurement)
    seen, estimate = adapter.snapshot(), adapter.estimate()
    assert seen is not None and estimate is not None
    assert seen[1][robot.state["base"]] == pytest.approx([way, 0.0, 0.0], abs=0.02)
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


def listening(
    robot: RobotModel, settings: RosSettings, bus: Listening, now: list[float], wall: list[float] | None = None
) -> tuple[RequestQueue, Callable[[], None]]:
    """What hears goals at times that are set by hand, and its look at the ``wall``'s."""
    by_wall = now if wall is None else wall
    hold_ups, planner = HoldUps(lambda: by_wall[0]), Planner(robot, settings.speeds, settings.goals)
    return RequestQueue(hold_ups, bus, planner, settings, lambda: 0.0, lambda: now[0], lambda: now[0]), hold_ups.look  # type: ignore[arg-type]


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


@pytest.mark.parametrize("stopped", [False, True])
def test_speeds_that_waited_in_a_process_that_was_held_up_are_no_goal(stopped: bool) -> None:
    """A stream of 20 Hz goes on while a process is held up for 2 s. Truth: by hand. The speed from before has run out, and is not prolonged by
    them. It counts again when none of that time, not even a zero, can come any more; where it was stopped after a zero."""
    robot = load_robot("differential-ur10")
    settings, bus, now = settings_of(robot)(), Listening(), [10.0]
    bus.publishers = lambda *given: []  # type: ignore[attr-defined]
    queue, look = listening(robot, settings, bus, now)
    speed = lambda v: bus.take["/cmd_vel"](SimpleNamespace(linear=vector(v), angular=vector()))
    look()
    speed(0.5)
    request = queue.take()
    assert request is not None
    queue.running = request(robot.home, 0.0)
    now[0] += 2.0
    for k in range(3):  # before the node's own thread goes on, and after
        speed(0.5)
        look()
        if stopped:
            queue.stop()
            queue.running = None
        request = queue.take()
        assert (request is not None) is (k == 0 and not stopped)
        if request is not None:
            assert request(robot.home, 0.0).description == queue.planner.slow_down(robot.home, 0.0, None).description
        now[0] += 1e-4
    assert "held up" in queue.rejected
    for k in range(80):
        now[0] += 0.05
        look()
        speed(0.0 if k == 20 else 0.5)
        assert k > 60 or queue.take() is None
    assert (queue.take() is not None) is not stopped
    speed(0.0)
    speed(0.5)
    assert queue.take() is not None
    assert not queue._latched


@pytest.mark.parametrize("held", [0.2, 0.47, 0.499])
def test_the_silence_of_a_process_that_was_held_up_is_no_pause_of_a_stream(held: float) -> None:
    """A stream of 10 Hz goes on while the process is held up for less than a speed holds (0.5 s): a robot that has stopped stays where it is
    until the stream itself pauses, also if messages that were lost meanwhile keep others back for 0.6 s. Truth: by hand."""
    robot = load_robot("differential-ur10")
    bus, now = Listening(), [10.0]
    queue, look = listening(robot, settings_of(robot)(), bus, now)
    queue._spoken_at = now[0]
    queue.stop()
    for count, silent, held_up in ((3, 4, 0.0), (1, 4, held), (3, 4, 0.0), (1, 30, 0.0), (45, 4, 0.0), (1, 30, 0.0)):
        assert queue.take() is None
        for _ in range(count):
            for _ in range(silent):
                now[0] += 0.02
                look()
            now[0] += held_up
            bus.take["/cmd_vel"](SimpleNamespace(linear=vector(0.5), angular=vector()))
            look()
    assert queue.take() is not None


@pytest.mark.skipif(
    not hasattr(time, "CLOCK_BOOTTIME"), reason="this system does not say for how long it was suspended"
)
@pytest.mark.parametrize(("clock", "balances"), [(WallClock(), False), (WallClock(), True), (BusClock(), False)])
def test_a_robot_whose_machine_was_suspended_stops(
    clock: WallClock | BusClock, balances: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By steady clocks nothing has passed: every tick seems to be in time, and nothing has waited. What balances goes on, and so does what lives
    by a simulator's time: a minute of the wall may be nothing for it. By hand: a quick look, a slow one, a minute of sleep, and a goal
    of before it."""
    machine = [10.0]
    monkeypatch.setattr("time.clock_gettime", lambda clock: {time.CLOCK_BOOTTIME: machine[0]}[clock])
    monkeypatch.setattr("time.monotonic", lambda: 5.0)
    hold_ups, stopped = HoldUps(spent=lambda: 0.0), list[str]()
    control = SimpleNamespace(
        runner=SimpleNamespace(stopped=False), running=True, adapter=SimpleNamespace(must_keep_running=balances),
        clock=clock, hold_ups=hold_ups, _began=hold_ups.wall(), _graph_checked_at=5.0, _stop_runner=stopped.append,
        **dict.fromkeys(("_check_clock", "_check_other_publishers"), lambda: None),
    )  # fmt: skip
    for slept in (0.02, 0.5, 60.0):
        assert not stopped and not hold_ups.too_old("a goal")
        hold_ups.look()
        machine[0] += slept
        ControlNode._supervise(control)  # type: ignore[arg-type]
    assert bool(stopped) is (isinstance(clock, WallClock) and not balances)
    assert hold_ups.too_old("a goal")
    with pytest.raises(InputError, match="from before the node was held up"):
        hold_ups.check(10.0)


@pytest.mark.parametrize("held", [0.15, 0.4, 0.9])
def test_a_zero_that_waited_is_no_sign_that_the_stop_was_seen(held: float) -> None:
    """Of a stream that had one while the process was held up, and goes on at its speed; a zero of now is. By hand."""
    robot = load_robot("differential-ur10")
    bus, now = Listening(), [10.0]
    queue, look = listening(robot, settings_of(robot)(), bus, now)
    speed = lambda v: bus.take["/cmd_vel"](SimpleNamespace(linear=vector(v), angular=vector()))
    look()
    speed(0.5)
    queue.stop()
    now[0] += held
    for v in (0.5, 0.0, 0.5):
        speed(v)
        look()
        assert queue.take() is None
    for k in range(200):
        now[0] += 0.02
        look()
        speed(0.0 if k == 190 else 0.5)
        assert (queue.take() is not None) is (k > 190)


@pytest.mark.parametrize("zero", [False, True])
def test_the_end_of_a_speed_starts_no_robot(zero: bool) -> None:
    """A speed was rejected, for a sensor was late, or the robot has stopped since; then it runs out, or a zero ends it. By hand."""
    robot = load_robot("differential-ur10")
    bus, now = Listening(), [10.0]
    queue, _ = listening(robot, settings_of(robot)(), bus, now)
    speed = lambda v: bus.take["/cmd_vel"](SimpleNamespace(linear=vector(v), angular=vector()))
    speed(0.5)
    request = queue.take()
    assert request is not None
    now[0] += 0.1 if zero else 0.6
    if zero:
        speed(0.0)
    assert queue.take() is None
    queue.running = request(robot.home, 0.0)
    speed(0.5)
    speed(0.0)
    assert queue.take() is not None


def test_a_speed_beside_a_stop_counts_before_it_or_not_at_all() -> None:
    """Threads that take and that stop take turns: a stop comes after a speed was judged, and before it waits to be taken up."""
    robot = load_robot("differential-ur10")
    bus, stops = Listening(), list[threading.Thread]()
    queue, _ = listening(robot, settings_of(robot)(), bus, [10.0])

    def stop(*given: Any) -> None:
        stops.append(threading.Thread(target=queue.stop))
        stops[0].start()
        stops[0].join(0.2)

    queue._limit = stop  # type: ignore[method-assign]
    bus.take["/cmd_vel"](SimpleNamespace(linear=vector(0.5), angular=vector()))
    stops[0].join()
    assert queue.take() is None and queue._latched


class OtherFirst:
    """A queue's lock whose next user finds that another thread has been faster: ``first`` is done before."""

    def __init__(self, queue: RequestQueue) -> None:
        self._lock, queue._lock = queue._lock, self  # type: ignore[assignment]
        self.first: Callable[[], None] | None = None

    def __enter__(self) -> None:
        first, self.first = self.first, None
        if first is not None:
            first()
        self._lock.acquire()

    def __exit__(self, *given: Any) -> None:
        self._lock.release()


def test_a_goal_that_replaces_a_speed_does_not_end_as_that_speed() -> None:
    """A speed comes while a goal waits for the queue. Truth: by hand; the goal counts, and nothing slows it down when a speed would have run
    out."""
    robot = load_robot("differential-ur10")
    bus, now = Listening(), [10.0]
    queue, _ = listening(robot, settings_of(robot)(), bus, now)
    other, goal = OtherFirst(queue), SimpleNamespace(description="a goal")
    other.first = lambda: bus.take["/cmd_vel"](SimpleNamespace(linear=vector(0.5), angular=vector()))
    queue._put_goal(lambda x, t: goal)  # type: ignore[arg-type, return-value]
    assert other.first is None
    request = queue.take()
    assert request is not None and request(robot.home, 0.0) is goal
    queue.running = goal  # type: ignore[assignment]
    now[0] += 0.6
    assert queue.take() is None


def test_a_speed_that_comes_as_the_one_before_it_runs_out_counts() -> None:
    """It is faster than the node, which takes up what to do. Truth: by hand; the robot does not slow down."""
    robot = load_robot("differential-ur10")
    bus, now = Listening(), [10.0]
    queue, _ = listening(robot, settings_of(robot)(), bus, now)
    speed = lambda: bus.take["/cmd_vel"](SimpleNamespace(linear=vector(0.5), angular=vector()))
    speed()
    request = queue.take()
    assert request is not None
    queue.running = request(robot.home, 0.0)
    now[0] += 0.6
    OtherFirst(queue).first = speed
    request = queue.take()
    assert request is not None and not request.rest
    now[0] += 0.6
    request = queue.take()
    assert request is not None and request.rest


def test_a_pause_that_does_not_count_is_not_asked_for() -> None:
    """A robot was stopped, and its process is busy for 0.2 s every 3 s: pauses of 0.6 s do not count, as messages may have been lost meanwhile.
    What is asked for counts. By hand."""
    robot = load_robot("differential-ur10")
    bus, now = Listening(), [10.0]
    queue, look = listening(robot, settings_of(robot)(), bus, now)
    speed = lambda v: bus.take["/cmd_vel"](SimpleNamespace(linear=vector(v), angular=vector()))

    def wait(seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            now[0] += 0.02
            look()

    look()
    speed(0.5)
    queue.stop()
    speed(0.5)
    assert queue.rejected.endswith("after a zero or a pause of 0.5 s")
    for _ in range(4):
        now[0] += 0.2
        look()
        wait(2.2)
        speed(0.5)
        assert queue.take() is None and "after a zero" in queue.rejected and "a pause of" not in queue.rejected
        wait(0.6)
    speed(0.0)
    speed(0.5)
    assert queue.take() is not None
    queue.stop()
    wait(AGAIN + 0.5)
    speed(0.5)
    assert queue.take() is not None


@pytest.mark.parametrize("looks", [1, 3, 7])
def test_what_waits_between_two_hold_ups_has_waited_for_both(looks: int) -> None:
    """Of 0.6 s each, with ``looks`` 0.02 s apart between them: within 0.1 s not all that waited is taken in. By hand; seen by a thread that is
    faster than the next look, and afterwards. Goals that were taken in before waited for neither longer than 1 s."""
    now = [10.0]
    hold_ups = HoldUps(lambda: now[0], lambda: 0.0)
    hold_ups.look()
    now[0] += 0.6
    hold_ups.look()
    for _ in range(looks - 1):
        now[0] += 0.02
        hold_ups.look()
    now[0] += 0.6
    waited = 1.2 if looks < 6 else 0.6
    for _ in range(2):
        assert hold_ups.waited() == pytest.approx(waited)
        assert bool(hold_ups.too_old("a goal")) is (waited > 1.0) and not hold_ups.since(10.0)
        hold_ups.look()
    for _ in range(6):
        now[0] += 0.02
        hold_ups.look()
    assert hold_ups.waited() == 0.0 and bool(hold_ups.too_old("a goal")) is (waited > 1.0)


#: Works for long beside the thread that looks, then waits to be stopped; says whether a goal of its beginning is old.
WORKS = """
import sys, time
from wbmpc.ros2.hold_ups import HoldUps
hold_ups = HoldUps()
hold_ups.begin()
came = time.monotonic()
begin, n = time.monotonic(), 10**7
while time.monotonic() - begin < 2.5:  # calls that keep the interpreter to themselves, longer and longer ones
    sum(range(n))
    n *= 2
print(hold_ups.since(came), bool(hold_ups.too_old("it")), flush=True)
sys.stdin.readline()
print(hold_ups.since(came), flush=True)
"""


def test_a_process_is_held_up_by_the_system_and_not_by_its_own_work() -> None:
    """Goals that came meanwhile are old after one of the two only: a run that ends, or begins, may take seconds of work that
    keeps the interpreter. Truth: SIGSTOP."""
    child = subprocess.Popen(
        [sys.executable, "-c", WORKS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    )
    assert child.stdin is not None and child.stdout is not None
    try:
        assert child.stdout.readline().split() == ["False", "False"]
        child.send_signal(signal.SIGSTOP)
        time.sleep(1.2)
        child.send_signal(signal.SIGCONT)
        child.stdin.write("\n")
        assert child.stdout.readline().split() == ["True"]
    finally:
        child.kill()
        child.communicate()


@pytest.mark.parametrize(("seconds", "old"), [(0.05, ""), (0.7, "wrench"), (3.0, "wrench goal legs")])
def test_goals_and_commands_that_waited_in_a_process_that_was_held_up_do_not_count(seconds: float, old: str) -> None:
    """Goals, wrenches, commands for legs and brakes that were sent meanwhile; sent again they count. Reliable writers offer goals that were
    lost meanwhile again, seconds later. Truth: by hand."""
    robot = load_robot("swerve-ur10")
    settings, bus, now = SwerveRosSettings(topics={"wrench": "/wrench"}), Listening(), [10.0]
    queue, look = listening(robot, settings, bus, now)
    bus.serve = lambda topic, kind, answer, **keys: bus.take.update({topic: answer})  # type: ignore[attr-defined]
    adapter = SimpleNamespace(robot=robot, settings=settings, brakes=None, snapshot=lambda: None)
    legs = LegControl(SimpleNamespace(node=bus, hold_ups=queue.hold_ups, running=True), adapter).commands  # type: ignore[arg-type]
    header = SimpleNamespace(frame_id="odom", stamp=SimpleNamespace(sec=0, nanosec=0))
    pose = SimpleNamespace(
        position=SimpleNamespace(x=1.0, y=0.0, z=0.0), orientation=SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0)
    )
    wrench = SimpleNamespace(force=SimpleNamespace(x=1.0, y=0.0, z=0.0), torque=vector())
    posed = SimpleNamespace(header=header, pose=pose)
    answer: list[Any] = []

    def counted() -> str:
        """What counts of all that is sent now."""
        bus.take["/wrench"](SimpleNamespace(header=header, wrench=wrench))
        goals = []
        for topic in ("/goal_pose", "/end_effector_goal", "/base_path", "/end_effector_path"):
            bus.take[topic](SimpleNamespace(header=header, pose=pose, poses=[posed]))
            goals.append(queue.take() is not None)
        orders = []
        for send in (
            lambda: bus.take["/brakes"](SimpleNamespace(data=[0.0] * 4)),
            lambda: bus.take["/leg_configuration"](SimpleNamespace(data="X")),
            lambda: bus.take["/legs"](SimpleNamespace(name=legs.names[:1], position=[0.1])),
            lambda: answer.append(
                bus.take["/set_legs"](SimpleNamespace(configuration="X", leg=[], angle=[], brake_open=[]))["success"]
            ),
        ):
            legs.drop()
            send()
            orders.append(legs.waiting)
        assert len({*goals}) == len({*orders}) == 1 and answer[-1] is orders[-1]
        named = {"wrench": bool(np.any(queue.wrench())), "goal": goals[0], "legs": orders[0]}
        return " ".join(name for name, counts in named.items() if counts)

    look()
    assert counted() == "wrench goal legs"
    for _ in range(8):  # the wrench runs out
        now[0] += 0.08
        look()
    now[0] += seconds
    count = " ".join(n for n in ("wrench", "goal", "legs") if n not in old)
    assert counted() == count  # in another thread than the node's own, which goes on first
    look()
    assert counted() == count
    for _ in range(8):
        now[0] += 0.02
        look()
    assert counted() == count
    for _ in range(180):
        now[0] += 0.02
        look()
    assert counted() == "wrench goal legs"


def test_a_plan_from_before_a_process_was_held_up_sends_no_trajectory() -> None:
    """The node's own thread goes on before the controller's, which stops the robot. By hand: ticks at 0.5 s, then at 2.5 s, limit 0.1 s; an arm
    that follows trajectories stands by then, and the plan is elsewhere."""
    runner, sent = StopControl(None, RealTimeSettings(), VirtualClock()), list[float]()  # type: ignore[arg-type]
    runner.plans = SimpleNamespace(current="a plan")  # type: ignore[attr-defined]
    control = SimpleNamespace(
        request_queue=SimpleNamespace(wrench=lambda: np.zeros(6)), wrench=np.zeros(6), runner=runner, running=True, now=None,
        clock=runner.clock, trajectories=SimpleNamespace(send=lambda policy, t, now: sent.append(t)),
    )  # fmt: skip
    for now in (0.5, 0.55, 2.5):
        runner.clock.wait(now)
        runner._beat = min(now, 0.5)
        ControlNode._send_setpoints(control)  # type: ignore[arg-type]
    assert sent == [0.5, 0.55]


def test_a_simulated_time_that_leaps_has_held_nothing_up() -> None:
    """The first time of a simulator, and of one that was restarted: goals and speeds count. By hand: leaps of 1000 s and 100 s."""
    robot = load_robot("differential-ur10")
    settings, bus, now = settings_of(robot)(), Listening(), [0.0]
    queue, look = listening(robot, settings, bus, now, [0.0])
    for leap in (1000.0, 100.0):
        look()
        now[0] += leap
        look()
        bus.take["/cmd_vel"](SimpleNamespace(linear=vector(0.5), angular=vector()))
        assert queue.take() is not None and not queue.rejected
