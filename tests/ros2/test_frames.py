"""One tree of frames on the bus. Truth: a stand-in for robot_state_publisher, which knows the URDF's text only; REP 105."""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from needs import MISSING, needs_dds, private

from frame_tree import joined, of_transforms, of_urdf, place, root
from planar_driving import write_robot
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.robots.urdf import to_urdf
from wbmpc.ros2.bus import LATCHED
from wbmpc.ros2.convert import seconds
from wbmpc.ros2.network import Network
from wbmpc.ros2.opening import open_node

pytestmark = needs_dds
if not MISSING:
    from simulated import Simulated

    from wbmpc.ros2.settings import settings_of
    from wbmpc.ros2.sim import SimNode

POINTS = {"swerve-ur10": {"tool0", "mount", "imu"}, "rezero": {"tool", "imu", "ball"}}


@pytest.mark.parametrize(
    ("name", "joints"), [("swerve-ur10", {"leg_LF": "front_left", "elbow_joint": "wheel_RF_2"}), ("rezero", {})]
)
def test_bus_and_description_are_one_tree(name: str, joints: dict[str, str]) -> None:
    robot = load_robot(name)
    s = Simulated(robot, Network.of(private()), joints=joints)
    try:
        topics = "/tf", "/tf_static", "/robot_description", "/odom", "/joint_states"
        got: dict[str, list[Any]] = {topic: [] for topic in topics}
        s.control.node.subscribe("/joint_states", "sensor_msgs/msg/JointState", got["/joint_states"].append)
        s.other.subscribe("/tf", "tf2_msgs/msg/TFMessage", got["/tf"].append)
        s.other.subscribe("/odom", "nav_msgs/msg/Odometry", got["/odom"].append)
        s.control.node.subscribe("/tf_static", "tf2_msgs/msg/TFMessage", got["/tf_static"].append, LATCHED)
        s.control.node.subscribe("/robot_description", "std_msgs/msg/String", got["/robot_description"].append, LATCHED)
        s.ready()
        assert s.until(lambda: all(got[t] for t in topics))
        text = got["/robot_description"][0].data
        links, by_joints = of_urdf(text, got["/joint_states"][0].name)
        sent = of_transforms(got["/tf"])
        parents = joined(by_joints, of_transforms(got["/tf_static"]), sent)
    finally:
        s.close()
    assert root(parents, "tool0" if name != "rezero" else "tool") == "odom"
    assert sent["base_link"] == "odom" and links | {"odom"} == {*parents, "odom"}
    assert POINTS[name] <= set(parents)
    odometry = got["/odom"][0]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    # who publishes the inertial unit's frame without the description says the same as the description
    imu = next(t for t in got["/tf_static"][0].transforms if t.child_frame_id == "imu")
    joint = next(j for j in ElementTree.fromstring(text).findall("joint") if j.find("child").get("link") == "imu")  # type: ignore[union-attr]
    origin = [float(v) for v in joint.find("origin").get("xyz").split()]  # type: ignore[union-attr]
    np.testing.assert_allclose(place(imu.transform)[0], origin, atol=1e-9)


def check_inertial_frame(robot: RobotModel, frames: dict[str, str]) -> None:
    """What the simulated robot sends once, and its description, are one tree, in which the inertial unit's messages have their frame."""
    node = open_node("robot", "dds", Network.of(private()))
    try:
        sim = SimNode(node, robot, settings_of(robot).model_validate({"frames": frames}))
        own = sim.settings.frames
        text = to_urdf(robot.description, own.base, own.world)
        frame = sim._imu_frame(text)
        header = SimpleNamespace(**frame["header"])
        sent = SimpleNamespace(header=header, child_frame_id=frame["child_frame_id"])
        static = of_transforms([SimpleNamespace(transforms=[sent])])
        said: list[Any] = []
        sim._imu = SimpleNamespace(publish=said.append)  # type: ignore[assignment]
        sim.publish()
    finally:
        node.close()
    _, joints = of_urdf(text)
    parents = joined(joints, static, {own.base: own.world})
    moving = [j for j in ElementTree.fromstring(text).findall("joint") if j.get("type") != "fixed"]
    assert not any(j.find("child").get("link") in static for j in moving)  # type: ignore[union-attr]
    assert said[0]["header"]["frame_id"] in static and root(parents, said[0]["header"]["frame_id"]) == own.world


@pytest.mark.parametrize(("name", "frames"), [("swerve-ur10", {"base": "imu"}), ("panda", {"world": "imu"})])
def test_the_inertial_units_frame_is_none_of_the_base_or_the_world(name: str, frames: dict[str, str]) -> None:
    """Whatever the settings call those."""
    check_inertial_frame(load_robot(name), frames)


@pytest.mark.parametrize("link", ["upper", "shoulder"])
def test_a_link_may_be_called_like_the_inertial_units_frame(link: str, tmp_path: Path) -> None:
    """A part of the arm: the description has another parent for it, or another place."""
    file = write_robot(tmp_path, [((0.1, y), (0.0, 1.0, 0.0)) for y in (0.2, -0.2)], {"type": "differential"})
    model = file.with_suffix(".xml")
    model.write_text(model.read_text().replace(f'name="{link}"', 'name="imu"'))
    check_inertial_frame(load_robot(file), {})


@pytest.mark.parametrize("name", ["swerve-ur10", "differential-ur10", "rezero", "panda"])
def test_stamps_of_a_moving_frame_do_not_leave_the_bus_time_when_a_run_begins(name: str) -> None:
    """tf2 drops what is 10 s older than the newest that it has: one stamp in the future silences a frame. Truth: the simulator's time."""
    s = Simulated(load_robot(name), Network.of(private()))
    try:
        got: list[tuple[float, float]] = []

        def take(message: Any) -> None:
            got.extend(
                (seconds(t.header.stamp), s.sim.now()) for t in message.transforms if t.child_frame_id == "base_link"
            )

        start, read, begun = s.control.start, s.control.robot_io.read, threading.Event()

        def begin(*given: Any) -> None:
            start(*given)
            s.control.publishers._odometry()  # before the first tick
            begun.set()

        s.control.start, s.control.robot_io.read = begin, lambda: begun.wait(60.0) and read()  # type: ignore[method-assign]
        s.other.subscribe("/tf", "tf2_msgs/msg/TFMessage", take)
        s.ready()
        s.run(0.3)
        before = len(got)
        s.end_effector(dx=0.05)
        assert s.until(lambda: s.control.running), s.control.state
        s.run(0.5)
    finally:
        s.close()
    assert 0 < before < len(got) - 5
    stamps, now = np.array(got).T
    assert np.all(stamps <= now + s.sim.period) and np.all(np.diff(stamps) >= 0.0), (
        stamps - now,
        np.diff(stamps).min(),
    )
