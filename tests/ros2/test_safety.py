"""What a broken bus does to the robot. Truth: what the stand-in was told and when, limits of the settings, real messages broken."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, private, wait_until

from wbmpc.model import load_robot, rolling_inverse_kinematics
from wbmpc.ros2 import Network, open_node

pytestmark = needs_dds
if not MISSING:
    from rosbags.rosbag2 import Reader, Writer
    from rosbags.typesys import Stores, get_typestore
    from standin import PERIOD, Pair

    from wbmpc.ros2.convert import header
    from wbmpc.ros2.messages import types

ROBOT = load_robot("swerve-ur10")
NETWORK = Network.of({**private(), "ROS_DOMAIN_ID": "45"})


@pytest.fixture
def pair() -> Iterator[Callable[..., Any]]:
    made: list[Any] = []

    def make(**settings: Any) -> Any:
        made.append(Pair(ROBOT, NETWORK, **settings))
        return made[-1]

    yield make
    for p in made:
        p.close()


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "wbmpc")


def running(p: Any) -> None:
    """Bring a pair to a base that drives."""
    p.ready()
    p.go(2.0)
    assert p.until(lambda: p.standin.speed > 0.5), p.control.state


def stopped(p: Any, because: str, caplog: pytest.LogCaptureFixture) -> None:
    """The robot is at rest for good; one log line and a diagnostics entry say why."""
    assert p.until(lambda: p.control.runner.stopped, 1.0), p.control.state
    assert because in p.control.state
    p.standin.change = lambda message: message
    assert p.until(lambda: p.standin.speed == 0.0, 2.0)
    p.said.clear()
    p.run(0.1)
    assert p.standin.speed == 0.0
    assert sum(because in r.getMessage() and r.levelno == logging.ERROR for r in caplog.records) == 1
    assert sum(r.getMessage() == p.control.state for r in caplog.records) == 1
    assert p.until(lambda: any(s.level == 2 and because in s.message for m in p.said for s in m.status), 2.0)


# ---------------------------------------------------------------------- before it moves
def test_nothing_is_sent_before_a_state_and_a_goal(pair: Callable[..., Any]) -> None:
    p = pair()
    assert p.control.state == "waiting: no time on /clock yet"
    p.go()
    p.control.step()
    assert "no time on /clock" in p.control.inbox.refused
    p.standin.change = lambda message: None
    assert p.until(lambda: "no joint states" in p.control.state)
    p.go()
    p.control.step()
    assert "a goal is refused: waiting: no joint states on /joint_states yet" in p.control.inbox.refused
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
    p.run(0.1)
    assert p.control.runner is None and says in p.control.inbox.refused
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
    x = p.control.pilot.snapshot()[1]
    np.testing.assert_array_equal(x, ROBOT.home)


# ---------------------------------------------------------------------- while it moves
def test_not_a_number_stops(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    running(p)
    broken = iter([lambda m: {**m, "position": np.where(np.arange(18) == 9, np.nan, m["position"])}])
    p.standin.change = lambda m: next(broken, lambda same: same)(m)  # one message only
    stopped(p, "the position of 'wheel_RF' is not finite", caplog)


def test_a_jump_stops(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    running(p)
    p.standin.joints["arm"][1] += 0.3
    stopped(p, "'shoulder_lift_joint' jumped by 0.3", caplog)


def test_stale_states_stop_within_the_watchdogs_time(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    p = pair()
    running(p)
    last = p.standin.time - PERIOD
    p.standin.change = lambda message: None
    stopped(p, "s old, the limit is 0.1 s", caplog)
    at = p.control.clock.origin + float(p.control.runner.state.split()[2])
    assert 0.1 < at - last < 0.1 + 2.5 * PERIOD


def test_a_driver_that_repeats_itself_is_stale(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    running(p)
    frozen: list[Any] = []
    p.standin.change = lambda m: frozen[0] if frozen else frozen.append(m) or m
    stopped(p, "s old, the limit is 0.1 s", caplog)


def test_by_the_walls_clock_states_are_as_old_as_their_arrival_if_their_stamp_moves(pair: Callable[..., Any]) -> None:
    """Two machines' clocks may differ by hours; a driver that hangs repeats itself."""
    body, t = pair(use_sim_time=False).control.body, types("jazzy")
    names = [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]]
    kind = "sensor_msgs/msg/JointState"
    encoded = lambda at: t.encode(kind, {"header": header(at, ""), "name": names, "position": ROBOT.home[3:]})
    message = lambda at: t.decode(kind, encoded(at))
    for at in (5.0, 5.1):
        body._take_joints(message(at))
        assert body.age() < 0.1 and body.waits_for() == ""
    for _ in range(5):
        time.sleep(0.03)
        body._take_joints(message(5.1))
    assert body.age() > 0.14 and "s old" in body.waits_for()


