"""The robot's side of the bus, simulated: publishes what a swerve robot's drivers would, follows what they would follow."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.model import RobotModel
from wbmpc.plant import SwerveCommand, SwervePlant
from wbmpc.plant.perturbation import Perturbation
from wbmpc.ros2.bus import DEFAULT, LATCHED, Node, Qos
from wbmpc.ros2.convert import header, pose, stamp, upright, vector
from wbmpc.ros2.settings import GROUPS, RosSettings

_LOG = logging.getLogger("wbmpc")
#: Like the watchdog of a drive [s]: without commands for longer the robot stops and its brakes close.
COMMAND_TIMEOUT = 0.1
#: In lockstep: how long an answer is waited for, and after what time the question is asked again [s of the wall].
PATIENCE, AGAIN = 1.0, 0.05
#: Simulated time at the beginning [s]: 0 means in ROS that there is no time yet.
BEGIN = 1.0
#: Physics that is later than this [s] lets the time go, and counts it.
LATE = 0.05
TRUTH_ODOM, TRUTH_HAND = "/ground_truth/odom", "/ground_truth/hand"


class SimNode:
    """A plant on a bus, at ``rate`` [Hz].

    ``lockstep``: after the first commands a period is simulated only when all commands to its beginning have come, so that
    nothing depends on the machine's speed; else in real time, ``factor`` times as fast. ``behind``: how often it was too slow.
    """

    def __init__(
        self,
        node: Node,
        robot: RobotModel,
        settings: RosSettings,
        seed: int = 0,
        perturbation: Perturbation | None = None,
        *,
        rate: float = 400.0,
        lockstep: bool = False,
        factor: float = 1.0,
    ) -> None:
        self.node, self.robot, self.settings = node, robot, settings
        self.plant = SwervePlant(robot.description, robot.state.split(robot.home), perturbation, seed)
        self.steps = max(round(1.0 / rate / self.plant.timestep), 1)
        self.period = self.steps * self.plant.timestep
        self.lockstep, self.factor, self.behind, self.ticks = lockstep, factor, 0, 0
        self.sim_time = settings.use_sim_time or lockstep
        self._groups = {g: np.zeros(len(names)) for g, names in self._drives().items()}
        self._changed = threading.Condition()
        self._controllers = settings.command_topics(robot)
        self._count = dict.fromkeys(self._controllers, 0)
        self._heard = dict.fromkeys(self._controllers, -np.inf)
        self._silent, self._lost = True, False
        self._open()

    def _drives(self) -> dict[str, list[str]]:
        given = self.robot.input.groups
        drives = {g: list(given.get("leg" if g == "brake" else g, ())) for g in GROUPS}
        drives["brake"] = [f"brake/{n}" for n in drives["brake"]]
        return drives

    def _open(self) -> None:
        topics, names = self.settings.topics, self._drives()
        places = {n: (g, i) for g, part in names.items() for i, n in enumerate(part)}
        sensors = Qos(depth=5)  # reliable, as the joint_state_broadcaster's
        self._joints = self.node.publisher(topics.joint_states, "sensor_msgs/msg/JointState", sensors)
        self._imu = self.node.publisher(topics.imu or "/imu", "sensor_msgs/msg/Imu", sensors)
        self._clock = self.node.publisher("/clock", "rosgraph_msgs/msg/Clock", Qos(depth=1))
        self._odom = self.node.publisher(TRUTH_ODOM, "nav_msgs/msg/Odometry")
        self._hand = self.node.publisher(TRUTH_HAND, "geometry_msgs/msg/PoseStamped")
        fixed = self.node.publisher("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        imu = {"header": header(self.now(), self.settings.frames.base), "child_frame_id": "imu"}
        fixed.publish({"transforms": [imu]})
        for name, controller in self._controllers.items():
            wanted = [places[j] for j in controller.joints]
            take = lambda message, n=name, w=wanted: self._take(n, w, message)
            self.node.subscribe(controller.topic, "std_msgs/msg/Float64MultiArray", take, DEFAULT)
        state = self.robot.state.groups
        self._names = [self.settings.bus_name(n) for g in ("leg", "steer", "wheel", "arm") for n in state.get(g, ())]

    def _take(self, name: str, places: list[tuple[str, int]], message: Any) -> None:
        values = np.asarray(message.data, float)
        if values.size != len(places) or not np.isfinite(values).all():
            _LOG.error("%s: %d finite numbers are needed, got %s", self._controllers[name].topic, len(places), values)
            return
        with self._changed:
            for (group, i), value in zip(places, values, strict=True):
                self._groups[group][i] = value
            self._count[name] += 1
            self._heard[name], self._lost = self.plant.time, False
            self._changed.notify_all()

    # ------------------------------------------------------------------ time
    def now(self) -> float:
        """Stamp [s] of what is published now."""
        return BEGIN + self.plant.time if self.sim_time else time.time()

    def spin(self, ended: Callable[[], bool], seconds: float = np.inf) -> str:
        """Run until ``ended()``, for ``seconds`` of simulated time or until the robot falls; returns why it ended."""
        due = time.perf_counter()
        while not ended():
            if self.plant.time >= seconds:
                return f"{seconds:g} s are over"
            before = dict(self._count)
            self.publish()
            if self.lockstep and not (self._silent or self._lost):
                self._await(before)
            else:
                due = self._pace(due)
            self.plant.step(self._command(), self.steps)
            self.ticks += 1
            if self.plant.diverged:
                return "the simulation diverged"
            if self.plant.fell:
                return f"the robot fell at {self.plant.time:.2f} s"
        return "ended"

    def _pace(self, due: float) -> float:
        """Wait for the next period's wall time; returns the one after it."""
        due += self.period / self.factor
        wait = due - time.perf_counter()
        if wait > 0.0:
            time.sleep(wait)
        elif wait < -LATE:
            self.behind += 1
            return time.perf_counter()
        return due

    def _await(self, before: dict[str, int]) -> None:
        """Commands to what was just published; asked again now and then, for a sensor's message may be lost.

        Who does not answer at all is not waited for again until it does.
        """
        end = time.monotonic() + PATIENCE
        answered = lambda: all(self._count[n] > before[n] for n in before)
        while not answered() and time.monotonic() < end:
            with self._changed:
                there = self._changed.wait_for(answered, AGAIN)
            if not there:
                self.publish()
        self._lost = not answered()

    # ------------------------------------------------------------------ messages
    def _command(self) -> SwerveCommand:
        with self._changed:
            now = self.plant.time
            late = [n for n, heard in self._heard.items() if now - heard > COMMAND_TIMEOUT]
            if late and not self._silent:
                _LOG.error("no commands on %s: the robot stops", self._controllers[late[0]].topic)
            self._silent = bool(late)
            if late:
                return SwerveCommand.stop(len(self._groups["wheel"]), len(self._groups["arm"]))
            return SwerveCommand(**{g: v.copy() for g, v in self._groups.items()})

    def publish(self) -> None:
        """Sensors, then the clock: who hears the clock has the sensors."""
        m, at = self.plant.measure(), self.now()
        positions = np.concatenate([m.leg, m.steer, m.wheel, m.arm])
        imu = {
            "header": header(at, "imu"), "orientation_covariance": [-1.0] + [0.0] * 8,
            "angular_velocity": vector(m.gyro), "linear_acceleration": vector(m.accel),
        }  # fmt: skip
        self._imu.publish(imu)
        self._joints.publish({"header": header(at, ""), "name": self._names, "position": positions})
        if self.ticks % 8 == 0:
            self._publish_truth(at)
        self._clock.publish({"clock": stamp(BEGIN + self.plant.time)})

    def _publish_truth(self, at: float) -> None:
        truth, world = self.plant.truth(), self.settings.frames.world
        position, turned = upright(truth.pose, self.robot.base.height)
        self._odom.publish(
            {"header": header(at, world), "child_frame_id": "base_truth", "pose": {"pose": pose(position, turned)}}
        )
        self._hand.publish(
            {"header": header(at, world), "pose": pose(truth.tool, lie.rotation_to_quaternion(truth.tool_rotation))}
        )
