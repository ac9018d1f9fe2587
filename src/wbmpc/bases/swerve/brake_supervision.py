"""Brakes of hinged legs while a robot drives: commanded, closed where a leg goes astray, and watched for those that do not answer."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_monitor import BrakeFault, BrakeMonitor
from wbmpc.bases.swerve.leg_guard import LegGuard
from wbmpc.model.robot import RobotModel

_LOG = logging.getLogger("wbmpc")
#: Brakes are checked about every so often [s]: legs do not move far meanwhile, and a check takes nearly as long as the rest of
#: a command.
POLL_PERIOD = 0.01
#: What the monitor of brakes sees: time [s], measured legs (n) [rad], brakes (n, 1 = open), planned rates (n) [rad/s].
Tick = tuple[float, Array, Array, Array]
#: Brakes (n, 1 = open) at a time [s].
Brakes = Callable[[float], Array]


class WatchesBrakes(Protocol):
    """A :class:`BrakeMonitor`, or what stands for it."""

    @property
    def real(self) -> list[BrakeFault]: ...
    def update(self, t: float, leg: Array, brake: Array, rate: Array, /) -> list[BrakeFault]: ...
    def restart_clock(self) -> None: ...


@dataclass(frozen=True)
class SupervisionSettings:
    """``guard``: whether open legs that go astray are held (:class:`LegGuard`), for which a :class:`BrakeControl` is needed, since the
    planner has to know; ``monitor`` of brakes that do not answer (None: one with the usual tolerances); ``report`` is called with
    each fault that it finds; ``hold`` with the times until which legs are held, instead of the brakes' own control."""

    guard: bool = True
    monitor: WatchesBrakes | None = None
    report: Callable[[BrakeFault], None] | None = None
    hold: Callable[[Array], None] | None = None


def brake_monitor(robot: RobotModel) -> BrakeMonitor | None:
    """Of the brakes of a robot's legs, with the usual tolerances; None for fixed legs."""
    if "leg" not in robot.input:
        return None
    return BrakeMonitor(robot.state.groups["leg"], limit=robot.limits.input_upper[robot.input["leg"]])


class BrakeSupervision:
    """``brakes``: of the legs over time, or a function of time; None: closed. ``monitor`` is None for fixed legs; it looks every
    :data:`POLL_PERIOD`, and before a stop.

    ``commanded`` may be replaced, as by a view; then the guard, which could not informs the planner, rests.
    """

    def __init__(
        self, robot: RobotModel, period: float, brakes: BrakeControl | Brakes | None, settings: SupervisionSettings
    ) -> None:
        hinges = len(robot.state.groups.get("leg", ()))
        control = brakes if isinstance(brakes, BrakeControl) else None
        self._period, self.report = period, settings.report
        self._control = control
        self.guard = LegGuard(hinges) if settings.guard and control is not None else None
        self._hold = settings.hold or (None if control is None else control.hold)
        self.monitor: WatchesBrakes | None = settings.monitor or brake_monitor(robot)
        self.commanded: Brakes
        if isinstance(brakes, BrakeControl):
            self.commanded = brakes.commanded
        else:
            self.commanded = brakes or (lambda t: np.zeros(hinges))
        self._own = self.commanded
        self._watched: Tick | None = None  # the newest tick since the last stop
        self._checked_at = -np.inf  # when the monitor looked last

    @property
    def faults(self) -> list[str]:
        """Messages of brakes that were found not to answer; those that did after all are left out."""
        return [] if self.monitor is None else [str(fault) for fault in self.monitor.real]

    @property
    def holds(self) -> int:
        """How often the guard has held a leg."""
        return 0 if self.guard is None else int(self.guard.holds.sum())

    def _guarded(self) -> LegGuard | None:
        """The guard, while it acts."""
        return self.guard if self.commanded is self._own else None

    def open(self, t: float) -> Array:
        """Brakes (n, 1 = open) at t [s]: as commanded, closed where the guard holds a leg."""
        brake, guard = self.commanded(t), self._guarded()
        return brake if guard is None else np.where(guard.held(t), 0.0, brake)

    def guard_legs(self, t: float, leg: Array, rate: Array) -> None:
        """Hold open legs that go astray from what drives have made of the commands, and informs the planner: measured angles ``leg``
        (n) [rad], ``rate`` (n) [rad/s]."""
        guard = self._guarded()
        if guard is not None and guard.update(t, leg, rate, self.commanded(t)):
            self._notify_planner(guard)

    def await_legs(self, t: float, leg: Array) -> None:
        """Brakes that are about to close wait for their legs (:meth:`BrakeControl.await_legs`), which are at ``leg`` (n) [rad]."""
        if self._control is not None and self.commanded is self._own:
            self._control.await_legs(t, leg)

    def _notify_planner(self, guard: LegGuard) -> None:
        """Inform the planner until when each leg is held."""
        assert self._hold is not None
        self._hold(guard.until)

    def watch(self, t: float, leg: Array, brake: Array, rate: Array) -> None:
        """A tick at t [s] of measured legs (n) [rad]: commanded ``brake`` (n, 1 = open), planned leg rates ``rate`` (n) [rad/s].

        Brakes are judged if the last check is :data:`POLL_PERIOD` ago (within half a period). Times may restart.
        """
        if self.monitor is None or not all(map(math.isfinite, rate.tolist())):
            return  # a command that is not finite is rejected, by the name of its drives, before it goes to them
        self._watched = t, leg, brake, rate
        if t < self._checked_at - self._period:  # the clock of a new run; by less: the check before a stop was ahead
            self.monitor.restart_clock()
            self._checked_at = -np.inf
        if t - self._checked_at >= max(POLL_PERIOD - 0.5 * self._period, 0.0):
            self._check(self._watched)

    def stop(self, leg: Array | None) -> None:
        """All brakes close: judged is what legs (n) [rad], measured last, have done until now; the guard restarts."""
        self._check_before_stop(leg)
        guard = self._guarded()
        if guard is None:
            return
        held = np.isfinite(guard.until).any()
        guard.restart()
        if held:
            self._notify_planner(guard)

    def _check_before_stop(self, leg: Array | None) -> None:
        """A stop ends the plan: what legs have done until now is judged by the commands until now."""
        watched, self._watched = self._watched, None
        if watched is None or leg is None:
            return
        t, previous, brake, rate = watched
        if leg.shape != previous.shape or not np.isfinite(leg).all():
            return  # the odometry has rejected this message, and the robot stops for it
        if brake.any() or rate.any():  # else the stop changes nothing for them
            self._check((max(t + self._period, self._checked_at), leg, brake, rate))

    def _check(self, tick: Tick) -> None:
        """Judge the brakes by a tick, and report what is found."""
        assert self.monitor is not None
        self._checked_at = tick[0]
        for fault in self.monitor.update(*tick):
            self.note(fault)
            if self.report is not None:
                self.report(fault)

    def note(self, fault: BrakeFault) -> None:
        """A fault that was found, into the log: a brake that does not hold is no use to the guard."""
        _LOG.log(logging.INFO if fault.withdraws else logging.WARNING, "%s", fault)
        if self.guard is not None and fault.kind == "does not hold":
            self.guard.give_up(fault.leg)
