"""Names and units of recorded numbers. Truth: the definitions of the ROS messages, the robots' own files."""

from __future__ import annotations

import pytest

from wbmpc.recording.quantities import channel_unit, column_unit, entry_name, joint_groups


@pytest.mark.parametrize(
    ("topic", "kind", "column", "unit"),
    [
        ("/joint_states", "sensor_msgs/JointState", "position.elbow", "rad"),
        ("/joint_states", "sensor_msgs/JointState", "effort.elbow", "N m"),
        ("/odom", "nav_msgs/Odometry", "pose.pose.position.x", "m"),
        ("/odom", "nav_msgs/Odometry", "twist.twist.angular.z", "rad/s"),
        ("/contact/foot", "geometry_msgs/WrenchStamped", "wrench.force.z", "N"),
        ("/end_effector/pose", "geometry_msgs/PoseStamped", "pose.orientation.w", "1"),
        ("/mpc/solve_time", "std_msgs/Float64", "data", "s"),
        ("/measured/accel", "std_msgs/Float64MultiArray", "data.0", "m/s²"),
        ("/theirs", "std_msgs/Float64", "data", "SI"),
    ],
)
def test_units_of_columns(topic: str, kind: str, column: str, unit: str) -> None:
    assert column_unit(topic, kind, column) == unit


def test_units_of_channels() -> None:
    known = {
        "hand": "m",
        "rotation_error": "rad",
        "drive_force": "N m",
        "wheel_slip": "m/s",
        "state": "SI",
        "command/torque": "N m",
    }
    assert {name: channel_unit(name) for name in known} == known


def test_entries_of_arrays_are_the_joints_of_the_robot() -> None:
    joints = joint_groups({"robot": "panda"})
    assert joints["arm"] == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert entry_name("/command/arm", "data.6", 7, joints) == "panda_joint7"
    assert entry_name("/command/arm", "data.6", 8, joints) == "data.6"  # another robot's
    assert entry_name("/measured/gyro", "data.2", 3, {}) == "z"
    assert joint_groups({"robot": "/nowhere.yaml"}) == joint_groups("damaged") == {}
