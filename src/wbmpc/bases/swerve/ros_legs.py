"""Legs and brakes from the bus: a service and topics that say where legs are to go and which brakes are to open.

A leg that is sent somewhere has its brake opened; when it has arrived the brake closes. The service has a type of its own,
``wbmpc_msgs/srv/SetLegs``; the topics have standard types, for peers that know no such service.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.bases.swerve.brake_control import BrakeControl, reject_floating, reject_floating_way
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.ros_settings import SwerveRosSettings
from wbmpc.errors import InputError, unknown_name
from wbmpc.logs import RateLimit
from wbmpc.model.robot import RobotModel
from wbmpc.ros2.bus import DEFAULT, SMALL, Node
from wbmpc.ros2.convert import error_message
from wbmpc.stability import configuration_positions

_LOG = logging.getLogger("wbmpc")
#: The service, of the package that docs/how-to/ros2.md shows: its type, its request and its answer.
SET_LEGS = "wbmpc_msgs/srv/SetLegs"
DEFINITION = (
    "string configuration\nstring[] leg\nfloat64[] angle\nbool[] brake_open\n",
    "bool success\nstring message\n",
)
#: Brakes (n, 1 = open) and legs (n) [rad].
Now = tuple[Array, Array]
#: A leg is where it should be within this [rad].
THERE = 0.01
#: A leg on its way is to go to so much [rad] beyond where it should be, and its brake ends it there. Of the last 0.03 rad alone a
#: plan would make nothing where wheels do not point along the leg's circle: to turn them costs more than those are worth.
BEYOND = 0.08
#: A leg that comes no nearer by this [rad] within so long [s] will not arrive: wheels turn first for a second or two, and a guard
#: may hold it now and then.
NEARER, PATIENCE = 0.002, 4.0


class Legs:
    """``angles`` (n) [rad]: where legs are to go, None before the first command; ``moving`` (n): which are on their way;
    ``rejected``: why the last bad order was not taken, empty when one has been taken since; ``short``: which legs have ended on
    their way, empty from the next order on.

    ``ready()``: why no order can be taken; ``now()``: how brakes and legs are. :meth:`apply` and :meth:`watch` belong to the
    node's own thread.
    """

    def __init__(
        self, node: Node, robot: RobotModel, settings: SwerveRosSettings, ready: Callable[[], str],
        now: Callable[[], Now | None],
    ) -> None:  # fmt: skip
        self.robot, self.settings, self._ready, self._now = robot, settings, ready, now
        self.names, self._units = robot.state.groups["leg"], robot.state.unit_groups["leg"]
        self.angles: Array | None = None
        self.moving = np.zeros(len(self.names), dtype=bool)
        self.rejected = self.short = ""
        self._limit = RateLimit()
        self._nearest, self._since = np.zeros(
            (2, len(self.names))
        )  # of legs on their way: distance [rad], since when [s]
        self._side = np.zeros(len(self.names))  # from which side legs come: the sign of their ways
        self._command: tuple[Array, Array] | None = None
        self._lock = threading.Lock()
        topics = settings.topics
        takes: dict[str, Callable[[Any], str]] = {
            "legs": lambda m: self._target("", list(m.name), m.position, ()),
            "brakes": lambda m: self._brakes(m.data),
            "leg_configuration": lambda m: self._target(m.data, [], (), ()),
        }
        for key, take in takes.items():
            if topic := getattr(topics, key):
                node.subscribe(
                    topic, topics.requests[key], partial(self._from_topic, topic, take), DEFAULT, deferred=True,
                    largest=SMALL,
                )  # fmt: skip
        if topics.set_legs:
            try:
                node.serve(topics.set_legs, SET_LEGS, self._asked, rejected=_failed, definition=DEFINITION)
            except (ImportError, AttributeError, ValueError, InputError) as error:
                _LOG.warning("%s is not served (%s); the topics are there", topics.set_legs, error)

    # ------------------------------------------------------------------ from the bus
    def _asked(self, request: Any) -> Mapping[str, Any]:
        why = self._ready()
        try:
            if why:
                raise InputError(why)
            message = self._target(str(request.configuration), list(request.leg), request.angle, request.brake_open)
        except Exception as error:
            self.reject(f"{self.settings.topics.set_legs}: {error_message(error)}")
            return _failed(error_message(error))
        return {"success": True, "message": message}

    def _from_topic(self, topic: str, take: Callable[[Any], str], message: Any) -> None:
        try:
            if why := self._ready():
                raise InputError(why)
            take(message)
        except Exception as error:
            self.reject(f"{topic}: {error_message(error)}")

    def reject(self, message: str) -> None:
        """Say once why an order is not taken."""
        if message != self.rejected:
            self._limit.log(_LOG, logging.WARNING, message.split(":")[0], message)
        self.rejected = message

    def _target(self, configuration: str, legs: list[str], angles: Any, opened: Any) -> str:
        """A configuration by name or angles, or single legs: ``angles``, brakes; what will be done."""
        n = len(self.names)
        goal, brake = np.full(n, np.nan), np.full(n, np.nan)
        if configuration:
            if legs:
                raise InputError("legs: either a configuration or single legs are needed, not both")
            goal[:] = configuration_positions(self.robot, configuration)
        else:
            places = [self._place(name) for name in legs]
            angle, open_ = np.asarray(angles, float), np.asarray(opened, float)
            if (
                not legs
                or len(set(places)) < len(places)
                or angle.size not in (0, len(legs))
                or open_.size not in (0, len(legs))
            ):
                raise InputError("legs: a configuration, or different legs with as many angles or brakes, are needed")
            if not np.isfinite(angle).all():
                raise InputError("legs: an angle is not a finite number")
            if angle.size:
                goal[places] = angle
            if open_.size:
                brake[places] = open_
        self._check(goal)
        self._put(goal, brake)
        going = ", ".join(
            f"{m} to {a:.3f} {u}" for m, a, u in zip(self.names, goal, self._units, strict=True) if a == a
        )
        opens = ", ".join(f"{m} {'opens' if b else 'closes'}" for m, b in zip(self.names, brake, strict=True) if b == b)
        return "; ".join(part for part in (going, opens) if part) or "nothing to do"

    def _brakes(self, values: Any) -> str:
        brake = np.asarray(values, float)
        if brake.shape != (len(self.names),) or not np.isin(brake, (0.0, 1.0)).all():
            raise InputError(f"brakes: {len(self.names)} numbers, 0 (closed) or 1 (open), are needed, got {brake}")
        self._put(np.full(brake.size, np.nan), brake)
        return ""

    def _place(self, name: str) -> int:
        on_bus = [self.settings.bus_name(n) for n in self.names]
        if name in on_bus:
            return on_bus.index(name)
        raise unknown_name("leg", name, on_bus)

    def _check(self, goal: Array) -> None:
        part, limits = self.robot.state["leg"], self.robot.limits
        for name, angle, unit, low, high in zip(
            self.names, goal, self._units, limits.state_lower[part], limits.state_upper[part], strict=True
        ):
            if np.isinf(angle) or angle < low or angle > high:
                raise InputError(f"legs: {name} at {angle:g} {unit} is outside its limits {low:g} to {high:g}")

    def _put(self, goal: Array, brake: Array) -> None:
        with self._lock:
            if self._command is not None:  # what has not been taken yet is completed
                goal = np.where(np.isnan(goal), self._command[0], goal)
                brake = np.where(np.isnan(brake), self._command[1], brake)
            if (now := self._now()) is not None:
                self._reject(goal, *self._outcome(goal, brake, now[0]), now[1])
            self._command = goal, brake
        self.rejected = ""

    def _reject(self, goal: Array, moving: Array, state: Array, leg: Array) -> None:
        """Raise :class:`InputError` where open legs would hold the base against nothing, at rest or for long on the way."""
        geometry = swerve_base(self.robot).geometry
        if not moving.any():
            reject_floating(geometry, leg, state)
            return
        previous = leg if self.angles is None else self.angles
        there = np.where(moving, np.where(np.isnan(goal), previous, goal), leg)
        reject_floating_way(geometry, leg, there, state, self.robot.limits.input_upper[self.robot.input["leg"]])

    def _outcome(self, goal: Array, brake: Array, commanded: Array) -> tuple[Array, Array]:
        """Which legs an order sets or keeps in motion, and the brakes (n, 1 = open) then."""
        moving = (self.moving | ~np.isnan(goal)) & (brake != 0.0)
        return moving, np.where(np.isnan(brake), np.where(moving, 1.0, commanded), brake)

    # ------------------------------------------------------------------ in the node's thread
    @property
    def aims(self) -> Array | None:
        """Where (n) [rad] the plan is to take the legs: of those on their way, :data:`BEYOND` where they are to go."""
        return None if self.angles is None else self.angles + BEYOND * self.moving * self._side

    @property
    def waiting(self) -> bool:
        """Whether there is an order that has not been taken."""
        return self._command is not None

    def drop(self) -> None:
        """Forget an order that has not been taken."""
        with self._lock:
            self._command = None

    def apply(self, brakes: BrakeControl, t: float, leg: Array) -> bool:
        """Carry out an order at time t [s], legs being at ``leg`` (n) [rad]; whether there was one."""
        with self._lock:
            command, self._command = self._command, None
        if command is None:
            return False
        goal, brake = command
        sent = ~np.isnan(goal)
        previous, were = self.angles, self.moving
        self.angles = np.where(sent, goal, leg if self.angles is None else self.angles)
        self.moving, state = self._outcome(goal, brake, brakes.commanded(t))
        # the same order once more, or one for other legs, gives a leg that comes no nearer no more time
        new = ~were if previous is None else ~were | (self.angles != previous)
        brakes.reset(t)
        try:
            brakes.set(t, state, None if self.moving.any() else leg)
        except InputError as error:
            self.reject(f"a command for the legs is rejected: {error}")
            self.angles, self.moving = previous, were
            return False
        self._nearest[new], self._since[new], self.short = np.inf, t, ""
        # a leg that is let go, or held where it is, goes nowhere
        stays = ~(self.moving | np.isnan(brake))
        self.angles = np.where(stays, leg, self.angles)
        self._side = np.sign(self.angles - leg)
        return True

    def watch(self, brakes: BrakeControl, t: float, leg: Array) -> bool:
        """Close the brakes of legs that have arrived, and of those that come no nearer, which stay where they are; whether there
        were some: :attr:`aims` has changed."""
        if self.angles is None or not self.moving.any():
            return False
        there = self.moving & (self._side * (self.angles - leg) < THERE)
        if there.any():
            self._close(brakes, t, there)
            _LOG.info("%s arrived: brakes closed", self._named(there))
        stuck = self._stuck(t, leg)
        if not stuck.any():
            return bool(there.any())
        self._close(brakes, t, stuck)
        places = zip(self.names, self._units, leg, self.angles, stuck, strict=True)
        message = [f"{n} stopped at {a:.3f} {u} on its way to {to:.3f} {u}" for n, u, a, to, ended in places if ended]
        self.short = f"{', '.join(message)}: no nearer for {PATIENCE:g} s, brakes closed"
        _LOG.warning("%s", self.short)
        self.angles = np.where(stuck, leg, self.angles)
        return True

    def _stuck(self, t: float, leg: Array) -> NDArray[np.bool_]:
        """Legs (n) on their way that come no nearer, also those whose brakes seem not to open: plans hold these, and an open brake that
        does answer would not."""
        assert self.angles is not None
        away = np.abs(leg - self.angles)
        goes_on = ~self.moving | (away < self._nearest - NEARER) | (t < self._since)
        self._nearest = np.where(goes_on, away, self._nearest)
        self._since = np.where(goes_on, t, self._since)
        return np.asarray(t - self._since > PATIENCE)

    def _close(self, brakes: BrakeControl, t: float, which: NDArray[np.bool_]) -> None:
        brake = brakes.commanded(t).copy()
        brake[which] = 0.0
        brakes.reset(t)
        brakes.set(t, brake)
        self.moving &= ~which

    def _named(self, which: NDArray[np.bool_]) -> str:
        return ", ".join(n for n, chosen in zip(self.names, which, strict=True) if chosen)

    def stop(self) -> None:
        """The robot has stopped: brakes are closed, no leg is on the way."""
        self.moving[:] = False
        self.angles = None


def _failed(reason: str) -> dict[str, Any]:
    """The answer to an order that is not taken."""
    return {"success": False, "message": reason}
