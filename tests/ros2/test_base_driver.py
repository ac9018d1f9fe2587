"""A base that takes speeds, on a bus. Truth: rigid motion by hand, the simulated robot's own pose."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from needs import needs_dds, private

from planar_driving import HEIGHT, write_robot
from wbmpc import lie
from wbmpc.bases.planar_motion.odometry import KNOWN
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.ros2.base_driver import HELD, LONGEST_WAY, BaseWay, ordered_speeds
from wbmpc.ros2.joints import JointSample
from wbmpc.ros2.settings import Controller, joint_groups, settings_of

#: How far ahead of its frame [m] the base turns.
CENTER = 0.1


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """A base that skids, with an arm of two joints."""
    wheels = [((x, y), (0.0, 1.0, 0.0)) for x in (0.2, -0.2) for y in (0.2, -0.2)]
    path = write_robot(tmp_path_factory.mktemp("skid"), wheels, {"type": "planar"})
    data = yaml.safe_load(path.read_text())
    data["base"] = {"type": "planar", "body": "chassis", "drive": "skid", "center": CENTER, "height": HEIGHT}
    data["fixed_joints"] = {f"w{i}": 0.0 for i in range(4)}
    data["limits"]["velocity"] = {"pan": 2.0, "lift": 2.0}
    path.write_text(yaml.safe_dump(data))
    return load_robot(path)


def odometry(stamp: float, pose: Any, twist: Any = (0.0, 0.0, 0.0)) -> Any:
    """A nav_msgs/Odometry."""
    xyz = lambda *v: SimpleNamespace(x=v[0], y=v[1], z=v[2])
    w, _, _, z = lie.quaternion_about((0.0, 0.0, 1.0), float(pose[2]))
    at = SimpleNamespace(position=xyz(pose[0], pose[1], 0.0), orientation=SimpleNamespace(x=0.0, y=0.0, z=z, w=w))
    moves = SimpleNamespace(linear=xyz(twist[0], twist[1], 0.0), angular=xyz(0.0, 0.0, twist[2]))
    sec = int(stamp)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=round(1e9 * (stamp - sec))))
    return SimpleNamespace(
        header=header, pose=SimpleNamespace(pose=at), twist=SimpleNamespace(twist=moves, linear=moves.linear, angular=moves.angular)
    )  # fmt: skip


def read(way: BaseWay, stamp: float, *given: Any) -> None:
    """A driver's odometry, which comes at once."""
    way.read(odometry(stamp, *given), stamp)


def way_at(way: BaseWay, stamp: float) -> np.ndarray:
    return way.with_way(JointSample(stamp, {"wheel": np.zeros(0), "arm": np.ones(2)})).groups["wheel"]


def test_the_way_is_that_of_the_turning_point_from_wherever_the_driver_counts(robot: RobotModel) -> None:
    """0.3 m/s ahead and 0.5 rad/s for 2 s about a point 0.1 m ahead of the frame, in a world that the driver turned by 0.7 rad."""
    way, pose, twist = BaseWay(robot), np.array([3.0, -1.0, 0.7]), np.array([0.3, -CENTER * 0.5, 0.5])
    for k in range(101):
        read(way, 10.0 + 0.02 * k, pose, twist)
        pose = lie.se2_step(pose, twist * 0.02)
    np.testing.assert_allclose(way_at(way, 12.0), [0.6, 1.0], atol=1e-9)
    # between two messages it goes on; not forever
    np.testing.assert_allclose(way_at(way, 12.05), [0.615, 1.025], atol=1e-9)
    np.testing.assert_allclose(way_at(way, 20.0), np.array([0.6, 1.0]) + HELD * np.array([0.3, 0.5]), atol=1e-9)
    with pytest.raises(InputError, match=r"its time went back by 1\.000 s"):
        read(way, 11.0, pose)
    with pytest.raises(InputError, match="base odometry"):
        read(way, 13.0, [np.nan, 0.0, 0.0])
    way.reset()  # another driver, which counts from elsewhere
    read(way, 1.0, [0.0, 0.0, 0.0])
    np.testing.assert_allclose(way_at(way, 1.0), [0.6, 1.0], atol=1e-9)


