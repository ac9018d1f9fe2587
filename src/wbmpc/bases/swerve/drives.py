"""Compensates dry friction of velocity-controlled drives, and smooths positions of encoders that are read before their message.

A drive follows a command with a first-order lag and turns slower than commanded by a constant speed, in either direction: a
proportional velocity servo lags by friction over gain.
"""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.drive_step import Friction, drive, learn, smooth
from wbmpc.checks import not_negative, positive
from wbmpc.kernel.step import Backend, bind, zeros


class DryFriction:
    """Dry friction of n drives: estimated from their measured motion, and compensated in their commands.

    ``period`` [s] of the commands, ``lag`` [s] of the drives. ``droop`` (n) [rad/s]: by how much each turns slower than commanded.
    ``backend``: machine code (:mod:`wbmpc.bases.swerve.drive_step`), or the same source as ordinary Python.
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
        """By how much each drive turns slower than commanded (n) [rad/s]."""
        return self._arrays["droop"].copy()

    @droop.setter
    def droop(self, droop: Array) -> None:
        self._arrays["droop"][:] = droop

    def learn(self, turned: Array, h: float) -> None:
        """Update the estimate: the joints turned by ``turned`` (n) [rad] in h [s] under the last command."""
        if h > 0.0:
            self._arrays["turned"][:] = turned
            self._learn(h)

    def command(self, target: Array, maximum: Array | float, step: Array | float) -> Array:
        """Commands for the drives (n) [rad/s] that make them turn at ``target`` (n), within ± ``maximum`` and at most ``step`` from the
        previous command. At low speeds only a share of the friction is compensated: drives would chatter around standstill."""
        a = self._arrays
        if maximum is not self._within[0] or step is not self._within[1]:  # usually the same at every tick
            a["maximum"][:], a["change"][:] = maximum, step
            self._within = maximum, step
        a["target"][:] = target
        self._drive()
        return a["command"].copy()


class Smoothing:
    """Positions (n) at the time of a message, from encoders whose values are some milliseconds old, ``age`` [s] on average.

    The age varies from message to message, so a value has an error of speed × age: noise with a known mean. The expected motion of the
    drives predicts the positions, and messages correct them with the time constant ``time`` [s]. ``arrays``: ``read``, ``rates`` and
    ``value`` (n), as in :func:`wbmpc.bases.swerve.drive_step.smooth`; ``value`` is the one of the last message. ``started``: there has been a
    message.
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
        """The positions (n) after a message: ``measured`` (n), h [s] after the previous one; the drives should have moved at ``rates`` (n)."""
        a = self.arrays
        a["read"][:], a["rates"][:] = measured, rates
        self._smooth(self.started, h)
        self.started = True
        return a["value"].copy()
