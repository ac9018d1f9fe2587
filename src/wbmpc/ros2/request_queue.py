"""Goals from the bus: poses, paths and speeds become requests that make a task at the moment they are taken up."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.logs import RateLimit
from wbmpc.ros2.bus import DEFAULT, LONG, Node
from wbmpc.ros2.convert import error_message, planar, planar_path, read_pose, read_poses, read_vector, seconds
from wbmpc.ros2.goals import Planner, Task, base_track, end_effector_track
from wbmpc.ros2.hold_ups import AGAIN, WAITED, HoldUps
from wbmpc.ros2.multi_type_subscriber import MultiTypeSubscriber
from wbmpc.ros2.settings import RosSettings

_LOG = logging.getLogger("wbmpc")
Time = Callable[[], float]
#: More points than this are a mistake.
_MAX_POINTS = 20_000
_TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
#: A path begins within this time [s], or its stamps are of another clock.
_LATEST = 60.0
#: So far [m] under the floor or over the base's own height a goal of the base is still one: localizations in space are not exact.
_OFF_FLOOR = 0.5


@dataclass(frozen=True)
class Request:
    """``make`` of the state (nx) and the plan's time [s] says what is to be done from then on. It ``came`` at a time [s] of
    :class:`HoldUps`; what only brings a base to ``rest`` is never too old, and starts no robot."""

    make: Callable[[Array, float], Task]
    came: float = np.inf
    rest: bool = False

    def __call__(self, x: Array, t: float) -> Task:
        return self.make(x, t)


class RequestQueue:
    """Listens to goals; the newest one counts, but paths of base and end effector go together. ``rejected``: why the last bad one was
    not taken; empty when one has been taken since.

    ``hold_ups`` of the process; ``origin()``: the bus's time [s] that is 0 for the plan; ``now()`` [s]: by which speeds run out;
    ``elapsed()`` [s]: by which the pauses of a stream of speeds are measured; it leaves out jumps of simulated time.
    ``running``: the task in force, set by who takes them up.
    """

    def __init__(
        self, hold_ups: HoldUps, node: Node, planner: Planner, settings: RosSettings, origin: Time, now: Time, elapsed: Time
    ) -> None:  # fmt: skip
        self.node, self.planner, self.settings = node, planner, settings
        self.origin, self.now, self.elapsed, self.hold_ups = origin, now, elapsed, hold_ups
        self.rejected = self._limited = ""
        self.running: Task | None = None
        self._limited_log = RateLimit()
        self._requests: dict[str, Request] = {}
        self._lock = threading.RLock()
        # when the last speed that counted came, and by the other time the last one of all
        self._twist_at = self._spoken_at = -np.inf
        self._moving = self._latched = False
        self._fastest = settings.fastest(planner.robot)
        speeds = settings.topics.cmd_vel
        self._speeds = MultiTypeSubscriber(
            node, speeds, dict.fromkeys(_TWISTS, partial(self._try, speeds, self._take_speed))
        )
        self._wrench = np.zeros(6), -np.inf  # and when it came
        for key, take in {
            "goal_pose": self._goal_pose, "end_effector_goal": self._end_effector_goal, "base_path": self._base_path,
            "end_effector_path": self._end_effector_path, "wrench": self._take_wrench,
        }.items():  # fmt: skip
            if topic := getattr(settings.topics, key):
                node.subscribe(
                    topic, settings.topics.requests[key], partial(self._try, topic, take), DEFAULT,
                    deferred=key != "wrench", largest=LONG,  # that is of when it comes, and done at once
                )  # fmt: skip

    # ------------------------------------------------------------------ taken up
    def take(self) -> Request | None:
        """The newest request, once. One that waited in a process that was held up is rejected."""
        with self._lock:  # a speed comes before this question or after the answer
            if self._moving and self.now() - self._twist_at > self.settings.safety.cmd_vel:
                self._slow_down()
        while True:
            with self._lock:
                if not self._requests:
                    return None
                request = self._requests.pop(next(iter(self._requests)))
            if request.rest and self.running is None:  # the speed that it ends was rejected, or the robot has stopped
                continue
            try:
                self.hold_ups.check(request.came)
            except InputError as error:
                self.reject(f"a goal is rejected: {error}")
            else:
                return request

    def stop(self) -> None:
        """The robot has stopped: what waits is rejected, and a stream of speeds that goes on is no new goal: it counts again after
        a zero, or after a pause as long as a speed holds."""
        with self._lock:
            waiting, self._requests = bool(self._requests), {}
            self._moving, self._latched = False, True
        if waiting:
            self.reject("a goal is rejected: the robot has stopped meanwhile")

    def wrench(self) -> Array:
        """What the end effector is to exert (6) [N, N m], world axes; like a speed it holds as long as messages come."""
        wrench, came = self._wrench
        return wrench if self.now() - came < self.settings.safety.cmd_vel else np.zeros(6)

    def _take_wrench(self, message: Any) -> None:
        if message.header.frame_id != self.settings.frames.world:
            raise InputError(
                f"the wrench is in the frame '{message.header.frame_id}'; valid: {self.settings.frames.world}"
            )
        force, torque = read_vector(message.wrench.force, "the force"), read_vector(message.wrench.torque, "the torque")
        if (maximum := self.settings.wrench) is not None:
            for name, value, limit, unit in (
                ("force", force, maximum.force, "N"),
                ("moment", torque, maximum.moment, "N m"),
            ):
                if (size := float(np.linalg.norm(value))) > limit:
                    raise InputError(
                        f"a {name} of {size:.4g} {unit} is too much; valid: 0 to {limit:g} (key 'wrench.{name}')"
                    )
        if old := self._too_old("the wrench"):
            raise InputError(old)
        self._wrench = np.concatenate([force, torque]), self.now()

    def reject(self, message: str) -> None:
        """Say once why a goal is not taken."""
        if message != self.rejected:
            self._limited_log.log(_LOG, logging.WARNING, message.split(":")[0], message)
        self.rejected = message

    @property
    def limited(self) -> str:
        """Which speed that is driven is less than what was asked for; empty if none is."""
        return self._limited if self._moving else ""

    @property
    def unheard(self) -> str:
        """Which type of speeds is not heard, and why; empty if all are."""
        return self._speeds.fault

    def detect_speed_inputs(self) -> None:
        """Subscribe to speeds in the types that are published (Twist, TwistStamped)."""
        self._speeds.update()

    # ------------------------------------------------------------------ messages
    def _try(self, topic: str, take: Callable[[Any], None], message: Any) -> None:
        try:
            take(message)
        except Exception as error:
            self.reject(f"{topic}: {error_message(error)}")

    def _put_goal(self, make: Callable[[Array, float], Task], kind: str = "") -> None:
        """As :meth:`_put`. Raises :class:`InputError` for a goal that waited too long."""
        if why := self.hold_ups.too_old("the goal"):
            raise InputError(why)
        self._put(Request(make, self.hold_ups.wall()), kind)

    def _put(self, request: Request, kind: str = "") -> None:
        """``kind`` of paths: a path replaces what waits but for the other kind of path."""
        with self._lock:
            self._moving = False
            others = {k: r for k, r in self._requests.items() if kind and k and k != kind}
            self._requests = {**others, kind: request}

    def _goal_pose(self, message: Any) -> None:
        frame, (p, q) = self._frame(message.header), read_pose(message.pose, "the goal")
        self._check_floor(frame, p[None])
        self._put_goal(lambda x, t: self.planner.to_base(x, t, planar(*self._in_world(frame, x, p, q))))

    def _end_effector_goal(self, message: Any) -> None:
        frame, (p, q) = self._frame(message.header), read_pose(message.pose, "the goal")
        self._put_goal(lambda x, t: self.planner.to_end_effector(x, t, *self._in_world(frame, x, p, q)))

    def _base_path(self, message: Any) -> None:
        frame, positions, turned, times = self._path(message)
        self._check_floor(frame, positions)

        def request(x: Array, t: float) -> Task:
            poses = planar_path(*self._in_world(frame, x, positions, turned))
            track = base_track(poses, self._plan_times(times, t), t, self.settings.speeds)
            going = self.running
            keep = going is not None and not going.carried and going.end_effector.times[-1] > t
            return self.planner.along_base_path(x, t, track, going.end_effector if going is not None and keep else None)

        self._put_goal(request, "base path")

    def _end_effector_path(self, message: Any) -> None:
        frame, positions, turned, times = self._path(message)

        def request(x: Array, t: float) -> Task:
            p, q = self._in_world(frame, x, positions, turned)
            track = end_effector_track(p, q, self._plan_times(times, t), t, self.settings.speeds)
            going = self.running
            keep = going is not None and going.base.times[-1] > t and going.base.times.size > 1
            return self.planner.along_end_effector_path(x, t, track, going.base if going is not None and keep else None)

        self._put_goal(request, "end effector path")

    def _take_speed(self, message: Any) -> None:
        """A Twist or a TwistStamped, in the base's axes."""
        if stamped := hasattr(message, "header"):
            frame, base = message.header.frame_id, self.settings.frames.base
            if frame not in ("", base):
                raise InputError(f"the speed is in the frame '{frame}'; valid: {base}, or none")
        twist = message.twist if stamped else message
        linear, angular = read_vector(twist.linear, "the speed"), read_vector(twist.angular, "the speed")
        target = np.array([linear[0], linear[1], angular[2]])
        over = float(np.max(np.abs(target) / self._fastest))
        with self._lock:  # a stop comes before or after it
            self._count_speed(target, over)

    def _count_speed(self, target: Array, over: float) -> None:
        """Take a speed (3) that is ``over`` 1 too fast, if it is current."""
        previous, self._spoken_at = self._spoken_at, self.elapsed()
        pause, old = self.settings.safety.cmd_vel, self._too_old("the speed")
        if np.any(target) and old:
            raise InputError(old)
        in_order = self.hold_ups.silence(pause)
        paused = in_order and self._spoken_at - previous > pause
        waited = bool(old) or self.hold_ups.waited() > WAITED  # a zero of before the stop, or of while nobody listened
        self._latched = self._latched and (waited or (bool(np.any(target)) and not paused))
        if self._latched:
            ways = (
                f"a zero or a pause of {pause:g} s"
                if in_order
                else f"a zero (no pause counts for {AGAIN:g} s after the node was held up or busy)"
            )
            raise InputError(f"the robot has stopped: speeds count again after {ways}")
        self._twist_at = self.now()
        if np.any(target):
            self._limit(target if over > 1.0 + 1e-9 else None)
            self._put_speed(target / max(over, 1.0))
        elif self._moving:
            self._slow_down()

    def _too_old(self, what: str) -> str:
        """Why ``what`` holds as long as a speed, and has just come, does not count; empty if it does."""
        return self.hold_ups.too_old(what, self.settings.safety.cmd_vel)

    def _put_speed(self, twist: Array) -> None:
        self._put(Request(lambda x, t: self.planner.drive(x, t, twist, self.running), self.hold_ups.wall()))
        self._moving = True

    def _limit(self, target: Array | None) -> None:
        """Say once that a speed is too fast; it is scaled as a whole, so that the way remains the same."""
        was, self._limited = self.limited, ""
        if target is None:
            return
        text = lambda v: f"{v[0]:.3g}, {v[1]:.3g} m/s, {v[2]:.3g} rad/s"
        topic = self.settings.topics.cmd_vel
        maximum = text(self._fastest)
        self._limited = f"{topic}: {text(target)} is faster than {maximum} (key 'cmd_vel'): scaled down to that"
        if not was:
            self._limited_log.log(_LOG, logging.WARNING, "limited", self._limited)

    def _slow_down(self) -> None:
        self._put(Request(lambda x, t: self.planner.slow_down(x, t, self.running), rest=True))

    # ------------------------------------------------------------------ parts
    def _frame(self, header: Any) -> str:
        frames = self.settings.frames
        if header.frame_id not in (frames.world, frames.base):
            raise InputError(
                f"the goal is in the unknown frame '{header.frame_id}'; valid: {frames.world}, {frames.base}"
            )
        return str(header.frame_id)

    def _check_floor(self, frame: str, positions: Array) -> None:
        """The base stays on the floor: a goal (n, 3) far over or under it is meant for another robot."""
        height = self.planner.base_height
        low = -_OFF_FLOOR if frame == self.settings.frames.world else -_OFF_FLOOR - height
        high, far = low + height + 2.0 * _OFF_FLOOR, positions[:, 2]
        worst = float(far[np.argmax(np.abs(far - 0.5 * (low + high)))])
        if not low <= worst <= high:
            raise InputError(f"the base's goal has z = {worst:.2f} m in '{frame}'; valid: {low:.2f} to {high:.2f}")

    def _path(self, message: Any) -> tuple[str, Array, Array, Array]:
        if not 0 < len(message.poses) <= _MAX_POINTS:
            raise InputError(f"a path of 1 to {_MAX_POINTS} poses is needed, got {len(message.poses)}")
        positions, turned = read_poses([p.pose for p in message.poses], "pose {} of the path")
        times = np.array([seconds(p.header.stamp) for p in message.poses])
        frame = self._frame(message.header)
        for i, p in enumerate(message.poses):
            if p.header.frame_id not in ("", frame):
                raise InputError(f"pose {i} of the path is in the frame '{p.header.frame_id}', the path in '{frame}'")
        return frame, positions, turned, times

    def _plan_times(self, times: Array, t: float) -> Array:
        """Stamps on the plan's clock, on which it is t [s]."""
        planned = times - self.origin()
        if planned[0] - t > _LATEST:
            raise InputError(
                f"the path begins {planned[0] - t:.4g} s from now; valid: at most {_LATEST:g} s (are its stamps of this clock?)"
            )
        return planned

    def _in_world(self, frame: str, x: Array, positions: Array, turned: Array) -> tuple[Array, Array]:
        """A pose of the bus (heights above the floor), or positions (n, 3) and quaternions (n, 4) of several, in the planner's world.
        The base's frame counts without its lean."""
        down = np.array([0.0, 0.0, self.planner.lift])
        if frame == self.settings.frames.world:
            return positions - down, turned
        p, q = self.planner.base_pose(x)
        moved = p + positions @ lie.quaternion_to_rotation(q).T - down
        return moved, np.transpose(lie.quaternion_multiply(q, np.transpose(turned)))