@pytest.mark.parametrize("jump", [(1.0, 0.0, 0.0), (0.0, -0.3, 0.0), (0.0, 0.0, 0.5)])
def test_a_driver_that_counts_from_elsewhere_moves_nobody(robot: RobotModel, jump: tuple[float, float, float]) -> None:
    """As one that resets its odometry while it goes on publishing: the estimate went along, and the base drove the jump back."""
    way = BaseWay(robot)
    read(way, 10.0, np.zeros(3))
    with pytest.raises(InputError, match=r"base odometry: it jumped by .* in 20 ms, faster than the base can move"):
        read(way, 10.02, np.array(jump))
    way.reset()
    read(way, 10.04, np.array(jump))
    np.testing.assert_allclose(way_at(way, 10.04), np.zeros(2), atol=1e-12)


def test_the_driver_gets_what_the_base_does(robot: RobotModel) -> None:
    message = odometry(0.0, np.zeros(3), [0.3, -CENTER * 0.5, 0.5])
    np.testing.assert_allclose(ordered_speeds(robot, message), [0.3, 0.5])


def test_its_speeds_go_to_a_controller_of_their_own(robot: RobotModel) -> None:
    settings = settings_of(robot)
    topics = settings().command_topics(robot)
    assert [(c.type, c.joints) for c in topics.values()] == [
        ("geometry_msgs/msg/TwistStamped", ("base/v", "base/wz")),
        ("std_msgs/msg/Float64MultiArray", ("pan", "lift")),
    ]
    assert joint_groups(robot)["wheel"] == ()
    arm = Controller(topic="/arm", joints=("pan", "lift"))
    for base, words in (
        (Controller(topic="/base", joints=("base/v", "base/wz")), "'base/v' is not commanded by 'numbers'"),
        (Controller(topic="/base", joints=("pan",), takes="twist"), "'pan' is not commanded by 'twist'"),
        (Controller(topic="/base", joints=("base/v",), takes="twist"), "no controller commands joint 'base/wz'"),
    ):
        with pytest.raises(InputError, match=words):
            settings(controllers={"base": base, "arm": arm}).command_topics(robot)


@needs_dds
def test_a_goal_over_the_bus(robot: RobotModel, tmp_path: Path) -> None:
    """The base's frame drives 0.3 m ahead, by twists out and odometry in."""
    from simulated import Simulated

    from wbmpc.ros2.network import Network

    s = Simulated(robot, Network.of(private()))
    try:
        s.ready()
        start = s.truth()
        s.end_effector(dx=0.3)
        s.run(3.0)
        assert s.control.running, s.control.state
        assert s.truth().tool[0] - start.tool[0] == pytest.approx(0.3, abs=0.02)
        assert s.truth().pose[0] > 0.05
        np.testing.assert_allclose(s.control.adapter.estimate().position[:2], s.truth().pose[:2], atol=0.01)
        s.sim._driver = None  # its driver goes silent
        assert s.until(lambda: not s.control.running)
        says = lambda: (v for m in s.said for st in m.status for v in [*st.values, SimpleNamespace(value=st.message)])
        assert s.until(lambda: any("/base_controller/odom" in v.value for v in says()))
    finally:
        s.close()


