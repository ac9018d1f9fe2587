"""A check of a robot's bus before anything moves: what is missing, mistyped, too slow, or has the wrong quality of service."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.base_driver import BaseWay
from wbmpc.ros2.bus import DEFAULT, LATCHED, SENSOR, Endpoint, Node
from wbmpc.ros2.convert import one_line, seconds
from wbmpc.ros2.joints import JointReader, read_imu
from wbmpc.ros2.localization import POSE_AGE, PoseSource
from wbmpc.ros2.settings import OBSTACLE_TYPES, Controller, RosSettings
from wbmpc.ros2.transforms import KIND, MOVING, TF

OK, WARNING, ERROR = "ok", "warning", "error"
#: Joint states slower than this [Hz] make a poor estimate; a watchdog needs this many messages within its time.
_MIN_RATE, _WITHIN_WATCHDOG = 100.0, 2.0
#: A sensor that has a message for this share of the ticks counts as one for each.
_OF_THE_TICKS = 0.9
#: Discovery takes this long [s] before what is not there counts as missing.
_DISCOVERY = 1.0


@dataclass(frozen=True)
class Finding:
    """``level``: ok, warning or error; ``topic``; a message."""

    level: str
    topic: str
    text: str


class _Ear:
    """Listens to one topic: arrival times, stamps, the last one's age, and what a reader says of the messages."""

    def __init__(self, node: Node, topic: str, kind: str, read: Any) -> None:
        self.times: list[float] = []
        self.stamps: list[float] = []
        self.topic, self.fault, self.offset = topic, "", np.nan
        self._read = read
        node.subscribe(topic, kind, self._take, SENSOR)

    def _take(self, message: Any) -> None:
        self.times.append(time.perf_counter())
        self.stamps.append(seconds(message.header.stamp if hasattr(message, "header") else message.clock))
        self.offset = time.time() - self.stamps[-1]
        try:
            self._read(message)
        except InputError as error:
            self.fault = self.fault or str(error)

    @property
    def rate(self) -> float:
        """Messages a second."""
        t = self.times
        return (len(t) - 1) / (t[-1] - t[0]) if len(t) > 2 else 0.0

    @property
    def gap(self) -> float:
        """The longest time [s] between two messages."""
        return float(np.diff(self.times).max()) if len(self.times) > 1 else np.inf

    @property
    def stands(self) -> bool:
        """Whether message after message has the same stamp, and one at all."""
        return len(self.stamps) > 2 and self.stamps[0] == self.stamps[-1] > 0.0


class _PlacesOfBase:
    """Who says on /tf where the frame ``base`` is."""

    def __init__(self, node: Node, base: str) -> None:
        self._base, self._parents = base, dict[Any, str]()
        node.subscribe(TF, KIND, self._take, MOVING, sourced=True)

    def _take(self, message: Any, source: Any = None) -> None:
        for transform in message.transforms:
            if transform.child_frame_id == self._base:
                self._parents[source] = str(transform.header.frame_id)

    def findings(self, node: Node, ours: str) -> list[Finding]:
        """Of those that are not the controller ``ours``."""
        there = any(node.owner(e) == ours for e in node.publishers(TF))
        if len(self._parents) <= there:
            return []
        parent = next(iter(self._parents.values()))
        text = f"another node says where '{self._base}' is in '{parent}', as the controller will: two odometries mix"
        return [Finding(WARNING, TF, f"{text} (diff_drive_controller: enable_odom_tf: false)")]


