"""What a broken bus does to the robot. Truth: what the stand-in was reported and when, limits of the settings."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, wait_until

pytestmark = needs_dds
if not MISSING:
    from standin import AHEAD, PERIOD, ROBOT, check_stopped, drive

    from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
    from wbmpc.ros2.command_conflicts import CommandConflicts


def test_nothing_is_sent_before_a_state_and_a_goal(pair: Callable[..., Any]) -> None:
    p = pair()
    assert p.control.state == "waiting: no time on /clock yet"
    p.go()
    assert wait_until(lambda: p.control.step() or "no time on /clock" in p.control.request_queue.rejected)
    p.standin.change = lambda message: None
    assert p.until(lambda: "no joint states" in p.control.state)
    p.go()
    says = "a goal is rejected: waiting: no joint states on /joint_states yet"
    assert wait_until(lambda: p.control.step() or says in p.control.request_queue.rejected)
    p.standin.change = lambda message: message
    p.ready()
    p.run(0.5)
    assert set(p.standin.counts.values()) == {0}
    p.go(0.3)
    assert p.until(lambda: p.standin.speed > 0.1)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda m: {**m, "name": m["name"][1:], "position": m["position"][1:]}, "joint 'leg_LF' is missing"),
        (lambda m: {**m, "name": ["hip", *m["name"][1:]]}, "'leg_LF' is missing; it has 'hip', which is not ours"),
        (lambda m: {**m, "name": [*m["name"], "gripper"], "position": [*m["position"], 0.0]}, "'gripper' is not known"),
        (lambda m: {**m, "position": m["position"][1:]}, "18 names but 17 positions"),
        (lambda m: {**m, "name": [m["name"][1], *m["name"][1:]]}, "joint 'leg_LF' is missing"),
        (lambda m: {**m, "position": m["position"] * np.nan}, "the position of 'leg_LF' is not finite"),
    ],
)
def test_joint_states_that_are_not_the_robots(pair: Callable[..., Any], change: Any, says: str) -> None:
    p = pair()
    p.standin.change = change
    assert p.until(lambda: says in p.control.state), p.control.state
    p.go()
    assert p.until(lambda: says in p.control.request_queue.rejected)
    assert p.control.runner is None
    p.standin.change = lambda message: message
    p.ready()


def test_joints_are_matched_by_name_and_mapped(pair: Callable[..., Any]) -> None:
    p = pair(joints={"wheel_LF": "front_left_wheel"}, ignore=["gripper"])

    def change(m: dict[str, Any]) -> dict[str, Any]:
        order = np.random.default_rng(0).permutation(len(m["name"]))
        names = [{"wheel_LF": "front_left_wheel"}.get(n, n) for n in m["name"]]
        return {
            **m, "name": [*(names[i] for i in order), "gripper"], "position": [*(m["position"][i] for i in order), 9.9],
        }  # fmt: skip

    p.standin.change = change
    p.ready()
    x = p.control.adapter.snapshot()[1]
    np.testing.assert_array_equal(x, ROBOT.home)


def test_not_a_number_stops(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    drive(p)
    broken = iter([lambda m: {**m, "position": np.where(np.arange(18) == 9, np.nan, m["position"])}])
    p.standin.change = lambda m: next(broken, lambda same: same)(m)  # one message only
    check_stopped(p, "the position of 'wheel_RF' is not finite", caplog)


def test_a_jump_stops(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    drive(p)
    p.standin.joints["arm"][1] += 0.3
    check_stopped(p, "'shoulder_lift_joint' jumped by 0.3", caplog)


def test_stale_states_stop_within_the_watchdogs_time(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    p = pair()
    drive(p)
    last = p.standin.time - PERIOD
    p.standin.change = lambda message: None
    check_stopped(p, "s old, the limit is 0.1 s", caplog)
    at = p.control.clock.origin + float(p.control.runner.state.split()[2])
    assert 0.1 < at - last < 0.1 + 2.5 * PERIOD


def test_a_driver_that_repeats_itself_is_stale(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    drive(p)
    frozen: list[Any] = []
    p.standin.change = lambda m: frozen[0] if frozen else frozen.append(m) or m
    check_stopped(p, "s old, the limit is 0.1 s", caplog)


def test_states_that_stand_still_under_new_stamps_stop(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """A driver that has lost its encoders: the robot drove on, to nobody knows where."""
    p = pair()
    drive(p)
    frozen: list[Any] = []
    p.standin.change = lambda m: {**m, "position": (frozen or frozen.append(m["position"]) or frozen)[0]}
    start = p.standin.time
    assert p.until(lambda: p.control.runner.stopped), p.control.state
    at = p.control.clock.origin + float(p.control.runner.state.split()[2])
    assert 0.3 < at - start < 0.35
    assert p.until(lambda: p.standin.speed == 0.0)
    assert "the joint states on /joint_states stand still, under new stamps" in p.control.state


def test_a_robot_at_rest_may_stand_still(pair: Callable[..., Any]) -> None:
    p = pair()
    p.ready()
    p.go(0.02)
    assert p.until(lambda: p.control.running)
    p.run(2.0)
    assert p.control.running and p.standin.speed < 0.2


def test_a_stop_is_a_ramp(pair: Callable[..., Any]) -> None:
    p = pair(safety={"ramp": 1.0})
    drive(p)
    previous = p.standin.commands["wheel"].copy()
    p.standin.change = lambda m: {**m, "position": m["position"] * np.nan}
    seen = []
    end = time.monotonic() + 60.0
    while p.standin.speed > 0.0 and time.monotonic() < end:
        p.standin.tick(wait=True)
        seen.append(p.standin.commands["wheel"].copy())
    shares = np.array([np.abs(w).max() / np.abs(previous).max() for w in seen])
    assert np.all(np.diff(shares[3:]) <= 1e-9) and shares[-1] == 0.0
    assert np.count_nonzero((shares > 0.1) & (shares < 0.9)) > 3


def test_another_controller_stops_ours(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    drive(p)
    p.standin.node.publisher("/arm_controller/commands", "std_msgs/msg/Float64MultiArray")
    check_stopped(p, "another node publishes on /arm_controller/commands", caplog)
    p.go(0.0)
    assert p.until(lambda: "a goal is rejected: waiting: another node publishes" in p.control.request_queue.rejected)


def test_another_controller_that_comes_and_goes_stops_ours(pair: Callable[..., Any]) -> None:
    """There for 50 ms, between two looks at the graph; a goal is not taken in the next moment."""
    p = pair()
    drive(p)
    watch = p.control.command_conflicts
    watch.update()
    p.control._graph_checked_at = time.monotonic() + 0.3
    there = p.standin.node.publisher("/arm_controller/commands", "std_msgs/msg/Float64MultiArray")
    time.sleep(0.05)
    p.standin.node._writers.remove(there._writer)
    there._writer.__del__()
    assert p.until(lambda: p.control.runner.stopped, 5.0)
    assert "another node publishes on /arm_controller/commands" in p.control.state
    assert p.control.waiting_reason() and p.until(lambda: not p.control.waiting_reason())


def test_one_that_is_seen_now_and_then_counts_in_between() -> None:
    """A back end without a memory of who has left, every half second; it is there every second time."""
    now, there = [0.0], [True]
    node = SimpleNamespace(publishers=lambda topic, within: [SimpleNamespace(own=not there[0])])
    watch, said = CommandConflicts(node, ["/arm"], lambda: now[0]), []  # type: ignore[arg-type]
    for k in range(20):
        now[0], there[0] = 0.5 * k, k % 2 == 0
        watch.update()
        said.append(watch.message)
    assert set(said) == {"another node publishes on /arm"}
    there[0] = False
    now[0] += 1.1
    watch.update()
    assert not watch.message


def test_time_that_stops_is_said(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    """A simulator that was killed: who asks is reported, and what still listens is ramped down though no time passes."""
    p = pair(safety={"clock": 2.0})
    drive(p)
    assert wait_until(lambda: p.control.step() or p.control.runner.stopped)
    assert "the time on /clock has stopped for " in p.control.state
    assert wait_until(lambda: p.control.step() or p.standin.speed == 0.0)
    assert sum("/clock has stopped" in r.getMessage() for r in caplog.records if r.levelno == logging.ERROR) == 1
    runner = p.control.runner
    p.go(2.0)  # nothing would move it
    says = "a goal is rejected: waiting: the time on /clock has stopped for "
    assert wait_until(lambda: p.control.step() or says in p.control.request_queue.rejected)
    assert p.control.runner is runner


def test_in_lockstep_a_busy_machine_has_time(pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Time that has stood for 5 s stops nobody as long as there is somebody who publishes it, or was a moment ago: to a process that
    was held up for as long all others have just left."""
    p = pair(safety={"clock": None})
    drive(p)
    monkeypatch.setattr(p.control.clock, "heard", time.monotonic() - 5.0)
    p.control.step()
    assert p.control.running, p.control.state
    publishers = p.node.publishers
    monkeypatch.setattr(p.node, "publishers", lambda topic, within=0.0: publishers(topic) if within else [])
    p.control.step()
    assert p.control.running, p.control.state
    monkeypatch.setattr(p.node, "publishers", lambda topic, within=0.0: [])
    p.control.step()
    assert not p.control.running
    assert re.search(r"the time on /clock has stopped for \d.\d s, it has no publisher any more", p.control.state)
    with_wall = SwerveRosSettings(use_sim_time=True)
    assert (with_wall.patience, SwerveRosSettings(lockstep=True).patience) == (1.0, 30.0)


