"""The robot's side of the bus, simulated: publishes what a robot's drivers would, follows what they would follow."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any
from xml.etree import ElementTree

import numpy as np

from wbmpc import lie
from wbmpc.bases.base import WHEELS
from wbmpc.errors import InputError
from wbmpc.logs import RateLimit
from wbmpc.model.robot import RobotModel
from wbmpc.robots.frames import MAP, SUFFIX, FixedFrame, fixed_frames, free_name
from wbmpc.robots.urdf import to_urdf
from wbmpc.ros2.base_driver import SimulatedDriver, ordered_speeds
from wbmpc.ros2.bus import DEFAULT, LATCHED, LONG, SMALL, Node, Qos
from wbmpc.ros2.command_conflicts import LINGERS
from wbmpc.ros2.convert import check_numbers, error_message, header, pose, quaternion, stamp, vector
from wbmpc.ros2.plants import plant_of
from wbmpc.ros2.settings import RosSettings, joint_groups
from wbmpc.ros2.trajectory_client import places_of
from wbmpc.settings import CONTROL_RATE
from wbmpc.simulation.scene import SceneReader

_LOG = logging.getLogger("wbmpc")
#: Like the watchdog of a drive [s]: without commands for longer the robot stops and its brakes close.
COMMAND_TIMEOUT = 0.1
#: In lockstep: how long an answer is waited for once the robot was reported to rest (a controller that has stopped it goes silent),
#: and after what time the question is asked again [s of the wall].
RESTED, AGAIN = 3.0, 0.05
#: A trajectory answers for so many periods of those that are sent.
AGAIN_LED = 4.0
#: Simulated time at the beginning [s]: 0 means in ROS that there is no time yet.
BEGIN = 1.0
#: Physics that is later than this [s] lets the time go, and counts it: of a robot that is held, whose controller takes states for that old,
#: and of others, whose stamps then leave a gap over which no estimator takes the gyro's rate for the turning between.
LATE, LATE_STANDING = 0.05, 0.12
IMU = "imu"
TRUTH_ODOM, TRUTH_END_EFFECTOR, CONTACT = "/ground_truth/odom", "/ground_truth/end_effector", "/contact"


class SimNode:
    """A plant on a bus, at the default rate of controllers, in lockstep at most at that of its own: who ticks more rarely answers not every state.

    In lockstep (as the settings say), after the first commands, a period is simulated only when all commands to its beginning
    have come (``patience`` [s] of the wall: as long as they are waited for), so that nothing depends on the machine's speed; else
    in real time, ``factor`` times as fast. ``behind``: how often it was too slow. Stamps say when the physics was sampled,
    whenever the message goes out: simulated time, by the wall clock from its beginning on. A robot that cannot stand by itself
    is held until the first commands come that are not those of a stop; only its time goes on.
    """

    def __init__(
        self, node: Node, robot: RobotModel, settings: RosSettings, seed: int = 0, *, factor: float = 1.0
    ) -> None:
        self.node, self.robot, self.settings = node, robot, settings
        self._limit = RateLimit()
        self.side = plant_of(robot, seed)
        self.plant = self.side.plant
        period = max(1.0 / CONTROL_RATE, 1.0 / settings.rates.control if settings.lockstep else 0.0)
        self.steps = max(math.ceil(period / self.plant.timestep - 1e-6), 1)
        self.period = self.steps * self.plant.timestep
        self.lockstep, self.factor, self.behind, self.ticks = settings.lockstep, factor, 0, 0
        self.patience = settings.patience
        self.sim_time = settings.use_sim_time or self.lockstep
        if factor != 1.0 and not self.sim_time:
            raise InputError(
                "factor: a simulation that is faster or slower than the wall clock needs simulated time (use_sim_time)"
            )
        self._began = time.time()  # the wall's time at which the simulated one was 0 [s]
        self._groups = self.side.rest()
        self._changed = threading.Condition()
        self._controllers = settings.command_topics(robot)
        self._count = dict.fromkeys(self._controllers, 0)
        self._heard = dict.fromkeys(self._controllers, -np.inf)
        self._silent, self._lost, self._begun = True, False, False
        self._stood = 0.0  # how long the robot was held [s]
        self._open()

    def _open(self) -> None:
        topics, frames, places = self.settings.topics, self.settings.frames, places_of(self.robot)
        sensors = Qos(depth=5)  # reliable, as the joint_state_broadcaster's
        self._joints = self.node.publisher(topics.joint_states, "sensor_msgs/msg/JointState", sensors)
        self._imu = self.node.publisher(topics.imu or "/imu", "sensor_msgs/msg/Imu", sensors)
        self._driver = None
        if self.robot.description.base.takes_twist:
            self._driver = SimulatedDriver(self.node, topics.base_odom, self.robot, frames.world, frames.base)
        self._clock = self.node.publisher("/clock", "rosgraph_msgs/msg/Clock", Qos(depth=1))
        self._odom = self.node.publisher(TRUTH_ODOM, "nav_msgs/msg/Odometry")
        self._end_effector = self.node.publisher(TRUTH_END_EFFECTOR, "geometry_msgs/msg/PoseStamped")
        self._reader, self._forces = SceneReader(self.plant.model, self.robot.description.base.body), {}  # type: ignore[var-annotated]
        text = to_urdf(self.robot.description, frames.base, frames.world, self.settings.joints)
        fixed = self.node.publisher("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
        fixed.publish({"transforms": [self._imu_frame(text)]})
        described = self.node.publisher("/robot_description", "std_msgs/msg/String", LATCHED)
        described.publish({"data": text})
        self._bus_names = {n: [self.settings.bus_name(j) for j in c.joints] for n, c in self._controllers.items()}
        self._order = {g: [self.settings.bus_name(n) for n in names] for g, names in joint_groups(self.robot).items()}
        self._names = [n for names in self._order.values() for n in names]
        for name, controller in self._controllers.items():  # last: commands may come at once
            target = [places[j] for j in controller.joints]
            follow, largest = partial(self._follow, name, target), LONG if controller.takes == "trajectory" else SMALL
            self.node.subscribe(controller.topic, controller.type, follow, DEFAULT, largest=largest)

    def _imu_frame(self, described: str) -> dict[str, Any]:
        """As the URDF ``described`` has its point, or where the simulated one is, under a name that no link there has: for those who run no
        robot_state_publisher."""
        frames = self.settings.frames
        points = fixed_frames(self.robot.description, frames.base, frames.world)
        at = np.concatenate([self.side.imu_at, [1.0, 0.0, 0.0, 0.0]])
        links = {link.get("name", "") for link in ElementTree.fromstring(described).iter("link")}
        free = FixedFrame(free_name(IMU, {frames.base, frames.world, MAP, *links}), frames.base, at)
        imu = next((p for p in points if p.name in (IMU, IMU + SUFFIX)), free)
        self._imu_name = imu.name
        transform = {"translation": vector(imu.pose[:3]), "rotation": quaternion(imu.pose[3:])}
        return {"header": header(self.now(), imu.parent), "child_frame_id": imu.name, "transform": transform}

    def _follow(self, name: str, places: list[tuple[str, int]], message: Any) -> None:
        """Take a command; one that cannot be meant is reported, and the one before it holds."""
        kinds = {"trajectory": self._take_trajectory, "twist": self._take_twist}
        try:
            kinds.get(self._controllers[name].takes, self._take)(name, places, message)
        except InputError as error:
            topic = self._controllers[name].topic
            self._limit.log(_LOG, logging.ERROR, topic, f"{topic}: {error_message(error)}")

    def _take(self, name: str, places: list[tuple[str, int]], message: Any) -> None:
        values = np.asarray(message.data, float)
        if values.size != len(places):
            raise InputError(f"{len(places)} numbers are needed, got {values.size}")
        check_numbers(values, f"{len(places)} numbers")
        with self._changed:
            for (group, i), value in zip(places, values, strict=True):
                self._groups[group][i] = value
            self._begun |= bool(np.any(values))
            self._answered(name)

    def _take_twist(self, name: str, places: list[tuple[str, int]], message: Any) -> None:
        """As a base's own driver does."""
        speeds = ordered_speeds(self.robot, message)
        with self._changed:
            self._groups[WHEELS][:] = speeds
            self._begun |= bool(np.any(speeds))
            self._answered(name)

    def _take_trajectory(self, name: str, places: list[tuple[str, int]], message: Any) -> None:
        """As a joint_trajectory_controller does: the drives follow the points' positions and velocities."""
        led = self.side.lead(self._bus_names[name], places, message, self.now())
        with self._changed:
            self.side.led[name] = led
            self._begun |= len(message.points) > 1  # a stop's has one point, at rest
            self._answered(name)

    def _answered(self, name: str) -> None:
        self._count[name] += 1
        self._heard[name], self._lost = self.time, False
        self._changed.notify_all()

    # ------------------------------------------------------------------ time
    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._stood + float(self.plant.time)

    @property
    def failed(self) -> bool:
        """Whether the robot fell, or the simulation diverged: what ended :meth:`spin` before it was asked to."""
        return self.plant.fell or self.plant.diverged

    def now(self) -> float:
        """Stamp [s] of what is published now."""
        return self.time + (BEGIN if self.sim_time else self._began)

    def spin(self, ended: Callable[[], bool], seconds: float = np.inf) -> str:
        """Run until ``ended()``, for ``seconds`` of simulated time or until the robot falls; returns why it ended."""
        due = time.perf_counter()
        self._began = time.time() - self.time
        while not ended():
            if self.time >= seconds:
                return f"{seconds:g} s are over"
            previous = dict(self._count)
            self.publish()
            if self.lockstep and not (self._silent or self._lost):
                self._await(previous)
            else:
                due = self._pace(due)
            self._advance()
            self.ticks += 1
            if self.plant.diverged:
                return "the simulation diverged"
            if self.plant.fell:
                return f"the robot fell at {self.time:.2f} s because {self._cause()}"
        return "ended"

    def _cause(self) -> str:
        """What counts as the fall, and what is known of why: commands that did not come, physics that was too slow for its controller."""
        known = [self.plant.fall_reason]
        late = [n for n, heard in self._heard.items() if self.time - heard > COMMAND_TIMEOUT]
        if late:
            heard = max(self._heard[late[0]], 0.0)
            known.append(f"no commands came on {self._controllers[late[0]].topic} after {heard:.2f} s")
        if self.behind:
            known.append(f"the physics was too slow {self.behind} times")
        return "; ".join(known)

    def _advance(self) -> None:
        command = self._command()
        if self.side.held and not self._begun:
            self._stood += self.period
        else:
            self.plant.step(command, self.steps)

    def _pace(self, due: float) -> float:
        """Wait for the next period's wall time; returns the one after it."""
        # without commands time goes by the wall clock, so that who begins has time to
        due += self.period / (min(self.factor, 1.0) if self._silent else self.factor)
        wait = due - time.perf_counter()
        if wait > 0.0:
            time.sleep(wait)
        elif wait < -(LATE if self.side.held else LATE_STANDING):
            self.behind += 1
            self._began -= wait
            return time.perf_counter()
        return due

    def _await(self, previous: dict[str, int]) -> None:
        """Commands to what was just published; asked again now and then, for a sensor's message may be lost.

        Who does not answer at all, or has left the bus, is not waited for again until it does.
        """
        begin = time.monotonic()
        rest = self.side.rest()
        rests = all(np.array_equal(self._groups[g], v) for g, v in rest.items())
        patience = min(RESTED, self.patience) if rests else self.patience
        recent = lambda n: self.time - self._heard[n] < AGAIN_LED / self.settings.rates.trajectory
        led = [n for n, c in self._controllers.items() if c.takes == "trajectory"]
        answered = lambda: all(recent(n) if n in led else self._count[n] > previous[n] for n in previous)
        while not answered() and time.monotonic() - begin < patience:
            with self._changed:
                there = self._changed.wait_for(answered, AGAIN)
            if not there:
                # those that have just left too: to a process that was held up all others have, and come back at once
                sent = [self.node.publishers(c.topic, LINGERS) for c in self._controllers.values()]
                if not all(any(not e.own for e in found) for found in sent):
                    break
                self.publish()
        self._lost = not answered()

    # ------------------------------------------------------------------ messages
    def _command(self) -> Any:
        with self._changed:
            now = self.time
            # a trajectory is followed to its end; who sends numbers has to go on
            late = [
                n for n, heard in self._heard.items()
                if now - heard > COMMAND_TIMEOUT and not (n in self.side.led and np.isfinite(heard))
            ]  # fmt: skip
            if late and not self._silent:
                _LOG.error("no commands on %s: the robot stops", self._controllers[late[0]].topic)
            self._silent = bool(late)
            groups = {g: v.copy() for g, v in (self.side.rest() if late else self._groups).items()}
            if not late:
                self.side.track(groups, self.now())
            return self.side.command(groups)

    def publish(self) -> None:
        """Sensors, then the clock: who hears the clock has the sensors."""
        reading, at = self.side.read(), self.now()
        sampled = at - reading.age
        imu = {
            "header": header(sampled, self._imu_name), "orientation_covariance": [-1.0] + [0.0] * 8,
            "angular_velocity": vector(reading.gyro), "linear_acceleration": vector(reading.accel),
        }  # fmt: skip
        self._imu.publish(imu)
        if self._driver is not None and reading.way is not None:
            self._driver.publish(sampled, reading.way)
        positions = np.concatenate([reading.joints[g] for g in self._order])
        self._joints.publish({"header": header(sampled, ""), "name": self._names, "position": positions})
        if self.ticks % 8 == 0:
            self._publish_truth(at)
        self._clock.publish({"clock": stamp(BEGIN + self.time)})

    def _publish_truth(self, at: float) -> None:
        truth, world = self.plant.truth(), self.settings.frames.world
        position, turned = self.side.base(truth)
        twist = self.plant.world.twist
        self._odom.publish({
            "header": header(at, world), "child_frame_id": "base_truth", "pose": {"pose": pose(position, turned)},
            "twist": {"twist": {"linear": vector(twist[:3]), "angular": vector(twist[3:])}},
        })  # fmt: skip
        end_effector = truth.tool + [0.0, 0.0, self.side.lift]
        self._end_effector.publish(
            {"header": header(at, world), "pose": pose(end_effector, lie.rotation_to_quaternion(truth.tool_rotation))}
        )
        for contact in self._reader.contacts(self.plant.data):
            if contact.body not in self._forces:
                topic = f"{CONTACT}/{contact.body}"
                self._forces[contact.body] = self.node.publisher(topic, "geometry_msgs/msg/WrenchStamped")
            self._forces[contact.body].publish(
                {"header": header(at, world), "wrench": {"force": vector(contact.force)}}
            )
