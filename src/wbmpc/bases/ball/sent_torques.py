"""The torques that were sent to a ball robot's drives, and what lagging drives with a dead time have made of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import not_negative, whole
from wbmpc.control.direct import lag_share
from wbmpc.errors import InputError

#: So much of what was sent before a measurement, and no fewer ticks, is remembered [s]: older measurements count as this old.
_MEMORY, _TICKS = 0.16, 64
#: A longer dead time [s] is a mistake: no robot stands so long without a command.
MAX_DEAD_TIME = 0.5


@dataclass(frozen=True)
class DriveSettings:
    """What a controller believes of the drives: ``lag`` [s], first order, and ``dead_time`` [s] between command and drive (in
    settings: ``actuator_dead_time``), whole controller periods, at most :data:`MAX_DEAD_TIME`. Too long a one costs little, too short
    a one the margin of stability."""

    lag: float = 0.0
    dead_time: float = 0.0

    def __post_init__(self) -> None:
        not_negative("ball robot's drives", lag=self.lag)


class SentTorques:
    """Torques (n + m) [N m] of the drives, tick by tick, from a start at ``torque`` on. ``dead``: the dead time in ticks.

    Raises :class:`InputError` for a dead time that is none.
    """

    def __init__(self, torque: Array, period: float, settings: DriveSettings) -> None:
        self._period = period
        self.blend = lag_share(period, settings.lag)
        self.dead = whole("actuator_dead_time", settings.dead_time, period, "controller periods", minimum=0)
        if settings.dead_time > MAX_DEAD_TIME:
            raise InputError(f"actuator_dead_time: must be at most {MAX_DEAD_TIME:g} s, got {settings.dead_time:g} s")
        self._known = max(_TICKS, math.ceil(_MEMORY / period)) + self.dead
        self._oldest = self._known - 1 - self.dead
        # twice as many rows as are known: they move to the front when the last one is taken
        self.rows = np.tile(np.asarray(torque, float), (2 * self._known, 1))
        self._end = self._known
        #: how many commands have gone to the drives
        self.count = 0

    @property
    def last(self) -> Array:
        """What the drives make of the last command, as soon as the dead time is over."""
        return self.rows[self._end - 1].copy()

    def follow(self, torque: Array, last: Array | None = None) -> Array:
        """What drives at ``last`` (left out: as they are) make of a command within a period."""
        last = self.rows[self._end - 1] if last is None else last
        return last + self.blend * (torque - last)

    def send(self, torque: Array) -> None:
        """A command goes to the drives."""
        self.rows[self.begin()] = self.follow(torque)
        self.end()

    def begin(self) -> int:
        """The row of ``rows`` for what drives make of the next command; :meth:`end` when it is there."""
        if self._end == len(self.rows):
            self.rows[: self._known] = self.rows[self._known :]
            self._end = self._known
        return self._end

    def end(self) -> None:
        """See :meth:`begin`."""
        self._end += 1
        self.count += 1

    def ticks(self, age: float) -> int:
        """``age`` [s] in ticks; what is older than all torques that are known counts as from the first."""
        return min(round(age / self._period), self._oldest)

    def at(self, ticks: int) -> int:
        """The row of what acted so many ticks ago."""
        return self._end - 1 - ticks - self.dead

    def acted(self, ticks: int) -> Array:
        """What acted so many ticks ago."""
        return self.rows[self.at(ticks)].copy()

    def since(self, ticks: int, dead: int | None = None) -> slice:
        """Rows of what has acted (``ticks``, n + m) in the ticks since then; with 0 for ``dead``, what will have acted a dead time from now."""
        end = self._end - (self.dead if dead is None else dead)
        return slice(end - ticks, end)