def test_a_robot_that_stands_by_is_commanded_however_long_that_takes(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the wall clock a stop falls silent after a second; a simulator in lockstep would wait for commands in vain."""
    monkeypatch.setattr("wbmpc.ros2.robot.ZEROS", -10.0)
    robot_io = pair().control.robot_io
    robot_io.arm()
    for sent in (1, 2, 3):
        robot_io.stop()
        assert robot_io.sent == sent
    robot_io.disarm()
    robot_io.stop()
    assert robot_io.sent == 3


@pytest.mark.parametrize(
    ("lockstep", "silent", "share"), [(False, 0.0, 1.0), (False, 0.1, 0.5), (False, 1.0, 0.0), (True, 1.0, 1.0)]
)
def test_a_stop_after_a_silence_does_not_set_a_robot_going_again(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, lockstep: bool, silent: float, share: float
) -> None:
    """A process that was held up: the drives have stopped by themselves, in 0.2 s, where they do not wait for it; the last commands are old.
    Truth: what is sent."""
    p = pair()
    drive(p)
    robot_io, sent = p.control.robot_io, list[Any]()
    before = np.array(robot_io.commanded["wheel"])
    monkeypatch.setattr(robot_io, "_send", sent.append)
    monkeypatch.setattr(robot_io, "settings", p.settings.model_copy(update={"lockstep": lockstep}))
    monkeypatch.setattr(robot_io, "_written", time.perf_counter() - silent)
    robot_io.stop()
    assert np.abs(before).max() > 0.5
    np.testing.assert_allclose(sent[0]["wheel"], share * before, atol=0.1 * np.abs(before).max())


def test_time_that_goes_back_stops(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    """A simulator that was restarted; a goal afterwards is taken again."""
    p = pair()
    drive(p)
    p.standin.time -= 0.5
    p.standin.answers = 0.01
    assert p.until(lambda: p.control.runner.stopped)
    assert "went back" in p.control.state
    p.run(0.2)
    p.standin.answers = 5.0
    p.go(2.0)
    assert p.until(lambda: "running" in p.control.state), (p.control.state, p.control.request_queue.rejected)


@pytest.mark.parametrize("when", ["take", "ready"])
def test_a_stop_between_two_looks_of_the_node_is_one(pair: Callable[..., Any], when: str) -> None:
    """The runner stops while the node takes up a speed, or waits for its plan, and its drives have stopped long ago; the stream of speeds goes
    on. Truth: nothing moves."""
    p = pair()
    p.ready()
    p.send("/cmd_vel", "geometry_msgs/msg/Twist", {"linear": {"x": 0.3}})
    publisher = p.standin.node.publisher("/cmd_vel", "geometry_msgs/msg/Twist")

    def stream(seconds: float) -> None:
        for _ in range(round(seconds / 0.04)):
            publisher.publish({"linear": {"x": 0.3}})
            p.run(0.04)

    assert p.until(lambda: stream(0.2) or p.control.running)
    stream(0.5)
    assert p.standin.speed > 0.5
    control, ramp = p.control, p.settings.safety.ramp
    at = control.request_queue if when == "take" else control.planning
    call = getattr(at, when)

    def halted() -> Any:
        setattr(at, when, call)
        control.robot_io._stopping = time.perf_counter() - ramp - 0.01
        control.runner.halt("its process was held up")
        return call()

    control.request_queue._put_speed(np.array([0.3, 0.0, 0.0]))
    setattr(at, when, halted)
    runner = control.runner
    control._process_requests()
    p.standin.answers = 0.02
    stream(1.5)
    assert control.runner is runner and runner.stopped and control.request_queue._latched, control.state


def test_drives_that_keep_their_last_command_stand_after_time_went_back(pair: Callable[..., Any]) -> None:
    """A simulator that puts time and robot back while its controllers go on: nobody else ends their last command. Truth: what is sent from then
    on, beside at most one tick that was under way: zeros, again and again."""
    p = pair()
    drive(p)
    p.run(1.0)
    assert p.standin.speed > 0.5
    sent, take = list[float](), p.standin._take
    p.standin._take = lambda group, message: (take(group, message), sent.append(p.standin.speed))
    p.standin.time, p.standin.answers = 1.0, 0.05
    p.standin.joints = {g: ROBOT.home[ROBOT.state[g]].copy() for g in p.standin.joints}
    assert p.until(lambda: p.control.runner.stopped and p.standin.speed == 0.0, 20.0)
    p.run(0.5)
    groups = len(p.standin.commands)
    assert p.standin.speed == 0.0 and sum(v > 0.0 for v in sent) <= 2 * groups, sent
    assert sent.count(0.0) > 10 * groups


def test_a_simulated_robot_that_restarts_is_where_its_odometry_begins(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """It has driven; then its time and its joints are as at the beginning, its wheels anywhere. Truth: what these turn from there."""
    p = pair()
    drive(p)
    assert p.until(lambda: p.control.adapter.snapshot()[1][0] > 0.5)
    p.standin.time, p.standin.answers = 1.0, 0.05
    p.standin.joints = {g: ROBOT.home[ROBOT.state[g]].copy() for g in p.standin.joints}
    p.standin.joints["wheel"] = 30.0 * AHEAD
    p.standin.commands = {g: np.zeros_like(v) for g, v in p.standin.commands.items()}
    assert p.until(lambda: p.control.runner.stopped and p.standin.speed == 0.0)
    p.run(0.2)
    rolled = ROBOT.base.geometry.wheel_radius * np.abs(p.standin.joints["wheel"] - 30.0 * AHEAD).mean()
    assert np.linalg.norm(p.control.adapter.snapshot()[1][:2]) == pytest.approx(rolled, abs=0.03)
    assert any("restart, their time went back" in r.getMessage() for r in caplog.records)


@pytest.mark.parametrize(
    ("broken", "says"), [(None, "the messages on /imu stopped 0.1"), (np.nan, "imu: a number is not finite")]
)
def test_an_inertial_unit_that_stops_or_says_nonsense(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture, broken: float | None, says: str
) -> None:
    p = pair()
    publisher, rate = p.standin.node.publisher("/imu", "sensor_msgs/msg/Imu"), [0.0]

    def change(message: dict[str, Any]) -> dict[str, Any]:
        if rate[0] is not None:
            publisher.publish({"header": message["header"], "angular_velocity": {"z": rate[0]}})
        return message

    p.standin.change = change
    drive(p)
    assert p.control.robot_io.has_imu
    rate[0] = broken  # type: ignore[call-overload]
    p.run(0.15)
    check_stopped(p, says, caplog)


def test_an_inertial_unit_that_is_stamped_ahead_stops(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """Its last message would look new for as long as it is ahead: nobody would see that it stops."""
    p = pair()
    publisher, ahead = p.standin.node.publisher("/imu", "sensor_msgs/msg/Imu"), [0]

    def change(message: dict[str, Any]) -> dict[str, Any]:
        stamp = message["header"]["stamp"]
        header = {**message["header"], "stamp": {**stamp, "sec": stamp["sec"] + ahead[0]}}
        publisher.publish({"header": header, "angular_velocity": {"z": 0.0}})
        return message

    p.standin.change = change
    drive(p)
    ahead[0] = 5
    p.run(0.15)
    check_stopped(p, r"the messages on /imu are stamped", caplog)


def test_a_command_to_the_legs_at_the_moment_of_a_stop_starts_nothing(pair: Callable[..., Any]) -> None:
    """One that waited when the robot stopped is rejected; and looking after the legs at that moment starts nobody. Later ones do."""
    p = pair()
    drive(p)
    runner, legs = p.control.runner, p.control.base_commands.commands
    p.standin.change = lambda m: {**m, "position": m["position"] * np.nan}
    assert wait_until(lambda: p.standin.tick(wait=False) or runner.stopped)  # the node has not looked yet
    p.control.base_commands.start_or_apply(p.control.adapter.snapshot()[1])
    legs._put(np.array([0.7, np.nan, np.nan, np.nan]), np.full(4, np.nan))
    p.standin.change = lambda m: m
    assert p.until(lambda: "the robot has stopped meanwhile" in legs.rejected)
    assert p.until(lambda: p.standin.speed == 0.0)
    assert p.control.runner is runner
    legs._put(np.array([0.7, np.nan, np.nan, np.nan]), np.full(4, np.nan))
    assert p.until(lambda: "running: stay" in p.control.state), p.control.state


def test_a_goal_after_a_stop_starts_again(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    drive(p)
    broken = iter([lambda m: {**m, "position": m["position"] * np.nan}])
    p.standin.change = lambda m: next(broken, lambda same: same)(m)
    check_stopped(p, "not finite", caplog)
    p.run(0.2)
    assert p.standin.speed == 0.0  # it does not go on by itself
    p.go(2.0)
    moved = 0.0
    while "running" not in p.control.state:  # until there is a policy it stands
        p.control.step()
        p.standin.tick(wait=p.control.running)
        moved = max(moved, p.standin.speed if "standing by" in p.control.state else 0.0)
    assert moved == 0.0
    assert p.until(lambda: p.standin.speed > 0.5), p.control.state


def test_a_stream_of_speeds_is_no_new_goal_after_a_stop(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    """As beside Nav2: 20 Hz without a pause, and one bad message of the robot. It ramps down and rests; after a zero it goes on."""
    p = pair(safety={"ramp": 0.3})
    p.ready()
    speeds = p.standin.node.publisher("/cmd_vel", "geometry_msgs/msg/Twist")
    assert p.until(lambda: speeds._writer.get_matched_subscriptions())
    wheels: list[float] = []

    def stream(count: int, x: float = 0.3) -> None:
        for _ in range(count):
            speeds.publish({"linear": {"x": x}})
            p.run(0.05)
            wheels.append(p.standin.speed)

    stream(20)
    assert wheels[-1] > 2.0, p.control.state
    broken = iter([lambda m: {**m, "position": m["position"] * np.nan}])
    p.standin.change = lambda m: next(broken, lambda same: same)(m)
    wheels.clear()
    stream(40)
    assert "is not finite" in p.control.state and p.control.runner.stopped
    assert p.until(lambda: p.standin.speed == 0.0)
    assert np.all(np.diff(wheels[2:]) <= 1e-9)
    assert sum("is not finite" in r.getMessage() for r in caplog.records if r.levelno == logging.ERROR) == 1
    says = "/cmd_vel: the robot has stopped: speeds count again after a zero or a pause of 0.5 s"
    assert sum(r.getMessage() == says for r in caplog.records) == 1
    stream(1, 0.0)
    stream(20)
    assert p.standin.speed > 2.0, p.control.state


def test_a_new_goal_waits_for_the_end_of_the_ramp(pair: Callable[..., Any]) -> None:
    """Speeds that are cut off in the middle of a ramp would make the wheels slip."""
    p = pair(safety={"ramp": 1.0})
    drive(p)
    broken = iter([lambda m: {**m, "position": m["position"] * np.nan}])
    p.standin.change = lambda m: next(broken, lambda same: same)(m)
    runner = p.control.runner
    assert p.until(lambda: runner.stopped)
    began = p.control.robot_io._stopping  # by the same clock
    p.control.step()
    p.go(3.0)
    assert p.until(lambda: p.control.runner is not runner)
    assert time.perf_counter() - began > 1.0
    assert p.until(lambda: p.standin.speed > 0.5), p.control.state
