"""Names and units of recorded numbers. Truth: the definitions of the ROS messages, the robots' own files."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import pytest

from wbmpc.recording.quantities import JOINT_UNITS, Columns, channel_unit, column_unit, entry_name, joint_groups
from wbmpc.recording.reader import Recording, Topic
from wbmpc.simulation.scene import joint_units


@pytest.mark.parametrize(
    ("topic", "kind", "column", "unit"),
    [
        ("/joint_states", "sensor_msgs/JointState", "position.elbow", ""),  # it may slide
        ("/odom", "nav_msgs/Odometry", "pose.pose.position.x", "m"),
        ("/odom", "nav_msgs/Odometry", "twist.twist.angular.z", "rad/s"),
        ("/contact/foot", "geometry_msgs/WrenchStamped", "wrench.force.z", "N"),
        ("/ground_truth/end_effector", "geometry_msgs/PoseStamped", "pose.orientation.w", "1"),
        ("/mpc/solve_time", "std_msgs/Float64", "data", "s"),
        ("/measured/accel", "std_msgs/Float64MultiArray", "data.0", "m/s²"),
        ("/theirs", "std_msgs/Float64", "data", ""),
    ],
)
def test_units_of_columns(topic: str, kind: str, column: str, unit: str) -> None:
    assert column_unit(topic, kind, column) == unit


def test_groups_of_joints_are_those_of_the_robot() -> None:
    """Truth: the robot's file, and one that is not here."""
    topics = {
        f"/{where}/{group}": Topic("std_msgs/Float64MultiArray", "")
        for where in ("measured", "command")
        for group in ("steer", "arm", "base")
    }
    of = lambda robot: {JOINT_UNITS: {"a": "rad"}, "run": {"settings": json.dumps({"robot": robot})}}
    known, unknown = (Columns(Recording(Path(), topics, of(robot), {}, True)) for robot in ("swerve-ur10", "?"))
    assert [known.unit(t, "data.0", 4) for t in topics] == ["rad", "rad", "", "rad/s", "rad/s", ""]
    assert [unknown.unit(t, "data.0", 4) for t in topics] == ["", "rad", "", "", "rad/s", ""]


LIFT = """<mujoco><worldbody><body><freejoint/><geom size=".1"/><body>
  <joint name="lift" type="slide"/><geom size=".1"/>
  <body><joint name="elbow"/><geom size=".1"/></body></body></body></worldbody></mujoco>"""


def test_joints_that_slide_have_other_units() -> None:
    units = joint_units(mujoco.MjModel.from_xml_string(LIFT))
    assert units == {"lift": "m", "elbow": "rad"}
    topics = {
        "/joint_states": Topic("sensor_msgs/JointState", ""),
        "/command/arm": Topic("std_msgs/Float64MultiArray", ""),
    }
    columns = Columns(Recording(Path(), topics, {JOINT_UNITS: units}, {}, True))
    of = lambda column: columns.unit("/joint_states", column, 6)
    assert [of(f"{part}.lift") for part in ("position", "velocity", "effort")] == ["m", "m/s", "N"]
    assert [of(f"{part}.elbow") for part in ("position", "velocity", "effort")] == ["rad", "rad/s", "N m"]
    assert columns.unit("/command/arm", "data.0", 2) == ""  # whose it is, is not known, and one of the joints slides
    turning = Columns(Recording(Path(), topics, {JOINT_UNITS: {"elbow": "rad"}}, {}, True))
    assert turning.unit("/command/arm", "data.0", 1) == "rad/s"


def test_units_of_channels() -> None:
    known = {
        "hand": "m",
        "rotation_error": "rad",
        "drive_force": "",
        "wheel_slip": "m/s",
        "state": "",
        "torque": "N m",
        "sliding": "m/s",
        "planned_clearance": "m",
        "coefficient": "1",
    }
    assert {name: channel_unit(name) for name in known} == known


def test_entries_of_arrays_are_the_joints_of_the_robot() -> None:
    joints = joint_groups({"robot": "panda"})
    assert joints["arm"] == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert entry_name("/command/arm", "data.6", 7, joints) == "panda_joint7"
    assert entry_name("/command/arm", "data.6", 8, joints) == "data.6"  # another robot's
    assert entry_name("/measured/gyro", "data.2", 3, {}) == "z"
    assert joint_groups({"robot": "/nowhere.yaml"}) == joint_groups("damaged") == {}