def check(node: Node, robot: RobotModel, settings: RosSettings, listen: float = 3.0) -> list[Finding]:
    """Listen for ``listen`` [s] and say what was found; sends nothing."""
    topics, reader = settings.topics, JointReader(robot, settings)
    timed = lambda read: lambda message: read(message, time.perf_counter())
    target: dict[str, tuple[str, Any]] = {topics.joint_states: ("sensor_msgs/msg/JointState", timed(reader.read))}
    if topics.imu and robot.description.base.moves:
        target[topics.imu] = "sensor_msgs/msg/Imu", read_imu
    if robot.description.base.takes_twist:
        target[topics.base_odom] = "nav_msgs/msg/Odometry", timed(BaseWay(robot).read)
    target["/clock"] = "rosgraph_msgs/msg/Clock", lambda message: None
    ears = {topic: _Ear(node, topic, kind, read) for topic, (kind, read) in target.items()}
    poses = PoseSource(node, settings, time.monotonic, time.time) if topics.pose else None
    places = _PlacesOfBase(node, settings.frames.base)
    described: list[str] = []
    node.subscribe("/robot_description", "std_msgs/msg/String", lambda m: described.append(m.data), LATCHED)
    silent, begin = 0.0, time.monotonic()
    while time.monotonic() - begin < max(listen, _DISCOVERY):
        if poses is not None:
            poses.update()
            silent = max(silent, time.monotonic() - max(poses.at, begin))
        time.sleep(0.02 if poses is not None else max(listen, _DISCOVERY))
    found: list[Finding] = []
    for topic, (kind, _) in target.items():
        if topic == "/clock" and not settings.use_sim_time:
            found += _needless_clock(node, ears[topic])
            continue
        needed = topic != topics.imu or robot.base.balances
        found += _source(node, topic, kind, ears[topic], settings, needed)
        if robot.base.balances and topic != "/clock":
            found += _balancing(topic, ears[topic].rate, settings.rates.control)
    found += _which_robot(robot, ears[topics.joint_states], described)
    controllers = settings.command_topics(robot)
    for controller in controllers.values():
        found += _sink(node, controller, settings.node, needed="brake" not in controller.topic)
    found += _brakes(robot, controllers)
    found += _other_odometry(node, topics.odom, settings.node) + places.findings(node, settings.node)
    found += _several_types(node, topics.cmd_vel, ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"), False)
    for key, kind in {**topics.requests, **OBSTACLE_TYPES}.items():
        found += _order(node, getattr(topics, key), kind)
    if poses is not None:
        found += _localization(node, poses, topics.pose, silent)
    return [replace(f, text=one_line(f.text)) for f in found]


def _which_robot(robot: RobotModel, joints: _Ear, described: list[str]) -> list[Finding]:
    """The robot that is there: by its URDF on the bus, if there is one, and by its joints."""
    target = robot.description.name
    has_joints = bool(joints.times) and not joints.fault
    if described:
        # no further than to the next tag: of a hostile text each beginning would be followed to its end
        named = re.search(r"""<robot\b[^<>]*\bname\s*=\s*["']([^"']*)["']""", described[-1])
        name = named.group(1) if named else ""
        if name and name != target:
            fit = "its joints fit all the same" if has_joints else "its joints do not fit either"
            text = f"the robot on the bus is called '{name}', not '{target}'; {fit}"
            return [Finding(WARNING if has_joints else ERROR, "robot", text)]
        if name:
            return [Finding(OK, "robot", f"the robot on the bus is '{name}'")]
    return [Finding(OK, "robot", f"the robot on the bus has the joints of '{target}'")] if has_joints else []


def _localization(node: Node, poses: PoseSource, topic: str, silent: float) -> list[Finding]:
    """Of another localization, without which nothing starts; ``silent`` [s]: the longest time without a pose that counts."""
    found = _several_types(node, topic, ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped"), True)
    if any(f.level != OK for f in found):
        return found
    if poses.fault:
        return [Finding(ERROR, topic, poses.fault)]
    if silent > POSE_AGE:
        return [Finding(ERROR, topic, f"too slow: {silent:.2f} s without a pose, the limit is {POSE_AGE:g} s")]
    return found


def _balancing(topic: str, rate: float, target: float) -> list[Finding]:
    """Of sensors that keep a robot upright: every tick of its controller needs a message."""
    if not 0.0 < rate < _OF_THE_TICKS * target:
        return []
    return [
        Finding(
            WARNING,
            topic,
            f"slow: {rate:.0f} Hz, the controller of a robot that balances, at {target:g} Hz, needs as many",
        )
    ]


def _brakes(robot: RobotModel, controllers: dict[str, Controller]) -> list[Finding]:
    brakes = [f"{group}/{n}" for group, held in robot.base.brakes.items() for n in robot.input.groups[held]]
    left = [name for name in brakes if not any(name in c.joints for c in controllers.values())]
    if not left:
        return []
    return [
        Finding(
            WARNING,
            "controllers",
            f"no controller commands the brake of {left[0].partition('/')[2]} ('{left[0]}'): it stays as it is",
        )
    ]


def _other_odometry(node: Node, topic: str, ours: str) -> list[Finding]:
    """Of a base controller that publishes an odometry of its own."""
    who = [node.owner(e) for e in node.publishers(topic) if not e.own] if topic else []
    return [Finding(WARNING, topic, f"'{name}' publishes it too: two odometries mix") for name in who if name != ours]


def _needless_clock(node: Node, ear: _Ear) -> list[Finding]:
    if not node.publishers("/clock"):
        return []
    findings = [Finding(WARNING, "/clock", "it is published, but the node runs on wall time: use --use-sim-time")]
    return findings + ([Finding(WARNING, "/clock", _stands(ear))] if ear.stands else [])


def _stands(ear: _Ear) -> str:
    return f"it stands still at {ear.stamps[-1]:.3f} s: the simulation is paused, or in lockstep waits for a controller"


def _source(node: Node, topic: str, kind: str, ear: _Ear, settings: RosSettings, needed: bool) -> list[Finding]:
    level = ERROR if needed else WARNING
    publishers = node.publishers(topic)
    if not publishers:
        without = "" if needed else " (the odometry is then of the wheels alone)"
        return [Finding(level, topic, f"no publisher{without}")]
    wrong = _wrong_types(topic, publishers, (kind,))
    if wrong or not ear.times:
        return wrong or [Finding(level, topic, "it has a publisher but no message came")]
    found = []
    if len(publishers) > 1:
        found.append(Finding(ERROR, topic, f"{len(publishers)} publishers: their messages mix"))
    if ear.fault:
        found.append(Finding(ERROR, topic, ear.fault))
    if ear.stands:
        text = f"its stamps stand still at {ear.stamps[-1]:.3f} s: a driver that hangs, or a simulation that is paused"
        found.append(Finding(level, topic, _stands(ear) if topic == "/clock" else text))
    limit = settings.safety.watchdog
    if ear.rate < _WITHIN_WATCHDOG / limit:
        found.append(
            Finding(
                level,
                topic,
                f"too slow: {ear.rate:.1f} Hz, the watchdog of {limit:g} s needs {_WITHIN_WATCHDOG / limit:g}",
            )
        )
    elif ear.rate < _MIN_RATE and topic != "/clock":
        found.append(Finding(WARNING, topic, f"slow: {ear.rate:.1f} Hz, {_MIN_RATE:g} or more are better"))
    elif ear.gap > limit and topic != "/clock":
        found.append(
            Finding(WARNING, topic, f"irregular: {1e3 * ear.gap:.0f} ms without a message, the watchdog is {limit:g} s")
        )
    if not settings.use_sim_time and topic != "/clock" and abs(ear.offset) > 1.0:
        found.append(
            Finding(
                WARNING,
                topic,
                f"its stamps are {ear.offset:.1f} s off this machine's clock, at {ear.rate:.0f} Hz (use_sim_time?)",
            )
        )
    return found or [Finding(OK, topic, f"{kind}, {ear.rate:.0f} Hz, longest gap {1e3 * ear.gap:.0f} ms")]


def _sink(node: Node, controller: Controller, ours: str, needed: bool) -> list[Finding]:
    topic = controller.topic
    subscribers = [e for e in node.subscribers(topic) if not e.own]
    who = [node.owner(e) for e in node.publishers(topic) if not e.own]
    others = [name for name in who if name != ours]
    if others:
        named = f" ('{others[0]}')" if others[0] else ""
        return [Finding(ERROR, topic, f"another node publishes on it{named}: the controller will not start")]
    if len(who) > 1:
        return [Finding(ERROR, topic, f"{len(who)} nodes called '{ours}' publish on it: they stop each other")]
    if not subscribers:
        return [Finding(ERROR if needed else WARNING, topic, "no subscriber: is the controller active?")]
    wrong = _wrong_types(topic, subscribers, (controller.type,))
    if wrong:
        return wrong
    faults = [Finding(ERROR, topic, e.qos.incompatible(DEFAULT)) for e in subscribers if e.qos.incompatible(DEFAULT)]
    there = f"; the controller '{ours}' is there" if who else ""
    return faults or [Finding(OK, topic, f"{len(subscribers)} listening{there}")]


def _order(node: Node, topic: str, kind: str) -> list[Finding]:
    """Of optional publishers of goals and requests."""
    publishers = [e for e in node.publishers(topic) if not e.own] if topic else []
    found = _wrong_types(topic, publishers, (kind,))
    offers = [DEFAULT.incompatible(e.qos) for e in publishers if e.type == kind]
    return found + [Finding(ERROR, topic, f"a publisher does not reach us: {why}") for why in offers if why]


def _several_types(node: Node, topic: str, kinds: tuple[str, ...], needed: bool) -> list[Finding]:
    publishers = node.publishers(topic) if topic else []
    if not publishers:
        return [Finding(ERROR, topic, "no publisher")] if topic and needed else []
    return _wrong_types(topic, publishers, kinds) or [Finding(OK, topic, publishers[0].type)]


def _wrong_types(topic: str, endpoints: list[Endpoint], kinds: tuple[str, ...]) -> list[Finding]:
    wrong = sorted({e.type for e in endpoints} - set(kinds))
    return [Finding(ERROR, topic, f"its type is {k}, {' or '.join(kinds)} is needed") for k in wrong]
