"""Open legs that go astray are held by their brakes: hinges have no motors, so nothing else can.

A wheel that hangs in the air does not move its leg; on a slope the leg swings downhill. Nor do wheels on the ground where open legs
hardly hold the base (all parallel, as in H): base and legs move together, and no wheel sees it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.arrays import Array
from wbmpc.checks import finite, numbers
from wbmpc.errors import InputError


@dataclass(frozen=True)
class LegHold:
    """At ``time`` [s] it is decided to hold ``leg`` (index) until ``until`` [s], or that long no more: ``str()`` says it."""

    time: float
    leg: int
    until: float

    def __str__(self) -> str:
        return f"leg {self.leg} goes astray: its brake is closed until {self.until:.2f} s ({self.time:.2f} s)"


class LegGuard:
    """Watches n open legs at a fixed period and says which are to be held, and until when.

    A leg is held once it would be nearer to its plan by ``away`` [rad] if it had stood: |moved − planned| − |planned| > ``away``,
    both summed with the time constant ``window`` [s]. So one that only lags behind its plan stays open: its brake would not help.
    It is held for ``hold`` [s]; if it goes astray again within ``again`` [s] of opening, for twice as long as the last time, up to
    ``longest`` [s]. No two legs open within ``apart`` [s]: those that are held meanwhile hold the base.

    ``until`` (n) [s]: when each opens, or has opened (−inf: was never held); ``holds`` (n): how often each was held.
    """

    def __init__(
        self,
        n: int,
        away: float = 0.018,
        window: float = 0.2,
        hold: float = 0.3,
        longest: float = 0.6,
        again: float = 0.6,
        apart: float = 0.2,
    ) -> None:
        who = "leg guard"
        finite(who, away=away, window=window, hold=hold, longest=longest, again=again, apart=apart)
        if min(away, window, hold, again) <= 0.0 or apart < 0.0 or longest < hold:
            raise InputError(
                f"{who}: away, window, hold and again must be positive, apart not negative, longest no less than hold"
            )
        self.away, self.window, self.hold, self.longest, self.again, self.apart = (
            away, window, hold, longest, again, apart,
        )  # fmt: skip
        self.holds = np.zeros(n, int)
        self.restart()

    def restart(self) -> None:
        """No leg is held, times may restart. What was counted stays counted."""
        n = self.holds.size
        self.until, self._length = np.full(n, -np.inf), np.full(n, self.hold)
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
        kept = np.exp(-h / self.window)
        self._moved = np.where(free, kept * self._moved + (angle - last), 0.0)
        self._planned = np.where(free, kept * self._planned + h * planned, 0.0)
        astray = free & (np.abs(self._moved - self._planned) - np.abs(self._planned) > self.away)
        if astray.any():
            self._begin(t, astray)
        return [LegHold(t, int(i), float(self.until[i])) for i in np.flatnonzero(previous != self.until)]

    def _begin(self, t: float, astray: NDArray[np.bool_]) -> None:
        soon = t - self.until < self.again  # after its last hold
        longer = np.minimum(2.0 * self._length, self.longest)
        self._length = np.where(astray, np.where(soon, longer, self.hold), self._length)
        self.until = np.where(astray, t + self._length, self.until)
        self._held |= astray
        self.holds += astray

    def _end(self, t: float, commanded_open: NDArray[np.bool_]) -> None:
        """Legs whose time is over open, one after the other; those whose brakes are commanded to be closed are not held besides."""
        closed = self._held & ~commanded_open
        self.until[closed], self._held[closed] = np.minimum(self.until[closed], t), False
        self._useless &= commanded_open
        for i in np.flatnonzero(self._held & ~self.held(t)):
            if t - self._freed < self.apart - 1e-9:
                self.until[i] = self._freed + self.apart
            else:
                self._held[i], self._freed = False, t
