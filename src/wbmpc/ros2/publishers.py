"""What the controller's node publishes: odometry and its frame, the end effector, the plan as paths, diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy
from wbmpc.robots import RobotDescription
from wbmpc.robots.frames import frame_names
from wbmpc.ros2.bus import Node, Publisher, Qos
from wbmpc.ros2.convert import header, path, pose, quaternion, status, vector
from wbmpc.ros2.settings import RosSettings
from wbmpc.stability import StanceOf, support_polygon

if TYPE_CHECKING:
    from wbmpc.ros2.control import ControlNode


def collect_statistics(controller: ControlNode) -> dict[str, Any]:
    """Values by name (times in ms, unless the name says otherwise), for diagnostics; without a runner what is known before."""
    c = controller
    values: dict[str, Any] = {"backend": c.node.backend, "age of the joint states [ms]": _ms(c.robot_io.age())}
    values["watchdog"] = f"{'armed' if c.running else 'not armed'}, {_ms(c.settings.safety.watchdog)} ms"
    values.update(rejections(c))
    if c.runner is None:
        return values
    r = c.runner.report()
    return {
        **values, **c.health.diagnostics(),
        "commands sent": c.robot_io.sent,
        "began at [s]": f"{c.stamp_of(0.0):.4f}",
        "task": c.task,
        "solve: median [ms]": _ms(r.solve.median), "solve: 95 % [ms]": _ms(r.solve.p95), "solve: max [ms]": _ms(r.solve.max),
        "missed deadlines of the MPC": r.mpc_misses, "missed deadlines of the controller": r.misses,
        **c.base_commands.counts(),
        **plan_clearance(c), "constraint violation": f"{c.adapter.mpc.solve_info['violation']:.2e}",
        "updates": r.updates, "failed solves": r.failures, "late policies": r.late,
        "observation to active policy: median [ms]": _ms(r.latency.median), "clamped ticks": r.clamped,
        "tick begins late: 99 % [ms]": _ms(r.jitter.p99), "tick takes: median [ms]": _ms(r.tick.median),
        "tick takes: 99 % [ms]": _ms(r.tick.p99), "command after its tick's time: median [ms]": _ms(r.sent.median),
        "command after its tick's time: 99 % [ms]": _ms(r.sent.p99),
        **{f"late commands: {part}": count for part, count in r.late_commands.items()},
    }  # fmt: skip


def plan_clearance(controller: ControlNode) -> dict[str, Any]:
    """The pair of the plan that lacks most of its margin, and how many plans were replaced by a stop, of a node that hears of obstacles."""
    mpc = controller.adapter.mpc
    if mpc.obstacles is None:
        return {}
    return {"clearance of the plan": str(mpc.clearance), "plans that stop at obstacles": mpc.statistics.braking_plans}


def rejections(controller: ControlNode) -> dict[str, str]:
    """What was rejected, and why: goals, commands to the base, poses; until one is taken again. And speeds that are limited."""
    c = controller
    reasons = {
        "rejected": c.request_queue.rejected, **c.base_commands.rejections(), "rejected pose": c.source.fault,
        "rejected obstacles": c.obstacles.fault, "limited speed": c.request_queue.limited,
    }  # fmt: skip
    return {key: why for key, why in reasons.items() if why}


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3f}"


#: Numbers of visualization_msgs/Marker.
LINE_STRIP, SPHERE = 4, 2
#: Width of lines, size of points [m]; how many moments of the plan are shown.
LINE, POINT, MOMENTS = 0.01, 0.05, 5
#: A base without feet of its own stands on one point, shown as a ring: its radius as a share of the base's height.
RING = 0.3
GREEN, RED, GRAY = (0.1, 0.7, 0.2, 1.0), (0.9, 0.1, 0.1, 1.0), (0.5, 0.5, 0.5, 0.5)


class Footprint:
    """Markers of a robot's states, in the frame ``world``. ``yield_to_controller`` is called before each state, which takes a tenth of a
    millisecond."""

    def __init__(self, robot: RobotModel, world: str, yield_to_controller: Callable[[], None] = lambda: None) -> None:
        self.robot, self.world, self._yield_to_controller = robot, world, yield_to_controller
        self._stance = None if robot.base.footprint is None else StanceOf(robot)

    def markers(
        self, now: float, x: Array, u: Array | None, wrench: Array, policy: Policy | None
    ) -> list[dict[str, Any]]:
        """At the state x (nx) with the inputs u (nu) and the world's ``wrench`` (6) on the end effector; and along a policy."""
        stands, point = self.stance(x, u, wrench)
        inside = self._stance is None or _inside(stands, point)
        found = [self._line(now, "support", 0, stands, GREEN), self._dot(now, "zmp", point, GREEN if inside else RED)]
        if policy is None:
            return found
        last = len(policy.u) - 1
        for i, k in enumerate(np.linspace(0, last, MOMENTS + 1, dtype=int)[1:]):
            polygon, _ = self.stance(policy.x[k], policy.u[k], wrench)
            found.append(self._line(now, "predicted", i, polygon, GRAY))
        return found

    def stance(self, x: Array, u: Array | None, wrench: Array) -> tuple[Array, Array]:
        """Corners (n, 2) of the support and the zero-moment point (2) [m] in the world."""
        self._yield_to_controller()
        place = x[self.robot.state["base"]][:2]
        if self._stance is None:
            angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
            ring = RING * self.robot.base.body_height * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            return place + ring, place
        s = self._stance(x, wrench, u=u)
        return place + support_polygon(s.feet), place + s.zmp

    def _line(self, now: float, space: str, number: int, corners: Array, color: tuple[float, ...]) -> dict[str, Any]:
        points = [{"x": float(a), "y": float(b), "z": 0.0} for a, b in [*corners, corners[0]]]
        return self._marker(now, space, number, LINE_STRIP, color) | {"scale": {"x": LINE}, "points": points}

    def _dot(self, now: float, space: str, at: Array, color: tuple[float, ...]) -> dict[str, Any]:
        if not np.isfinite(at).all():  # nothing presses on the floor
            return self._marker(now, space, 0, SPHERE, color) | {"action": 2}
        pose = {"position": {"x": float(at[0]), "y": float(at[1])}}
        return self._marker(now, space, 0, SPHERE, color) | {"scale": dict.fromkeys("xyz", POINT), "pose": pose}

    def _marker(self, now: float, space: str, number: int, kind: int, color: tuple[float, ...]) -> dict[str, Any]:
        rgba = dict(zip("rgba", color, strict=True))
        return {"header": header(now, self.world), "ns": space, "id": number, "type": kind, "color": rgba}


