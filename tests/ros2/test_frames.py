"""One tree of frames on the bus. Truth: a stand-in for robot_state_publisher, which knows the URDF's text only; REP 105."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from needs import MISSING, needs_dds, private

from frame_tree import joined, of_transforms, of_urdf, place, root
from wbmpc.model import load_robot
from wbmpc.ros2 import LATCHED, Network

pytestmark = needs_dds
if not MISSING:
    from simulated import Simulated

POINTS = {"swerve-ur10": {"tool0", "mount", "imu"}, "rezero": {"tool", "imu", "ball"}}


@pytest.mark.parametrize("name", list(POINTS))
def test_bus_and_description_are_one_tree(name: str) -> None:
    robot = load_robot(name)
    s = Simulated(robot, Network.of(private()))
    try:
        got: dict[str, list[Any]] = {"/tf": [], "/tf_static": [], "/robot_description": [], "/odom": [], "/imu": []}
        s.other.subscribe("/tf", "tf2_msgs/msg/TFMessage", got["/tf"].append)
        s.other.subscribe("/odom", "nav_msgs/msg/Odometry", got["/odom"].append)
        s.control.node.subscribe("/tf_static", "tf2_msgs/msg/TFMessage", got["/tf_static"].append, LATCHED)
        s.control.node.subscribe("/robot_description", "std_msgs/msg/String", got["/robot_description"].append, LATCHED)
        s.ready()
        assert s.until(lambda: all(got[t] for t in ("/tf", "/tf_static", "/robot_description", "/odom")))
        text = got["/robot_description"][0].data
        links, by_joints = of_urdf(text)
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
