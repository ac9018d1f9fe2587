"""States as they come from the bus: their age, their order, a recording. Truth: stamps and means by hand, rolling by geometry."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import MISSING, needs_dds, wait_until

from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics
from wbmpc.runtime.clock import WallClock

pytestmark = needs_dds
if not MISSING:
    from rosbags.rosbag2 import Reader, Writer
    from rosbags.typesys import Stores, get_typestore
    from standin import ROBOT

    from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
    from wbmpc.ros2.clock import BusClock
    from wbmpc.ros2.convert import header
    from wbmpc.ros2.hold_ups import HoldUps
    from wbmpc.ros2.inertial_readings import InertialReadings
    from wbmpc.ros2.joints import Inertial, JointReader, JointSample, Repetition, mean_rate
    from wbmpc.ros2.localization import PoseSource
    from wbmpc.ros2.messages import types
    from wbmpc.ros2.request_queue import RequestQueue
    from wbmpc.ros2.settings import Safety, settings_of
    from wbmpc.ros2.transforms import Transforms


def test_by_the_walls_clock_states_are_as_old_as_their_arrival_if_their_stamp_moves(
    pair: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two machines' clocks may differ by hours; a driver that hangs repeats itself. The wall clock is the test's."""
    body, t, now = pair(use_sim_time=False).control.robot_io, types("jazzy"), [7.0]
    monkeypatch.setattr("wbmpc.ros2.robot.time", SimpleNamespace(perf_counter=lambda: now[0]))
    names = [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]]
    kind = "sensor_msgs/msg/JointState"
    encoded = lambda at: t.encode(kind, {"header": header(at, ""), "name": names, "position": ROBOT.home[3:]})
    message = lambda at: t.decode(kind, encoded(at))
    for at in (5.0, 5.1):
        now[0] += 0.1
        body._take_joints(message(at))
        assert body.age() == 0.0 and body.waiting_reason() == ""
    for _ in range(5):
        now[0] += 0.032
        body._take_joints(message(5.1))
    assert body.age() == pytest.approx(0.16) and "have stopped for more than 0.1 s" in body.waiting_reason()


def test_inertial_readings_belong_to_the_joint_states_of_their_time(pair: Callable[..., Any]) -> None:
    """Means by hand: what is stamped up to the joint states counts for these, what is later for the next ones; stamps of
    another clock say nothing, so all that came counts."""
    body, t = pair(use_sim_time=False).control.robot_io, types("jazzy")
    names = [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]]

    def joints(at: float) -> None:
        kind = "sensor_msgs/msg/JointState"
        moving = ROBOT.home[3:] + 0.1 * at  # joints that stand still while the gyro turns do not count
        body._take_joints(t.decode(kind, t.encode(kind, {"header": header(at, ""), "name": names, "position": moving})))

    def imu(at: float, rate: float) -> None:
        kind = "sensor_msgs/msg/Imu"
        body._take_imu(t.decode(kind, t.encode(kind, {"header": header(at, ""), "angular_velocity": {"z": rate}})))

    read = lambda: float(body._inertial.averaged(body._joints[0].stamp).gyro[2])
    for at, rate in ((10.000, 1.0), (10.001, 2.0), (10.003, 4.0)):
        imu(at, rate)
    joints(10.001)
    assert read() == read() == 1.5  # asked twice, it is the same
    joints(10.002)
    assert read() == 4.0  # the newest, while there is none of this interval
    joints(10.003)
    assert read() == 4.0
    for at, rate in ((99.0, 3.0), (99.1, 5.0)):
        imu(at, rate)
    joints(10.005)
    assert read() == 4.0
    for at, rate in ((200.0, 4.5), (1.0, 2.0), (1.001, 4.0)):  # the simulator was restarted
        imu(at, rate)
    joints(1.0)  # its time went back: rejected once
    joints(1.001)
    assert read() == 3.0