def test_inertial_readings_belong_to_the_joint_states_of_their_time(pair: Callable[..., Any]) -> None:
    """Means by hand: what is stamped up to the joint states counts for these, what is later for the next ones; stamps of
    another clock say nothing, so all that came counts."""
    body, t = pair(use_sim_time=False).control.body, types("jazzy")
    names = [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]]

    def joints(at: float) -> None:
        kind = "sensor_msgs/msg/JointState"
        body._take_joints(
            t.decode(kind, t.encode(kind, {"header": header(at, ""), "name": names, "position": ROBOT.home[3:]}))
        )

    def imu(at: float, rate: float) -> None:
        kind = "sensor_msgs/msg/Imu"
        body._take_imu(t.decode(kind, t.encode(kind, {"header": header(at, ""), "angular_velocity": {"z": rate}})))

    read = lambda: float(body._averaged(body._joints[0].stamp).gyro[2])
    for at, rate in ((10.000, 1.0), (10.001, 2.0), (10.003, 8.0)):
        imu(at, rate)
    joints(10.001)
    assert read() == read() == 1.5  # asked twice, it is the same
    joints(10.002)
    assert read() == 8.0  # the newest, while there is none of this interval
    joints(10.003)
    assert read() == 8.0
    for at, rate in ((99.0, 3.0), (99.1, 5.0)):
        imu(at, rate)
    joints(10.005)
    assert read() == 4.0


def test_a_stop_is_a_ramp(pair: Callable[..., Any]) -> None:
    p = pair(safety={"ramp": 0.4})
    running(p)
    before = p.standin.commands["wheel"].copy()
    p.standin.change = lambda m: {**m, "position": m["position"] * np.nan}
    seen = []
    begin = time.perf_counter()
    while time.perf_counter() < begin + 0.6:
        p.standin.tick(wait=True)
        seen.append((time.perf_counter() - begin, p.standin.commands["wheel"].copy()))
    shares = np.array([np.abs(w).max() / np.abs(before).max() for _, w in seen])
    assert np.all(np.diff(shares[3:]) <= 1e-9) and shares[-1] == 0.0
    assert any(0.2 < s < 0.8 for s in shares)


