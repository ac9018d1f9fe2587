"""Compensates dry friction of velocity-controlled drives, and smooths positions of encoders that are read before their message.

A drive follows a command with a first-order lag and turns slower than commanded by a constant speed, in either direction: a
proportional velocity servo lags by friction over gain.

What a swerve robot's drives make of commands: their first-order lag, and the arm's sag under loads that are not fed forward.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.compilation import step
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.tracking_step import learn_sag
from wbmpc.checks import not_negative, positive
from wbmpc.control.direct import lag_share
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.step import bind, zeros
from wbmpc.model.robot import RobotModel

#: Time [s] over which the arm's sag is learned, longer than drives lag; the most that is taken for it [rad/s].
SAG_TIME, MAX_SAG = 1.0, 0.15


class DriveModel:
    """Drives of first order with a ``lag`` [s]. ``rates`` (nu): what they make of the commands now; the planned steering has no
    lag, so its rates are 0 where ``planned_steering``; ``turning`` (n) [rad/s]: of the steering drives in any case. ``arrays``: both,
    which :mod:`wbmpc.bases.swerve.tracking_step` writes."""

    def __init__(self, robot: RobotModel, period: float, lag: float, planned_steering: bool) -> None:
        self.lag, self.blend = lag, lag_share(period, lag)
        self.arrays = {"rates": np.zeros(robot.input.size), "turning": np.zeros(swerve_base(robot).geometry.modules)}
        self.rates, self.turning = self.arrays["rates"], self.arrays["turning"]


class ArmDrives:
    """The arm's ``count`` drives. ``sag`` (m) [rad/s]: by what joints turn besides their commands; ``command`` (m), the last one;
    ``rate`` and ``mean`` (m): what lagging drives make of the commands now and over the last period. ``arrays``: these."""

    def __init__(self, count: int, period: float, lag: float) -> None:
        self._period, self._lag, self._blend = period, lag, lag_share(period, lag)
        self.arrays = {name: np.zeros(count) for name in ("sag", "command", "rate", "mean", "turned")}
        self.sag, self.command, self.mean = (self.arrays[name] for name in ("sag", "command", "mean"))
        self._learn = bind(learn_sag, self.arrays, m=count, largest=MAX_SAG)

    def learn(self, turned: Array, h: float) -> None:
        """The sag from what the joints ``turned`` (m) [rad] in h [s] and what drives should have made of the commands."""
        if h > 0.0:
            self.arrays["turned"][:] = turned
            self._learn(float(1.0 - np.exp(-h / SAG_TIME)), h)

    def follow(self, command: Array) -> None:
        """A period under a command (m) [rad/s]."""
        a = self.arrays
        behind = a["rate"] - command
        a["command"][:], a["mean"][:] = command, command + behind * self._blend * self._lag / self._period
        a["rate"][:] = command + behind * (1.0 - self._blend)


#: Time [s] of turning over which friction is learned; the most that is taken for it, speeds below which a drive may stick and
#: shows nothing, and below which the sign of a command is not trusted [rad/s].
LEARNED_IN, MAXIMUM, TURNS, SLOW = 1.0, 0.1, 0.05, 0.02


class Friction(NamedTuple):
    """Drives (n) with a lag, and their dry friction."""

    n: int
    droop: Floats  # (n) [rad/s], what friction takes
    command: Floats  # (n) [rad/s]
    rate: Floats  # (n) [rad/s], what drives make of it at the end of a period
    mean: Floats  # (n) [rad/s], and on the average of it
    turned: Floats  # (n) [rad], measured
    target: Floats  # (n) [rad/s]
    maximum: Floats  # (n) [rad/s], of the command
    change: Floats  # (n) [rad/s], of the command in a period, at most
    blend: float  # share of the way to a command that drives go in a period
    late: float  # blend · lag / period


@step
def learn(f: Friction, h: float) -> None:
    """``droop`` from joints that ``turned`` in h [s] while ``mean`` was to be expected."""
    mean, droop = f.mean, f.droop
    share = 1.0 - np.exp(-h / LEARNED_IN)
    for i in range(f.n):
        if abs(mean[i]) > TURNS:
            lacks = mean[i] - f.turned[i] / h
            if mean[i] < 0.0:
                lacks = -lacks
            droop[i] = min(max(droop[i] + share * (lacks - droop[i]), 0.0), MAXIMUM)


@step
def drive(f: Friction) -> None:
    """The ``command`` for a ``target``, and what drives make of it."""
    command, rate, target, maximum, change = f.command, f.rate, f.target, f.maximum, f.change
    for i in range(f.n):
        given = target[i] + f.droop[i] * min(max(target[i] / SLOW, -1.0), 1.0)
        given = min(max(given, -maximum[i]), maximum[i])
        given = min(max(given, command[i] - change[i]), command[i] + change[i])
        behind = rate[i] - given
        command[i], f.mean[i], rate[i] = given, given + behind * f.late, given + behind * (1.0 - f.blend)


@step
def smooth(
    n: int, read: Floats, rates: Floats, value: Floats, started: bool, age: float, time: float, h: float
) -> None:
    """``value`` (n): positions at a message, whose encoders ``read`` (n) ``age`` [s] before it on average, h [s] after the message before
    (``started``: there was one); ``rates`` (n): what drives should have moved at. Messages correct it over ``time`` [s]."""
    share = 1.0 - np.exp(-h / time)
    for i in range(n):
        now = read[i] + rates[i] * age
        if not started:
            value[i] = now
        elif h > 0.0:
            carried = value[i] + rates[i] * h
            value[i] = carried + share * (now - carried)


class DryFriction:
    """Dry friction of n drives: estimated from their measured motion, and compensated in their commands.

    ``period`` [s] of the commands, ``lag`` [s] of the drives. ``droop`` (n) [rad/s]: by how much each turns slower than commanded.
    """

    def __init__(self, count: int, period: float, lag: float) -> None:
        positive("dry friction", period=period)
        not_negative("dry friction", lag=lag)
        a = self._arrays = zeros(Friction, count)
        blend = lag_share(period, lag)
        self._learn, self._drive = (
            bind(step, a, n=count, blend=blend, late=blend * lag / period) for step in (learn, drive)
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
    ``value`` (n), as in :func:`smooth`; ``value`` is the one of the last message. ``started``: there has been a
    message.
    """

    def __init__(self, time: float, age: float, count: int) -> None:
        positive("smoothing", time=time)
        not_negative("smoothing", age=age)
        self.time, self.age, self.started = time, age, False
        self.arrays = {name: np.zeros(count) for name in ("read", "rates", "value")}
        self._smooth = bind(smooth, self.arrays, n=count, age=age, time=time)

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
