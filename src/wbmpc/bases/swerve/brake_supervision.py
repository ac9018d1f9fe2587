"""Brakes of hinged legs while a robot drives: commanded, closed where a leg goes astray, and watched for those that do not answer.

Open legs that go astray are held by their brakes: hinges have no motors, so nothing else can.

A wheel that hangs in the air does not move its leg; on a slope the leg swings downhill. Nor do wheels on the ground where open legs
hardly hold the base (all parallel, as in H): base and legs move together, and no wheel sees it.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.arrays import Array
from wbmpc.bases.swerve.brake_control import BrakeControl
from wbmpc.bases.swerve.brake_monitor import BrakeFault, BrakeMonitor, SwerveReadings, per_radian
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.checks import finite, numbers
from wbmpc.control.monitor import Fault, Monitor
from wbmpc.model.robot import RobotModel


@dataclass(frozen=True)
class LegHold:
    """At ``time`` [s] it is decided to hold ``leg`` (index) until ``until`` [s], or that long no more: ``str()`` says it."""

    time: float
    leg: int
    until: float

    def __str__(self) -> str:
        return (
            f"leg {self.leg} deviates from its plan: its brake is closed until {self.until:.2f} s ({self.time:.2f} s)"
        )


#: By so much [rad] a leg must be farther from its plan than if it had stood; time constant [s] of both motions.
AWAY, WINDOW = 0.018, 0.2
#: A leg is held for so long [s], at most, and twice as long as last time if so soon [s] after it; time [s] between two that open.
HOLD, LONGEST, AGAIN, APART = 0.3, 0.6, 0.6, 0.2


class LegGuard:
    """Watches n open legs at a fixed period and says which are to be held, and until when.

    A leg is held once it would be nearer to its plan by :data:`AWAY` if it had stood: |moved − planned| − |planned| > AWAY,
    both summed with the time constant :data:`WINDOW`. So one that only lags behind its plan stays open: its brake would not help.
    It is held for :data:`HOLD`; if it goes astray again within :data:`AGAIN` of opening, for twice as long as the last time, up to
    :data:`LONGEST`. No two legs open within :data:`APART`: those that are held meanwhile hold the base.

    ``until`` (n) [s]: when each opens, or has opened (−inf: was never held); ``holds`` (n): how often each was held. ``units`` of the
    legs, as those of :class:`BrakeMonitor`.
    """

    def __init__(self, n: int, units: Sequence[str] = ()) -> None:
        self.holds = np.zeros(n, int)
        self._away = AWAY * per_radian(units or ["rad"] * n)
        self.restart()

    def restart(self) -> None:
        """No leg is held, times may restart. What was counted stays counted."""
        n = self.holds.size
        self.until, self._length = np.full(n, -np.inf), np.full(n, HOLD)
        self._moved, self._planned = np.zeros((2, n))
        self._held, self._useless = np.zeros((2, n), bool)
        self._last: Array | None = None
        self._freed = self.time = -np.inf

    def held(self, t: float) -> NDArray[np.bool_]:
        """Which legs (n) are to be held at t [s]."""
        return self.until > t + 1e-9

    def give_up(self, leg: int) -> None:
        """The brake of ``leg`` (index) does not hold: it is left alone until it is next commanded to be closed."""
        self._useless[leg], self._held[leg] = True, False

    def update(self, t: float, leg: ArrayLike, rate: ArrayLike, is_open: ArrayLike) -> list[LegHold]:
        """Legs whose ``until`` is another one after measured angles ``leg`` (n) [rad] at t [s], planned rates ``rate`` (n) [rad/s]
        since the last update; which brakes (n, 1 = open) are commanded to be open.

        Raises :class:`InputError` for what is not finite or of another length. Time that goes back restarts.
        """
        who, n = "leg guard", self.holds.size
        finite(who, time=t)
        angle, planned = numbers(who, "leg", leg, n), numbers(who, "rate", rate, n)
        commanded_open = numbers(who, "brake", is_open, n) > 0.5
        previous = self.until.copy()
        if t < self.time:
            self.restart()
        h, last = (t - self.time, self._last) if self._last is not None else (0.0, angle)
        self.time, self._last = t, angle
        self._end(t, commanded_open)
        free = commanded_open & ~self._held & ~self._useless
        kept = np.exp(-h / WINDOW)
        self._moved = np.where(free, kept * self._moved + (angle - last), 0.0)
        self._planned = np.where(free, kept * self._planned + h * planned, 0.0)
        astray = free & (np.abs(self._moved - self._planned) - np.abs(self._planned) > self._away)
        if astray.any():
            self._begin(t, astray)
        return [LegHold(t, int(i), float(self.until[i])) for i in np.flatnonzero(previous != self.until)]

    def _begin(self, t: float, astray: NDArray[np.bool_]) -> None:
        soon = t - self.until < AGAIN  # after its last hold
        longer = np.minimum(2.0 * self._length, LONGEST)
        self._length = np.where(astray, np.where(soon, longer, HOLD), self._length)
        self.until = np.where(astray, t + self._length, self.until)
        self._held |= astray
        self.holds += astray

    def _end(self, t: float, commanded_open: NDArray[np.bool_]) -> None:
        """Legs whose time is over open, one after the other; those whose brakes are commanded to be closed are not held besides."""
        closed = self._held & ~commanded_open
        self.until[closed], self._held[closed] = np.minimum(self.until[closed], t), False
        self._useless &= commanded_open
        for i in np.flatnonzero(self._held & ~self.held(t)):
            if t - self._freed < APART - 1e-9:
                self.until[i] = self._freed + APART
            else:
                self._held[i], self._freed = False, t


_LOG = logging.getLogger("wbmpc")
#: Brakes are checked about every so often [s]: legs do not move far meanwhile, and a check takes nearly as long as the rest of
#: a command.
POLL_PERIOD = 0.01
#: Brakes (n, 1 = open) at a time [s].
Brakes = Callable[[float], Array]


class WatchesBrakes(Protocol):
    """A :class:`BrakeMonitor`, or what stands for it."""

    @property
    def real(self) -> list[BrakeFault]: ...
    def update(self, readings: SwerveReadings, /) -> list[BrakeFault]: ...
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


def brake_monitor(robot: RobotModel, name: Callable[[str], str] = str) -> BrakeMonitor | None:
    """Of the brakes of a robot's legs, with the usual tolerances; None for fixed legs. ``name``: what faults call a leg's joint."""
    if "leg" not in robot.input:
        return None
    layout, limit = robot.state, robot.limits.input_upper[robot.input["leg"]]
    return BrakeMonitor([name(leg) for leg in layout.groups["leg"]], limit=limit, units=layout.unit_groups["leg"])


class BrakeSupervision:
    """``brakes``: of the legs over time, or a function of time; None: closed. ``monitor`` is None for fixed legs; it is the first
    of ``monitors``, which look every :data:`POLL_PERIOD`, and before a stop.
    """

    def __init__(
        self, robot: RobotModel, period: float, brakes: BrakeControl | Brakes | None, settings: SupervisionSettings
    ) -> None:
        self._hinges = len(robot.state.groups.get("leg", ()))
        self._units = robot.state.unit_groups.get("leg", ())
        self._period, self._settings, self.report = period, settings, settings.report
        self.monitor: WatchesBrakes | None = settings.monitor or brake_monitor(robot)
        self.monitors: list[Monitor[SwerveReadings]] = [] if self.monitor is None else [self.monitor]
        self._others: list[Fault] = []  # what they found beside brakes
        self.guard: LegGuard | None = None
        self._control: BrakeControl | None
        self._hold: Callable[[Array], None] | None
        self.follow(brakes)
        self._watched: SwerveReadings | None = None  # the newest tick since the last stop
        self._checked_at = -np.inf  # when the monitor looked last

    def follow(self, brakes: BrakeControl | Brakes | None) -> None:
        """Command ``brakes`` from now on. Only a :class:`BrakeControl` informs the planner, so the guard rests with any other."""
        self.commanded: Brakes
        if not isinstance(brakes, BrakeControl):
            self._control, self._hold = None, None
            self.commanded = brakes or (lambda t: np.zeros(self._hinges))
            return
        self._control, self._hold = brakes, self._settings.hold or brakes.hold
        self.commanded = brakes.commanded
        if self._settings.guard and self.guard is None:
            self.guard = LegGuard(self._hinges, self._units)

    @property
    def faults(self) -> list[Fault]:
        """Brakes that were found not to answer, without those that did after all; and what other monitors found."""
        return [*(() if self.monitor is None else self.monitor.real), *self._others]

    @property
    def holds(self) -> int:
        """How often the guard has held a leg."""
        return 0 if self.guard is None else int(self.guard.holds.sum())

    def _guarded(self) -> LegGuard | None:
        """The guard, while it acts."""
        return None if self._control is None else self.guard

    def open(self, t: float) -> Array:
        """Brakes (n, 1 = open) at t [s]: as commanded, closed where the guard holds a leg."""
        brake, guard = self.commanded(t), self._guarded()
        return brake if guard is None else np.where(guard.held(t), 0.0, brake)

    def guard_legs(self, t: float, leg: Array, rate: Array) -> None:
        """Hold open legs that go astray from what drives have made of the commands, and inform the planner: measured angles ``leg``
        (n) [rad], ``rate`` (n) [rad/s]."""
        guard = self._guarded()
        if guard is not None and guard.update(t, leg, rate, self.commanded(t)):
            self._notify_planner(guard)

    def await_legs(self, t: float, leg: Array) -> None:
        """Brakes that are about to close wait for their legs (:meth:`BrakeControl.await_legs`), which are at ``leg`` (n) [rad]."""
        if self._control is not None:
            self._control.await_legs(t, leg)

    def _notify_planner(self, guard: LegGuard) -> None:
        """Inform the planner until when each leg is held."""
        assert self._hold is not None
        self._hold(guard.until)

    def watch(self, t: float, measured: SwerveMeasurement, brake: Array, rate: Array) -> None:
        """A tick at t [s]: commanded ``brake`` (n, 1 = open), planned leg rates ``rate`` (n) [rad/s].

        Monitors judge it if the last check is :data:`POLL_PERIOD` ago (within half a period). Times may restart.
        """
        if not self.monitors or not all(map(math.isfinite, rate.tolist())):
            return  # a command that is not finite is rejected, by the name of its drives, before it goes to them
        self._watched = SwerveReadings(t, measured.leg, brake, rate, measured)
        if t < self._checked_at - self._period:  # the clock of a new run; by less: the check before a stop was ahead
            if self.monitor is not None:
                self.monitor.restart_clock()
            self._checked_at = -np.inf
        if t - self._checked_at >= max(POLL_PERIOD - 0.5 * self._period, 0.0):
            self._check(self._watched)

    def stop(self, measured: SwerveMeasurement | None) -> None:
        """All brakes close: judged is what legs, ``measured`` last, have done until now; the guard restarts."""
        self._check_before_stop(measured)
        guard = self._guarded()
        if guard is None:
            return
        held = np.isfinite(guard.until).any()
        guard.restart()
        if held:
            self._notify_planner(guard)

    def _check_before_stop(self, measured: SwerveMeasurement | None) -> None:
        """A stop ends the plan: what legs have done until now is judged by the commands until now."""
        watched, self._watched = self._watched, None
        if watched is None or measured is None:
            return
        t, previous, brake, rate, _ = watched
        leg = measured.leg
        if leg.shape != np.shape(previous) or not np.isfinite(leg).all():
            return  # the odometry has rejected this message, and the robot stops for it
        if np.any(brake) or np.any(rate):  # else the stop changes nothing for them
            self._check(SwerveReadings(max(t + self._period, self._checked_at), leg, brake, rate, measured))

    def _check(self, readings: SwerveReadings) -> None:
        """Judge a tick, and report what is found."""
        self._checked_at = readings.time
        for fault in (fault for monitor in self.monitors for fault in monitor.update(readings)):
            self.note(fault)
            if self.report is not None and isinstance(fault, BrakeFault):
                self.report(fault)

    def note(self, fault: Fault) -> None:
        """A fault that was found, into the log: a brake that does not hold is no use to the guard."""
        _LOG.log(logging.INFO if isinstance(fault, BrakeFault) and fault.withdraws else logging.WARNING, "%s", fault)
        if not isinstance(fault, BrakeFault):
            self._others.append(fault)
        elif self.guard is not None and fault.kind == "does not hold":
            self.guard.give_up(fault.leg)
