"""A ball robot on a bus. Truth: MuJoCo's robot stands or has fallen; limits of the settings; the simulator's pose."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds

from effort import thorough
from wbmpc.bases.ball.sensors import SensorFault

pytestmark = needs_dds
if not MISSING:
    from balancing import NETWORK, ROBOT, Deaf, balancing, errors, standing
    from simulated import Simulated

    from wbmpc.ros2.trajectory_client import places_of


@pytest.fixture(scope="class")
def balanced() -> Iterator[Callable[..., Any]]:
    """A robot that balances: the one that a test before has left so, or else a new one; ``sound``: that has a plan, too."""
    opened: list[Any] = []

    def get(sound: bool = True) -> Any:
        s = opened[-1] if opened else None
        if s is None or s.why or not s.control.running or (sound and s.control.degraded):
            if s is not None:
                s.close()
            s = Simulated(ROBOT, NETWORK)
            opened.append(s)
            balancing(s)
        s.change = lambda message: message
        s.said.clear()
        return s

    yield get
    for s in opened:
        s.close()


@thorough
def test_a_stream_of_one_speed_is_that_speed(made: Callable[..., Any]) -> None:
    """20 messages a second: it leans first, and then rolls at the speed that was asked for."""
    s = made(seed=3)
    s.ready()
    publisher = s.other.publisher("/cmd_vel", "geometry_msgs/msg/Twist")
    assert s.until(lambda: publisher._writer.get_matched_subscriptions())
    begin, ways = s.sim.time, []
    while s.sim.time < begin + 4.5:
        publisher.publish({"linear": {"x": -0.2}})
        s.run(0.05)
        ways.append((s.sim.time - begin, s.control.adapter.snapshot()[1][0]))
    times, x = np.array(ways).T
    settled = times > 2.7
    assert np.polyfit(times[settled], x[settled], 1)[0] == pytest.approx(-0.2, rel=0.03)
    speed = np.gradient(x, times)[4:]
    assert speed.min() > -0.29 and np.ptp(speed[times[4:] > 2.7]) < 0.08


def test_it_is_held_until_a_goal_comes_and_then_balances(made: Callable[..., Any]) -> None:
    s = made()
    s.ready()
    s.run(0.3)
    assert not any(s.sim._count.values()) and s.sim.plant.time == 0.0
    s.end_effector(dx=0.1)
    s.run(3.0)
    assert not s.why and s.control.running
    truth = s.truth()
    home = ROBOT.pose(ROBOT.home)[0]
    np.testing.assert_allclose(truth.tool, home + [0.1, 0.0, 0.0], atol=0.02)
    e = s.control.adapter.estimate()
    np.testing.assert_allclose(e.position, [*truth.pose[:2], 0.125], atol=0.01)
    spread = np.sqrt(np.diag(e.covariance))
    assert np.all(spread > 0.0) and spread[0] < 0.05 and spread[3] < 0.05
    # the position does not get better but for what a better lean takes off it, the lean does not get worse
    s.run(1.0)
    later = s.control.adapter.estimate().covariance
    assert later[0, 0] > 0.9 * e.covariance[0, 0] and later[3, 3] < 1.5 * e.covariance[3, 3]


def test_a_stop_before_the_first_torques_lets_nobody_fall(made: Callable[..., Any]) -> None:
    """A controller whose first tick took too long stops, and sends zeros: nobody balances the robot yet. Truth: it stands for 3 s, which without
    torques it does not."""
    s = made()
    s.ready()
    for name, controller in s.sim._controllers.items():
        targets = [places_of(ROBOT)[j] for j in controller.joints]
        s.sim._take(name, targets, SimpleNamespace(data=np.zeros(len(targets))))
    s.run(3.0)
    s.end_effector(dx=0.02)
    standing(s)


def test_drives_that_take_the_first_commands_late(made: Callable[..., Any]) -> None:
    """Somebody holds the robot for 0.3 s while torques are sent already: neither its encoders nor its inertial unit are to blame, and
    no force is learned from it."""
    s = made()
    take, began, at_release = s.sim._take, [], []

    def late(*given: Any) -> None:
        began or began.append(s.sim.time)
        if s.sim.time - began[0] >= 0.3:
            at_release or at_release.append(np.abs(s.control.adapter.controller.learned.disturbance).max())
            take(*given)

    s.sim._take = late
    s.ready()
    s.end_effector(dx=0.1, dz=-0.05)
    assert s.until(lambda: at_release or s.control.adapter.faults), s.control.state
    assert at_release == [0.0] and not s.control.adapter.faults
    standing(s)
    assert not s.control.adapter.faults


@thorough
def test_an_mpc_that_gives_no_plan_for_a_while(made: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    """A policy that is too old is kept, and given up as soon as there is a new one."""
    s = made()
    balancing(s)
    solve = s.control.adapter.mpc.advance
    s.control.adapter.mpc.advance = lambda observation: False
    s.run(2.0)
    assert "the policy is 0.5" in s.control.state and errors(caplog, "running on the last policy") == 1
    assert not s.why and s.truth().tilt < 0.25
    s.control.adapter.mpc.advance = solve
    assert s.until(lambda: s.control.state == "running: end effector to a goal"), s.control.state
    standing(s)


STATES = {
    "nan": lambda m: {**m, "position": m["position"] * np.nan},
    "elsewhere": lambda m: {**m, "position": m["position"] + 1.0},
    "huge": lambda m: {**m, "position": m["position"] - 1e300},
    "short": lambda m: {**m, "position": m["position"][1:]},
    "empty": lambda m: {**m, "name": [], "position": []},
    "missing": lambda m: {**m, "name": ["hip", *m["name"][1:]]},
    "late": lambda m: {**m, "header": {**m["header"], "stamp": {"sec": 0, "nanosec": 5}}},
    "ahead": lambda m: {**m, "header": {**m["header"], "stamp": {"sec": 1000, "nanosec": 0}}},
}


class TestOneRun:
    """On one robot as long as it balances; what ends that comes after what does not."""

    def test_messages_that_are_wrong_do_not_count(
        self, balanced: Callable[[], Any], caplog: pytest.LogCaptureFixture
    ) -> None:
        """One at a time, twice each but for the jumps, which would be believed; and the same message again. Of the inertial unit two
        that are stamped wrong."""
        s = balanced()
        changes = [lambda m: m] * 4
        for name, change in STATES.items():
            changes += [change] * (1 if name in ("elsewhere", "ahead") else 2) + [lambda m: m] * 4
        frozen: list[Any] = []
        repeated = lambda m: frozen[0] if frozen else frozen.append(m) or m
        broken = iter([*changes, *[repeated] * 5])
        s.change = lambda m: next(broken, lambda same: same)(m)
        send, stamps = s.sim._imu, iter([0, 1000])

        def imu(m: Any) -> None:
            sec = next(stamps, None)
            send.publish(m if sec is None else {**m, "header": {**m["header"], "stamp": {"sec": sec, "nanosec": 0}}})

        s.sim._imu = Deaf(imu)
        s.run(0.2)
        standing(s)
        assert next(broken, None) is None and next(stamps, None) is None and not s.control.robot_io.fault
        lines = [r.getMessage() for r in caplog.records if "it does not count, the robot goes on" in r.getMessage()]
        assert "imu: its stamp is " in lines.pop(0)
        assert 1 <= len(lines) <= 5 and "is not finite" in lines[0] and "jumped by 1 rad" in lines[1]

    def test_a_second_inertial_unit_does_not_make_it_fall(
        self, balanced: Callable[[], Any], caplog: pytest.LogCaptureFixture
    ) -> None:
        """5 rad/s beside the truth, as often: it holds its position, and goes on when that has gone."""
        s = balanced()
        second, send = s.other.publisher("/imu", "sensor_msgs/msg/Imu"), s.sim._imu
        s.sim._imu = Deaf(lambda m: (send.publish(m), second.publish({**m, "angular_velocity": {"x": 5.0, "y": 5.0}})))
        says = "holds its position: 2 publishers on /imu, which has one source"
        assert s.until(lambda: says in s.control.state), s.control.state
        standing(s)
        s.sim._imu = send
        s.other._writers.remove(second._writer)
        second._writer.__del__()
        assert s.until(lambda: s.control.state == "running: stay"), s.control.state
        assert errors(caplog, says) == 1

    def test_somebody_else_on_the_drives_topic_is_reported_and_it_holds_its_place(
        self, balanced: Callable[[], Any], caplog: pytest.LogCaptureFixture
    ) -> None:
        s = balanced()
        somebody = s.other.publisher("/arm_controller/commands", "std_msgs/msg/Float64MultiArray")
        assert s.until(lambda: "holds its position: another node publishes on /arm" in s.control.state)
        s.end_effector(dx=0.2)
        standing(s)
        assert "a goal is rejected: another node" in s.control.request_queue.rejected
        assert errors(caplog, "another node publishes") == 1 and any("another node" in m for m in s.messages(2))
        s.other._writers.remove(somebody._writer)
        somebody._writer.__del__()
        assert s.until(lambda: s.control.state == "running: stay"), s.control.state

    def test_an_inertial_unit_that_says_nonsense_does_not_count(
        self, balanced: Callable[[], Any], caplog: pytest.LogCaptureFixture
    ) -> None:
        s = balanced()
        send = s.sim._imu
        s.sim._imu = Deaf(lambda m: send.publish({**m, "angular_velocity": {"x": np.nan}}))
        s.run(0.01)
        s.sim._imu = send
        standing(s)
        assert errors(caplog, "imu") == 1 and not s.control.robot_io.fault

    def test_a_wrench_counts_beside_the_observers_disturbance(self, balanced: Callable[[], Any]) -> None:
        """What the MPC is given: the world's answer to the wrench, and both end when no more messages come."""
        s = balanced()
        forces = lambda: ROBOT.parameters.split(s.control.adapter.parameters())["force"]
        s.send(
            "/wrench",
            "geometry_msgs/msg/WrenchStamped",
            {"header": {"frame_id": "odom"}, "wrench": {"force": {"x": 3.0}}},
        )
        assert s.until(lambda: np.allclose(forces(), [-3.0, 0.0, 0.0])), forces()
        s.run(1.0)
        np.testing.assert_array_equal(forces(), np.zeros(3))
        assert np.any(ROBOT.parameters.split(s.control.adapter.parameters())["disturbance"] != 0.0)

    def test_an_encoder_that_stands_still_is_reported_and_one_of_the_arm_ends_it(
        self, balanced: Callable[[], Any]
    ) -> None:
        s = balanced()
        s.sim.plant.sensors.faults = (SensorFault("stalled", 0, s.sim.plant.time, np.inf),)
        s.end_effector(dx=0.1)
        said = "the encoder of wheel_0 stands still"
        assert s.until(lambda: any(said in m for m in s.messages(1))), s.control.adapter.faults
        assert s.control.running and any(said in f for f in s.control.adapter.faults)
        s.sim.plant.sensors.faults += (SensorFault("stalled", 1, s.sim.plant.time, np.inf, of="arm"),)
        s.end_effector(dx=-0.1)
        assert s.until(lambda: not s.control.running)
        assert "the encoder of arm_shoulder stands still; motors off" in s.control.state

    def test_an_mpc_that_dies_leaves_its_last_policy(
        self, balanced: Callable[[], Any], caplog: pytest.LogCaptureFixture
    ) -> None:
        s = balanced()

        def dies(observation: Any) -> bool:
            raise RuntimeError("no memory")

        s.control.adapter.mpc.advance = dies
        standing(s)
        assert "running on the last policy" in s.control.state and "no memory" in s.control.state
        assert errors(caplog, "no memory") == 1
        assert any("no memory" in m for m in s.messages(2))

    def test_without_states_there_is_no_balance(
        self, balanced: Callable[[], Any], caplog: pytest.LogCaptureFixture
    ) -> None:
        s = balanced(sound=False)
        s.change = lambda m: None
        assert s.until(lambda: s.control.runner.stopped), s.control.state
        assert "s old, the limit is 0.1 s" in s.control.state
        assert s.until(lambda: np.all(s.sim._groups["wheel"] == 0.0) or s.why)
        assert errors(caplog, "s old, the limit") == 1
        assert s.until(lambda: any("s old" in m for m in s.messages(2)))


