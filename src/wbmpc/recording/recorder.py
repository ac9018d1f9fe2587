"""Writes what a run does into an MCAP file, while it does it.

Frames (REP 105): ``map`` is the simulated world, ``odom`` the frame of the controller's estimate, in which references and
plans are; ``map`` → ``odom`` is the drift. Where the controller has no estimate of the base the two are one. Joints, forces
and links are those of the simulation; what the sensors said is under ``/measured``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.loop import Ending, Running
from wbmpc.mpc import Plans
from wbmpc.plant.scene import SceneReader
from wbmpc.recording.messages import Message
from wbmpc.recording.writer import McapFile, stamp
from wbmpc.robots.urdf import to_urdf

#: Rates [Hz] at which states, links and plans are written (at most the controller's).
STATES, LINKS, PLANS = 100.0, 50.0, 10.0
#: Points of a written plan.
PLAN_POINTS = 31
MAP, ODOM = "map", "odom"
#: A second loop of the same run follows this long [s] after the first in the file.
PAUSE = 1.0

Array = np.ndarray


class Recorder:
    """A :class:`~wbmpc.loop.Watcher` that writes ``path``. The file comes into being when the loop begins.

    ``about``: tables of texts by name, written as metadata (what ran, settings, versions).
    """

    def __init__(self, path: Path, about: Mapping[str, Mapping[str, Any]]) -> None:
        self.path, self.about = path, about
        self.file: McapFile | None = None
        self._start = self._last = 0.0

    # ------------------------------------------------------------------ the loop
    def begin(self, running: Running) -> None:
        """Open the file and write all that holds for the whole run."""
        self.running, self._solves, self._mode = running, 0, ""
        self._odometry: tuple[float, Array] | None = None
        description = running.plant.description
        self._reader = SceneReader(running.plant.model, description.base.body)
        self._lift = np.array([0.0, 0.0, getattr(description.base, "ball_radius", 0.0)])
        every = lambda rate: max(1, round(1.0 / (rate * running.timing.period)))
        self._every = {"states": every(STATES), "links": every(LINKS), "plans": every(PLANS)}
        if self.file is not None:
            self._start = self._last + PAUSE
            return
        self.file = McapFile(self.path)
        for name, table in self.about.items():
            self.file.metadata(name, table)
        self.file.attach("scene.json", self._reader.scene.plain())
        self._put("/robot_description", "std_msgs/String", {"data": to_urdf(description)}, latched=True)
        self._put("/mpc/period", "std_msgs/Float64", [running.mpc.period], latched=True)
        self._static_links()

    def tick(self, t: float, command: Any, plans: Plans) -> None:
        """Write what is due at time t [s]."""
        self._last = self._start + t
        tick = round(t / self.running.timing.period)
        self._solver()
        due = {name for name, every in self._every.items() if tick % every == 0}
        if due:
            truth = self.running.plant.truth()
            data = self.running.plant.data
            poses = self._reader.poses(data)
        if "states" in due:
            self._states(poses, truth)
            self._numbers("/command", command)
            self._numbers("/measured", getattr(self.running.agent, "measured", None))
        if "links" in due:
            self._links(poses, data)
        if "plans" in due:
            self._plans(plans)

    def end(self, ending: Ending) -> None:
        """Note how the loop ended; more loops may follow."""
        self._put("/mode", "std_msgs/String", {"data": f"ended: {ending.reason or 'completed'}"}, latched=True)

    def close(self, result: Mapping[str, Any]) -> None:
        """Complete the file; ``result``: what came out, as metadata."""
        if self.file is not None:
            self.file.metadata("result", result)
            self.file.close()
            self.file = None

    # ------------------------------------------------------------------ parts
    def _put(self, topic: str, kind: str, message: Message, latched: bool = False) -> None:
        assert self.file is not None
        self.file.put(topic, kind, self._last, message, latched=latched)

    def _header(self, frame: str) -> dict[str, Any]:
        return {"stamp": stamp(self._last), "frame_id": frame}

    def _pose(self, topic: str, frame: str, pose: Array) -> None:
        self._put(topic, "geometry_msgs/PoseStamped", {"header": self._header(frame), "pose": ros_pose(pose)})

    def _numbers(self, prefix: str, parts: Any) -> None:
        """Every field of a command or measurement that holds an array, on a topic of its own."""
        for name, values in vars(parts).items() if parts is not None else ():
            if isinstance(values, np.ndarray) and values.size:
                layout = {"dim": [{"label": name, "size": values.size, "stride": values.size}], "data_offset": 0}
                self._put(f"{prefix}/{name}", "std_msgs/Float64MultiArray", {"layout": layout, "data": values.ravel()})

    def _states(self, poses: Array, truth: Any) -> None:
        joints = self._reader.joint_states(self.running.plant.data)
        self._put("/joint_states", "sensor_msgs/JointState", {
            "header": self._header(MAP), "name": self._reader.joint_names,
            "position": joints[:, 0], "velocity": joints[:, 1], "effort": joints[:, 2],
        })  # fmt: skip
        base = poses[self._reader.robot]
        estimated = self._estimated(base)
        self._odometry_message(estimated)
        hand = np.concatenate([truth.tool + self._lift, lie.rotation_to_quaternion(truth.tool_rotation)])
        self._pose("/hand/pose", MAP, hand)
        self._pose("/hand/pose_odom", ODOM, lie.pose_compose(estimated, lie.pose_between(base, hand)))
        if "hand" in self.running.mpc.reference:
            wanted = self.running.mpc.reference["hand"].at(self._last - self._start)
            if wanted.size == 7:
                self._pose("/hand/reference", ODOM, np.concatenate([wanted[:3] + self._lift, wanted[3:]]))

    def _estimated(self, base: Array) -> Array:
        """What the controller believes of the base's pose (7); the truth where it has no belief."""
        belief = getattr(self.running.agent, "base_pose", None)
        return base if belief is None else belief()

    def _odometry_message(self, pose: Array) -> None:
        """The twist is that of the two last estimates, in the base's axes."""
        twist = np.zeros(6)
        if self._odometry is not None and self._last > self._odometry[0]:
            moved = lie.pose_between(self._odometry[1], pose)
            twist = np.concatenate([moved[:3], lie.quaternion_log(moved[3:])]) / (self._last - self._odometry[0])
        self._odometry = (self._last, pose.copy())
        unknown = np.zeros(36)
        self._put("/odom", "nav_msgs/Odometry", {
            "header": self._header(ODOM), "child_frame_id": self._reader.scene.robot,
            "pose": {"pose": ros_pose(pose), "covariance": unknown}, "twist": {"twist": twist, "covariance": unknown},
        })  # fmt: skip

    def _transform(self, parent: str, child: str, pose: Array) -> dict[str, Any]:
        return {"header": self._header(parent), "child_frame_id": child, "transform": ros_pose(pose)}

    def _link(self, poses: Array, i: int) -> dict[str, Any]:
        """A body in its parent."""
        body, parent = self._reader.scene.bodies[i], self._reader.parents[i]
        if parent < 0:
            return self._transform(MAP, body.name, poses[i])
        return self._transform(body.parent, body.name, lie.pose_between(poses[parent], poses[i]))

    def _static_links(self) -> None:
        self.running.plant.truth()  # brings positions up to date
        poses, bodies = self._reader.poses(self.running.plant.data), self._reader.scene.bodies
        fixed = [self._link(poses, i) for i, body in enumerate(bodies) if not body.moves]
        self._put("/tf_static", "tf2_msgs/TFMessage", {"transforms": fixed}, latched=True)

    def _links(self, poses: Array, data: Any) -> None:
        """All frames that move, and one frame with the axes of ``map`` at each contact, for its force."""
        robot = self._reader.robot
        estimated = self._estimated(poses[robot])
        drift = lie.pose_compose(poses[robot], lie.pose_inverse(estimated))
        transforms = [self._transform(MAP, ODOM, drift), self._transform(ODOM, self._reader.scene.robot, estimated)]
        bodies = enumerate(self._reader.scene.bodies)
        transforms += [self._link(poses, i) for i, body in bodies if body.moves and i != robot]
        for contact in self._reader.contacts(data):
            frame = f"contact_{contact.body}"
            transforms.append(self._transform(MAP, frame, np.array([*contact.point, 1.0, 0, 0, 0])))
            self._put(f"/contact/{contact.body}", "geometry_msgs/WrenchStamped", {
                "header": self._header(frame), "wrench": np.concatenate([contact.force, np.zeros(3)]),
            })  # fmt: skip
        self._put("/tf", "tf2_msgs/TFMessage", {"transforms": transforms})

    def _solver(self) -> None:
        mpc = self.running.mpc
        if mpc.statistics.solves == self._solves:
            return
        self._solves = mpc.statistics.solves
        for name, value in mpc.figures.items():
            self._put(f"/mpc/{name}", "std_msgs/Float64", [value])
        for name in ("failures", "no_step"):
            self._put(f"/mpc/{name}", "std_msgs/Float64", [float(getattr(mpc.statistics, name))])

    def _plans(self, plans: Plans) -> None:
        policy, running = plans.current, self.running
        schedule = running.mpc.solver.schedule
        mode = schedule.modes[schedule.index(self._last - self._start)].name
        if mode != self._mode:
            self._mode = mode
            self._put("/mode", "std_msgs/String", {"data": mode}, latched=True)
        if policy is None:
            return
        robot, layout = running.agent.robot, running.mpc.ocp.dynamics.state
        base, hand = predicted(robot, layout, policy.x)
        for topic, points in (("/plan", base), ("/plan/hand", hand)):
            poses = [{"header": self._header(ODOM), "pose": ros_pose(p + [*self._lift, 0, 0, 0, 0])} for p in points]
            self._put(topic, "nav_msgs/Path", {"header": self._header(ODOM), "poses": poses})


def predicted(robot: Any, layout: Any, states: Array) -> tuple[Array, Array]:
    """Predicted poses of base and hand (n, 7) of planned states (N + 1, nx) of ``layout``, n at most PLAN_POINTS.

    A base that is planned in the plane lies at the planner's z = 0.
    """
    chosen = np.unique(np.linspace(0, len(states) - 1, PLAN_POINTS).round().astype(int))
    base, hand = [], []
    for x in states[chosen]:
        parts = layout.split(x)
        own = robot.state.vector({g: parts[g] for g in robot.state.groups})
        hand.append(np.concatenate(robot.pose(own)))
        base.append(_base_pose(parts.get("base", np.zeros(3))))
    return np.array(base), np.array(hand)


def _base_pose(base: Array) -> Array:
    if base.size == 7:
        return base
    yaw = float(base[2]) if base.size > 2 else 0.0
    return np.array([base[0], base[1], 0.0, *lie.quaternion_about((0.0, 0.0, 1.0), yaw)])


def ros_pose(pose: Array) -> Array:
    """Position and quaternion (x, y, z, w) of a pose with this library's quaternion (w, x, y, z)."""
    return np.asarray(pose)[[0, 1, 2, 4, 5, 6, 3]]
