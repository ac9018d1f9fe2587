"""A base that takes speeds, on a bus: its driver gets a twist and says in an odometry how far it went. Its wheels are not known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.base import WHEELS
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.bus import DEFAULT, Node
from wbmpc.ros2.convert import header, planar, pose, read_pose, read_vector, seconds, vector
from wbmpc.ros2.joints import SPEED_FACTOR, SPEED_REST, JointSample, Waited

#: Between two messages the way goes on with the speed of the last one for so long [s] at most.
HELD = 0.1
#: A way over a silence is at most so many times as long as the line between its ends: after whole turns nothing is known of it.
LONGEST_WAY = 20.0


@dataclass(frozen=True)
class _Seen:
    """At ``stamp`` [s] the driver was at ``pose`` (3) in its own frame (None: the next message begins another one); ``way`` (m) [m, rad]
    along each speed of the base, ``speeds`` (m); the message ``came`` [s]."""

    stamp: float
    pose: Array | None
    way: Array
    speeds: Array
    came: float


class BaseWay:
    """How far a base went along each of its speeds (m), as the nav_msgs/Odometry of its driver says: like angles of wheels, which count
    from anywhere. What is wrong with a message is an :class:`InputError`."""

    def __init__(self, robot: RobotModel) -> None:
        self._twist, self._inverse = robot.base.twist, np.linalg.pinv(robot.base.twist)
        limits, speeds = robot.limits, robot.input["base"]
        fastest = np.maximum(np.abs(limits.input_lower[speeds]), np.abs(limits.input_upper[speeds]))
        self._fastest = np.abs(self._twist) @ fastest  # in each direction of the frame [m/s, m/s, rad/s]
        self._seen: _Seen | None = None
        self._waited = Waited()

    def read(self, message: Any, now: float) -> None:
        """Take in a message that came ``now`` [s]. One from before the last, or farther from it than the base can move, is an error."""
        at = planar(*read_pose(message.pose.pose, "base odometry"))
        linear, angular = (read_vector(getattr(message.twist.twist, n), "base odometry") for n in ("linear", "angular"))
        stamp, last = seconds(message.header.stamp), self._seen
        if last is not None and stamp < last.stamp:
            raise InputError(f"base odometry: its time went back by {last.stamp - stamp:.3f} s")
        way = np.zeros(len(self._inverse)) if last is None else last.way
        speeds = self._inverse @ [linear[0], linear[1], angular[2]]
        if last is not None and last.pose is not None:
            # a stamp far ahead is no time in which a base could move, but for a message that has waited
            came = self._waited.interval(max(now - last.came, 0.0), stamp - last.stamp)
            passed = min(stamp - last.stamp, came + HELD)
            turn = 0.5 * float(self._twist[2] @ (last.speeds + speeds)) * passed
            moved = _arc(last.pose, at, turn)
            if np.any(np.abs(moved) > SPEED_FACTOR * self._fastest * passed + SPEED_REST):
                far, turned = float(np.hypot(*moved[:2])), abs(float(moved[2]))
                raise InputError(
                    f"base odometry: it jumped by {far:.3g} m and {turned:.3g} rad in {1e3 * passed:.3g} ms, faster than the base can move"
                )
            way = way + self._inverse @ moved
        self._seen = _Seen(stamp, at, way, speeds, now)

    def reset(self) -> None:
        """The next message may be of any time and place, and moves nothing."""
        if self._seen is not None:
            self._seen = replace(self._seen, stamp=-np.inf, pose=None)

    @property
    def stamp(self) -> float | None:
        """Of the last message [s]; None before the first."""
        return None if self._seen is None else self._seen.stamp

    def with_way(self, sample: JointSample) -> JointSample:
        """Joint states with the way (m) by their time in place of wheels' angles."""
        seen = self._seen
        assert seen is not None
        ahead = float(np.clip(sample.stamp - seen.stamp, 0.0, HELD))
        return replace(sample, groups={**sample.groups, WHEELS: seen.way + ahead * seen.speeds})


def _arc(start: Array, end: Array, expected: float) -> Array:
    """Integral (3) of the constant body twist between two poses: of all that lead there, the one whose turn is nearest to what is
    ``expected`` [rad]. A driver that was silent may have turned by more than π."""
    short = lie.se2_log(start, end)
    rounds = np.round((expected - short[2]) / (2.0 * np.pi))
    if rounds == 0.0:
        return short
    turn = short[2] + 2.0 * np.pi * rounds
    half, away = 0.5 * turn, np.asarray(end[:2]) - start[:2]
    length = min(abs(half / np.sin(half)) if np.sin(half) else np.inf, LONGEST_WAY) * np.sign(half * np.sin(half))
    c, s = np.cos(start[2] + half), np.sin(start[2] + half)  # along the chord
    return np.array([length * (c * away[0] + s * away[1]), length * (c * away[1] - s * away[0]), turn])


class TwistSender:
    """To the driver of a ``robot``'s base: geometry_msgs/TwistStamped in axes of the frame ``base``. Its stamp is 0, which
    diff_drive_controller takes for its own time: clocks of two machines differ."""

    def __init__(self, node: Node, topic: str, kind: str, robot: RobotModel, base: str) -> None:
        self._to, self._twist, self._frame = node.publisher(topic, kind, DEFAULT), robot.base.twist, base

    def send(self, values: dict[str, Array]) -> None:
        """A command by groups: the base's speeds are in the group of its wheels."""
        vx, vy, turn = self._twist @ values[WHEELS]
        twist = {"linear": vector(np.array([vx, vy, 0.0])), "angular": vector(np.array([0.0, 0.0, turn]))}
        self._to.publish({"header": header(0.0, self._frame), "twist": twist})


def ordered_speeds(robot: RobotModel, message: Any) -> Array:
    """The base's speeds (m) that a TwistStamped asks for. Raises :class:`InputError` for numbers that are not finite."""
    linear, angular = (read_vector(getattr(message.twist, n), "base's twist") for n in ("linear", "angular"))
    return np.asarray(np.linalg.pinv(robot.base.twist) @ [linear[0], linear[1], angular[2]])


class SimulatedDriver:
    """What the driver of a simulated base publishes: its odometry, from the way (m) that it counts."""

    def __init__(self, node: Node, topic: str, robot: RobotModel, world: str, base: str) -> None:
        self._to, self._twist = node.publisher(topic, "nav_msgs/msg/Odometry", DEFAULT), robot.base.twist
        self._world, self._base = world, base
        self._pose, self._last = np.zeros(3), (0.0, np.zeros(robot.base.twist.shape[1]))

    def publish(self, now: float, way: Array) -> None:
        """At ``now`` [s]."""
        before, last = self._last
        moved = self._twist @ (way - last)
        if now > before:
            self._pose, self._last = lie.se2_step(self._pose, moved), (now, way.copy())
        vx, vy, turn = moved / (now - before) if 0.0 < now - before < HELD else np.zeros(3)
        turned = np.asarray(lie.quaternion_about((0.0, 0.0, 1.0), float(self._pose[2])))
        self._to.publish({
            "header": header(now, self._world), "child_frame_id": self._base,
            "pose": {"pose": pose(np.array([*self._pose[:2], 0.0]), turned)},
            "twist": {"twist": {"linear": vector(np.array([vx, vy, 0.0])), "angular": vector(np.array([0.0, 0.0, turn]))}},
        })  # fmt: skip
