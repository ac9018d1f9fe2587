"""What recorded numbers are called and their units: columns of topics, entries of arrays, channels of a log."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Mapping
from typing import TYPE_CHECKING, Any

from wbmpc.bases.base import WHEELS
from wbmpc.errors import InputError
from wbmpc.robots import load_description
from wbmpc.units import force_unit, rate_unit

if TYPE_CHECKING:
    from wbmpc.recording.reader import Recording

#: Record of a recording's metadata: units of the positions of joints by their name.
JOINT_UNITS = "joint_units"
#: Parts of JointState: how their units follow from that of the joint's position.
_JOINT_PARTS: dict[str, Callable[[str], str]] = {"position": str, "velocity": rate_unit, "effort": force_unit}
#: Units of columns by the end of their name, by message type.
_FIELDS = {
    "geometry_msgs/WrenchStamped": (("wrench.force", "N"), ("wrench.torque", "N m")),
    "nav_msgs/Odometry": (("twist.twist.linear", "m/s"), ("twist.twist.angular", "rad/s")),
}
#: Of poses, wherever they are in a message.
_POSES = ((r"(position|translation)\.[xyz]$", "m"), (r"(orientation|rotation)\.[xyzw]$", "1"))
#: Of arrays and numbers by topic; the first that fits is taken.
_TOPICS = (
    (r"/mpc/(solve_time|period)$", "s"), (r"/mpc/clearance$", "m"), (r"/mpc/", "1"), (r"/gyro$", "rad/s"), (r"/accel$", "m/s²"),
    (r"/force$", "N"), (r"/brake$", "1"),
)  # fmt: skip
#: Of arrays of joints by topic: how their units follow from that of the joint's position; the first that fits is taken.
_JOINT_TOPICS: tuple[tuple[str, Callable[[str], str]], ...] = (
    (r"/command/torque$", force_unit), (r"/command/position$", str),
    (r"/command/stiffness$", lambda unit: f"{force_unit(unit)}/{unit}" if force_unit(unit) else ""),
    (r"/command/damping$", lambda unit: f"{force_unit(unit)} s/{unit}" if force_unit(unit) else ""),
    (r"/command/speed$", rate_unit),
)  # fmt: skip
#: The same of topics that end in the name of a group of joints, by the part before it.
_GROUP_TOPICS: dict[str, Callable[[str], str]] = {"measured": str, "command": rate_unit}
#: Of a log's channels; the first that fits is taken.
_CHANNELS = (
    (r"quaternion|brake", "1"), (r"orientation|rotation|yaw|tilt", "rad"), (r"gyro", "rad/s"), (r"torque", "N m"), (r"^force", "N"),
    (r"wheel_slip$|^sliding$", "m/s"), (r"^(hand|end_effector)", "m"),
    (r"clearance|penetration|margin|^feet$|^zero_moment_point$|^wall$", "m"), (r"coefficient|^grip$|^pushing$|^touching$|_fault$", "1"),
    (r"^payload", "kg"),
)  # fmt: skip
#: What the entries of arrays are called whatever the robot.
_AXES = {"gyro": ("x", "y", "z"), "accel": ("x", "y", "z"), "force": ("x", "y", "z")}


class Columns:
    """Names and units of what a recording's topics hold; "" for a unit that is not known. ``groups`` of joints, where the robot is known."""

    def __init__(self, recording: Recording) -> None:
        self._topics, self.groups = recording.topics, joint_groups(recording.settings)
        self._units: Mapping[str, str] = recording.metadata.get(JOINT_UNITS, {})
        #: Unit of what turns or slides without being a joint of the simulated world: known where nothing slides.
        self._other = "rad" if set(self._units.values()) == {"rad"} else ""

    def name(self, topic: str, column: str, count: int) -> str:
        """What a ``column`` of a topic with ``count`` numbers is called."""
        if self._topics[topic].kind == "sensor_msgs/JointState":
            return column.partition(".")[2]
        return entry_name(topic, column, count, self.groups)

    def unit(self, topic: str, column: str, count: int) -> str:
        """The unit of a ``column`` of a topic with ``count`` numbers."""
        kind = self._topics[topic].kind
        position = self._units.get(self.name(topic, column, count), self._other)
        return column_unit(topic, kind, column, position, {"arm", WHEELS, *self.groups})


def column_unit(topic: str, kind: str, column: str, position: str = "", groups: Container[str] = ()) -> str:
    """The unit of a topic's column, of a message type ``kind``; "" where it is not known which.

    ``position``: the unit of the position of the joint that the column is of; ``groups`` of the robot's joints.
    """
    part = column.partition(".")[0]
    if kind == "sensor_msgs/JointState" and part in _JOINT_PARTS:
        return _JOINT_PARTS[part](position)
    for field, unit in _FIELDS.get(kind, ()):
        if column.startswith(field):
            return unit
    for pattern, unit in _POSES:
        if re.search(pattern, column):
            return unit
    above, _, group = topic.rpartition("/")
    if group in groups and (derive := _GROUP_TOPICS.get(above.rpartition("/")[2])):
        return derive(position)
    for pattern, derived in _JOINT_TOPICS:
        if re.search(pattern, topic):
            return derived(position)
    return next((unit for pattern, unit in _TOPICS if re.search(pattern, topic)), "")


def channel_unit(channel: str) -> str:
    """The unit of a log's channel whose components have none of their own; "" where it is not known which."""
    last = channel.split(".")[-1]
    return next((unit for pattern, unit in _CHANNELS if re.search(pattern, last)), "")


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
    torques = (*joints.get(WHEELS, ()), *joints.get("arm", ()))
    names = (
        torques
        if part in ("torque", "position", "speed", "stiffness", "damping")
        else joints.get(part, _AXES.get(part, ()))
    )
    return names[int(found[1])] if len(names) == count else column
