"""What recorded numbers are called and their units: columns of topics, entries of arrays, channels of a log."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from wbmpc.errors import InputError
from wbmpc.robots import load_description

#: Units of columns by the end of their name, by message type.
_FIELDS = {
    "sensor_msgs/JointState": (("position", "rad"), ("velocity", "rad/s"), ("effort", "N m")),
    "geometry_msgs/WrenchStamped": (("wrench.force", "N"), ("wrench.torque", "N m")),
    "nav_msgs/Odometry": (("twist.twist.linear", "m/s"), ("twist.twist.angular", "rad/s")),
}
#: Of poses, wherever they are in a message.
_POSES = ((r"(position|translation)\.[xyz]$", "m"), (r"(orientation|rotation)\.[xyzw]$", "1"))
#: Of arrays and numbers by topic; the first that fits is taken.
_TOPICS = (
    (r"/mpc/(solve_time|period)$", "s"), (r"/mpc/clearance$", "m"), (r"/mpc/", "1"), (r"/command/torque$", "N m"),
    (r"/command/position$", "rad"), (r"/command/stiffness$", "N m/rad"), (r"/command/damping$", "N m s/rad"),
    (r"/command/(arm|wheel|steer|leg|speed)$", "rad/s"), (r"/measured/(arm|wheel|steer|leg)$", "rad"), (r"/gyro$", "rad/s"),
    (r"/accel$", "m/s²"), (r"/force$", "N"), (r"/brake$", "1"),
)  # fmt: skip
#: Of a log's channels; the first that fits is taken.
_CHANNELS = (
    (r"orientation|rotation|yaw|tilt", "rad"), (r"joint_speed|wheel_speed|gyro", "rad/s"), (r"torque|drive_force", "N m"), (r"force", "N"),
    (r"slip|twist|velocity", "m/s"), (r"^base", "m, yaw: rad"), (r"^(hand|end_effector|error|ball)", "m"), (r"brake", "1"),
)  # fmt: skip
#: What the entries of arrays are called whatever the robot.
_AXES = {"gyro": ("x", "y", "z"), "accel": ("x", "y", "z"), "force": ("x", "y", "z")}


def column_unit(topic: str, kind: str, column: str) -> str:
    """The unit of a topic's column, of a message type ``kind``; "SI" where it is not known which."""
    for field, unit in _FIELDS.get(kind, ()):
        if column.startswith(field):
            return unit
    for pattern, unit in _POSES:
        if re.search(pattern, column):
            return unit
    return next((unit for pattern, unit in _TOPICS if re.search(pattern, topic)), "SI")


def channel_unit(channel: str) -> str:
    """The unit of a log's channel, or of a topic; "SI" where it is not known which."""
    if "/" in channel:
        return next((unit for pattern, unit in _TOPICS if re.search(pattern, f"/{channel.strip('/')}")), "SI")
    last = channel.split(".")[-1]
    return next((unit for pattern, unit in _CHANNELS if re.search(pattern, last)), "SI")


def joint_groups(settings: Any) -> dict[str, tuple[str, ...]]:
    """Joints of a run's robot by group ("arm", those of its base), from the run's ``settings``; nothing where they are not known."""
    robot = settings.get("robot") if isinstance(settings, dict) else None
    try:
        description = load_description(robot) if isinstance(robot, str) else None
    except InputError:  # a file that is elsewhere
        return {}
    if description is None:
        return {}
    return {"arm": tuple(description.arm.joints), **{g: tuple(n) for g, n in description.base.joint_groups().items()}}


def entry_name(topic: str, column: str, count: int, joints: Mapping[str, tuple[str, ...]]) -> str:
    """What entry ``data.I`` of an array of ``count`` numbers is called: the robot's joint, an axis, or as the column."""
    found = re.fullmatch(r"data\.([0-9]+)", column)
    if found is None:
        return column
    part = topic.rpartition("/")[2]
    torques = (*joints.get("wheel", ()), *joints.get("arm", ()))
    names = (
        torques
        if part in ("torque", "position", "speed", "stiffness", "damping")
        else joints.get(part, _AXES.get(part, ()))
    )
    return names[int(found[1])] if len(names) == count else column
