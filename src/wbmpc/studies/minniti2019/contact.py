"""Whether an end effector touches: force with hysteresis, debounced."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wbmpc.checks import finite, not_negative
from wbmpc.errors import InputError


@dataclass
class ContactDetector:
    """A contact begins when the force has been at least ``on`` [N] for ``debounce`` [s], and ends when it has been at most
    ``off`` [N] for ``release`` [s] (left out: as long). It also begins when a mean of the force, with the time constant ``mean_time`` [s] (0:
    not), has come to ``off``: an end effector that leans on something lightly touches it. ``since``: when it last changed [s]."""

    on: float = 2.0
    off: float = 0.8
    debounce: float = 0.010
    release: float | None = None
    mean_time: float = 0.0

    def __post_init__(self) -> None:
        finite("contact", on=self.on, off=self.off, debounce=self.debounce, mean_time=self.mean_time)
        if not 0.0 <= self.off < self.on:
            raise InputError(f"contact: thresholds need 0 <= off < on, got {self.off:g} and {self.on:g} N")
        self._waits = {False: self.debounce, True: self.debounce if self.release is None else self.release}
        not_negative("contact", debounce=self.debounce, release=self._waits[True], mean_time=self.mean_time)
        self.touching, self.since = False, 0.0
        self._candidate: float | None = None
        self._mean, self._last = 0.0, math.inf

    def update(self, t: float, force: float) -> bool:
        """Whether there is contact, after a force [N] at time t [s]; :class:`NotFinite` for what is no number."""
        finite("contact", t=t, force=force)
        other = force <= self.off if self.touching else force >= self.on
        if not other:
            self._candidate = None
        elif self._candidate is None:
            self._candidate = t
        leans = self._leans(t, force) and not self.touching
        if leans or (self._candidate is not None and t - self._candidate >= self._waits[self.touching] - 1e-9):
            self.touching, self.since, self._candidate, self._mean = not self.touching, t, None, 0.0
        return self.touching

    def _leans(self, t: float, force: float) -> bool:
        """Whether the mean of the force says that there is contact."""
        if self.mean_time <= 0.0:
            return False
        self._mean += -math.expm1(-max(t - self._last, 0.0) / self.mean_time) * (force - self._mean)
        self._last = t
        return self._mean >= self.off
