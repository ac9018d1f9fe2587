"""Magnetic brakes on the joints of the legs: dry friction that rises and falls in time, and faults.

Each brake holds its torque (200 N m, Pankert et al., RA-L 2022, section II-C) and slips beyond it; that of a slide holds as much force
as there is at the end of a leg of 0.4 m then. Between open and closed
the torque changes linearly over ``delay``, an assumption: the data sheet's times were not available.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.errors import InputError, unknown_name

State = Literal["open", "opening", "closing", "closed"]
#: Torque [N m] that the brake of a hinge holds, force [N] that that of a slide does.
BRAKE_TORQUE, BRAKE_FORCE = 200.0, 500.0
_STUCK = {"open": 0.0, "closed": 1.0}


class Brakes:
    """n brakes, closed at the start. ``delay`` [s] from open to closed and back; ``engaged`` (n): 0 open to 1 closed; ``held`` (n) [N m]:
    what they can hold now; ``rests``: whether all are what they shall be."""

    def __init__(self, n: int, delay: float = 0.0, torque: ArrayLike = BRAKE_TORQUE) -> None:
        self.delay = delay
        self.torque: Array = np.asarray(torque, float)
        self.engaged: Array = np.ones(n)
        self._target: Array = np.ones(n)
        self._asked: list[float] | None = None
        self._stuck: dict[int, float] = {}
        self.held: Array = self.torque * self.engaged
        self.rests = False

    def command(self, brake: ArrayLike) -> None:
        """What each brake (n) shall be: 1 open, 0 closed."""
        asked = np.asarray(brake, float).tolist()
        if asked == self._asked:  # as at most ticks
            return
        target = np.where(np.asarray(brake, float) > 0.5, 0.0, 1.0)
        if (target != self._target).any():
            self._target, self.rests = target, False
        self._asked = asked

    def fail(self, leg: int, kind: str | None) -> None:
        """A brake that no longer answers: "open" or "closed" for good; None repairs it."""
        if not 0 <= leg < self.engaged.size:
            raise InputError(f"brakes: there is no leg {leg}; valid: 0 to {self.engaged.size - 1}")
        self.rests = False
        if kind is None:
            self._stuck.pop(leg, None)
            return
        if kind not in _STUCK:
            raise unknown_name("fault of a brake", kind, _STUCK)
        self._stuck[leg] = _STUCK[kind]

    def advance(self, h: float) -> Array:
        """Torques (n) [N m] that the brakes can hold after h [s]."""
        if self.rests:
            return self.held
        target = self._target.copy()
        for leg, value in self._stuck.items():
            target[leg] = value
        step = h / self.delay if self.delay > h else 1.0
        self.engaged = self.engaged + np.clip(target - self.engaged, -step, step)
        self.held, self.rests = self.torque * self.engaged, bool((target == self.engaged).all())
        return self.held

    @property
    def states(self) -> list[State]:
        return [self._word(e, w) for e, w in zip(self.engaged, self._target, strict=True)]

    @staticmethod
    def _word(engaged: float, target: float) -> State:
        if engaged >= 1.0:
            return "closed"
        if engaged <= 0.0:
            return "open"
        return "closing" if target > 0.5 else "opening"
