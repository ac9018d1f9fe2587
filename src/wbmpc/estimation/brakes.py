"""Brakes that do not answer: found by comparing the legs' encoders with what brakes and plan say.

A leg that moves though its brake is closed (it slips, or did not close), and one that does not move though it is open. A leg
may also stand because wheels hang in the air, of others or its own: it is taken back as soon as the leg moves after all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BrakeFault:
    """At ``time`` [s] the brake of ``leg`` (index) turned out not to do what it was told, or that it does: ``str()`` tells it."""

    time: float
    leg: int
    name: str
    kind: Literal["does not hold", "does not open", "opens after all"]
    angle: float

    def __str__(self) -> str:
        seen = "was to move by" if self.kind == "does not open" else "moved by"
        return f"brake of {self.name} {self.kind}: the leg {seen} {self.angle:.3f} rad ({self.time:.2f} s)"


class BrakeMonitor:
    """Watches n legs at a fixed period.

    ``moved`` [rad]: motion of a closed leg that is a fault. ``expected`` [rad]: planned motion of an open leg during which
    it has stayed within ``still`` [rad] (a few counts of its encoder; the base may move in place of a leg that is stuck,
    and then other legs move too little as well: they are not judged any more) for ``patience`` [s]: on a bump, too, the base
    turns in place of legs, until all wheels are down again; plans are forgotten with the time constant
    ``window`` [s], and rates below ``crawl`` [rad/s] do not count, for a leg is also held by small rates. ``settle`` [s] after
    a command nothing is judged: brakes take their time. ``faults``: all that were told; ``withdrawn``: those of legs that were
    said not to open and then moved by ``moved``.
    """

    def __init__(
        self,
        names: Sequence[str],
        moved: float = 0.01,
        expected: float = 0.2,
        still: float = 0.0015,
        window: float = 5.0,
        settle: float = 0.25,
        crawl: float = 0.08,
        patience: float = 1.3,
    ) -> None:
        if min(moved, expected, still, window, settle, patience) <= 0.0 or crawl < 0.0:
            raise InputError(
                "brake monitor: moved, expected, still, window, settle and patience must be positive, crawl not negative"
            )
        n = len(names)
        self.names, self.moved, self.expected, self.still = list(names), moved, expected, still
        self.window, self.settle, self.crawl, self.patience = window, settle, crawl, patience
        self.faults: list[BrakeFault] = []
        self.withdrawn: list[BrakeFault] = []
        self._open: NDArray[np.bool_] | None = None
        self._since = np.zeros(n)
        self._anchor, self._gone, self._planned, self._resting, self._told_at = np.zeros((5, n))
        self._told = np.zeros(n, bool)
        self._time = 0.0

    def update(self, t: float, leg: ArrayLike, brake: ArrayLike, rate: ArrayLike) -> list[BrakeFault]:
        """What is new after measured angles ``leg`` (n) [rad] at t [s], brakes (n, 1 = open) and planned ``rate`` (n) [rad/s].

        A fault is told once per command of its brake, or again after it was taken back.
        """
        angle, is_open, planned = np.asarray(leg, float), np.asarray(brake, float) > 0.5, np.asarray(rate, float)
        if self._open is None:
            self._open, self._anchor, self._time = is_open, angle.copy(), t
            self._since[:] = t - self.settle
        changed = is_open != self._open
        self._since[changed], self._told[changed], self._open = t, False, is_open
        h, self._time = t - self._time, t
        settled = t - self._since >= self.settle - 1e-9
        # a leg counts from where it was when its brake had settled; an open one from where it was last seen to move
        afresh = ~settled | (is_open & (np.abs(angle - self._anchor) > self.still))
        self._anchor = np.where(afresh, angle, self._anchor)
        counted = np.sign(planned) * np.maximum(np.abs(planned) - self.crawl, 0.0)
        self._planned = np.where(afresh, 0.0, np.exp(-h / self.window) * self._planned + h * counted)
        self._resting = np.where(afresh, 0.0, self._resting + h)
        self._gone = angle - self._anchor
        withdrawn, new = self._withdraw(t, angle), []
        for i in np.flatnonzero(settled & ~self._told):
            fault = self._judge(t, int(i))
            if fault is not None:
                new.append(fault)
                self._told[i], self._told_at[i] = True, angle[i]
        self.faults += new
        return withdrawn + new

    def _withdraw(self, t: float, angle: Array) -> list[BrakeFault]:
        """Legs that were said not to open and have moved since."""
        assert self._open is not None
        found = []
        for i in np.flatnonzero(self._told & self._open & (np.abs(angle - self._told_at) > self.moved)):
            found.append(BrakeFault(t, int(i), self.names[i], "opens after all", float(angle[i] - self._told_at[i])))
            self._told[i] = False
        self.withdrawn += found
        return found

    def _judge(self, t: float, i: int) -> BrakeFault | None:
        assert self._open is not None
        if not self._open[i]:
            gone = float(self._gone[i])
            return BrakeFault(t, i, self.names[i], "does not hold", gone) if abs(gone) > self.moved else None
        if np.any(self._told & self._open):
            return None
        wanted = float(self._planned[i])
        stuck = abs(wanted) > self.expected and self._resting[i] >= self.patience - 1e-9
        return BrakeFault(t, i, self.names[i], "does not open", wanted) if stuck else None
