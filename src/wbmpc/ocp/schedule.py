"""Modes and their schedule: N events in time, N + 1 modes between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from wbmpc.checks import real_numbers
from wbmpc.errors import InputError


@dataclass(frozen=True)
class Mode:
    """A named set of the model's discrete values, all finite.

    ``values`` gives, by group of the model's mode layout, the numbers of that mode (e.g. ``{"brake": (0, 0, 0, 0)}``,
    1 = open); a group that is not named is zero. ``name`` is what terms refer to with ``modes=``.
    """

    name: str
    values: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for group, numbers in self.values.items():
            if not np.isfinite(real_numbers(f"mode '{self.name}', '{group}'", numbers)).all():
                raise InputError(f"mode '{self.name}': values of '{group}' must be finite numbers, got {numbers}")


@dataclass(frozen=True)
class ModeSchedule:
    """``modes[i]`` holds from ``events[i - 1]`` up to (not including) ``events[i]``; ``events`` [s] are absolute times."""

    modes: tuple[Mode, ...]
    events: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "modes", tuple(self.modes))
        if not all(isinstance(mode, Mode) for mode in self.modes):
            raise InputError(f"mode schedule: modes must be Mode objects, got {list(self.modes)}")
        object.__setattr__(self, "events", tuple(float(t) for t in self.events))
        if len(self.modes) != len(self.events) + 1:
            raise InputError(
                f"mode schedule: {len(self.events)} events need {len(self.events) + 1} modes, got {len(self.modes)}"
            )
        if not all(np.isfinite(self.events)) or any(np.diff(self.events) <= 0):
            raise InputError(f"mode schedule: events must be finite and increasing, got {list(self.events)}")

    def index(self, t: float) -> int:
        """The place of the mode that holds at time ``t`` [s]."""
        return int(np.searchsorted(np.asarray(self.events), t + 1e-9, side="right"))


#: What holds where no schedule was set: one mode forever.
DEFAULT = ModeSchedule((Mode("default"),))
