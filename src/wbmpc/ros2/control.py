"""The controller as a node: waits for states and a goal, runs the real-time runner, tells what it does."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from wbmpc.control import SwerveAgent
from wbmpc.errors import InputError
from wbmpc.experiments.swerve_problem import swerve_mpc
from wbmpc.model import RobotModel
from wbmpc.mpc import RealTime, Runner, SteeringGuess, WallClock
from wbmpc.mpc.safety import SafeStop
from wbmpc.ocp import Reference
from wbmpc.plant import SwerveMeasurement
from wbmpc.ros2.bus import SENSOR, Node
from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.convert import nearest_turn, seconds
from wbmpc.ros2.goals import Planner, Task
from wbmpc.ros2.inbox import Inbox, PoseSource
from wbmpc.ros2.robot import BusRobot
from wbmpc.ros2.settings import RosSettings, need_swerve
from wbmpc.ros2.telling import Teller
from wbmpc.solver import Solver

_LOG = logging.getLogger("wbmpc")
#: How often [s] goals are taken up, and the graph is looked at.
LOOK, LOOK_AT_GRAPH = 0.02, 0.5
#: Largest age [s] of another localisation's pose.
POSE_AGE = 0.5
#: Samples kept of the runner's figures.
_RECORDS = 4000


class References:
    """A guess for the MPC that first puts new references into force: in its own thread, between two solves."""

    def __init__(self, robot: RobotModel) -> None:
        self._steering = SteeringGuess(robot, self._preview)
        self._pending: dict[str, Reference] | None = None
        self._twists: Reference | None = None
        self._base = robot.input["base"]

    def set(self, references: dict[str, Reference]) -> None:
        """In force from the next solve on."""
        self._pending = references

    def __call__(self, solver: Solver, t: float, x0: np.ndarray) -> None:
        pending, self._pending = self._pending, None
        if pending is not None:
            for name, reference in pending.items():
                solver.set_reference(name, reference)
            self._twists = pending["input"]
        self._steering(solver, t, x0)

    def _preview(self, times: np.ndarray, pose: np.ndarray) -> np.ndarray:
        assert self._twists is not None
        twists = self._twists
        columns = [np.interp(times, twists.times, v) for v in twists.values[:, self._base].T]
        return np.stack(columns, axis=1)


class BusAgent(SwerveAgent):
    """A swerve robot's agent whose odometry another localisation may correct."""

    source: PoseSource | None = None
    #: the newest measurement with the pose that belongs to it, for other threads
    seen: tuple[SwerveMeasurement, np.ndarray] | None = None
    _used = -np.inf

    def measure(self, measurement: SwerveMeasurement) -> None:
        """Take in the encoders of this tick, and a new pose if there is one."""
        super().measure(measurement)
        source = self.source
        if source is not None:
            age = source.now() - source.at
            if age > POSE_AGE:
                topic = source.settings.topics.pose
                raise SafeStop(f"the pose on {topic} is {age:.2f} s old, the limit is {POSE_AGE:g} s")
            self.correct()
        self.seen = measurement, self.odometry.pose

    def stand(self, m: SwerveMeasurement) -> None:
        """Follow the wheels, and the gyro's bias, while nobody commands them."""
        if self.measured is not None and m.time <= self.measured.time:
            return
        super().measure(m)
        self.correct()
        self.seen = m, self.odometry.pose

    def snapshot(self) -> tuple[float, np.ndarray]:
        """Time [s] of the runner's clock and the state (nx) estimated for it; from any thread."""
        assert self.seen is not None
        m, pose = self.seen
        parts = {"base": pose, "leg": m.leg, "steer": m.steer, "wheel": m.wheel, "arm": m.arm}
        return m.time, self.robot.state.vector({g: parts[g] for g in self.robot.state.groups})

    def correct(self) -> None:
        """The newest pose of the other localisation is the odometry's, yaw not wrapped."""
        source = self.source
        if source is not None and source.pose is not None and source.at > self._used:
            self._used, (x, y, yaw) = source.at, source.pose
            self.odometry.place([x, y, nearest_turn(yaw, self.odometry.pose[2])])


