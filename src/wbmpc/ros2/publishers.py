"""What the controller's node publishes: odometry and its frame, the end effector, the plan as paths, diagnostics."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from wbmpc import lie
from wbmpc.mpc.policy import Policy
from wbmpc.robots import RobotDescription
from wbmpc.robots.frames import frame_names
from wbmpc.ros2.bus import Node, Publisher, Qos
from wbmpc.ros2.convert import header, path, pose, quaternion, status, vector
from wbmpc.ros2.markers import Footprint
from wbmpc.ros2.settings import RosSettings
from wbmpc.ros2.statistics import collect_statistics, rejections

if TYPE_CHECKING:
    from wbmpc.ros2.control import ControlNode

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
            "odom": [0.0, 1.0 / rates.odom],
            "plan": [0.0, 1.0 / rates.plan],
            "say": [0.0, 1.0 / rates.diagnostics],
        }
        self._published: tuple[str, ...] = ()
        self._published_at = -np.inf

    def publish(self) -> None:
        """Publish what is due."""
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
        if seen is None or e is None:
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
        """Pose of the end effector above the floor."""
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
