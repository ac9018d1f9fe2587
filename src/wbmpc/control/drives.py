"""What drives that follow speeds make of commands, and what encoders that are read a little before their message show of it.

A first-order lag delays a command; dry friction takes a constant speed off it (a servo that gives gain times the missing speed
turns slower than commanded by friction over gain), in whichever direction it turns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import not_negative, positive
from wbmpc.control.drive_step import Friction, drive, learn, smooth
from wbmpc.kernel.step import Backend, bind, zeros

Array = NDArray[np.float64]


class DryFriction:
    """Of n drives, learned from what they turn and given back to their commands.

    ``period`` [s] of the commands, ``lag`` [s] of the drives. ``droop`` (n) [rad/s]: by what each turns slower than commanded.
    ``backend``: machine code (:mod:`wbmpc.control.drive_step`), or the same source as ordinary Python.
    """

    def __init__(self, count: int, period: float, lag: float, backend: Backend = "compiled") -> None:
        positive("dry friction", period=period)
        not_negative("dry friction", lag=lag)
        a = self._arrays = zeros(Friction, count)
        blend = float(1.0 - np.exp(-period / lag)) if lag > 0.0 else 1.0
        self._learn, self._drive = (
            bind(step, a, backend, n=count, blend=blend, late=blend * lag / period) for step in (learn, drive)
        )
        self._within: tuple[Array | float | None, Array | float | None] = (None, None)

    @property
    def droop(self) -> Array:
        """(n) [rad/s]."""
        return self._arrays["droop"].copy()

    @droop.setter
    def droop(self, droop: Array) -> None:
        self._arrays["droop"][:] = droop

    def learn(self, turned: Array, h: float) -> None:
        """From joints that turned by ``turned`` (n) [rad] in h [s], under the last command."""
        if h > 0.0:
            self._arrays["turned"][:] = turned
            self._learn(h)

    def command(self, target: Array, maximum: Array | float, step: Array | float) -> Array:
        """Commands for the drives (n) [rad/s] so that they turn as ``target`` (n), within ± ``maximum`` and by no more than ``step``
        beside the command before. Slow ones get a share, or they would chatter about a standstill."""
        a = self._arrays
        if maximum is not self._within[0] or step is not self._within[1]:  # the same ones at every tick
            a["maximum"][:], a["change"][:] = maximum, step
            self._within = maximum, step
        a["target"][:] = target
        self._drive()
        return a["command"].copy()


class Smoothing:
    """Positions (n) at the moment of a message, from encoders whose values are up to some milliseconds old, ``age`` [s] on average.

    Values that are age × speed behind, with another age in each message, are noise of a known mean. What the drives should have
    done carries the positions on, and messages correct them over ``time`` [s]. ``arrays``: ``read``, ``rates`` and ``value`` (n) by their
    names in :func:`wbmpc.control.drive_step.smooth`; ``value`` is that of the last message once it has ``started``.
    """

    def __init__(self, time: float, age: float, count: int, backend: Backend = "compiled") -> None:
        positive("smoothing", time=time)
        not_negative("smoothing", age=age)
        self.time, self.age, self.started = time, age, False
        self.arrays = {name: np.zeros(count) for name in ("read", "rates", "value")}
        self._smooth = bind(smooth, self.arrays, backend, n=count, age=age, time=time)

    @property
    def value(self) -> Array | None:
        """The positions (n), None before the first message."""
        return self.arrays["value"].copy() if self.started else None

    def update(self, measured: Array, rates: Array, h: float) -> Array:
        """After h [s] in which drives should have moved at ``rates`` (n)."""
        a = self.arrays
        a["read"][:], a["rates"][:] = measured, rates
        self._smooth(self.started, h)
        self.started = True
        return a["value"].copy()
