"""Whether an end effector touches: force with hysteresis, debounced."""

from __future__ import annotations

from dataclasses import dataclass

from wbmpc.checks import finite, not_negative
from wbmpc.errors import InputError


@dataclass
class ContactDetector:
    """A contact begins when the force has been at least ``on`` [N] for ``debounce`` [s], and ends when it has been at most
    ``off`` [N] for ``release`` [s] (left out: as long). ``since``: when it last changed [s]."""

    on: float = 2.0
    off: float = 0.8
    debounce: float = 0.010
    release: float | None = None

    def __post_init__(self) -> None:
        finite("contact", on=self.on, off=self.off, debounce=self.debounce)
        if not 0.0 <= self.off < self.on:
            raise InputError(f"contact: thresholds need 0 <= off < on, got {self.off:g} and {self.on:g} N")
        self._waits = {False: self.debounce, True: self.debounce if self.release is None else self.release}
        not_negative("contact", debounce=self.debounce, release=self._waits[True])
        self.touching, self.since = False, 0.0
        self._candidate: float | None = None

    def update(self, t: float, force: float) -> bool:
        """Whether there is contact, after a force [N] at time t [s]; :class:`NotFinite` for what is no number."""
        finite("contact", t=t, force=force)
        other = force <= self.off if self.touching else force >= self.on
        if not other:
            self._candidate = None
        elif self._candidate is None:
            self._candidate = t
        if self._candidate is not None and t - self._candidate >= self._waits[self.touching] - 1e-9:
            self.touching, self.since, self._candidate = not self.touching, t, None
        return self.touching
