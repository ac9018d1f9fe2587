"""A swerve robot behind a bus, as the real-time runner wants it: newest checked measurement, commands, a ramp to rest."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.model import RobotModel
from wbmpc.mpc import WallClock
from wbmpc.mpc.safety import SafeStop
from wbmpc.plant import SwerveCommand, SwerveMeasurement
from wbmpc.ros2.bus import DEFAULT, SENSOR, Node
from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.joints import Inertial, JointReader, JointSample, read_imu
from wbmpc.ros2.settings import GROUPS, RosSettings

#: How long zeros are sent after the ramp of a stop [s].
ZEROS = 1.0


class BusRobot:
    """See :class:`wbmpc.mpc.RobotInterface`. What is wrong with a message stops the robot once it is :meth:`arm`-ed.

    With simulated time a measurement is as old as its stamp; with the wall's as its arrival, if its stamp has moved on: clocks
    of two machines may differ, and a driver that hangs repeats itself.
    """

    def __init__(self, node: Node, robot: RobotModel, settings: RosSettings, clock: WallClock | BusClock) -> None:
        self.robot, self.settings, self.clock = robot, settings, clock
        self.fault = ""
        self._reader = JointReader(robot, settings)
        self._joints: tuple[JointSample, float] | None = None
        self._inertial: tuple[Inertial, float] | None = None
        self._armed = False
        self._stopping: float | None = None
        given = robot.input.groups
        sizes = {g: len(given.get("leg" if g == "brake" else g, ())) for g in GROUPS}
        self._zero = {g: np.zeros(n) for g, n in sizes.items()}
        self._last = dict(self._zero)
        self._open(node, settings)

    def _open(self, node: Node, settings: RosSettings) -> None:
        node.subscribe(settings.topics.joint_states, "sensor_msgs/msg/JointState", self._take_joints, SENSOR)
        if settings.topics.imu:
            node.subscribe(settings.topics.imu, "sensor_msgs/msg/Imu", self._take_imu, SENSOR)
        given = self.robot.input.groups
        names = {g: list(given.get(g, ())) for g in GROUPS} | {"brake": [f"brake/{n}" for n in given.get("leg", ())]}
        places = {n: (g, i) for g, part in names.items() for i, n in enumerate(part)}
        self._commands = [
            (node.publisher(c.topic, "std_msgs/msg/Float64MultiArray", DEFAULT), [places[j] for j in c.joints])
            for c in settings.command_topics(self.robot).values()
        ]

    # ------------------------------------------------------------------ from the bus
    def _take_joints(self, message: Any) -> None:
        try:
            sample = self._reader.read(message)
        except InputError as error:
            if not (self._armed and self.fault):
                self.fault = str(error)
            if not self._armed:
                self._reader.forget()
            return
        before = self._joints
        if before is None or sample.stamp != before[0].stamp or sample.stamp == 0.0:
            self._joints = sample, time.perf_counter()
        if not self._armed:
            self.fault = ""

    def _take_imu(self, message: Any) -> None:
        try:
            self._inertial = read_imu(message), time.perf_counter()
        except InputError as error:
            self.fault = self.fault or str(error)

    @property
    def has_imu(self) -> bool:
        """Whether there has been an inertial measurement."""
        return self._inertial is not None

    def waits_for(self) -> str:
        """Why the robot cannot be moved yet; empty if it can."""
        if self.fault:
            return self.fault
        if self._joints is None:
            return f"no joint states on {self.settings.topics.joint_states} yet"
        age = self.age()
        if age > self.settings.safety.watchdog:
            return f"the joint states on {self.settings.topics.joint_states} are {age:.1f} s old"
        return ""

    def age(self) -> float:
        """Of the last joint states [s]; infinite before the first."""
        if self._joints is None:
            return np.inf
        if isinstance(self.clock, BusClock):
            return self.clock.stamp() - self._joints[0].stamp
        return time.perf_counter() - self._joints[1]

    def arm(self) -> None:
        """From now on faults stop the robot; it is at rest."""
        self.fault, self._stopping, self._armed = "", None, True
        self._last = dict(self._zero)

    def disarm(self) -> None:
        """Faults are reported only, and pass with the next good message."""
        self._armed = False
        self._reader.forget()

    # ------------------------------------------------------------------ for the runner
    def read(self) -> SwerveMeasurement:
        """The newest measurement, its time on the runner's clock."""
        if self.fault and self._armed:
            raise SafeStop(self.fault)
        joints, inertial = self._joints, self._inertial
        if joints is None:
            raise SafeStop(f"no joint states on {self.settings.topics.joint_states}")
        sample, arrival = joints
        on_bus = isinstance(self.clock, BusClock)
        at = (sample.stamp if on_bus else arrival) - self.clock.origin
        if inertial is None:
            return SwerveMeasurement(at, **sample.groups)  # type: ignore[arg-type]
        silent = 0.0 if on_bus else time.perf_counter() - inertial[1]
        if silent > self.settings.safety.watchdog and self._armed:
            raise SafeStop(f"the messages on {self.settings.topics.imu} stopped {silent:.3f} s ago")
        return SwerveMeasurement(at, **sample.groups, gyro=inertial[0].gyro, accel=inertial[0].accel)  # type: ignore[arg-type]

    def write(self, command: SwerveCommand) -> None:
        """Send a command to all controllers."""
        self._last, self._stopping = {g: getattr(command, g) for g in GROUPS}, None
        self._send(self._last)

    def stop(self) -> None:
        """The last speeds, ramped down, then zero, brakes closed, then nothing: who else commands the robot is not disturbed.

        To be called again and again.
        """
        now = time.perf_counter()
        if self._stopping is None:
            self._stopping = now
        ramp = self.settings.safety.ramp
        if now - self._stopping > ramp + ZEROS:
            return
        left = max(1.0 - (now - self._stopping) / ramp, 0.0) if ramp > 0.0 else 0.0
        brakes = self._last["brake"] if left > 0.0 else self._zero["brake"]
        self._send({**{g: left * v for g, v in self._last.items()}, "brake": brakes})

    def rest(self) -> None:
        """Zero at once."""
        self._send(self._zero)

    def _send(self, values: dict[str, np.ndarray]) -> None:
        for publisher, places in self._commands:
            publisher.publish({"data": [values[g][i] for g, i in places]})