def _inside(corners: Array, point: Array) -> bool:
    edges = np.roll(corners, -1, axis=0) - corners
    to = point - corners
    sides = edges[:, 0] * to[:, 1] - edges[:, 1] * to[:, 0]
    return bool(np.all(sides > 0.0) or np.all(sides < 0.0))


WELL, WARNING, ERROR = 0, 1, 2
#: Of the plan's nodes every so many are reported: making messages takes the interpreter from the controller's ticks.
EVERY = 2
#: What has changed is reported before its turn, but not sooner than this [s] after the last time.
SOON = 0.05


class Publishers:
    """Publishes at the rates of the settings by the wall clock, from the node's own thread: piece by piece, each in the gap
    between two ticks of the controller, which would wait for the interpreter."""

    def __init__(self, node: Node, controller: ControlNode) -> None:
        self.controller = controller
        topics = controller.settings.topics
        kinds = {
            "odom": "nav_msgs/msg/Odometry", "end_effector_pose": "geometry_msgs/msg/PoseStamped", "plan": "nav_msgs/msg/Path",
            "end_effector_plan": "nav_msgs/msg/Path", "footprint": "visualization_msgs/msg/MarkerArray",
            "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        }  # fmt: skip
        names = {key: getattr(topics, key) for key in kinds}
        self._to: dict[str, Publisher] = {k: node.publisher(n, kinds[k]) for k, n in names.items() if n}
        self._to["tf"] = node.publisher("/tf", "tf2_msgs/msg/TFMessage", Qos(depth=100))
        self.footprint = Footprint(controller.robot, controller.settings.frames.world, controller.yield_to_controller)
        self._parts = _part_frames(controller.robot.description, controller.settings)
        rates = controller.settings.rates
        self._due = {
            "odom": [0.0, 1.0 / rates.odom], "plan": [0.0, 1.0 / rates.plan], "say": [0.0, 1.0 / rates.diagnostics],
        }  # fmt: skip
        self._published: tuple[str, ...] = ()
        self._published_at = -np.inf

    def publish(self) -> None:
        now = time.perf_counter()
        c = self.controller
        messages = c.state, *rejections(c).values(), *c.adapter.faults, c.health.late, c.health.fell
        if messages != self._published and now - self._published_at > SOON:
            self._published, self._due["say"][0] = messages, now
        for key, do in (("odom", self._odometry), ("plan", self._plans), ("say", self._diagnostics)):
            due = self._due[key]
            if now >= due[0]:
                due[0] = max(due[0] + due[1], now)
                self.controller.yield_to_controller()
                do()

    def _send(self, key: str, values: dict[str, Any]) -> None:
        if key in self._to:
            self.controller.yield_to_controller()
            self._to[key].publish(values)

    def _odometry(self) -> None:
        c = self.controller
        seen, e = c.adapter.snapshot(), c.adapter.estimate()
        if seen is None or e is None or not c.robot_io.is_current(seen[0]):
            return
        (t, x), frames = seen, c.settings.frames
        now = c.stamp_of(t)
        twist = e.twist if c.running else np.zeros(6)
        self._send("odom", {
            "header": header(now, frames.world), "child_frame_id": frames.base,
            "pose": {"pose": pose(e.position, e.orientation), "covariance": e.covariance.ravel()},
            "twist": {
                "twist": {"linear": vector(twist[:3]), "angular": vector(twist[3:])},
                "covariance": e.twist_covariance.ravel(),
            },
        })  # fmt: skip
        transforms = [_transform(now, frames.world, frames.base, e.position, e.orientation)]
        for part in (
            self._parts
        ):  # a URDF's floating joint: no other node has its frame. How a sphere has turned is not estimated
            upright_again = np.asarray(lie.quaternion_conjugate(e.orientation))
            transforms.append(_transform(now, frames.base, part, np.zeros(3), upright_again))
        self._send("tf", {"transforms": transforms})
        self._send("end_effector_pose", {"header": header(now, frames.world), "pose": pose(*self._end_effector(x))})

    def _end_effector(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position, turned = self.controller.robot.pose(x)
        return position + [0.0, 0.0, self.controller.adapter.planner.lift], turned

    def _plans(self) -> None:
        c = self.controller
        policy = c.runner.plans.current if c.runner is not None and c.running else None
        self._stand(policy)
        if policy is None:
            return
        now, world, planner = c.now(), c.settings.frames.world, c.adapter.planner
        nodes = slice(None, None, EVERY)
        times = [c.stamp_of(float(t)) for t in policy.times[nodes]]
        base = [planner.base_pose(x) for x in policy.x[nodes]]
        end_effector = []
        for x in policy.x[nodes]:
            self.controller.yield_to_controller()
            end_effector.append(self._end_effector(x))
        for key, poses in (("plan", base), ("end_effector_plan", end_effector)):
            positions, turned = (np.array(part) for part in zip(*poses, strict=True))
            self._send(key, path(now, world, positions, turned, times))

    def _stand(self, policy: Policy | None) -> None:
        """How the robot stands, with the inputs of the plan and the world's answer to what the end effector exerts."""
        c = self.controller
        seen = c.adapter.snapshot()
        if seen is not None and "footprint" in self._to and c.adapter.planner.moves:
            u = None if policy is None else policy.u[0]
            self._send("footprint", {"markers": self.footprint.markers(c.now(), seen[1], u, -c.wrench, policy)})

    def _diagnostics(self) -> None:
        c = self.controller
        self._published_at = time.perf_counter()
        stopped = c.runner is not None and c.runner.stopped
        level = ERROR if stopped or c.degraded or c.health.fell else WELL if c.running else WARNING
        if level == WELL and (rejections(c) or c.health.late):
            level = WARNING
        reasons = [why for why in rejections(c).values() if why not in c.state]
        message = "; ".join(filter(None, [c.health.fell, c.state, c.health.late, *reasons]))
        entries = [
            status(level, f"{c.settings.node}: controller", message, c.robot.description.name, collect_statistics(c))
        ]
        faults = [*c.node.faults, *filter(None, [c.request_queue.unheard])]
        entries += [status(ERROR, f"{c.settings.node}: bus", "; ".join(faults), "", {})] if faults else []
        found = c.adapter.faults
        entries += (
            [status(WARNING, f"{c.settings.node}: {c.adapter.watches}", "; ".join(found), "", {})] if found else []
        )
        self._send("diagnostics", {"header": header(c.now(), ""), "status": entries})


def _transform(now: float, parent: str, child: str, position: np.ndarray, orientation: np.ndarray) -> dict[str, Any]:
    transform = {"translation": vector(position), "rotation": quaternion(orientation)}
    return {"header": header(now, parent), "child_frame_id": child, "transform": transform}


def _part_frames(description: RobotDescription, settings: RosSettings) -> list[str]:
    """The frames of bodies that the base's own equations move, whose origins are the base's."""
    parts, frames = [*description.base.parts().values()], settings.frames
    names = frame_names(description.base.body, parts, frames.base, frames.world)
    return [names[part] for part in parts]
