"""What depends on the kind of base: problem, estimator, controller, references, commands. The node does the rest for all."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from wbmpc.arrays import Array
from wbmpc.control.protocols import RobotController
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.guess import Bound, Guess
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.world import Obstacles
from wbmpc.ocp import ModeSchedule, OptimalControlProblem, Reference
from wbmpc.ocp.terms import Weight
from wbmpc.ros2.convert import upright
from wbmpc.ros2.goals import Planner, Task
from wbmpc.ros2.joints import Inertial, JointSample
from wbmpc.ros2.settings import RosSettings
from wbmpc.solver import Trajectory

if TYPE_CHECKING:
    from wbmpc.ros2.control import ControlNode

#: Weights of costs, by name and place (path or terminal).
Weights = dict[tuple[str, Literal["path", "terminal"]], Weight]
Groups = dict[str, Array]
#: Another localization's pose: time [s] of the runner's clock, (x, y, yaw), covariance (3, 3) (zero: exact).
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


class BaseCommands:
    """What a base takes from the bus beside goals, on topics and services of its own (its settings' ``topics``); here nothing."""

    def update(self) -> None:
        """In the node's own thread, at every step: carry out what has come."""

    def stop(self, had_task: bool) -> None:
        """The robot has stopped, with a task or without."""

    def rejections(self) -> dict[str, str]:
        """What was rejected, and why, by what it was; empty texts where nothing was."""
        return {}

    def counts(self) -> dict[str, Any]:
        """Values of a run by name, for diagnostics."""
        return {}


class BaseAdapter(Protocol):
    """``must_keep_running``: the robot falls when it is stopped, so that it is kept on its last policy as long as there are states.

    ``faults``: what was found in this run of what it ``watches`` (sensors, brakes), as messages; ``inspect``, called in the
    node's own thread now and then, looks for those that would take too long in a tick. ``fall``: message that the robot at x (nx) has
    fallen, which begins with :data:`wbmpc.ros2.health.FELL`; empty if it has not.
    ``parameters``: see :class:`wbmpc.runtime.runner.RealTimeRunner`; ``fix``: asked for another localization's pose at every tick;
    after ``relocate`` the next one says where the robot is, whatever was known before. ``origin``: when [s] the runner's clock was 0,
    on the one behind it, which goes on from run to run. ``begin`` makes a new controller and MPC for a run
    from state x (nx) on. ``problem``: the controller's with another ``cost``, for its weights. ``base_commands``: what the base takes
    from the bus of the node ``control`` beside goals.
    ``obstacles``: what the MPC keeps clear of (:func:`obstacles_of` the settings); None: of nothing.
    ``references`` of a task that begins at x may take long, and are made in another thread.

    An adapter derives from it: what has a body here is that of a base without commands of its own and localization.
    """

    robot: RobotModel
    settings: RosSettings
    planner: Planner
    mpc: MPC
    obstacles: Obstacles | None
    pending: PendingChanges
    controller: RobotController
    watches: str
    must_keep_running: bool = False
    needs_imu: bool = False
    parameters: Callable[[], Array] | None = None
    fix: Callable[[], Fix | None] | None = None
    origin: Callable[[], float] | None = None

    @property
    def faults(self) -> list[str]:
        return list(map(str, self.controller.faults))

    def fall(self, x: Array) -> str:  # what need not be kept running does not fall
        return ""

    def inspect(self) -> None:
        return None

    def problem(self, cost: Any) -> OptimalControlProblem: ...
    def base_commands(self, control: ControlNode) -> BaseCommands:
        return BaseCommands()

    def rest(self) -> Groups: ...
    def groups(self, command: Any) -> Groups: ...
    def measurement(
        self, now: float, at: float, sample: JointSample, imu: Inertial | None, origin: float = 0.0
    ) -> Any: ...
    def stand(self, measurement: Any) -> None: ...
    def snapshot(self) -> tuple[float, Array] | None: ...
    def on_runners_clock(self, time: float) -> float:
        """A time [s] of the clock behind the runner's, which may be of before the run began."""
        return time - (0.0 if self.origin is None else self.origin())

    def begin(self, x: Array) -> None: ...
    def references(self, task: Task, x: Array) -> dict[str, Reference]: ...
    def estimate(self) -> Estimate | None: ...
    def follow(self, references: dict[str, Reference]) -> None:
        self.pending.set(references)

    def push(self, wrench: Array) -> None:  # drives that follow speeds cannot exert one
        return None

    def relocate(self) -> None:
        return None


#: Variance of what a planar odometry says nothing about.
_UNKNOWN = 1e6


def spatial_covariance(planar: Array) -> Array:
    """A covariance (3, 3) of x, y and yaw in six dimensions."""
    out = np.diag([0.0, 0.0, _UNKNOWN, _UNKNOWN, _UNKNOWN, 0.0])
    out[np.ix_([0, 1, 5], [0, 1, 5])] = planar
    return out


def planar_estimate(pose: Array, twist: Array, height: float, covariance: Array, twist_covariance: Array) -> Estimate:
    """Of a base at ``pose`` (x, y, yaw) with ``twist`` (vx, vy, ω) in its axes, both with covariances (3, 3), at a ``height`` [m]; the rest
    is unknown."""
    position, orientation = upright(pose, height)
    spatial = np.array([twist[0], twist[1], 0.0, 0.0, 0.0, twist[2]])
    return Estimate(
        position, orientation, spatial, spatial_covariance(covariance), spatial_covariance(twist_covariance)
    )


def obstacles_of(settings: RosSettings) -> Obstacles | None:
    """Room for obstacles where topics bring them."""
    return Obstacles() if settings.sees_obstacles else None


class PendingChanges:
    """A guess for the MPC that first applies new references, weights and modes: in its own thread, between two solves."""

    def __init__(self, then: Guess | None = None) -> None:
        self._then = then
        self._mpc: MPC | None = None
        self._references: dict[str, Reference] | None = None
        self._schedule: ModeSchedule | None = None
        self._once: Callable[[Array, Trajectory], Trajectory] | None = None
        self._weights: Weights = {}
        self._lock = threading.Lock()

    def bind(self, mpc: MPC) -> None:
        """Whose references and modes these are."""
        self._mpc = mpc
        if isinstance(self._then, Bound):
            self._then.bind(mpc)

    def set(self, references: dict[str, Reference]) -> None:
        """Takes effect at the next solve."""
        with self._lock:
            self._references = references

    def schedule(self, schedule: ModeSchedule) -> None:
        """Takes effect at the next solve."""
        with self._lock:
            self._schedule = schedule

    def reweigh(self, weights: Weights) -> None:
        """Takes effect at the next solve."""
        with self._lock:
            self._weights = {**self._weights, **weights}

    def guess(self, once: Callable[[Array, Trajectory], Trajectory]) -> None:
        """The next solve starts from ``once(x0, last plan)``, in place of the usual guess."""
        with self._lock:
            self._once = once

    def __call__(self, t: float, x0: Array, trajectory: Trajectory) -> Trajectory | None:
        with self._lock:
            references, self._references = self._references, None
            schedule, self._schedule = self._schedule, None
            once, self._once = self._once, None
            weights, self._weights = self._weights, {}
        assert self._mpc is not None, "the guess of an MPC"
        for name, reference in (references or {}).items():
            self._mpc.reference[name] = reference
        for (name, place), weight in weights.items():
            self._mpc.solver.set_weight(name, weight, place)
        if schedule is not None:
            self._mpc.solver.set_schedule(schedule)
        if once is not None:
            return once(x0, trajectory)
        return None if self._then is None else self._then(t, x0, trajectory)