def test_another_controller_stops_ours(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    running(p)
    p.standin.node.publisher("/arm_controller/commands", "std_msgs/msg/Float64MultiArray")
    stopped(p, "somebody else publishes on /arm_controller/commands", caplog)
    p.go(0.0)
    p.run(0.1)
    assert "a goal is refused: waiting: somebody else publishes" in p.control.inbox.refused


def test_time_that_stops_is_said(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    """A simulator that was killed: nobody moves any more, but who asks is told."""
    p = pair(safety={"clock": 0.3})
    running(p)
    assert wait_until(lambda: p.control.step() or p.control.runner.stopped, 3.0)
    assert "the time on /clock has stopped for 0.3 s" in p.control.state
    assert sum("/clock has stopped" in r.getMessage() for r in caplog.records if r.levelno == logging.ERROR) == 1


def test_time_that_goes_back_stops(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    """A simulator that was started anew; a goal afterwards is taken again."""
    p = pair()
    running(p)
    p.standin.time -= 0.5
    p.standin.answers = 0.01
    assert p.until(lambda: p.control.runner.stopped, 1.0)
    assert "went back" in p.control.state
    p.run(0.2)
    p.standin.answers = 0.5
    p.go(2.0)
    assert p.until(lambda: "running" in p.control.state, 3.0), (p.control.state, p.control.inbox.refused)


def test_a_pose_in_a_wrong_frame_is_told_once_until_it_is_right(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    p = pair(topics={"pose": "/amcl_pose"})
    publisher = p.standin.node.publisher("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    assert p.until(lambda: publisher._writer.get_matched_subscriptions())
    says = "/amcl_pose: the pose is in frame 'map', 'odom' is needed"

    def tell(frame: str, times: int) -> None:
        for _ in range(times):
            publisher.publish({"header": {"frame_id": frame}, "pose": {"pose": {"position": {"x": 1.0}}}})
            time.sleep(0.02)

    said = lambda: [v.value for m in p.said for s in m.status for v in s.values if v.key == "refused pose"]
    for k in (1, 2):
        tell("map", 5)
        assert p.until(lambda: p.control.state == f"waiting: {says}"), p.control.state
        assert sum(r.getMessage() == says for r in caplog.records) == k
        assert p.until(lambda: says in said(), 3.0)
        tell("odom", 1)
        assert p.until(lambda: p.control.source.fault == "")
        time.sleep(0.6)


def test_lost_localisation_stops(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair(topics={"pose": "/amcl_pose"})
    assert p.until(lambda: p.control.state == "waiting: no pose on /amcl_pose"), p.control.state
    publisher = p.standin.node.publisher("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    sending = [True]

    def change(message: dict[str, Any]) -> dict[str, Any]:
        if sending and round(p.standin.time / PERIOD) % 10 == 0:
            publisher.publish({"header": {"frame_id": "odom"}, "pose": {"pose": {"position": {"x": 3.0, "y": -1.0}}}})
        return message

    p.standin.change = change
    p.ready()
    np.testing.assert_allclose(p.control.pilot.snapshot()[1][:3], [3.0, -1.0, 0.0])
    p.go(3.5, -1.0)
    assert p.until(lambda: p.control.runner is not None and "running" in p.control.state)
    sending.clear()
    p.run(0.45)
    stopped(p, "the pose on /amcl_pose is 0.", caplog)


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
    running(p)
    assert p.control.body.has_imu
    rate[0] = broken  # type: ignore[call-overload]
    p.run(0.15)
    stopped(p, says, caplog)


def test_a_pose_with_a_covariance_is_weighed(pair: Callable[..., Any]) -> None:
    """Two poses of the same spread for a robot that stands: their mean, with half of the variance (Kalman by hand)."""
    p = pair(topics={"pose": "/amcl_pose"})
    publisher = p.standin.node.publisher("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped")
    assert p.until(lambda: publisher._writer.get_matched_subscriptions())
    covariance = np.diag([1e-4, 1e-4, 0.0, 0.0, 0.0, 1e-4]).ravel()
    for x in (3.0, 3.01):
        message = {"pose": {"position": {"x": x}}, "covariance": covariance}
        publisher.publish({"header": {"frame_id": "odom"}, "pose": message})
        time.sleep(0.05)
        p.run(0.05)
    assert p.control.pilot.snapshot()[1][0] == pytest.approx(3.005, abs=1e-4)
    e = p.control.pilot.estimate()
    assert e.covariance[0, 0] == pytest.approx(0.5e-4, rel=0.05) and e.covariance[2, 2] == 1e6


def test_a_goal_after_a_stop_starts_again(pair: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    p = pair()
    running(p)
    broken = iter([lambda m: {**m, "position": m["position"] * np.nan}])
    p.standin.change = lambda m: next(broken, lambda same: same)(m)
    stopped(p, "not finite", caplog)
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


# ---------------------------------------------------------------------- a recording
def test_a_recorded_bag_replayed_into_the_node(pair: Callable[..., Any], tmp_path: Path) -> None:
    """A bag in which all wheels, parallel as at home, roll a turn ahead: its untouched bytes give the odometry 2 π r ahead, and
    nothing is commanded."""
    geometry = ROBOT.base.geometry
    ahead = np.sign(
        rolling_inverse_kinematics(geometry, *(ROBOT.home[ROBOT.state[g]] for g in ("leg", "steer")), [1, 0, 0])[1]
    )
    store, kind = get_typestore(Stores.ROS2_JAZZY), "sensor_msgs/msg/JointState"
    names = [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]]
    t = types("jazzy")
    with Writer(tmp_path / "bag", version=9) as bag:
        connection = bag.add_connection("/joint_states", kind, typestore=store)
        for k in range(101):
            x = ROBOT.home.copy()
            x[ROBOT.state["wheel"]] = ahead * 2 * np.pi * k / 100
            stamped = header(1.0 + 0.01 * k, "")
            message = t.encode(kind, {"header": stamped, "name": names, "position": x[3:]})
            bag.write(connection, k * 10_000_000, message)
    p = pair(topics={"imu": ""})
    node = p.standin.node
    clock = node.publisher("/clock", "rosgraph_msgs/msg/Clock")
    joints = node.publisher("/joint_states", kind)
    assert wait_until(lambda: joints._writer.get_matched_subscriptions() and clock._writer.get_matched_subscriptions())
    with Reader(tmp_path / "bag") as bag:
        for _, at, data in bag.messages():
            joints.send(data)
            clock.publish({"clock": {"sec": 1 + at // 10**9, "nanosec": at % 10**9}})
            stamp = 1.0 + 1e-9 * at
            arrived = lambda s=stamp: (  # type: ignore[misc]
                p.control.body._joints is not None and abs(p.control.body._joints[0].stamp - s) < 1e-6
                and abs(p.control.clock.stamp() - s) < 1e-6
            )  # fmt: skip
            assert wait_until(arrived)
            p.control.step()
    pose = p.control.pilot.snapshot()[1][:3]
    np.testing.assert_allclose(pose, [2 * np.pi * 0.1, 0.0, 0.0], atol=1e-9)
    assert p.control.state == "waiting for a goal" and set(p.standin.counts.values()) == {0}


# ---------------------------------------------------------------------- goals that are none
@pytest.mark.parametrize(
    ("topic", "frame", "position", "says"),
    [
        ("/goal_pose", "map", {}, "unknown frame 'map'; valid: odom, base_link"),
        ("/goal_pose", "odom", {"x": float("nan")}, "a number is not finite"),
        ("/hand_goal", "odom", {"x": 1.0, "z": -0.4}, "out of reach: height -0.40 m, possible 0.00 to 2.39 m"),
        ("/hand_goal", "odom", {"x": 1.0, "z": 3.0}, "out of reach: height 3.00 m, possible 0.00 to 2.39 m"),
    ],
)
def test_a_bad_goal_changes_nothing(
    pair: Callable[..., Any], topic: str, frame: str, position: dict[str, float], says: str
) -> None:
    p = pair()
    running(p)
    task = p.control._task
    p.send(topic, "geometry_msgs/msg/PoseStamped", {"header": {"frame_id": frame}, "pose": {"position": position}})
    p.run(0.1)
    assert says in p.control.inbox.refused
    assert p.control._task is task and p.control.running
    said = lambda: [v.value for m in p.said for s in m.status for v in s.values if v.key == "refused"]
    assert p.until(lambda: any(says in text for text in said()), 3.0)


def test_whatever_a_goal_does_what_runs_goes_on(
    pair: Callable[..., Any], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Too far away, and a planner that fails as nobody foresaw: the robot drives on, one log line each, diagnostics say so;
    the next goal that is taken ends it."""
    p = pair()
    running(p)
    task = p.control._task
    for _ in range(2):
        p.go(1e9)
        p.run(0.05)
    assert p.control._task is task and "the base's goal is 1e+09 m away" in p.control.inbox.refused
    assert sum("1e+09 m away" in r.getMessage() for r in caplog.records) == 1

    def fails(*_: Any) -> None:
        raise MemoryError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(p.control.pilot.planner, "to_base", fails)
        for _ in range(2):
            p.go(1.5)
            p.run(0.05)
    assert p.control._task is task and p.control.running and p.standin.speed > 0.5
    says = "a goal is refused: MemoryError: no room"
    assert p.control.inbox.refused == says and sum(says in r.getMessage() for r in caplog.records) == 1
    said = lambda: [v.value for m in p.said for s in m.status for v in s.values if v.key == "refused"]
    assert p.until(lambda: says in said(), 3.0)
    p.go(1.5)
    p.run(0.05)
    assert p.control._task is not task and p.control.inbox.refused == ""


@pytest.mark.parametrize("stamped", [False, True])
def test_speeds_of_either_type_drive_the_base_and_run_out(pair: Callable[..., Any], stamped: bool) -> None:
    p = pair(safety={"cmd_vel": 0.3})
    p.ready()
    twist = {"linear": {"x": 0.4}}
    kind = "geometry_msgs/msg/TwistStamped" if stamped else "geometry_msgs/msg/Twist"
    publisher = p.standin.node.publisher("/cmd_vel", kind)
    assert p.until(lambda: publisher._writer.get_matched_subscriptions())
    for _ in range(12):
        publisher.publish({"twist": twist} if stamped else twist)
        p.run(0.1)
    assert p.control.pilot.snapshot()[1][0] > 0.1
    np.testing.assert_allclose(np.abs(p.standin.commands["wheel"]), 4.0, rtol=0.1)  # 0.4 m/s on wheels of 0.1 m
    assert p.until(lambda: np.abs(p.standin.commands["wheel"]).max() < 0.2, 1.5)  # 20 mm/s
    assert p.control.state == "running: base to rest"
    assert p.control.running


def test_stamped_speeds_drive_the_base_beside_somebody_who_could_send_plain_ones(pair: Callable[..., Any]) -> None:
    """A teleoperator who is silent, then a navigator: both types of one topic, and no mismatch is told."""
    p = pair()
    p.ready()
    silent = p.standin.node.publisher("/cmd_vel", "geometry_msgs/msg/Twist")
    assert p.until(lambda: silent._writer.get_matched_subscriptions())
    other = open_node("navigator", "dds", NETWORK)
    try:
        publisher = other.publisher("/cmd_vel", "geometry_msgs/msg/TwistStamped")
        assert p.until(lambda: publisher._writer.get_matched_subscriptions())
        for _ in range(4):
            publisher.publish({"twist": {"linear": {"x": 0.4}}})
            p.run(0.1)
        assert p.control.state == "running: base at a speed" and p.standin.speed > 1.0
        assert p.node.faults == []
    finally:
        other.close()