class ControlNode:
    """``state``: what it does, as a sentence. A goal starts it, also anew after a stop; nothing moves before.

    Clocks: the wall's, or with ``use_sim_time`` the bus's.
    """

    def __init__(self, node: Node, robot: RobotModel, settings: RosSettings) -> None:
        need_swerve(robot)
        self.node, self.robot, self.settings = node, robot, settings
        self.clock: WallClock | BusClock = BusClock() if settings.use_sim_time else WallClock()
        self.references = References(robot)
        self.mpc = swerve_mpc(robot, settings.mpc, settings.cost, self.references)
        self.period = 1.0 / settings.rates.control
        steady = self.clock.stamp if isinstance(self.clock, BusClock) else time.monotonic
        self.source = PoseSource(node, settings, steady)
        self.body = BusRobot(node, robot, settings, self.clock)
        self.agent = self._new_agent(np.zeros(3))
        robot.pose(robot.home)  # builds the function: not in a tick
        self.planner = Planner(robot, settings.speeds)
        self.inbox = Inbox(node, self.planner, settings, self._origin, steady)
        self.runner: Runner | None = None
        self._rival, self._said = "", ""
        self._task: Task | None = None
        self._looked_at_graph = -np.inf
        if isinstance(self.clock, BusClock):
            clock = self.clock
            take = lambda message: clock.set(seconds(message.clock))
            node.subscribe("/clock", "rosgraph_msgs/msg/Clock", take, SENSOR)
        self.teller = Teller(node, self)

    # ------------------------------------------------------------------ life
    def spin(self, ended: Callable[[], bool]) -> None:
        """Until ``ended()``; then the robot is brought to rest."""
        try:
            while not ended():
                self.step()
                time.sleep(LOOK)
        finally:
            self.close()

    def step(self) -> None:
        """One look: goals, start and stop, messages."""
        self.node.work()
        self._watch()
        if not self.running:
            self._stand()
        self._take_up()
        self.teller.tell()
        if self.state != self._said:
            self._said = self.state
            _LOG.info("%s", self.state)

    def close(self) -> None:
        """Bring the robot to rest and end."""
        moved = self.running
        self._end_runner()
        if moved:
            end = time.perf_counter() + self.settings.safety.ramp + 0.05
            while time.perf_counter() < end:
                self.body.stop()
                time.sleep(self.period)
        if self.runner is not None:
            self.body.rest()

    def _end_runner(self) -> None:
        runner = self.runner
        if runner is None:
            return
        runner.orders["end"] = 1.0
        if isinstance(self.clock, BusClock):
            self.clock.release()
        runner.shutdown()

    # ------------------------------------------------------------------ state
    @property
    def running(self) -> bool:
        """Whether the runner commands the robot."""
        return self.runner is not None and not self.runner.stopped

    @property
    def state(self) -> str:
        """What the node does, as a sentence."""
        if self.runner is not None:
            if self.running and self._task is not None:
                return f"{self.runner.state}: {self._task.said}"
            return self.runner.state
        return self.waits_for() or "waiting for a goal"

    def waits_for(self) -> str:
        """Why no goal can be taken up; empty if one can."""
        if isinstance(self.clock, BusClock) and self.clock.heard is None:
            return "waiting: no time on /clock yet"
        why = self._rival or self.body.waits_for()
        if not why and self.settings.topics.pose and self.source.now() - self.source.at > POSE_AGE:
            why = f"no pose on {self.settings.topics.pose}"
        return f"waiting: {why}" if why else ""

    def now(self) -> float:
        """Stamp [s] of what is published now."""
        return self.clock.stamp() if isinstance(self.clock, BusClock) else time.time()

    def stamp_of(self, t: float) -> float:
        """Stamp [s] of a time of the runner's clock."""
        return self.now() - (self.clock.now() - t)

    def _origin(self) -> float:
        """The bus's time [s] at which the plan's is 0."""
        return self.now() - (self.clock.now() if self.running else 0.0)

    # ------------------------------------------------------------------ before a goal
    def _new_agent(self, pose: np.ndarray) -> BusAgent:
        settings = self.settings
        use_gyro = settings.use_gyro and self.body.has_imu
        agent = BusAgent(self.robot, pose, self.period, lag=settings.drive_lag, use_gyro=use_gyro)
        agent.source = self.source if self.settings.topics.pose else None
        return agent

    def _stand(self) -> None:
        """Follow the wheels while nobody commands them."""
        if self.waits_for():
            return
        try:
            m = self.body.read()
        except (SafeStop, InputError):
            return
        self.agent.use_gyro = self.settings.use_gyro and self.body.has_imu
        self.agent.stand(m)

    # ------------------------------------------------------------------ goals
    def _take_up(self) -> None:
        """All goals that wait, in the order in which they came."""
        while (request := self.inbox.take()) is not None:
            why = "" if self.running else self.waits_for()
            if why or self.agent.seen is None:
                self.inbox.refuse(f"a goal is refused: {why or 'there is no state yet'}")
                continue
            x, t = self.agent.snapshot()[1], self.clock.now() if self.running else 0.0
            try:
                task = request(x, t)
                references = task.references(self.robot, x)
            except InputError as error:
                self.inbox.refuse(f"a goal is refused: {error}")
                continue
            self.inbox.running, self._task = task, task
            self.references.set(references)
            if not self.running:
                self._start(x)

    def _start(self, x: np.ndarray) -> None:
        self._end_runner()
        settings, old = self.settings, self.agent
        self.agent = self._new_agent(old.odometry.pose)
        self.agent.seen, self.agent.odometry = old.seen, old.odometry
        self.agent.odometry.restart_clock()  # the runner's clock starts at 0
        self.mpc.reset(x)
        watchdog = settings.safety.watchdog
        times = RealTime(
            settings.rates.control,
            max_policy_age=0.5,
            max_observation_age=watchdog,
            watchdog=watchdog,
            records=_RECORDS,
        )
        self.runner = Runner(self.body, self.agent, self.mpc, times, self.clock)
        self.body.arm()
        self.runner.start()

    # ------------------------------------------------------------------ watching
    def _watch(self) -> None:
        if self.runner is not None and self.runner.stopped:
            self.body.disarm()
            self.inbox.running = None
        clock, limit = self.clock, self.settings.safety.clock
        if isinstance(clock, BusClock) and clock.heard is not None:
            silent = time.monotonic() - clock.heard
            if silent > limit and self.running:
                self._halt(f"the time on /clock has stopped for {silent:.1f} s")
            elif clock.went_back and self.running:
                self._halt("the time on /clock went back: the simulator was started anew")
        if time.monotonic() - self._looked_at_graph > LOOK_AT_GRAPH:
            self._looked_at_graph = time.monotonic()
            self.inbox.look_for_speeds()
            self.source.look()
            self._look_for_rivals()

    def _look_for_rivals(self) -> None:
        """Somebody else on our command topics: two controllers on one drive are worse than none."""
        topics = [c.topic for c in self.settings.command_topics(self.robot).values()]
        rivals = [topic for topic in topics if any(not e.own for e in self.node.publishers(topic))]
        self._rival = f"somebody else publishes on {rivals[0]}" if rivals else ""
        if rivals and self.running:
            self._halt(self._rival)

    def _halt(self, sentence: str) -> None:
        """Stop; with the bus's clock at rest the runner's loop does not ramp down, so it is done from here."""
        assert self.runner is not None
        self.runner.halt(sentence)
        self.body.stop()

    def figures(self) -> dict[str, Any]:
        """For diagnostics."""
        values: dict[str, Any] = {"backend": self.node.backend, "age of the joint states [ms]": _ms(self.body.age())}
        if self.inbox.refused:
            values["refused"] = self.inbox.refused
        if self.runner is None:
            return values
        r = self.runner.report()
        return {
            **values,
            "task": self._task.said if self._task is not None else "",
            "solve: median [ms]": _ms(r.solve.median), "solve: 95 % [ms]": _ms(r.solve.p95), "solve: max [ms]": _ms(r.solve.max),
            "missed deadlines of the MPC": r.mpc_misses, "missed deadlines of the controller": r.misses,
            "updates": r.updates, "failed solves": r.failures, "late policies": r.late,
            "observation to policy in force: median [ms]": _ms(r.latency.median), "clamped ticks": r.clamped,
            "tick begins late: 99 % [ms]": _ms(r.jitter.p99), "tick takes: 99 % [ms]": _ms(r.tick.p99),
        }  # fmt: skip


def _ms(seconds_: float) -> str:
    return f"{1e3 * seconds_:.3f}"
