"""What depends on the kind of base: problem, estimator, agent, references, commands. The node does the rest for all."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from wbmpc.control import BrakeControl
from wbmpc.model import RobotModel
from wbmpc.mpc import MPC
from wbmpc.ocp import ModeSchedule, Reference
from wbmpc.ocp.terms import Weight
from wbmpc.ros2.goals import Planner, Task
from wbmpc.ros2.joints import Inertial, JointSample
from wbmpc.ros2.settings import RosSettings
from wbmpc.solver import Solver

Array = np.ndarray
#: Weights of costs, by name and place (path or terminal).
Weights = dict[tuple[str, Literal["path", "terminal"]], Weight]
Groups = dict[str, Array]
#: Another localisation's pose: time [s] of the runner's clock, (x, y, yaw), covariance (3, 3) (zero: exact).
Fix = tuple[float, Array, Array]


@dataclass(frozen=True)
class Estimate:
    """Of the base in the bus's world: position (3) [m], quaternion (4); twist (6) in its own axes, linear [m/s] first; the
    covariances (6, 6) of both, as in nav_msgs/Odometry (position, rotation about the world's axes)."""

    position: Array
    orientation: Array
    twist: Array
    covariance: Array
    twist_covariance: Array


class Pilot(Protocol):
    """``brakes`` of a run and ``legs`` (n) [rad], where they are to go (None: where they are); both None without hinges.
    ``keeps``: the robot falls when it is stopped, so that it is kept on its last policy as long as there are states.

    ``faults``: what was found in this run of what it ``watches`` (sensors, brakes), as sentences; ``inspect``, called in the
    node's own thread now and then, looks for those that would take too long in a tick.
    ``parameters``: see :class:`wbmpc.mpc.Runner`; ``fix``: asked for another localisation's pose at every tick; after
    ``relocate`` the next one says where the robot is, whatever was known before. ``begin`` makes agent and MPC anew for a run
    from state x (nx) on. ``references`` of a task that begins at x may take long, and are made in another thread.
    """

    robot: RobotModel
    settings: RosSettings
    planner: Planner
    mpc: MPC
    pending: Pending
    agent: Any
    keeps: bool
    watches: str
    brakes: BrakeControl | None
    legs: Array | None
    needs_imu: bool
    parameters: Callable[[], Array] | None
    fix: Callable[[], Fix | None] | None

    @property
    def faults(self) -> list[str]: ...
    def inspect(self) -> None: ...
    def rest(self) -> Groups: ...
    def groups(self, command: Any) -> Groups: ...
    def measurement(
        self, now: float, at: float, sample: JointSample, imu: Inertial | None, origin: float = 0.0
    ) -> Any: ...
    def stand(self, measurement: Any) -> None: ...
    def snapshot(self) -> tuple[float, Array] | None: ...
    def begin(self, x: Array) -> None: ...
    def references(self, task: Task, x: Array) -> dict[str, Reference]: ...
    def follow(self, references: dict[str, Reference]) -> None: ...
    def swing(self, legs: Array) -> None: ...
    def push(self, wrench: Array) -> None: ...
    def relocate(self) -> None: ...
    def estimate(self) -> Estimate | None: ...


class Pending:
    """A guess for the MPC that first puts new references, weights and modes into force: in its own thread, between two solves."""

    def __init__(self, then: Callable[[Solver, float, Array], None] | None = None) -> None:
        self._then = then
        self._references: dict[str, Reference] | None = None
        self._schedule: ModeSchedule | None = None
        self._once: Callable[[Solver, Array], None] | None = None
        self._weights: Weights = {}
        self._lock = threading.Lock()

    def set(self, references: dict[str, Reference]) -> None:
        """In force from the next solve on."""
        with self._lock:
            self._references = references

    def schedule(self, schedule: ModeSchedule) -> None:
        """In force from the next solve on."""
        with self._lock:
            self._schedule = schedule

    def reweigh(self, weights: Weights) -> None:
        """In force from the next solve on."""
        with self._lock:
            self._weights = {**self._weights, **weights}

    def guess(self, once: Callable[[Solver, Array], None]) -> None:
        """Rewrites the trajectories before the next solve, in place of the usual guess."""
        with self._lock:
            self._once = once

    def __call__(self, solver: Solver, t: float, x0: Array) -> None:
        with self._lock:
            references, self._references = self._references, None
            schedule, self._schedule = self._schedule, None
            once, self._once = self._once, None
            weights, self._weights = self._weights, {}
        for name, reference in (references or {}).items():
            solver.set_reference(name, reference)
        for (name, place), weight in weights.items():
            solver.set_weight(name, weight, place)
        if schedule is not None:
            solver.set_schedule(schedule)
        if once is not None:
            once(solver, x0)
        elif self._then is not None:
            self._then(solver, t, x0)