@pytest.mark.parametrize("silent", [1.0, 7.0, 9.0, 11.0, 15.0, 20.0])
@pytest.mark.parametrize("turning", [0.5, -0.5])
def test_a_driver_that_was_silent_may_have_turned_by_more_than_half_a_turn(
    robot: RobotModel, silent: float, turning: float
) -> None:
    """With the turn beyond π the other way round the base was 0.3 m beside where it is. Truth: the constant twist."""
    way, pose, twist = BaseWay(robot), np.array([3.0, -1.0, 0.7]), np.array([0.3, -CENTER * turning, turning])
    read(way, 10.0, pose, twist)
    read(way, 10.0 + silent, lie.se2_step(pose, twist * silent), twist)
    np.testing.assert_allclose(way_at(way, 10.0 + silent), np.array([0.3, turning]) * silent, atol=1e-9)


def test_after_a_whole_turn_at_once_the_way_is_bounded(robot: RobotModel) -> None:
    way = BaseWay(robot)
    read(way, 10.0, [0.0, 0.0, 0.0], (0.0, 0.0, 1.0))
    read(way, 10.0 + 2.0 * np.pi, [0.1, 0.0, 0.0], (0.0, 0.0, 1.0))
    found = way_at(way, 10.0 + 2.0 * np.pi)
    assert abs(found[0]) <= LONGEST_WAY * 0.1 and abs(found[1]) < 7.0


@needs_dds
def test_a_way_that_was_not_heard_is_not_taken_for_rest(robot: RobotModel) -> None:
    """The base turns, and its driver says nothing for 1 s. Truth: the simulated robot's pose."""
    from simulated import Simulated

    from wbmpc.ros2.network import Network

    s = Simulated(robot, Network.of(private()))
    try:
        s.ready()
        gyro, start = s.control.adapter.controller.odometry.gyro, s.truth().pose
        assert s.until(lambda: gyro.std < KNOWN)
        bias = gyro.bias
        s.sim._command = lambda: s.sim.side.command({**s.sim.side.rest(), "wheel": np.array([0.1, 0.6])})
        s.run(0.5)
        publish, s.sim._driver._to.publish = s.sim._driver._to.publish, lambda message: None
        s.run(1.0)
        s.sim._driver._to.publish = publish
        s.run(0.3)
        s.sim._command = lambda: s.sim.side.command(s.sim.side.rest())
        s.run(0.5)
        moved = s.truth().pose - start
        assert moved[2] > 0.9 and abs(gyro.bias - bias) < 3e-3
        np.testing.assert_allclose(s.control.adapter.controller.pose, moved, atol=0.01)
    finally:
        s.close()


@needs_dds
def test_a_way_that_is_heard_more_often_than_joint_states_is_not_lost(robot: RobotModel) -> None:
    """Of 400 messages per second of the driver there are joint states to every 20th. Truth: the driver, which counts all."""
    from simulated import Simulated

    from wbmpc.ros2.network import Network

    s, count = Simulated(robot, Network.of(private()), rates={"control": 400.0}), itertools.count()
    try:
        s.ready()
        start = s.sim._driver._pose.copy()
        s.change = lambda message: message if next(count) % 20 == 0 else None
        s.end_effector(dx=0.5)
        s.run(3.0)
        assert s.control.running, s.control.state
        counted = s.sim._driver._pose - start
        assert counted[0] > 0.1
        np.testing.assert_allclose(s.control.adapter.controller.pose, counted, atol=0.01)
    finally:
        s.close()


def test_a_stamp_ahead_gives_a_base_no_time_to_move(robot: RobotModel) -> None:
    """Within the 1000 s of a wrong stamp a base gets 40 m far, and turns round many times. Truth: what has passed when it came; by a clock that was
    set forward the base goes on from where it is."""
    way = BaseWay(robot)
    moving = (0.3, 0.0, 0.5)
    read(way, 10.0, np.zeros(3), moving)
    with pytest.raises(InputError, match=r"jumped by 40 m"):
        way.read(odometry(1010.0, np.array([40.0, 0.0, 0.0]), moving), 10.02)
    before = way_at(way, 10.0)
    way.read(odometry(1010.02, np.zeros(3), moving), 10.02)
    assert np.abs(way_at(way, 1010.02) - before).max() < 1e-9
