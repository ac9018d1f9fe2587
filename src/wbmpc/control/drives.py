"""What drives that follow speeds make of commands, and what encoders that are read a little before their message show of it.

A first-order lag delays a command; dry friction takes a constant speed off it (a servo that gives gain times the missing speed
turns slower than commanded by friction over gain), in whichever direction it turns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import not_negative, positive

Array = NDArray[np.float64]

#: Time [s] of turning over which friction is learned; the most that is taken for it, speeds below which a drive may stick and
#: shows nothing, and below which the sign of a command is not trusted [rad/s].
LEARNED_IN, MAXIMUM, TURNS, SLOW = 1.0, 0.1, 0.05, 0.02


class DryFriction:
    """Of n drives, learned from what they turn and given back to their commands.

    ``period`` [s] of the commands, ``lag`` [s] of the drives. ``droop`` (n) [rad/s]: by what each turns slower than commanded.
    """

    def __init__(self, count: int, period: float, lag: float) -> None:
        positive("dry friction", period=period)
        not_negative("dry friction", lag=lag)
        self.droop: Array = np.zeros(count)
        self._command, self._rate, self._mean = np.zeros((3, count))
        self._blend = 1.0 - np.exp(-period / lag) if lag > 0.0 else 1.0
        self._late = self._blend * lag / period

    def learn(self, turned: Array, h: float) -> None:
        """From joints that turned by ``turned`` (n) [rad] in h [s], under the last command."""
        if h <= 0.0:
            return
        reject_missing_part = (self._mean - turned / h) * np.sign(self._mean)
        now = np.clip(self.droop + (1.0 - np.exp(-h / LEARNED_IN)) * (reject_missing_part - self.droop), 0.0, MAXIMUM)
        self.droop = np.where(np.abs(self._mean) > TURNS, now, self.droop)

    def command(self, target: Array, maximum: Array | float, step: Array | float) -> Array:
        """Commands for the drives (n) [rad/s] so that they turn as ``target`` (n), within ± ``maximum`` and by no more than ``step``
        beside the command before. Slow ones get a share, or they would chatter about a standstill."""
        command = target + self.droop * np.clip(target / SLOW, -1.0, 1.0)
        command = np.clip(np.clip(command, -maximum, maximum), self._command - step, self._command + step)
        behind = self._rate - command
        self._command, self._mean, self._rate = (
            command,
            command + behind * self._late,
            command + behind * (1.0 - self._blend),
        )
        return command


class Smoothing:
    """Positions (n) at the moment of a message, from encoders whose values are up to some milliseconds old.

    Values that are age × speed behind, with another age in each message, are noise of a known mean. What the drives should have
    done carries the positions on, and messages correct them over ``time`` [s].
    """

    def __init__(self, time: float) -> None:
        positive("smoothing", time=time)
        self.time = time
        self.value: Array | None = None

    def update(self, measured: Array, moved: Array, ahead: Array, h: float) -> Array:
        """After h [s] in which drives should have moved by ``moved`` (n); ``ahead`` (n): mean age × speed."""
        now = measured + ahead
        if self.value is None or h <= 0.0:
            self.value = now if self.value is None else self.value
        else:
            carried = self.value + moved
            self.value = carried + (1.0 - np.exp(-h / self.time)) * (now - carried)
        return self.value
