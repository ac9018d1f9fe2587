"""Who commands the brakes: one place that sends the same commands to the brakes and the planner."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.arrays import Array
from wbmpc.bases.swerve.brake_monitor import BrakeFault
from wbmpc.checks import numbers
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import ModuleGeometry
from wbmpc.ocp import Mode, ModeSchedule

#: A base that its legs hold by less than this (:func:`floating`) counts as floating.
FLOATING = 0.05
#: Time [s] that it may float while legs pass through such angles on their way to others.
FLOATING_TIME = 1.0
#: Time [s] that brakes take by default.
BRAKE_DELAY = 0.1
#: A leg within this [rad] of where it is to be has arrived: its brake closes.
ARRIVED = 0.015
#: A brake waits for its leg so long [s] at most: a wheel that hangs in the air comes down again.
MAX_WAIT = 2.0
#: So long [s] before a brake closes it is decided whether it waits: plans have to know.
NOTICE = 0.3
#: By so much [s] a brake that waits closes later each time.
POSTPONEMENT = 0.2
#: Length [m] that turns a yaw rate into a speed.
_YAW_LENGTH = 0.5
#: Rate [rad/s] of legs whose speed has no limit.
_AT_ONCE = 1e3


def floating(geometry: ModuleGeometry, leg: ArrayLike, brake: ArrayLike) -> tuple[float, Array]:
    """How firmly the wheels hold the base (0: not at all), and the body motion (vx, vy, ω) [m/s, rad/s] that they hold least.

    ``leg`` (n) [rad], ``brake`` (n, 1 = open). A wheel at the end of a leg that swings holds the base only along that leg: from
    Pankert et al. 2022, equations 4 and 5, a motion v + ω ẑ × h with d · (v + ω ẑ × h) = 0 for every open leg (hinge h,
    direction d) is one that leg rates cancel, and no wheel sees it. So it is with all legs parallel (H: sideways). A leg that slides
    holds the base across itself.
    """
    angle = geometry.leg_heading + geometry.leg_angles(leg)
    rows = []
    places = zip(
        geometry.hinge, geometry.steer_axes(leg), angle, geometry.slides, np.asarray(brake, float), strict=True
    )
    for hinge, axis, a, slides, is_open in places:
        at, held = axis, [(1.0, 0.0), (0.0, 1.0)]
        if is_open > 0.5:
            at, held = (axis, [(-np.sin(a), np.cos(a))]) if slides else (hinge, [(np.cos(a), np.sin(a))])
        rows += [[x, y, (at[0] * y - at[1] * x) / _YAW_LENGTH] for x, y in held]
    _, values, motions = np.linalg.svd(np.array(rows))
    motion = motions[-1] / [1.0, 1.0, _YAW_LENGTH]
    return float(values[-1]), motion * np.sign(motion[np.argmax(np.abs(motion))])


def described(motion: Array) -> str:
    """A body motion in words."""
    parts = zip(motion / np.linalg.norm(motion), ("forwards", "sideways", "turning"), strict=True)
    return " and ".join(name for part, name in parts if abs(part) > 0.3)


def reject_floating(geometry: ModuleGeometry, leg: ArrayLike, brake: ArrayLike) -> None:
    """Raise :class:`InputError` if legs that stay at ``leg`` (n) [rad] with brakes (n, 1 = open) hold the base against nothing,
    or for what is not finite or of another length."""
    n = geometry.modules
    leg, brake = numbers("brakes", "leg", leg, n), numbers("brakes", "brake", brake, n)
    held, motion = floating(geometry, leg, brake)
    if held < FLOATING:
        raise InputError(
            f"brakes: with these legs, {geometry.leg_text(leg)}, nothing would hold the base against "
            f"{described(motion)} once they are open; valid: a closed brake, or other leg positions at once"
        )


def reject_floating_way(
    geometry: ModuleGeometry, leg: ArrayLike, goal: ArrayLike, brake: ArrayLike, rate: ArrayLike
) -> None:
    """Raise :class:`InputError` if legs on their way from ``leg`` to ``goal`` (n) [rad] at ``rate`` (n) [rad/s] hold the base
    against nothing for longer than ``FLOATING_TIME``, brakes (n, 1 = open) as given: as from H to other angles that are all parallel;
    also for numbers that are not finite, of another length, or rates that are not positive.
    """
    n = geometry.modules
    start, goal = numbers("brakes", "leg", leg, n), numbers("brakes", "goal", goal, n)
    brake, way = numbers("brakes", "brake", brake, n), goal - start
    rate = numbers("brakes", "rate", np.minimum(np.asarray(rate, float), _AT_ONCE), n)
    if not (rate > 0.0).all():
        raise InputError(f"brakes: 'rate' needs positive numbers [rad/s], got {rate}")
    step, since = 0.05, np.inf
    for t in np.arange(0.0, float(np.max(np.abs(way) / rate)) + step, step):
        at = start + np.sign(way) * np.minimum(np.abs(way), t * rate)
        held, motion = floating(geometry, at, brake)
        since = min(since, t) if held < FLOATING else np.inf
        if t - since > FLOATING_TIME:
            raise InputError(
                f"brakes: on the way to {geometry.leg_text(goal)} nothing would hold the base against "
                f"{described(motion)} for more than {FLOATING_TIME:g} s; valid: one leg after the other, or other leg positions"
            )


class BrakeControl:
    """Brakes of a robot's legs over time: events that are scheduled, or that come at any time.

    ``commanded(t)`` (n, 1 = open) goes to the brakes. The planner's mode λ follows from it: a leg that is being closed is
    held from the command on, one that is being opened only ``delay`` [s] after it. ``changed`` is called with the new
    schedule whenever there is one: usually ``mpc.set_schedule``. Who keeps brakes closed besides says so by :meth:`hold`.
    ``arrivals(t)`` (n) [rad]: where legs are to be when their brakes close at t [s]; None: brakes close where legs are.
    """

    def __init__(
        self, robot: RobotModel, start: ArrayLike | None = None, delay: float = 0.0,
        changed: Callable[[ModeSchedule], None] | None = None,
    ) -> None:  # fmt: skip
        footprint = robot.base.footprint
        geometry = None if footprint is None else footprint.modules
        if "brake" not in robot.mode or geometry is None:
            raise InputError(f"{robot.description.name}: its legs have no brakes")
        if not 0.0 <= delay < np.inf:
            raise InputError(f"brakes: the delay must be finite and not negative, got {delay} s")
        self.legs, self.delay, self.changed = robot.state.groups["leg"], delay, changed
        self.geometry = geometry
        self.arrivals: Callable[[float], Array] | None = None
        self._fastest = np.minimum(robot.limits.input_upper[robot.input["leg"]], _AT_ONCE)
        closed = np.zeros(len(self.legs))
        # times and states from then on: replaced as a whole, for a controller's thread may ask meanwhile
        self._events: tuple[list[float], list[Array]] = [-np.inf], [self._checked(closed if start is None else start)]
        self._known: dict[int, BrakeFault] = {}  # leg: how it is otherwise than commanded
        self._held = np.full(len(self.legs), -np.inf)
        self._due = np.full(len(self.legs), np.inf)  # when the brakes were to close that wait for their legs
        self._notify_planner()

    def _checked(self, brake: ArrayLike) -> Array:
        try:
            state = np.asarray(brake, float)
        except (TypeError, ValueError):
            state = np.empty(0)  # no numbers
        if state.shape != (len(self.legs),) or not np.isin(state, (0.0, 1.0)).all():
            raise InputError(f"brakes: {len(self.legs)} numbers, 0 (closed) or 1 (open), are needed, got {brake!r}")
        return state.copy()

    def set(self, t: float, brake: ArrayLike, leg: ArrayLike | None = None) -> None:
        """From t [s] on the brakes (n) are as given; what was scheduled for later stays, what was for the same time goes.

        ``leg`` (n) [rad]: where the legs will stay meanwhile. If nothing held the base then, as in H with open brakes, the
        event is rejected (:class:`InputError`). Missions that move their legs at once do not give it.
        """
        if not np.isfinite(t):
            raise InputError(f"brakes: the time of an event must be finite, got {t}")
        if leg is not None:
            reject_floating(self.geometry, leg, self._checked(brake))
        state, (times, states) = self._checked(brake), self._events
        place = int(np.searchsorted(times, t))
        rest = place + int(place < len(times) and times[place] == t)
        self._events = [*times[:place], float(t), *times[rest:]], [*states[:place], state, *states[rest:]]
        self._notify_planner()

    def replace(self, events: Sequence[tuple[float, ArrayLike]]) -> None:
        """Brakes (n) from times [s] on, in their order; what was scheduled from the first of them on goes."""
        if not events or not all(np.isfinite(t) for t, _ in events) or any(a[0] >= b[0] for a, b in pairwise(events)):
            raise InputError("brakes: events in the order of their finite times are needed")
        states = [self._checked(brake) for _, brake in events]
        keep = bisect_left(self._events[0], events[0][0])
        self._events = [*self._events[0][:keep], *(float(t) for t, _ in events)], [*self._events[1][:keep], *states]
        self.reset(events[0][0])
        self._notify_planner()

    def commanded(self, t: float) -> Array:
        """Brakes (n) at t [s], 1 = open."""
        times, states = self._events
        return states[bisect_right(times, t + 1e-9) - 1]

    def accept(self, fault: BrakeFault) -> None:
        """Plan with what a brake really does until its next command: a leg that does not open is held, one that does not hold
        is free; one that opens or holds after all is as commanded again."""
        if fault.withdraws:
            self._known.pop(fault.leg, None)
        else:
            self._known[fault.leg] = fault
        self._notify_planner()

    def hold(self, until: ArrayLike) -> None:
        """Plan with legs that are kept closed from now on, each until ``until`` (n) [s] (−inf: it is not), whatever is commanded.

        A guard of the legs does that. Commands stay as they are, and count again afterwards. A leg that is held again is
        believed to hold: its brake has a new command.
        """
        held = np.asarray(until, float)
        if held.shape != self._held.shape or np.isnan(held).any() or np.any(held == np.inf):
            raise InputError(f"brakes: hold: {len(self.legs)} times [s] are needed, finite or -inf, got {held}")
        newly_held = held > self._held
        self._known = {leg: k for leg, k in self._known.items() if not newly_held[leg]}
        self._held = held.copy()
        self._notify_planner()

    def await_legs(self, t: float, leg: Array) -> None:
        """Brakes that would close within :data:`NOTICE` after t [s] wait for their legs, which are at ``leg`` (n) [rad] now and cannot be
        there in time: see ``arrivals``. One that closed on the way would leave its leg there until it opens again."""
        times, states = self._events
        k = bisect_right(times, t)
        if self.arrivals is None or k == len(times) or times[k] > t + NOTICE:
            return
        at, before, after = times[k], states[k - 1], states[k]
        closes = before > after
        another = at > self._due + MAX_WAIT + 0.5 * POSTPONEMENT  # command than the one that waited
        self._due[closes & another] = np.inf
        self._due[closes] = np.minimum(self._due[closes], at)
        away = np.abs(leg - self.arrivals(at)) - self._fastest * (at - t)
        waits = closes & (away > ARRIVED) & (at + POSTPONEMENT < self._due + MAX_WAIT)
        if waits.any():
            self._postpone(at, waits)

    def _postpone(self, at: float, waits: NDArray[np.bool_]) -> None:
        """The event at ``at`` [s], and what comes within ``POSTPONEMENT``, is so much later for the brakes (n) that wait."""
        times, states = self._events
        later, k = at + POSTPONEMENT, bisect_left(times, at)
        before, end, rest = states[k - 1], bisect_left(times, later), bisect_right(times, later)
        between = [np.where(waits, before, s) for s in states[k:end]]
        self._events = [*times[:end], later, *times[rest:]], [*states[:k], *between, states[rest - 1], *states[rest:]]
        self._notify_planner()

    def doubted(self, t: float) -> list[BrakeFault]:
        """What is planned with at t [s] in place of commands: faults that were accepted, until the next command of the brake."""
        return [fault for leg, fault in self._known.items() if t < self._changes(leg, fault.time)]

    def reset(self, t: float) -> None:
        """What was before t [s] is not asked for any more: call it now and then where events go on forever."""
        first = bisect_right(self._events[0], t - self.delay) - 1
        if first > 0:
            times, states = self._events
            self._known = {leg: k for leg, k in self._known.items() if self._changes(leg, k.time) > times[first]}
            self._events = [-np.inf, *times[first + 1 :]], states[first:]

    def _changes(self, leg: int, since: float) -> float:
        """When [s] the next command of a leg's brake comes after ``since`` [s]."""
        times, states = self._events
        first = bisect_right(times, since)
        later = zip(times[first:], pairwise(states[first - 1 :]), strict=True)
        return next((t for t, (a, b) in later if a[leg] != b[leg]), np.inf)

    def schedule(self) -> ModeSchedule:
        times = self._events[0]
        held = self._held.tolist()
        events = sorted({t for t in (*times, *(t + self.delay for t in (*times, *held))) if np.isfinite(t)})
        states = [self._planned(-np.inf), *map(self._planned, events)]
        modes = [Mode("".join("CO"[int(b)] for b in s), {"brake": tuple(s)}) for s in states]
        # events at which nothing changes are left out
        kept = [k for k, (a, b) in enumerate(pairwise(states)) if np.any(a != b)]
        return ModeSchedule((modes[0], *(modes[k + 1] for k in kept)), tuple(events[k] for k in kept))

    def _planned(self, t: float) -> Array:
        """λ (n) at t [s]: open since at least the delay, and not held (when that began is of no interest any more)."""
        times, states = self._events
        recent = states[bisect_right(times, t - self.delay) : bisect_right(times, t)]
        state = np.min([*recent, self.commanded(t), self.commanded(t - self.delay)], axis=0)
        state = np.where(t + 1e-9 < self._held + self.delay, 0.0, state)
        for fault in self.doubted(t):
            state[fault.leg] = 0.0 if fault.kind == "does not open" else 1.0
        return np.asarray(state)

    def _notify_planner(self) -> None:
        if self.changed is not None:
            self.changed(self.schedule())
