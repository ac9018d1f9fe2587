"""Records a run in an MCAP file while it runs.

Frames are those of :mod:`wbmpc.recording.observer`. Joints, forces and links are those of the simulation; what the sensors
said is under ``/measured``.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.plots.motion import Motion, picture_points
from wbmpc.recording.messages import Message
from wbmpc.recording.observer import Moment, Observer
from wbmpc.recording.quantities import JOINT_UNITS
from wbmpc.recording.template import Template
from wbmpc.recording.writer import LIMIT, McapFile, nanoseconds, stamp
from wbmpc.robots.frames import MAP, ODOM, fixed_frames
from wbmpc.robots.urdf import to_urdf
from wbmpc.simulation.lockstep import Ending, Running
from wbmpc.simulation.scene import Scene, joint_units

_LOG = logging.getLogger(__name__)
#: Rates [Hz] at which states, links and plans are written (at most the controller's).
STATES, LINKS, PLANS = 100.0, 50.0, 10.0
#: A second loop of the same run follows this long [s] after the first in the file.
PAUSE = 1.0

#: A pose (7) that changes nothing; where a pose's numbers are in ROS's order.
NOWHERE, _ROS_ORDER = np.array([0.0, 0, 0, 1, 0, 0, 0]), np.array([0, 1, 2, 4, 5, 6, 3])


class Recorder:
    """A :class:`~wbmpc.simulation.lockstep.Watcher` that writes ``path``. The file is created when the loop begins.

    ``about``: tables of texts by name, written as metadata (what ran, settings, versions). ``limit``: see :class:`McapFile`.
    If the file can no longer be written (a full disk), recording ends, ``failure`` holds the reason, and the run continues.
    ``motion``: data of the replay in the report of the run.
    """

    def __init__(self, path: Path, about: Mapping[str, Mapping[str, Any]], limit: int = LIMIT) -> None:
        self.path, self.about, self.limit = path, about, limit
        self._place = path.absolute()  # the program that runs may change the directory
        self.file: McapFile | None = None
        self.failure = ""
        self.motion = Motion()
        self._start = self._last = 0.0
        self._templates: dict[Any, Template] = {}
        self._scene: Scene | None = None

    # ------------------------------------------------------------------ the loop
    def begin(self, running: Running) -> None:
        """Open the file and write what is constant over the run."""
        with self._noted():
            self._begin(running)

    @contextmanager
    def _noted(self) -> Iterator[None]:
        """Record an error of the file and end the recording: it must not end the run."""
        try:
            yield
        except OSError as error:
            self.failure = f"{self.path}: cannot be written ({error.strerror}); recording ended at {self._last:.2f} s"
            _LOG.error("%s; the run continues", self.failure)
            with suppress(OSError):  # what is buffered cannot be written either
                if self.file is not None:
                    self.file.close()
            self.file = None

    def _begin(self, running: Running) -> None:
        if self.failure:
            return
        self.running, self._solves, self._mode = running, 0, ""
        self._odometry: tuple[float, Array] | None = None
        self._observer = Observer(running)
        scene = self._observer.scene
        every = lambda rate: max(1, round(1.0 / (rate * running.timing.period)))
        self._every = {"states": every(STATES), "links": every(LINKS), "plans": every(PLANS)}
        self._templates.clear()
        if self.file is not None:
            self._start = self._last = self._last + PAUSE
            self._begin_loop(scene)
            return
        self.file = McapFile(self._place, self.limit)
        for name, table in self.about.items():
            self.file.metadata(name, table)
        self.file.metadata(JOINT_UNITS, joint_units(running.plant.model))
        self._scene, self._scenes = None, 0
        self._begin_loop(scene)
        self._put("/robot_description", "std_msgs/String", {"data": to_urdf(running.plant.description)}, latched=True)
        if running.mpc is not None:
            self._put("/mpc/period", "std_msgs/Float64", [running.mpc.period], latched=True)
        self._static_links()

    def _begin_loop(self, scene: Scene) -> None:
        """Attach the scene again, with its start time, if it differs from that of the previous loop."""
        assert self.file is not None
        if scene != self._scene:
            self._scene, self._scenes = scene, self._scenes + 1
            name = "scene.json" if self._scenes == 1 else f"scene-{self._scenes}.json"
            self.file.attach(name, scene.plain(), self._start)
        self.motion.begin(self.running.name, scene.plain())
        if self.running.name:
            self._put("/mode", "std_msgs/String", {"data": f"begins: {self.running.name}"}, latched=True)

    def tick(self, t: float, command: Any, plans: PolicyQueue) -> None:
        """Write what is due at time t [s]."""
        if not self.failure:
            with self._noted():
                self._tick(t, command, plans)

    def _tick(self, t: float, command: Any, plans: PolicyQueue) -> None:
        self._last = self._start + t
        tick = round(t / self.running.timing.period)
        self._solver()
        states, links, plan = (tick % self._every[name] == 0 for name in ("states", "links", "plans"))
        if states or links or plan:
            moment = self._observer.see()
        if states:
            self._states(moment)
            self._numbers("/command", command)
            self._numbers("/measured", getattr(self.running.controller, "measured", None))
        if links:
            self._links(moment)
        if plan:
            paths = self._plans(plans)
            if self.motion.due(t):
                self._picture(t, moment, paths)

    def end(self, ending: Ending) -> None:
        """Note how the loop ended; more loops may follow."""
        if not self.failure:
            with self._noted():
                self._put("/mode", "std_msgs/String", {"data": f"ended: {ending.reason or 'completed'}"}, latched=True)

    def close(self, result: Mapping[str, Any]) -> None:
        """Complete the file with the ``result`` of the run as metadata."""
        with self._noted():
            if self.file is not None:
                self.file.metadata("result", result)
                self.file.close()
                self.file = None

    # ------------------------------------------------------------------ parts
    def _put(self, topic: str, kind: str, message: Message, latched: bool = False) -> None:
        assert self.file is not None
        self.file.put(topic, kind, self._last, message, latched=latched)

    def _fill(self, topic: str, kind: str, key: Any, values: Array, make: Callable[[], Message]) -> None:
        """Write a message. While ``key`` is the same, only its time and float64 numbers change; ``make`` builds a template."""
        assert self.file is not None
        template = self._templates.get((topic, key))
        if template is None:
            template = self._templates[topic, key] = Template(kind, make())
        self.file.put_bytes(topic, kind, self._last, template.fill(nanoseconds(self._last), values))

    def _header(self, frame: str) -> dict[str, Any]:
        return {"stamp": stamp(self._last), "frame_id": frame}

    def _pose(self, topic: str, frame: str, pose: Array) -> None:
        values = ros_pose(pose)
        make = lambda: {"header": self._header(frame), "pose": values}
        self._fill(topic, "geometry_msgs/PoseStamped", frame, values, make)

    def _number(self, topic: str, value: float) -> None:
        self._fill(topic, "std_msgs/Float64", None, np.array([value]), lambda: [value])

    def _numbers(self, prefix: str, parts: Any) -> None:
        """Every field of a command or measurement that holds an array, on a topic of its own."""
        for name, values in vars(parts).items() if parts is not None else ():
            if type(values) is np.ndarray and values.size:
                make = lambda name=name, values=values: _array_message(name, values)
                self._fill(f"{prefix}/{name}", "std_msgs/Float64MultiArray", values.size, values, make)

    def _states(self, moment: Moment) -> None:
        reader = self._observer.reader
        joints = reader.joint_states(self.running.plant.data).T
        make = lambda: {
            "header": self._header(MAP), "name": reader.joint_names,
            "position": joints[0], "velocity": joints[1], "effort": joints[2],
        }  # fmt: skip
        self._fill("/joint_states", "sensor_msgs/JointState", None, joints, make)
        self._odometry_message(moment.estimated)
        self._pose("/ground_truth/end_effector", MAP, moment.end_effector)
        in_odom = lie.pose_compose(moment.estimated, lie.pose_between(moment.base, moment.end_effector))
        self._pose("/end_effector_pose", ODOM, in_odom)
        goal = self._observer.end_effector_goal(self._last - self._start)
        if goal is not None:
            self._pose("/end_effector_reference", ODOM, goal)

    def _odometry_message(self, pose: Array) -> None:
        """Write the odometry; its twist is the difference of the last two estimates, in axes of the base."""
        twist = np.zeros(6)
        if self._odometry is not None and self._last > self._odometry[0]:
            moved = lie.pose_between(self._odometry[1], pose)
            twist = np.concatenate([moved[:3], lie.quaternion_log(moved[3:])]) / (self._last - self._odometry[0])
        self._odometry = (self._last, pose.copy())
        unknown = np.zeros(36)
        values = np.concatenate([ros_pose(pose), unknown, twist, unknown])
        make = lambda: {
            "header": self._header(ODOM), "child_frame_id": self._observer.scene.robot,
            "pose": {"pose": ros_pose(pose), "covariance": unknown}, "twist": {"twist": twist, "covariance": unknown},
        }  # fmt: skip
        self._fill("/odom", "nav_msgs/Odometry", None, values, make)

    def _transform(self, parent: str, child: str, pose: Array) -> dict[str, Any]:
        return {"header": self._header(parent), "child_frame_id": child, "transform": ros_pose(pose)}

    def _link(self, bodies: Array, i: int) -> dict[str, Any]:
        """A body in its parent."""
        body, parent = self._observer.scene.bodies[i], self._observer.reader.parents[i]
        if parent < 0:
            return self._transform(MAP, body.name, bodies[i])
        return self._transform(body.parent, body.name, lie.pose_between(bodies[parent], bodies[i]))

    def _static_links(self) -> None:
        bodies, scene = self._observer.see().bodies, self._observer.scene
        # the parent of a base is the odometry frame, also if the base is fixed
        fixed = [self._link(bodies, i) for i, b in enumerate(scene.bodies) if not b.moves and i != scene.index]
        points = fixed_frames(self.running.plant.description)
        fixed += [self._transform(point.parent, point.name, point.pose) for point in points]
        self._put("/tf_static", "tf2_msgs/TFMessage", {"transforms": fixed}, latched=True)

    def _links(self, moment: Moment) -> None:
        """All frames that move, and one frame with the axes of ``map`` at each contact, for its force."""
        scene, reader = self._observer.scene, self._observer.reader
        contacts = reader.contacts(self.running.plant.data)
        frames = [f"contact_{c.body}" for c in contacts]
        places = [np.array([*c.point, *NOWHERE[3:]]) for c in contacts]
        poses = np.vstack([moment.drift, moment.estimated, reader.links(moment.bodies), *places])
        for frame, contact in zip(frames, contacts, strict=True):
            wrench = np.concatenate([contact.force, np.zeros(3)])
            make = partial(self._wrench_message, frame, wrench)
            self._fill(f"/contact/{contact.body}", "geometry_msgs/WrenchStamped", None, wrench, make)

        def message() -> Message:
            bodies = [scene.bodies[i] for i in reader.moving]
            above = [MAP if reader.parents[i] < 0 else scene.bodies[i].parent for i in reader.moving]
            parents = [MAP, ODOM, *above, *(MAP for _ in frames)]
            children = [ODOM, scene.robot, *(b.name for b in bodies), *frames]
            rows = zip(parents, children, poses, strict=True)
            return {"transforms": [self._transform(parent, child, pose) for parent, child, pose in rows]}

        self._fill("/tf", "tf2_msgs/TFMessage", tuple(frames), ros_pose(poses), message)

    def _wrench_message(self, frame: str, wrench: Array) -> Message:
        return {"header": self._header(frame), "wrench": wrench}

    def _solver(self) -> None:
        mpc = self.running.mpc
        if mpc is None or mpc.statistics.solves == self._solves:
            return
        self._solves = mpc.statistics.solves
        for name, value in mpc.solve_info.items():
            self._number(f"/mpc/{name}", value)
        for name in ("failures", "no_step"):
            self._number(f"/mpc/{name}", float(getattr(mpc.statistics, name)))

    def _picture(self, t: float, moment: Moment, paths: tuple[Array, Array]) -> None:
        goal = self._observer.end_effector_goal(t)
        in_map = lambda points: points @ lie.quaternion_to_rotation(moment.drift[3:]).T + moment.drift[:3]
        base, end_effector = (in_map(path[:, :3]) for path in paths)
        reference = None if goal is None else in_map(goal[:3])
        self.motion.add(t, moment.bodies, picture_points(moment.end_effector[:3], reference, (end_effector, base)))

    def _plans(self, plans: PolicyQueue) -> tuple[Array, Array]:
        """Write the predicted paths of base and end effector, which are returned."""
        if self.running.mpc is None:
            return np.zeros((0, 7)), np.zeros((0, 7))
        schedule = self.running.mpc.solver.schedule
        mode = schedule.modes[schedule.index(self._last - self._start)].name
        if mode != self._mode:
            self._mode = mode
            self._put("/mode", "std_msgs/String", {"data": mode}, latched=True)
        paths = self._observer.plan(plans)
        for topic, path in zip(("/plan", "/end_effector_plan"), paths, strict=True):
            if len(path):
                self._fill(topic, "nav_msgs/Path", len(path), ros_pose(path), partial(self._path_message, path))
        return paths

    def _path_message(self, path: Array) -> Message:
        poses = [{"header": self._header(ODOM), "pose": ros_pose(pose)} for pose in path]
        return {"header": self._header(ODOM), "poses": poses}


def _array_message(name: str, values: Array) -> Message:
    layout = {"dim": [{"label": name, "size": values.size, "stride": values.size}], "data_offset": 0}
    return {"layout": layout, "data": values.ravel()}


def ros_pose(pose: Array) -> Array:
    """Position and quaternion (x, y, z, w) of poses (…, 7) with this library's quaternion (w, x, y, z)."""
    return np.asarray(pose)[..., _ROS_ORDER]
