"""What a user of the view may do to a run: goals, pushes, brakes, weights."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.control.protocols import RobotController
from wbmpc.errors import InputError
from wbmpc.logs import RateLimit
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.shapes import Box
from wbmpc.ocp import Cost, Reference
from wbmpc.simulation.lockstep import Running
from wbmpc.view import bounds
from wbmpc.view.braked_joints import BrakedJoints

_LOG = logging.getLogger(__name__)
#: How many places there are for weights in the commands.
MAX_WEIGHTS = 16
#: Name of the user's box among the obstacles.
OBSTACLE = "box of the view"

#: Shapes of what the panel sends. Names in the plural count how often something was asked for. ``weights``: factors.
#: ``obstacle``: pose (7) of a cube above the floor, and its edge [m]; 0: there is none.
REQUESTS: dict[str, tuple[int, ...]] = {
    "goals": (), "goal": (7,), "base_goals": (), "base_goal": (3,),
    "pushes": (), "push": (3,), "push_time": (),
    "obstacles": (), "obstacle": (8,),
    "configurations": (), "configuration": (), "brake_clicks": (), "brakes_open": (),
    "weights": (MAX_WEIGHTS,),
    "paused": (), "steps": (), "speed": (), "resets": (), "ends": (),
}  # fmt: skip


def no_requests() -> dict[str, Array]:
    """Nothing is asked for; real time."""
    return {
        name: np.ones(shape) if name in ("weights", "speed") else np.zeros(shape) for name, shape in REQUESTS.items()
    }


@dataclass(frozen=True)
class Controls:
    """What there is to control: a title, names of weights, whether there are joints with brakes, a base goal; ``groups`` of drives whose shares of
    their limits are plotted (:data:`~wbmpc.view.actuator_load.SHARES`); ``paced``: whether time can be
    held, ``pushes``: whether a user can push, ``obstacle``: whether plans keep clear of a box that a user places; names of the
    ``configurations`` of those joints."""

    title: str
    weights: tuple[str, ...]
    brakes: bool
    base: bool
    groups: tuple[str, ...] = ()
    paced: bool = True
    pushes: bool = True
    obstacle: bool = False
    configurations: tuple[str, ...] = ()


class UserCommands:
    """Applies commands to one run, in the run's own thread. Poses come in ``map``; ``drift`` (7) places ``odom`` in it.

    What cannot be done, or is outside of :mod:`wbmpc.view.bounds`, is left out: ``reject(reason)`` is called.
    """

    def __init__(self, running: Running, lift: Array, reject: Callable[[str], None] = lambda reason: None) -> None:
        self.running, self.mpc, self._lift, self._reject = running, running.mpc, lift, reject
        self._done = {name: 0 for name in REQUESTS if name.endswith("s") and name != "weights"}
        self._limit = RateLimit(1, 5.0)
        self._weights = self._seen_weights = np.ones(MAX_WEIGHTS)
        self._push_ends: float | None = None
        #: Whether anything was done.
        self.used = False
        self._obstacle = np.zeros(8)
        self.costs, self.braked = self.costs_of(self.mpc), BrakedJoints.of(running)

    @property
    def _controller(self) -> RobotController:
        assert self.running.controller is not None, "commands go to runs with a controller"
        return self.running.controller

    @property
    def _planner(self) -> MPC:
        assert self.mpc is not None, "commands to a plan go to runs with an MPC"
        return self.mpc

    @staticmethod
    def costs_of(mpc: MPC | None) -> list[Cost]:
        """The costs whose weights can be changed; none without an MPC."""
        if mpc is None:
            return []
        return [t for t in mpc.ocp.terms.values() if isinstance(t, Cost)][:MAX_WEIGHTS]

    @staticmethod
    def base_of(mpc: MPC | None) -> bool:
        """Whether the base has a goal: that of a robot that balances has none, it goes where its end effector needs it."""
        if mpc is None or "state" not in mpc.reference or "base" not in mpc.dynamics.state:
            return False
        part = mpc.dynamics.state["base"]
        return bool(part.stop - part.start == 3)

    def skip(self, requests: dict[str, Array]) -> None:
        """What was asked for before this run is not for it, but a box that stands there."""
        self._done = {name: int(requests[name]) for name in self._done}
        self._done["obstacles"] -= int(requests["obstacle"][7] > 0.0)

    def _asked(self, requests: dict[str, Array], name: str) -> bool:
        new = int(requests[name]) != self._done[name]
        self._done[name] = int(requests[name])
        self.used = self.used or new
        return new

    def apply(self, t: float, requests: dict[str, Array], drift: Array) -> None:
        """Do what is new at time t [s]."""
        if self._asked(requests, "goals"):
            self._try(lambda: self._end_effector_goal(t, self._near(requests["goal"], drift)))
        if self._asked(requests, "base_goals"):
            self._try(lambda: self._base_goal(t, self._near_planar(requests["base_goal"], drift)))
        if self._asked(requests, "obstacles"):
            self._try(lambda: self._put_obstacle(requests["obstacle"], drift))
        if self._asked(requests, "pushes"):
            self._try(lambda: self._push(t, *bounds.push(requests["push"], requests["push_time"])))
        if self._push_ends is not None and t >= self._push_ends:
            self._push_ends = None
            self.running.plant.push(np.zeros(3))
        if (braked := self.braked) is not None:
            if self._asked(requests, "configurations"):
                self._try(lambda: braked.configure(requests["configuration"]))
            if self._asked(requests, "brake_clicks"):
                self._try(lambda: braked.click(bool(bounds.choice("brakes", requests["brakes_open"], 2))))
            braked.update()
        if not np.array_equal(requests["weights"], self._seen_weights, equal_nan=True):
            self.used, self._seen_weights = True, requests["weights"].copy()
            self._try(lambda: self._set_weights(bounds.factors(requests["weights"])))

    def _try(self, act: Callable[[], None]) -> None:
        """Do something, or say why not."""
        try:
            act()
        except InputError as error:
            left_out = self._limit.left_out(str(error).partition(":")[0])
            if left_out is not None:
                _LOG.warning("view: %s%s", error, f" ({left_out} more like this)" if left_out else "")
            self._reject(str(error))

    def _near(self, goal: Array, drift: Array) -> Array:
        """A goal of the end effector in the estimate's frame, checked before and after."""
        checked = bounds.pose(goal, lie.pose_compose(drift, spatial(self._here()))[:2])
        return lie.pose_between(drift, checked)

    def _near_planar(self, goal: Array, drift: Array) -> Array:
        """As :meth:`_near`, of the base: by the shorter turn from where it is, however often it has turned."""
        checked = bounds.planar(goal, lie.pose_compose(drift, spatial(self._here()))[:2])
        found = planar(lie.pose_between(drift, spatial(checked)))
        if self.base_of(self.mpc):
            yaw = self._controller.state()[self._planner.dynamics.state["base"]][2]
            found[2] = yaw + lie.wrapped(found[2] - yaw)
        return found

    def _put_obstacle(self, box: Array, drift: Array) -> None:
        """Put, move or take away the user's cube."""
        world = None if self.mpc is None else self.mpc.obstacles
        if world is None:
            return
        pose, edge = bounds.box(box, lie.pose_compose(drift, spatial(self._here()))[:2])
        if edge > 0.0:
            pose = lie.pose_between(drift, pose)
            half = np.full(3, 0.5 * edge)
            world.set(OBSTACLE, Box(half), position=pose[:3] - self._lift, orientation=pose[3:])
        elif OBSTACLE in world:
            world.remove(OBSTACLE)
        self._obstacle = np.append(pose, edge)

    def obstacle(self, drift: Array) -> Array:
        """The user's cube as plans keep clear of it: pose above the floor in ``map`` and edge [m], 0 where there is none (8)."""
        if self._obstacle[7] == 0.0:
            return np.zeros(8)
        return np.append(lie.pose_compose(drift, self._obstacle[:7]), self._obstacle[7])

    def _here(self) -> Array:
        """Where the base is estimated to be (x, y, 0) [m]; a base that does not move is at the origin."""
        if self.mpc is None or "base" not in self.mpc.dynamics.state:
            return np.zeros(3)
        place = self._controller.state()[self.mpc.dynamics.state["base"]][:2]
        return np.array([*place, 0.0])

    def _push(self, t: float, force: Array, seconds: float) -> None:
        self._push_ends = t + seconds
        self.running.plant.push(force)

    # ------------------------------------------------------------------ goals
    def _end_effector_goal(self, t: float, goal: Array) -> None:
        """The end effector's goal from now on; the base goes to where the end effector is beside it as at home."""
        if self.mpc is None or "end_effector" not in self.mpc.reference:
            return
        goal = np.concatenate([goal[:3] - self._lift, goal[3:]])
        self.mpc.reference["end_effector"] = Reference(np.zeros(1), goal[None], "pose_hold")
        robot = self._controller.robot
        if self.base_of(self.mpc):
            yaw = self._target(t)[2]
            beside = robot.pose(robot.home)[0][:2] - robot.home[robot.state["base"]][:2]
            c, s = np.cos(yaw), np.sin(yaw)
            self._base_goal(
                t, np.array([*(goal[:2] - [c * beside[0] - s * beside[1], s * beside[0] + c * beside[1]]), yaw])
            )

    def _target(self, t: float) -> Array:
        """The reference (nx) of the state at time t [s]: one that moves has left its start."""
        value: Array = self._planner.reference["state"].at(t)
        return value

    def _base_goal(self, t: float, pose: Array) -> None:
        """The base's goal (x, y, yaw) from now on, at rest. Where there is none, nothing."""
        if not self.base_of(self.mpc):
            return
        target = self._target(t)
        target[self._planner.dynamics.state["base"]] = pose
        self._hold(target)

    def _hold(self, target: Array) -> None:
        self._planner.reference["state"] = Reference.constant(target)
        if "input" in self._planner.reference:
            self._planner.reference["input"] = Reference.constant(np.zeros(self._planner.dynamics.input.size))

    def brakes_open(self, t: float) -> float:
        """Whether all brakes are commanded to be open at time t [s] (1 or 0); nan without brakes."""
        return np.nan if self.braked is None else float(self.braked.are_open(t))

    # ------------------------------------------------------------------ weights
    @property
    def factors(self) -> dict[str, float]:
        """Of weights that are not as the problem has them, by cost."""
        pairs = zip(self.costs, self._weights, strict=False)
        return {cost.name: float(factor) for cost, factor in pairs if factor != 1.0}

    def _set_weights(self, factors: Array) -> None:
        for cost, factor, old in zip(self.costs, factors, self._weights, strict=False):
            if factor == old:
                continue
            weight = cost.expand(cost.weight)
            end = weight if cost.terminal_weight is None else cost.expand(cost.terminal_weight)
            for place, value in (("path", weight), ("terminal", end)):
                if cost.at in (place, "path+terminal"):
                    self._planner.solver.set_weight(cost.name, list(factor * value), place)  # type: ignore[arg-type]
        self._weights = factors.copy()


def planar(pose: Array) -> Array:
    """(x, y, yaw) of a pose (7)."""
    yaw = lie.rotation_to_euler_zyx(lie.quaternion_to_rotation(pose[3:]))[0]
    return np.array([pose[0], pose[1], yaw])


def spatial(pose: Array) -> Array:
    """The pose (7) on the floor of (x, y, yaw)."""
    return np.array([pose[0], pose[1], 0.0, *lie.quaternion_about((0.0, 0.0, 1.0), float(pose[2]))])