def test_without_its_inertial_unit_there_is_no_balance(
    made: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing else says how it leans: torques ramp down within the watchdog's time, and it says why it fell."""
    s = made()
    balancing(s)
    s.sim._imu = Deaf()
    at = s.sim.time
    assert s.until(lambda: s.control.runner.stopped), s.control.state
    assert "the messages on /imu stopped 0.1" in s.control.state and s.sim.time - at < 0.15
    assert errors(caplog, "the messages on /imu stopped") == 1
    assert s.until(lambda: any("on /imu stopped" in m for m in s.messages(2)))
    assert s.until(lambda: np.all(s.sim._groups["wheel"] == 0.0) or s.why)


def keep_pace(s: Any, hung: threading.Event) -> None:
    """The physics does not run away from an MPC that a busy machine gives no time; one that hangs is not waited for."""
    advance, last = s.sim._advance, [0.0, 0.0]

    def paced() -> None:
        runner, end = s.control.runner, time.monotonic() + 60.0
        while runner is not None and not hung.is_set() and time.monotonic() < end:
            updates = float(runner.board["updates"])
            if updates != last[0]:
                last[:] = updates, s.sim.time
            if not updates or s.sim.time - last[1] < 0.1:
                break
            time.sleep(1e-3)
        advance()

    s.sim._advance = paced


def test_an_mpc_that_hangs_leaves_its_last_policy(made: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    """A solve that does not come back, in a thread of its own: balance goes on, and the MPC takes over when it is back."""
    s = made(lockstep=False)
    solve, hung, back = s.control.adapter.mpc.advance, threading.Event(), threading.Event()
    keep_pace(s, hung)
    balancing(s)

    def hangs(observation: Any) -> Any:
        hung.set()
        back.wait(60.0)
        return solve(observation)

    s.control.adapter.mpc.advance = hangs
    assert s.until(hung.is_set)
    try:
        s.run(1.2)
        assert not s.why and s.truth().tilt < 0.25 and s.control.running
        assert "the policy is 0.5" in s.control.state and errors(caplog, "running on the last policy") == 1
        assert s.until(lambda: any("the policy is 0.5" in m for m in s.messages(2)))
    finally:
        s.control.adapter.mpc.advance = solve
        back.set()
        hung.clear()
    assert s.until(lambda: s.control.state == "running: end effector to a goal"), s.control.state
    s.run(0.5)
    assert not s.why and s.truth().tilt < 0.25
