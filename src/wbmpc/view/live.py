"""A live view of a run: a watcher that hands pictures to a process of its own and takes the user's commands from it.

The hand-over is two mailboxes in shared memory: neither side ever waits for the other, so a browser that hangs, or a view
that has crashed, changes nothing in the run.
"""

from __future__ import annotations

import gc
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.errors import EndedByUser, InputError
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.recording.observer import Observer
from wbmpc.simulation.lockstep import PREPARATION, Ending, Running
from wbmpc.simulation.scene import Scene
from wbmpc.view import bounds
from wbmpc.view.actuator_load import Loads
from wbmpc.view.core import LiveView, followed, numbers, solved
from wbmpc.view.history import Factor, Trail
from wbmpc.view.named_configuration import NamedConfiguration
from wbmpc.view.process import RATE
from wbmpc.view.snapshot import PLAN, REFERENCE, TRAIL, fields, filled, ground
from wbmpc.view.user_commands import UserCommands, no_requests, planar, spatial

#: A run that is late by more than this [s] gives up catching up with the clock.
_LATEST = 0.2
#: Ticks of which figures are kept.
_KEPT = 100_000


class View(LiveView):
    """A :class:`~wbmpc.simulation.lockstep.Watcher` that shows a run at ``url`` and paces it to the clock.

    ``wants_reset``: whether the run ended in order to restart; ``ended``: whether the user ended it; ``commanded``: whether
    its goals, weights, brakes or forces were changed.
    ``live``: it also shows what drives before the run, which nobody can steer: its calibration is kept.
    ``opened(url)`` is called once the server answers; no browser is waited for. Times in s.
    """

    live = True

    def __init__(
        self, title: str, host: str = "127.0.0.1", port: int = 8080, *,
        opened: Callable[[str], None] = lambda url: None, with_token: bool = True,
    ) -> None:  # fmt: skip
        super().__init__(title, host, port, opened, with_token)
        self._shown: tuple[Scene, bool] | None = None
        self.commanded, self._factor, self._trail = False, Factor(), Trail()
        self._ticks, self._late_ticks, self._period = 0, 0, np.inf
        #: Seconds that watching took at each tick, and by how much ticks began late while nothing was paused: the last ones.
        self.own_time: deque[float] = deque(maxlen=_KEPT)
        self.lateness: deque[float] = deque(maxlen=_KEPT)

    def open(self, running: Running) -> None:
        """Start the server's process for the world of a run; returns when it answers."""
        self.scene, before = self._shown = Observer(running).scene, running.name == PREPARATION
        controls = self._controls(
            None if before else running.mpc, getattr(running.controller, "robot", None), self._loads_of(running).groups,
            pushes=not before,
        )  # fmt: skip
        self.start(self.scene, controls, fields(self.scene))

    @staticmethod
    def _loads_of(running: Running) -> Loads:
        return Loads(running.plant.description, Observer(running).reader.joint_names)

    def restart(self) -> None:
        """What comes is another run. Those before are in reference cycles, of many bytes in few objects: Python itself would look for them
        once in dozens of runs."""
        self.wants_reset = self.commanded = False
        gc.collect()

    @property
    def factors(self) -> dict[str, float]:
        """By which the sliders multiply the weights of costs, by cost: those of this run that are not 1."""
        commands = getattr(self, "_commands", None)
        return {} if commands is None else commands.factors

    # ------------------------------------------------------------------ the loop
    def begin(self, running: Running) -> None:
        """Show this loop from now on; of one without MPC there are no goals and weights."""
        self.running, self._observer = running, Observer(running)
        self._before = running.name == PREPARATION
        self.show_message("")
        self._ticks, self._late_ticks, self._period = 0, 0, running.timing.period
        self._factor.reset()
        self._trail.reset()
        if self.process is not None and (self._observer.scene, self._before) != self._shown:
            self.close()  # another page: browsers find the new server at the same place
            self._requests = no_requests()
        if self.process is None:
            self.open(running)
        name = f"{running.name} ({running.duration:.0f} s)" if self._before else running.name
        self.show_message(", ".join(text for text in (name, self._previous) if text))
        self._loads = self._loads_of(running)
        self._configuration = NamedConfiguration(
            getattr(running.controller, "robot", None), self._observer.reader.joint_names
        )
        self._commands = UserCommands(running, self._observer.lift, self.reject)
        self._commands.skip(self._requests)
        self._expect()
        self._steps = int(self._requests["steps"])
        self._drift = np.array([0.0, 0, 0, 1, 0, 0, 0])
        self._next = -np.inf
        self._anchor(0.0)

    def tick(self, t: float, command: Any, plans: PolicyQueue) -> None:
        """Pictures and commands; then wait until it is time."""
        start = time.perf_counter()
        self._take_requests()
        self._apply_commands(t)
        if start >= self._next:
            self._next = start + 1.0 / RATE
            self.shown.write(**self._snapshot(t, plans))
        self.own_time.append(time.perf_counter() - start)
        self._wait(t, plans)

    def end(self, ending: Ending) -> None:
        """Say so; the last picture stays until :meth:`close`."""
        what, why = f"{PREPARATION}: done" if self._before else "The run is over", ending.reason
        if ending.fell and "the robot fell" not in why:  # after it was stopped
            why += "; then the robot fell"
        self.show_message(f"{what}: {why}" if why else what)
        self._previous = f"Before: {why}" if ending.fell else ""

    # ------------------------------------------------------------------ time
    def _anchor(self, t: float) -> None:
        self._origin, self._speed = (
            time.perf_counter() - t / float(self._requests["speed"]),
            float(self._requests["speed"]),
        )

    def _wait(self, t: float, plans: PolicyQueue) -> None:
        """Hold the run while it is paused, and until the wall clock is at t."""
        if self._requests["paused"]:
            self._pause(t, plans)
            self._anchor(t)
            self._factor.reset()
        else:
            self._steps = int(self._requests["steps"])  # what was asked for while nothing was paused
        if float(self._requests["speed"]) != self._speed:
            self._anchor(t)
        ahead = self._origin + t / self._speed - time.perf_counter()
        self.lateness.append(-ahead)
        self._ticks += 1
        self._late_ticks += int(-ahead > self._period)
        if ahead > 0.0 and not self._before:  # the user waits for the run
            time.sleep(ahead)
        elif ahead < -_LATEST:
            self._anchor(t)

    def _pause(self, t: float, plans: PolicyQueue) -> None:
        while self._requests["paused"] and int(self._requests["steps"]) == self._steps:
            if not self.process.is_alive():
                self._requests["paused"][...] = 0.0  # it could never be let go again
                return
            if self.running.interrupted():
                return
            time.sleep(0.02)
            self._take_requests()
            self._apply_commands(t)
            self.shown.write(**self._snapshot(t, plans))
        self._steps += int(self._requests["steps"]) != self._steps  # each of several clicks is a step

    def _take_requests(self) -> None:
        previous = self._requests["speed"]
        if not self._read_requests():
            return
        try:
            bounds.within("speed", float(self._requests["speed"]), *bounds.SPEEDS)
        except InputError as error:
            self._requests["speed"] = previous
            self.reject(str(error))
        if self._asked("ends"):
            self.ended = True
            raise EndedByUser("ended in the view")
        if self._asked("resets"):
            self.wants_reset = True
            raise EndedByUser("restarted in the view")

    def _apply_commands(self, t: float) -> None:
        if self._before:
            return
        self._commands.apply(t, self._requests, self._drift)
        self.commanded = self.commanded or self._commands.used

    # ------------------------------------------------------------------ pictures
    def _snapshot(self, t: float, plans: PolicyQueue) -> dict[str, Array]:
        running, reader, moment, mpc = self.running, self._observer.reader, self._observer.see(), self.running.mpc
        data, self._drift = running.plant.data, moment.drift
        target, on_floor = followed(mpc, t, self._observer.lift), ground(reader.contacts(data))
        goal = lie.pose_compose(self._drift, target.goal) if np.isfinite(target.goal).all() else target.goal
        base_goal = target.base
        if UserCommands.base_of(mpc):
            base_goal = planar(lie.pose_compose(self._drift, spatial(base_goal)))
        joints = reader.joint_states(data)
        others = {
            "t": t, **solved(mpc), **{name: on_floor.pop(name) for name in ("margin", "triangle_margin")},
            **self._loads.shares(joints[:, 1], data.actuator_force), "late": np.nan,
            "factor": self._factor.add(time.perf_counter(), t), "ticks": self._ticks, "late_ticks": self._late_ticks,
            "configuration": self._configuration.number(joints[:, 0]),
        }  # fmt: skip
        return {
            "numbers": numbers(moment.end_effector, goal, moment.base, base_goal, others), "poses": moment.bodies, "goal": goal,
            "base_goal": base_goal, "brakes": np.array(self._commands.brakes_open(t)),
            "obstacle": self._commands.obstacle(self._drift),
            "trail": filled(self._trail.add(moment.end_effector[:3]), (TRAIL, 3)), **self._paths(target.way, plans), **on_floor,
        }  # fmt: skip

    def _paths(self, way: Array, plans: PolicyQueue) -> dict[str, Array]:
        """The ``way`` (n, 3) of the end effector's reference, and the predicted ones of end effector and base."""
        base, end_effector = self._observer.plan(plans)
        paths = {
            "reference": (way, REFERENCE),
            "end_effector_plan": (end_effector[:, :3], PLAN),
            "base_plan": (base[:, :3], PLAN),
        }
        return {name: self._in_map(filled(points, (count, 3))) for name, (points, count) in paths.items()}

    def _in_map(self, points: Array) -> Array:
        """Positions (n, 3) in ``odom`` as the scene shows them."""
        return points @ lie.quaternion_to_rotation(self._drift[3:]).T + self._drift[:3]
