"""Brakes that do not answer: found by comparing the legs' encoders with what brakes and plan say.

A leg that moves though its brake is closed (it slips, or did not close), and one that does not move though it is open. A leg
may also stand because wheels hang in the air, of others or its own: it is taken back as soon as the leg moves after all. A
brake that slipped once holds again: that is taken back when the leg stands though the plan, which takes it for free, moves it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.swerve.compilation import step
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.checks import finite, numbers, positive
from wbmpc.errors import InputError
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind, zeros

#: A leg that slides by this [m] counts as one that turns by 1 rad: its foot goes as far as that of a hinged leg of the usual length.
METERS_PER_RADIAN = 0.4
#: Motion [rad] of a leg that is held which is a fault, less what is no faster than this [rad/s]; motion [rad] that is none: a few counts.
MOVED, CREEP, STILL = 0.01, 2e-4, 0.0015
#: Time constant [s] of planned motion; time [s] after a command in which nothing is judged; planned rates [rad/s] that do not count.
WINDOW, SETTLE, CRAWL = 5.0, 0.25, 0.08


class Brakes(NamedTuple):
    """Legs (n), their brakes, and what a monitor remembers of them."""

    n: int
    angle: Floats  # (n) [rad], measured
    brake: Floats  # (n), 1 = open
    rate: Floats  # (n) [rad/s], planned
    opened: Floats  # (n), the brakes at the last call
    since: Floats  # (n) [s], when that changed
    anchor: Floats  # (n) [rad], where motion is counted from
    gone: Floats  # (n) [rad], motion since
    planned: Floats  # (n) [rad], motion that was planned since, fading
    resting: Floats  # (n) [s], since the anchor
    reported: Floats  # (n), 1 for legs with a fault
    settled: Floats  # (n), 1 for brakes that have had time to answer
    crawl: Floats  # (n) [rad/s], planned rates that do not count
    expected: Floats  # (n) [rad], planned motion after which a loose leg must have moved
    patience: float  # [s], before a loose leg that stands is judged


@step
def monitor_brakes(b: Brakes, t: float, h: float, unsettled: float) -> tuple[float, int]:
    """Take in what is measured at ``t`` [s], ``h`` [s] after the call before. Returns since when legs that were reported have not been
    held in the plan (``unsettled`` [s]), and how many legs are to be judged: those reported, and those whose brake seems not to answer."""
    any_stuck = False
    for i in range(b.n):
        is_open = 1.0 if b.brake[i] > 0.5 else 0.0
        if is_open != b.opened[i]:
            b.since[i], b.reported[i], b.opened[i] = t, 0.0, is_open
        b.settled[i] = 1.0 if t - b.since[i] >= SETTLE - 1e-9 else 0.0
        if b.reported[i] > 0.0 and is_open > 0.0:
            any_stuck = True
            if abs(b.rate[i]) > b.crawl[i]:
                unsettled = t
    waits = any_stuck and t - unsettled < SETTLE
    forgotten, count = np.exp(-h / WINDOW), 0
    for i in range(b.n):
        apart = b.angle[i] - b.anchor[i]
        loose = b.opened[i] > 0.0 or b.reported[i] > 0.0  # may move, as far as is known
        # a leg counts from where it was when its brake had settled; a loose one from where it was last seen to move
        afresh = b.settled[i] == 0.0 or (loose and (abs(apart) > STILL or (waits and b.reported[i] == 0.0)))
        if afresh:
            b.anchor[i], b.planned[i], b.resting[i] = b.angle[i], 0.0, 0.0
        else:
            if not loose:
                b.anchor[i] += min(max(apart, -h * CREEP), h * CREEP)
            counted = max(b.rate[i] - b.crawl[i], 0.0) - max(-b.rate[i] - b.crawl[i], 0.0)
            b.planned[i], b.resting[i] = forgotten * b.planned[i] + h * counted, b.resting[i] + h
        b.gone[i] = b.angle[i] - b.anchor[i]
        stands = abs(b.planned[i]) > b.expected[i] and b.resting[i] >= b.patience - 1e-9
        odd = stands if b.opened[i] > 0.0 else abs(b.gone[i]) > MOVED
        if b.reported[i] > 0.0 or (b.settled[i] > 0.0 and odd):
            count += 1
    return unsettled, count


#: Planned rates [rad/s] at which ``expected`` counts in full; largest share of a leg's limit that does not count.
FAST, CRAWL_SHARE = 0.4, 0.7


class SwerveReadings(NamedTuple):
    """What monitors of a swerve robot compare at ``time`` [s]: measured angles ``leg`` (n) [rad], ``brake`` (n, 1 = open) as commanded and
    planned ``rate`` (n) [rad/s] of legs; the whole ``measurement``, where there is one."""

    time: float
    leg: ArrayLike
    brake: ArrayLike
    rate: ArrayLike
    measurement: SwerveMeasurement | None = None


Kind = Literal["does not hold", "does not open", "opens after all", "holds after all"]


@dataclass(frozen=True)
class BrakeFault:
    """At ``time`` [s] the brake of ``leg`` (index) turned out not to do what it was commanded to do, or that it does: ``str()`` is the message."""

    time: float
    leg: int
    name: str
    kind: Kind
    angle: float
    unit: str = "rad"

    @property
    def withdraws(self) -> bool:
        """Whether it takes an earlier one of its leg back."""
        return self.kind in ("opens after all", "holds after all")

    def __str__(self) -> str:
        seen = "was to move by" if self.kind in ("does not open", "holds after all") else "moved by"
        return f"brake of {self.name} {self.kind}: the leg {seen} {self.angle:.3f} {self.unit} ({self.time:.2f} s)"


def per_radian(units: Sequence[str]) -> Array:
    """How far each leg moves, in its unit, where one that turns moves by 1 rad: 1, or :data:`METERS_PER_RADIAN`."""
    return np.array([METERS_PER_RADIAN if unit == "m" else 1.0 for unit in units])


class BrakeMonitor:
    """Watches n legs at a fixed period; ``time`` [s] of the last update.

    A closed leg must not move by :data:`MOVED`, but for what creeps (:data:`CREEP`). ``expected``
    [rad]: planned motion of an open leg during which it has stayed within :data:`STILL` for
    ``patience`` [s]: on a bump, too, the base turns in place of legs, until all wheels are down again; plans are forgotten with
    the time constant :data:`WINDOW`, and rates below :data:`CRAWL` do not count, for a leg is also held by small rates.
    ``limit`` (n) [rad/s, or m/s]: largest planned rates; where they are small, so are these (:data:`CRAWL_SHARE` of the limit at
    most) and ``expected``. For :data:`SETTLE` after a command nothing is judged: brakes take their time. The base may move in place
    of a leg that is stuck, and then other legs move too little as well: those that did not stand as long as the first are
    judged again, from the beginning, once the plan has held it as long. ``faults``: all that were reported; ``withdrawn``:
    those that were taken back, of legs that were said not to open and then moved by as much, or not to hold and then stood as
    one does that is not open; ``real``: those of ``faults`` that were not wrong (a brake that holds again did slip). ``units``:
    of each leg, by default "rad"; for those that slide ("m") all these are lengths, :data:`METERS_PER_RADIAN` for a radian.
    """

    def __init__(
        self, names: Sequence[str], limit: ArrayLike = np.inf, expected: float = 0.2, patience: float = 1.3,
        units: Sequence[str] = (),
    ) -> None:  # fmt: skip
        positive("brake monitor", expected=expected, patience=patience)
        self.names, self.patience, self._units = list(names), patience, list(units) or ["rad"] * len(names)
        self._radian = per_radian(self._units)
        maximum = _positive_rates(limit, len(names)) / self._radian
        self.crawl = np.minimum(CRAWL, CRAWL_SHARE * maximum)
        self.expected = expected * np.minimum(1.0, (maximum - self.crawl) / (FAST - CRAWL))
        self.faults: list[BrakeFault] = []
        self.withdrawn: list[BrakeFault] = []
        self.real: list[BrakeFault] = []
        self._bind()
        self.restart_clock()

    def _bind(self) -> None:
        """Arrays by their names in :class:`Brakes`, and that step."""
        n = len(self.names)
        a = self._arrays = zeros(Brakes, n)
        a |= {"crawl": np.array(self.crawl, float), "expected": np.array(self.expected, float)}
        self._open, self._since, self._anchor, self._gone = a["opened"], a["since"], a["anchor"], a["gone"]
        self._planned, self._resting, self._reported = a["planned"], a["resting"], a["reported"]
        self._reported_at = np.zeros(n)
        self._monitor = bind(monitor_brakes, a, n=n, patience=self.patience)

    def restart_clock(self) -> None:
        """Times restart: the next update is a first one, of brakes that count as sound again. What was reported stays reported."""
        for values in (
            self._since,
            self._anchor,
            self._gone,
            self._planned,
            self._resting,
            self._reported_at,
            self._reported,
        ):
            values[:] = 0.0
        self._first = True
        self._unsettled = -np.inf  # when legs that were reported last had not been held in the plan
        self.time = -np.inf

    def update(self, readings: SwerveReadings, /) -> list[BrakeFault]:
        """What is new.

        A fault is reported once per command of its brake, or again after it was taken back. Raises :class:`InputError` for what is
        not finite or of another length, and for time that goes back (see :meth:`restart_clock`); it does not count, and the next
        one does.
        """
        a, t = self._arrays, readings.time
        a["angle"][:], a["brake"][:], a["rate"][:] = self._checked(*readings[:4])
        if self._first:
            self._open[:], self._anchor[:] = a["brake"] > 0.5, a["angle"]
            self._since[:], self._first, self.time = t - SETTLE, False, t
        h, self.time = t - self.time, t
        self._unsettled, suspects = self._monitor(t, h, self._unsettled)
        if not suspects:
            return []
        return self._withdraw(t, a["angle"]) + self._judged(t, a["angle"])

    def _judged(self, t: float, angle: Array) -> list[BrakeFault]:
        new = []
        for i in np.flatnonzero((self._arrays["settled"] > 0.0) & (self._reported == 0.0)):
            fault = self._judge(t, int(i))
            if fault is not None:
                new.append(fault)
                self._reported[i], self._reported_at[i] = 1.0, angle[i]
                self._unsettled = t
        self.faults += new
        self.real += new
        return new

    def _checked(self, t: float, leg: ArrayLike, brake: ArrayLike, rate: ArrayLike) -> tuple[Array, Array, Array]:
        """What :meth:`update` was given, as arrays (n) in radians."""
        who, n = "brake monitor", len(self.names)
        finite(who, time=t)
        if t < self.time:
            raise InputError(f"{who}: time must not go back, got {t:.6g} s after {self.time:.6g} s")
        is_open = numbers(who, "brake", brake, n)
        return numbers(who, "leg", leg, n) / self._radian, is_open, numbers(who, "rate", rate, n) / self._radian

    def _withdraw(self, t: float, angle: Array) -> list[BrakeFault]:
        """Legs that were said not to open and have moved since, and those that were said not to hold and stand."""
        found = []
        for i in map(int, np.flatnonzero(self._reported)):
            gone = float(angle[i] - self._reported_at[i])
            if self._open[i] and abs(gone) > MOVED:
                found.append(self._fault(t, i, "opens after all", gone))
            elif not self._open[i] and self._stands(i):
                found.append(self._fault(t, i, "holds after all", float(self._planned[i])))
        self._reported[[f.leg for f in found]] = 0.0
        self.withdrawn += found
        for back in found:
            if back.kind == "opens after all":
                self.real.remove([f for f in self.real if f.leg == back.leg][-1])
        return found

    def _stands(self, i: int) -> bool:
        """Whether a leg has stood for long though the plan moves it."""
        return bool(abs(self._planned[i]) > self.expected[i] and self._resting[i] >= self.patience - 1e-9)

    def _judge(self, t: float, i: int) -> BrakeFault | None:
        if not self._open[i]:
            gone = float(self._gone[i])
            return self._fault(t, i, "does not hold", gone) if abs(gone) > MOVED else None
        return self._fault(t, i, "does not open", float(self._planned[i])) if self._stands(i) else None

    def _fault(self, t: float, i: int, kind: Kind, moved: float) -> BrakeFault:
        return BrakeFault(t, i, self.names[i], kind, moved * float(self._radian[i]), self._units[i])


def _positive_rates(limit: ArrayLike, n: int) -> Array:
    """One rate [rad/s] for all or ``n``, infinite where there is no limit; or :class:`InputError`."""
    try:
        maximum = np.broadcast_to(np.asarray(limit, float), n)
    except (TypeError, ValueError):
        maximum = np.full(n, np.nan)
    if not np.all(maximum > 0.0):
        raise InputError(f"brake monitor: limit: one positive rate [rad/s] or {n} are needed, got {limit!r}")
    return maximum
