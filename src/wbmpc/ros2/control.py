"""The controller as a node: waits for states and a goal, runs the real-time runner, publishes what it does."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import suppress
from typing import cast

import numpy as np

from wbmpc.bases import base_type
from wbmpc.errors import InputError
from wbmpc.logs import RateLimit
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.base_adapter import BaseAdapter
from wbmpc.ros2.bus import SENSOR, SMALL, Node
from wbmpc.ros2.clock import BusClock
from wbmpc.ros2.command_conflicts import LINGERS, CommandConflicts
from wbmpc.ros2.convert import error_message, seconds
from wbmpc.ros2.goals import Task
from wbmpc.ros2.health import Health
from wbmpc.ros2.hold_ups import HoldUps
from wbmpc.ros2.interpreter import TURNS, control_priority, real_time_interpreter
from wbmpc.ros2.localization import POSE_AGE, ExternalPose, PoseSource
from wbmpc.ros2.obstacles import ObstacleTopics
from wbmpc.ros2.planning import Planned, Planning, References
from wbmpc.ros2.publishers import Publishers
from wbmpc.ros2.request_queue import RequestQueue
from wbmpc.ros2.robot import BusRobot
from wbmpc.ros2.rosout import Rosout
from wbmpc.ros2.settings import RosSettings
from wbmpc.ros2.trajectory_client import Trajectories
from wbmpc.ros2.tuning import Tuning
from wbmpc.runtime.clock import WallClock
from wbmpc.runtime.runner import RealTimeRunner
from wbmpc.runtime.safety import RealTimeSettings, SafeStop
from wbmpc.types import Observation

_LOG = logging.getLogger("wbmpc")
#: How often [s] goals are taken up, and the graph is checked.
POLL_PERIOD, GRAPH_POLL_PERIOD = 0.02, 0.5
#: Shares of a period: where the MPC's ticks begin, and from when to when the node's own thread does short pieces of work.
MPC_OFFSET, QUIET_PHASES = 0.5, (0.4, 0.75)
_WENT_BACK = "the time on /clock went back: the simulator was restarted"
#: Samples kept of the runner's figures.
_RECORDS = 4000


class ControlNode:
    """``state``: what it does, as a message. A goal starts it, also after a stop; nothing moves before. Clocks: the wall's, or with
    ``use_sim_time`` the bus's."""

    def __init__(self, node: Node, robot: RobotModel, settings: RosSettings) -> None:
        self.node, self.robot, self.settings, self.period = node, robot, settings, 1.0 / settings.rates.control
        self.clock: WallClock | BusClock = WallClock(turns=TURNS)
        self.hold_ups = HoldUps(lambda: 0.0) if settings.lockstep else HoldUps()
        if settings.lockstep:  # the MPC begins a period after its observation
            self.clock = BusClock(max(settings.mpc.computation_delay - self.period, 0.0))
        elif settings.use_sim_time:
            self.clock = BusClock()
        self.runner: RealTimeRunner | None = None
        self._limit = RateLimit()
        self.rosout = Rosout(node, settings.node, self.now, self.yield_to_controller)
        try:
            self._create_parts()
        except BaseException:
            self.rosout.close()
            raise

    def _create_parts(self) -> None:
        """What the node is made of, and its endpoints."""
        node, robot, settings = self.node, self.robot, self.settings
        self.adapter = cast(BaseAdapter, base_type(robot.description.base.type).ros(robot, settings, self.period))
        self.adapter.origin = lambda: self.clock.origin
        clock, wall = self.clock, time.monotonic
        steady, elapsed = (clock.steady, clock.elapsed) if isinstance(clock, BusClock) else (wall, wall)
        self.source = PoseSource(node, settings, steady, self.now)
        self.external_pose = ExternalPose(self)
        if settings.topics.pose:
            self.adapter.fix = self.external_pose.take
        self.robot_io = BusRobot(node, self.adapter, settings, self.clock)
        self.request_queue = RequestQueue(
            self.hold_ups, node, self.adapter.planner, settings, self._plan_origin, steady, elapsed
        )
        self.base_commands = self.adapter.base_commands(self)
        self.planning = Planning(self.adapter.references)
        self.obstacles = ObstacleTopics(node, self.adapter, settings, steady, self.now, self._plan_origin)
        self.command_conflicts = CommandConflicts(node, [c.topic for c in settings.command_topics(robot).values()])
        self._logged = self._hold_reason = ""
        self.active_task: Task | None = None
        self._graph_checked_at = self._began = -np.inf
        if isinstance(clock, BusClock):
            take = lambda message, source, clock=clock: clock.set(seconds(message.clock), source)
            node.subscribe("/clock", "rosgraph_msgs/msg/Clock", take, SENSOR, largest=SMALL, sourced=True)
        self.trajectories = Trajectories(node, robot, settings)
        self.wrench = np.zeros(6)
        self.health = Health(self)
        self.publishers = Publishers(node, self)
        self.tuning = Tuning(self.adapter, settings)
        node.offer(self.tuning.parameters)

    # ------------------------------------------------------------------ life
    def spin(self, ended: Callable[[], bool]) -> None:
        """Until ``ended()``; then the robot is brought to rest. Garbage is collected when it suits, and young only."""
        self.hold_ups.begin()
        try:
            with real_time_interpreter() as collect:
                while not ended():
                    self.step()
                    collect(self.yield_to_controller)
                    time.sleep(POLL_PERIOD)
        finally:
            self.close()

    def step(self) -> None:
        """One look: goals, start and stop, messages."""
        self.node.work()
        self.tuning.update()
        self._supervise()
        if not self.running:
            self._follow_sensors()
        self._process_requests()
        self.yield_to_controller()
        parts = (
            self.adapter.inspect, self.obstacles.update, self.base_commands.update, self._send_setpoints, self.health.update,
            self.publishers.publish, self.rosout.send,
        )  # fmt: skip
        for update in parts:
            try:
                update()
            except Exception as error:  # of what is beside the control of a robot that may be moving
                self._limit.log(_LOG, logging.ERROR, str(update), f"{update.__qualname__}: {error_message(error)}")
        if self.state != self._logged:
            self._logged = self.state
            if self.runner is None or not self.runner.stopped:  # a stop is reported by the runner
                self._limit.log(_LOG, logging.INFO, self.state.split(":")[0], self.state)

    def close(self) -> None:
        self.hold_ups.end()
        if moved := self.running:
            self._stop_trajectories()
        self._end_runner()
        if moved:
            end = time.perf_counter() + self.settings.safety.ramp + 0.05
            while time.perf_counter() < end:
                self.robot_io.stop()
                time.sleep(self.period)
        if self.runner is not None:
            self.robot_io.rest()
        self.obstacles.close()
        self.planning.close()  # a goal's plan may take long: the robot is at rest by then
        self.rosout.close()

    def _end_runner(self) -> None:
        if (runner := self.runner) is None:
            return
        runner.worker_commands["end"] = 1.0
        if isinstance(self.clock, BusClock):
            self.clock.release()
        runner.shutdown()

    # ------------------------------------------------------------------ state
    @property
    def running(self) -> bool:
        """Whether the runner commands the robot."""
        return self.runner is not None and not self.runner.stopped

    @property
    def stopping(self) -> bool:
        """Whether a stop is still going on, or has not been seen yet: nothing is started before it is over."""
        return not self.running and (self.robot_io.ramping or self.request_queue.running is not None)

    @property
    def degraded(self) -> bool:
        """Whether it runs, but not as it should."""
        kept = self.runner is not None and bool(self.runner.kept)
        return self.running and (kept or bool(self._hold_reason) or bool(self.robot_io.fault))

    @property
    def state(self) -> str:
        """What the node does, as a message."""
        if self.runner is not None:
            trouble = self._hold_reason or (self.robot_io.fault if self.adapter.must_keep_running else "")
            if self.running and trouble:
                return f"{self.runner.state}: {'holds its position: ' if self._hold_reason else ''}{trouble}"
            return f"{self.runner.state}: {self.task}" if self.running and self.task else self.runner.state
        return self.waiting_reason() or "waiting for a goal"

    def waiting_reason(self) -> str:
        """Why no goal can be taken up; empty if one can."""
        if isinstance(self.clock, BusClock) and self.clock.heard is None:
            return "waiting: no time on /clock yet"
        why = self._clock_lost() or self._other_publisher or self.robot_io.waiting_reason()
        if not why and self.settings.topics.pose and self.source.now() - self.source.at > POSE_AGE:
            why = self.source.fault or f"no pose on {self.settings.topics.pose}"
        return f"waiting: {why}" if (why := why or self.obstacles.lost()) else ""

    @property
    def task(self) -> str:
        """What the last goal was about, in words; empty before the first."""
        return self.active_task.description if self.active_task is not None else ""

    def now(self) -> float:
        """Stamp [s] of what is published now."""
        return self.clock.stamp() if isinstance(self.clock, BusClock) else time.time()

    def yield_to_controller(self) -> None:
        """Wait until a tick of the controller is over and the next one is not near: a short piece of work fits in then."""
        if not self.running or isinstance(self.clock, BusClock):
            return
        phase = self.clock.now() / self.period % 1.0
        if not QUIET_PHASES[0] < phase < QUIET_PHASES[1]:
            time.sleep((QUIET_PHASES[0] - phase) % 1.0 * self.period)

    def stamp_of(self, t: float) -> float:
        """Stamp [s] of a time of the runner's clock."""
        return self.now() - (self.clock.now() - t)

    def _plan_origin(self) -> float:
        """The bus's time [s] at which the plan's is 0."""
        return self.now() - (self.clock.now() if self.running else 0.0)

    # ------------------------------------------------------------------ before a goal
    def _follow_sensors(self) -> None:
        """Follow the sensors while the drives are not commanded, in every state; a tick that a stop overtakes has them to itself."""
        unheard = isinstance(self.clock, BusClock) and self.clock.heard is None
        ticking = self.runner is not None and self.runner.ticking
        if unheard or ticking or (self.adapter.needs_imu and not self.robot_io.has_imu):
            return
        for measurement in self.robot_io.unread():
            with suppress(SafeStop, InputError):
                self.adapter.stand(measurement)

    # ------------------------------------------------------------------ goals
    def _process_requests(self) -> None:
        """All goals that wait, in the order in which they came; those whose plans take long in a later step."""
        while self.planning.busy or (not self.stopping and (request := self.request_queue.take()) is not None):
            if not self.planning.busy:
                seen, why = self.adapter.snapshot(), self._rejection_reason()
                if why or seen is None:
                    self.request_queue.reject(f"a goal is rejected: {why or 'there is no state yet'}")
                    continue
                assert request is not None
                self.planning.begin(request, seen[1], self.clock.now() if self.running else 0.0, self.running)
            if not self.planning.ready():
                return
            was = self.request_queue.running  # also of a run whose stop has not been seen yet
            try:
                self._activate(self.planning.take())
            except Exception as error:  # whatever a goal does, a robot that moves is not left alone
                self.request_queue.reject(f"a goal is rejected: {error_message(error)}")
                self.request_queue.running = self.request_queue.running if self.running else was
            else:
                self.request_queue.rejected = ""

    def _rejection_reason(self) -> str:
        """Why no goal can be taken; empty if one can."""
        unseen = "the robot has stopped meanwhile" if self.request_queue.running is not None else ""
        return self._hold_reason if self.running else unseen or self.waiting_reason()

    def _activate(self, planned: Planned) -> None:
        """Start a planned task, if that is still right. Raises :class:`InputError`."""
        seen, why = self.adapter.snapshot(), self._rejection_reason()
        if planned.moving and not self.running:
            why = "the robot has stopped meanwhile"
        if why or seen is None:
            raise InputError(why or "there is no state yet")
        self.hold_ups.check(planned.came)
        if planned.moving or self.running:  # one that was for a moving robot starts none, whenever it has stopped
            self.set_task(planned.task, planned.references)
        else:
            self.start(seen[1], planned.task, planned.references)

    def _send_setpoints(self) -> None:
        """Trajectories to those who follow them, and the wrench to who counts with it."""
        wrench = self.request_queue.wrench()
        if np.any(wrench != self.wrench):
            self.wrench = wrench
            self.adapter.push(wrench)
        runner = self.runner
        policy = runner.plans.current if runner is not None and self.running else None
        if runner is not None and policy is not None and not runner.overdue:
            self.trajectories.send(policy, self.clock.now(), self.now)

    def set_task(self, task: Task, references: References) -> None:
        self.adapter.follow(references)
        self.request_queue.running, self.active_task = task, task

    def start(self, x: np.ndarray, task: Task, references: References) -> None:
        settings, adapter, self._began = self.settings, self.adapter, self.hold_ups.wall()
        self._end_runner()
        adapter.begin(x)
        self.external_pose.reset()
        self.obstacles.begin()
        self.set_task(task, references)
        adapter.mpc.advance(Observation(0.0, x))  # the first solve takes many iterations: not in the runner's time
        self._follow_sensors()  # what the sensors said meanwhile
        self.hold_ups.check(self._began)
        times = RealTimeSettings(
            settings.rates.control, max_policy_age=settings.safety.policy, max_observation_age=settings.safety.watchdog,
            watchdog=settings.held_up, records=_RECORDS, keep_last_policy=adapter.must_keep_running,
            priority=control_priority(), offset=MPC_OFFSET * self.period,
        )  # fmt: skip
        self.runner = RealTimeRunner(
            self.robot_io, adapter.controller, adapter.mpc, times, self.clock, parameters=adapter.parameters
        )
        self.robot_io.arm()
        self.trajectories.restart()
        self._hold_reason = ""
        self.runner.start()

    # ------------------------------------------------------------------ watching
    def _supervise(self) -> None:
        if self.runner is not None and self.runner.stopped:
            self._after_stop()
        slept = isinstance(self.clock, WallClock) and self.hold_ups.since(self._began)
        if slept and self.running and not self.adapter.must_keep_running:
            # the runner's clock stands still while a machine is suspended; the bus's does not, and runs at its own speed
            self._stop_runner("the machine was suspended, or the process was held up")
        self._check_clock()
        if time.monotonic() - self._graph_checked_at > GRAPH_POLL_PERIOD:
            self._graph_checked_at = time.monotonic()
            self.yield_to_controller()
            self.request_queue.detect_speed_inputs()
            self.source.update()
            self.command_conflicts.update()
        self._check_other_publishers()

    def _after_stop(self) -> None:
        """The runner has stopped the robot: nothing that was asked for before counts any more."""
        self.robot_io.disarm()
        if self.request_queue.running is not None:
            self._stop_trajectories()
            self.request_queue.stop()
        self.base_commands.stop(self.request_queue.running is not None)
        self.request_queue.running = None

    def _clock_lost(self) -> str:
        """Why there is no time any more; empty if there is."""
        if not isinstance(self.clock, BusClock):
            return ""
        # to a process that was held up for longer than a lease all others have left, and come back at once
        there = lambda: bool(self.node.publishers("/clock", LINGERS))
        return self.clock.lost(self.settings.silence(self.clock.speed), there)

    def _check_clock(self) -> None:
        if not isinstance(clock := self.clock, BusClock):
            return
        lost = self._clock_lost()
        if self.running and not self.adapter.must_keep_running:
            lost = lost or clock.stood(self.settings.silence)
        restarted = _WENT_BACK if clock.went_back else clock.source.replaced
        if self.running and (lost or restarted):
            self._stop_runner(lost or restarted)
        elif (lost or clock.went_back) and self.runner is not None:
            self.robot_io.stop()  # the runner's loop waits for a time that does not come

    @property
    def _other_publisher(self) -> str:
        """Who else commands the drives, or sends what has one source; empty if there is no other."""
        clock = self.clock.source.conflict if isinstance(self.clock, BusClock) else ""
        return self.command_conflicts.message or clock or self.robot_io.conflict or self.source.source.conflict

    def _check_other_publishers(self) -> None:
        """No robot moves beside another publisher. And a robot that cannot stop because it has lost its localization at least goes
        nowhere."""
        other = self._other_publisher
        lost = self.source.lost() if self.settings.topics.pose and self.adapter.must_keep_running else ""
        replaced = self.source.source.settle()  # counts once: who would fall takes the next goal
        lost = lost or replaced or self.obstacles.lost() or self.robot_io.lateness.fault
        if (other or lost) and self.running:
            self._stop_or_hold(other or lost)
        elif self._hold_reason and not (other or lost):
            self._hold_reason = ""

    def _stop_or_hold(self, message: str) -> None:
        """No more goals: a stop, or, for a robot that would fall, balance on the spot as long as that lasts."""
        if not self.adapter.must_keep_running:
            self._stop_runner(message)
        elif not self._hold_reason:
            self._hold_reason = message
            _LOG.error("holds its position: %s", message)
            seen = self.adapter.snapshot()
            assert seen is not None
            task = self.adapter.planner.hold(seen[1], self.clock.now())
            self.set_task(task, self.adapter.references(task, seen[1]))

    def _stop_trajectories(self) -> None:
        """Who follows trajectories brakes as the other drives do, once. A simulated robot that has restarted follows none, and is elsewhere."""
        self.trajectories.restart()
        if not getattr(self.clock, "went_back", False) and (seen := self.adapter.snapshot()) is not None:
            self.trajectories.stop(seen[1], self.settings.safety.ramp, self.now, self.clock.now() - seen[0])

    def _stop_runner(self, message: str) -> None:
        """Stop; see :meth:`_supervise` for one without a clock."""
        assert self.runner is not None
        self.runner.halt(message)
        self.robot_io.stop()