def test_a_recorded_bag_replayed_into_the_node(pair: Callable[..., Any], tmp_path: Path) -> None:
    """A bag in which all wheels, parallel as at home, roll a turn ahead: its untouched bytes give the odometry 2 π r ahead, and
    nothing is commanded."""
    geometry = ROBOT.base.geometry
    ahead = np.sign(
        rolling_inverse_kinematics(geometry, *(ROBOT.home[ROBOT.state[g]] for g in ("leg", "steer")), [1, 0, 0])[1]
    )
    store, kind = get_typestore(Stores.ROS2_JAZZY), "sensor_msgs/msg/JointState"
    names = [n for g in ("leg", "steer", "wheel", "arm") for n in ROBOT.state.groups[g]]
    t, order = types("jazzy"), np.argsort(names)  # by their names, as the joint_state_broadcaster has them
    with Writer(tmp_path / "bag", version=9) as bag:
        connection = bag.add_connection("/joint_states", kind, typestore=store)
        for k in range(101):
            x = ROBOT.home.copy()
            x[ROBOT.state["wheel"]] = ahead * 2 * np.pi * k / 100
            stamped = header(1.0 + 0.01 * k, "")
            message = t.encode(kind, {"header": stamped, "name": np.array(names)[order], "position": x[3:][order]})
            bag.write(connection, k * 10_000_000, message)
    p = pair(topics={"imu": ""})
    clock, joints = p.standin._clock, p.standin._joints
    assert wait_until(lambda: joints._writer.get_matched_subscriptions() and clock._writer.get_matched_subscriptions())
    with Reader(tmp_path / "bag") as bag:
        for _, at, data in bag.messages():
            joints.send(data)
            clock.publish({"clock": {"sec": 1 + at // 10**9, "nanosec": at % 10**9}})
            stamp = 1.0 + 1e-9 * at
            arrived = lambda s=stamp: (  # type: ignore[misc]
                p.control.robot_io._joints is not None and abs(p.control.robot_io._joints[0].stamp - s) < 1e-6
                and abs(p.control.clock.stamp() - s) < 1e-6
            )  # fmt: skip
            assert wait_until(arrived)
            p.control.step()
    pose = p.control.adapter.snapshot()[1][:3]
    np.testing.assert_allclose(pose, [2 * np.pi * 0.1, 0.0, 0.0], atol=1e-9)
    assert p.control.state == "waiting for a goal" and set(p.standin.counts.values()) == {0}


@pytest.mark.parametrize("speed", [0.05, 0.3, 1.0, 20.0])
def test_the_bus_clock_knows_how_fast_its_time_passes(speed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: 400 messages in each second of the bus, at times of the wall clock that are the test's; 0.1 s of silence of a
    simulator in real time, or of a faster one, is too long, and of a slower one as much of its own time."""
    wall = [5.0]
    monkeypatch.setattr("wbmpc.ros2.clock.time.monotonic", lambda: wall[0])
    clock = BusClock()
    for k in range(4000):
        wall[0] = 5.0 + 0.0025 * k / speed
        clock.set(1.7e9 * (k > 10) + 0.0025 * k)
    assert min(clock.speed, 1.0) == pytest.approx(min(speed, 1.0), rel=0.02)
    limit = SwerveRosSettings(use_sim_time=True).silence(clock.speed)
    assert limit == pytest.approx(min(0.1 / min(speed, 1.0), 1.0), rel=0.02)
    assert SwerveRosSettings(use_sim_time=True, safety=Safety(clock=7.0)).silence(clock.speed) == 7.0
    assert SwerveRosSettings(lockstep=True).silence(clock.speed) == 30.0


def test_time_that_goes_back_in_small_steps_has_gone_back() -> None:
    """A recording that is played backward, by 15 ms from message to message; a single message that another one has overtaken by as much says
    nothing. By hand."""
    clock = BusClock()
    for t in (9.985, 10.0, 9.985):
        clock.set(t)
    assert clock.stamp() == 10.0 and not clock.went_back
    for k in range(2, 5):
        clock.set(10.0 - 0.015 * k)
    assert clock.stamp() == pytest.approx(9.94) and clock.went_back


def test_what_came_before_time_went_back_is_old() -> None:
    """A simulator that is restarted begins at 0, as does a recording that is played again: a wrench, a pose, a transform and a stop
    of before are not of the future; nor does a stream of speeds that goes on move a robot that was stopped. Truth: the limits of the settings."""
    clock, takes = BusClock(), {}
    subscribe = lambda topic, kind, callback, *_, **__: takes.setdefault(topic, callback) and (lambda: None)
    node: Any = SimpleNamespace(subscribe=subscribe, publishers=lambda topic: [])
    settings = settings_of(ROBOT)(topics={"pose": "/pose"})
    planner: Any = SimpleNamespace(robot=ROBOT)
    requests = RequestQueue(HoldUps(), node, planner, settings, lambda: 0.0, clock.steady, clock.elapsed)
    poses = PoseSource(node, settings, clock.steady, clock.stamp)
    frames = Transforms(node, "odom", "base_link", clock.steady)

    def message(kind: str, **values: Any) -> Any:
        return types("jazzy").decode(kind, types("jazzy").encode(kind, values))

    def send() -> None:
        head = {"header": header(clock.stamp(), "odom")}
        takes["/cmd_vel"](message("geometry_msgs/msg/Twist", linear={"x": 0.2}))
        takes["/wrench"](message("geometry_msgs/msg/WrenchStamped", **head, wrench={"force": {"x": 5.0}}))
        takes["/pose"](message("nav_msgs/msg/Odometry", **head))

    for k in range(5):
        clock.set(200.0 + 0.1 * k)
        send()
        frames.note_base(clock.stamp(), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    assert requests.wrench().any() and requests.take() is not None and not poses.lost()
    frames.pose("base_link", clock.stamp())
    requests.stop()
    clock.set(0.0)
    assert clock.went_back and not requests.wrench().any() and poses.lost()
    with pytest.raises(InputError, match="has not come for 2 s"):
        frames.pose("base_link", clock.stamp())
    taken = poses.newest()
    assert taken is not None and taken[0] > 60.0
    for k in range(7):
        send()
        assert requests.take() is None and requests.wrench().any() and not poses.lost()
        clock.set(0.1 * k)
    for k in range(7):  # the jump was no pause of the stream of speeds
        clock.set(1.0 + 0.1 * k)
    send()
    assert requests.take() is not None


def test_states_that_are_read_while_another_thread_resets_them_count() -> None:
    """The node's thread does at every stop: the message was lost with an error of Python's."""

    class Reset(JointReader):
        @property
        def last(self) -> Any:
            found, self._last = self._last, None
            return found

        @last.setter
        def last(self, value: Any) -> None:
            self._last = value

    robot = load_robot("swerve-ur10")
    reader = Reset(robot, settings_of(robot)())
    head = SimpleNamespace(stamp=SimpleNamespace(sec=5, nanosec=0))
    message = SimpleNamespace(name=reader.names, position=np.zeros(len(reader.names)), header=head)
    assert [reader.read(message, 5.0).stamp for _ in range(3)] == [5.0] * 3


@pytest.mark.parametrize("confirmed", [False, True])
def test_a_jump_that_the_next_message_confirms_is_true_for_who_would_fall(confirmed: bool) -> None:
    """Joints of a robot that is hit move faster than their drives can; without their states it would be let go."""
    robot = load_robot("rezero")
    reader = JointReader(robot, settings_of(robot)(), confirmed)
    positions = np.zeros(len(reader.names))

    def read(k: int, elbow: float) -> bool:
        values = positions.copy()
        values[-1] = elbow
        at = SimpleNamespace(sec=5, nanosec=2_500_000 * k)
        message = SimpleNamespace(name=reader.names, position=values, header=SimpleNamespace(stamp=at))
        try:
            return reader.read(message, 5.0 + 0.0025 * k).groups["arm"][-1] == elbow
        except InputError as error:
            assert "jumped by" in str(error)
            return False

    taken = [read(k, elbow) for k, elbow in enumerate([0.0, 0.001, 1.0, 0.002, 0.5, 0.58, 0.66, 0.74])]
    assert taken == [True, True, False, True, False, confirmed, False, confirmed]


@pytest.mark.parametrize(
    "robot", [load_robot(n) for n in ("swerve-ur10", "differential-ur10", "panda")], ids=lambda r: r.description.name
)
def test_a_stamp_ahead_gives_joints_no_time_to_move(robot: RobotModel) -> None:
    """One message with a wrong stamp and wrong angles moved the odometry for good: within its 1000 s a wheel can turn that far.
    Truth: what has passed when it came. A clock that was set, and a driver that was silent while others moved the robot, are no faults."""
    reader = JointReader(robot, settings_of(robot)())

    def read(at: float, moved: float, came: float) -> str:
        head = SimpleNamespace(stamp=SimpleNamespace(**header(at, "")["stamp"]))
        position = np.full(len(reader.names), moved)
        try:
            reader.read(SimpleNamespace(name=reader.names, position=position, header=head), came)
        except InputError as error:
            return str(error)
        return ""

    assert not read(5.0, 0.0, 0.0)
    assert "jumped by 10 rad" in read(1005.0, 10.0, 0.01)
    assert not read(5.02, 0.001, 0.02)
    assert not read(1005.0, 0.002, 0.03)
    assert not read(1025.0, 10.0, 20.03)


@pytest.mark.parametrize("ahead", [0.3, 1000.0])
def test_a_single_stamp_ahead_does_not_count_for_who_would_fall(ahead: float) -> None:
    """One message with a wrong stamp made every later one too old, and let the robot fall; a clock that was set forward is confirmed by the
    second one, as is a driver that was silent."""
    robot = load_robot("rezero")
    reader = JointReader(robot, settings_of(robot)(), confirmed=True)

    def read(at: float) -> bool:
        stamped = header(at, "")["stamp"]
        head = SimpleNamespace(stamp=SimpleNamespace(**stamped))
        try:
            reader.read(SimpleNamespace(name=reader.names, position=np.zeros(len(reader.names)), header=head), at)
        except InputError as error:
            assert f"their time jumped ahead by {ahead:.3g} s" in str(error)
            return False
        return True

    assert [read(at) for at in (5.0, 5.0 + ahead, 5.0025, 5.005)] == [True, False, True, True]
    assert [read(at) for at in (5.005 + ahead, 5.0075 + ahead)] == [False, True]


@pytest.mark.parametrize("back", [0.5, 1000.0])
def test_a_clock_that_is_set_back_lets_nobody_fall(back: float) -> None:
    """Every message was rejected until its time was where it had been: the robot fell. The second message of the new time counts; what has
    only been overtaken does not, however much of it there is, and neither does what repeats itself."""
    robot = load_robot("rezero")
    reader = JointReader(robot, settings_of(robot)(), confirmed=True)

    def read(at: float) -> bool:
        head = SimpleNamespace(stamp=SimpleNamespace(**header(at, "")["stamp"]))
        try:
            reader.read(SimpleNamespace(name=reader.names, position=np.zeros(len(reader.names)), header=head), at)
        except InputError as error:
            assert "their time went back by" in str(error)
            return False
        return True

    start = 2000.0
    assert [read(start + at) for at in (0.0, 0.01, 0.0025, 0.005, 0.0075, 0.0125)] == [
        True,
        True,
        False,
        False,
        False,
        True,
    ]
    now = start + 0.0125 - back
    assert [read(now + at) for at in (0.0, 0.0, 0.0025, 0.005)] == [False, False, True, True]


def test_a_gyro_says_nothing_of_the_time_over_which_its_clock_was_set_back() -> None:
    """A base that turns by 0.7 rad/s when all clocks are set back by 13 ms: what passed between the last reading and the next is not the
    difference of their stamps, and the odometry turned by 9 mrad too little. By hand: the rate, where it is known; units without a
    clock have stamps of 0."""
    readings, turning = InertialReadings(BusClock(), 0.1), []
    for k in range(12):
        at = 5.0 + 0.0025 * k - (0.013 if k >= 6 else 0.0)
        readings.put(at, Inertial(np.array([0.0, 0.0, 0.7]), np.zeros(3)))
        found = readings.averaged(at)
        assert found is not None
        turning.append(None if found.turning is None else float(found.turning[2]))
    assert turning[1:6] == [0.7] * 5 and turning[6] is None and turning[7:] == [0.7] * 5
    rate = mean_rate([0.0, 0.0, 0.0], [np.full(3, r) for r in (0.1, 0.2, 0.3)], 0.1)
    np.testing.assert_allclose(rate, np.full(3, 0.2))


@pytest.mark.parametrize("watchdog", [0.1, 1.0])
def test_a_gap_between_readings_is_not_one_interval_of_the_gyro(watchdog: float) -> None:
    """A node that was held up for 0.9 s while the robot's own timeout stopped it: the mean of the rates before and after, over the gap,
    turned the odometry by up to 0.1 rad where the watchdog is patient. By hand: nothing is known of the turning."""
    readings, turning = InertialReadings(BusClock(), watchdog), []
    for at, rate in ((5.0, 0.4), (5.0025, 0.4), (5.9, 0.0), (5.9025, 0.0)):
        readings.put(at, Inertial(np.array([0.0, 0.0, rate]), np.zeros(3)))
        found = readings.averaged(at)
        assert found is not None
        turning.append(None if found.turning is None else float(found.turning[2]))
    assert turning[1:] == [pytest.approx(0.4), None, 0.0]


@pytest.mark.parametrize("simulated", [False, True])
@pytest.mark.parametrize("came", [0, 3])
def test_readings_of_a_part_of_a_gap_are_not_all_of_it(simulated: bool, came: int) -> None:
    """A node that was held up for 1.9 s gets its messages one after the other: joint states of now, but readings of then alone, or none, and
    the time of then. The last rate was taken for the whole gap: 0.07 rad. By hand: nothing is known of the turning. A tick that is late,
    of which all readings are there, loses nothing."""
    clock = BusClock() if simulated else WallClock()
    readings = InertialReadings(clock, 0.1)

    def put(at: float, rate: float) -> None:
        readings.put(at, Inertial(np.array([0.0, 0.0, rate]), np.zeros(3)))
        if isinstance(clock, BusClock):
            clock.set(at)

    def turning(stamp: float) -> float | None:
        found = readings.averaged(stamp)
        assert found is not None
        return None if found.turning is None else float(found.turning[2])

    for k in range(2):
        put(5.0 + 0.0025 * k, 0.4)
        read = turning(5.0 + 0.0025 * k)
    assert read == pytest.approx(0.4)
    for k in range(came):
        put(5.005 + 0.0025 * k, 0.3)
    assert turning(6.9) is None and turning(6.9) is None
    for k in range(160):
        put(6.9025 + 0.0025 * k, 0.1)
    assert turning(6.9) is None
    late = turning(6.9 + 0.4)
    assert late is None or late == pytest.approx(0.1)
    for k in range(160):
        put(7.3025 + 0.0025 * k, 0.2)
    assert turning(7.7) == pytest.approx(0.2, abs=1e-3)


def test_in_lockstep_a_tick_may_be_late_by_what_the_simulator_goes_on_before_its_first_commands() -> None:
    """Truth: the limit of the watchdog that the file gives, without and with lockstep."""
    assert SwerveRosSettings(safety=Safety(watchdog=0.05)).held_up == 0.05
    assert SwerveRosSettings(safety=Safety(watchdog=0.05), lockstep=True).held_up == 1.0


def test_joint_states_that_repeat_themselves_count_where_the_base_rests() -> None:
    """A gyro with a bias, and one that turned 5 s ago, say nothing against them; one message that is the same as the one before is held
    back while the gyro turns. Truth: by hand."""
    still, moved = {"wheel": np.ones(4)}, {"wheel": np.ones(4) + 1e-4}
    repetition = Repetition()
    held = lambda at, turning, groups=still: repetition.goes_on(JointSample(at, groups), turning)
    assert [held(0.01 * k, 0.1) for k in range(100)] == [False] * 100
    assert [held(1.01, 0.5), held(1.02, 0.5, moved), held(1.03, -0.5, moved), held(1.04, 0.5)] == [
        True,
        False,
        True,
        False,
    ]
    assert [held(2.0, 0.5), held(2.5, 0.1), held(6.9, 0.1), held(7.1, 0.1)] == [True, True, True, False]
    assert repetition.lasted(JointSample(7.1, still)) == pytest.approx(7.1 - 1.04)
    assert not held(0.5, 0.5)  # times went back: another clock
