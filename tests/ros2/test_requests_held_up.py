"""Requests to a process that was held up meanwhile. Truth: by hand, times that are set, SIGSTOP."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from listening import Listening, vector

from wbmpc.bases.swerve.ros_leg_control import LegControl
from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.control import ControlNode
from wbmpc.ros2.goals import Planner
from wbmpc.ros2.hold_ups import AGAIN, HoldUps
from wbmpc.ros2.request_queue import RequestQueue
from wbmpc.ros2.settings import RosSettings, settings_of
from wbmpc.runtime.clock import VirtualClock, WallClock
from wbmpc.runtime.safety import RealTimeSettings
from wbmpc.runtime.stop_control import StopControl


def listening(
    robot: RobotModel, settings: RosSettings, bus: Listening, now: list[float], wall: list[float] | None = None
) -> tuple[RequestQueue, Callable[[], None]]:
    """What hears goals at times that are set by hand, and its look at the ``wall``'s."""
    by_wall = now if wall is None else wall
    hold_ups, planner = HoldUps(lambda: by_wall[0]), Planner(robot, settings.speeds, settings.goals)
    return RequestQueue(hold_ups, bus, planner, settings, lambda: 0.0, lambda: now[0], lambda: now[0]), hold_ups.look  # type: ignore[arg-type]


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


#: Works for long beside the thread that looks, then waits to be stopped; says whether a goal of its beginning is old. Its time leaves out
#: for how long it was to run and others ran in its place.
WORKS = """
import sys, time
from wbmpc.ros2.hold_ups import HoldUps
def wall():
    with open("/proc/self/schedstat") as kernel:
        return time.monotonic() - 1e-9 * int(kernel.read().split()[1])
hold_ups = HoldUps(wall)
hold_ups.begin()
came = begin = wall()
n = 10**7
while wall() - begin < 2.5:  # calls that keep the interpreter to themselves, longer and longer ones
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
