"""The controller of `swerve-track`: it compensates dry friction of its drives, and smooths positions of encoders that are read before their
message.

A drive follows a command with a first-order lag and turns slower than commanded by a constant speed, in either direction: a
proportional velocity servo lags by friction over gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.estimator import EstimatorSettings, SwerveEstimator
from wbmpc.bases.swerve.messages import SwerveMeasurement
from wbmpc.bases.swerve.model import swerve_base
from wbmpc.bases.swerve.odometry_filter import OdometryNoise
from wbmpc.bases.swerve.tracking import SwerveTracking, TrackingSettings
from wbmpc.checks import not_negative, positive
from wbmpc.control.direct import lag_share
from wbmpc.kernel.ir import Floats
from wbmpc.kernel.library import Library
from wbmpc.kernel.step import bind, zeros

LIBRARY = Library(
    "controller of swerve-track", packages=("kernel", "studies/pankert2022/track_control.py"), modules=(__name__,)
)
step = LIBRARY.step

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


class Speeds(NamedTuple):
    """How fast base and arm move."""

    drives: Floats  # (nu), rates of the inputs
    mean: Floats  # (m) [rad/s], of the arm
    sag: Floats  # (m) [rad/s], beyond that


class Smoothed(NamedTuple):
    """Of x, y and the arm (2 + m each): what was read, how fast it changes, and its value."""

    read: Floats
    rates: Floats
    value: Floats


@step
def smooth_pose(
    m: int,
    base: int,
    pose: Floats,
    arm: Floats,
    speeds: Speeds,
    smoothed: Smoothed,
    started: bool,
    age: float,
    time: float,
    h: float,
) -> None:
    """x and y of the base's ``pose`` (3) and the ``arm`` (m) are ``smoothed``. The base's ``drives`` begin at ``base``."""
    drives, read, rates = speeds.drives, smoothed.read, smoothed.rates
    c, s = np.cos(pose[2]), np.sin(pose[2])
    vx, vy = drives[base], drives[base + 1]
    rates[0], rates[1] = c * vx - s * vy, s * vx + c * vy
    read[0], read[1] = pose[0], pose[1]
    for i in range(m):
        rates[2 + i], read[2 + i] = speeds.mean[i] + speeds.sag[i], arm[i]
    smooth(2 + m, read, rates, smoothed.value, started, age, time, h)


@dataclass(frozen=True)
class TrackTracking(TrackingSettings):
    """``friction``: whether the dry friction of wheels and steering is estimated and compensated."""

    friction: bool = True


@dataclass(frozen=True)
class TrackEstimation(EstimatorSettings):
    """``smoothing`` [s] of base position and arm against the jitter of the encoders' age (0: none)."""

    smoothing: float = 0.0

    def __post_init__(self) -> None:
        not_negative("swerve robot's estimator", smoothing=self.smoothing)


class FrictionTracking(SwerveTracking):
    """The law whose drives get what friction takes of their commands besides."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        robot, limits, groups = self.robot, self.robot.limits, ("wheel", "steer")
        compensates = isinstance(self.settings, TrackTracking) and self.settings.friction
        modules = swerve_base(robot).geometry.modules
        self.friction = {
            g: DryFriction(modules, self.period, self.settings.lag) for g in (groups if compensates else ())
        }
        self._most = {
            g: (limits.actuator_upper[robot.input[g]], limits.input_rate[robot.input[g]] * self.period) for g in groups
        }

    def learn_friction(self, previous: SwerveMeasurement, now: SwerveMeasurement) -> None:
        """What dry friction takes, from one message to the next."""
        for group, drives in self.friction.items():
            drives.learn(getattr(now, group) - getattr(previous, group), now.time - previous.time)

    def rest(self) -> None:
        """A stop: the next commands start from rest."""
        super().rest()
        for drives in self.friction.values():
            drives.command(np.zeros(drives.droop.size), np.inf, np.inf)

    def driven(self, group: str, target: Array) -> Array:
        """With what friction takes of it."""
        if group not in self.friction:
            return super().driven(group, target)
        return self.friction[group].command(target, *self._most[group])


class SmoothedEstimator(SwerveEstimator):
    """The estimator whose positions of base and arm are those of the moment of a message."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        settings = args[2]
        self._smoothing: Smoothing | None = None
        if isinstance(settings, TrackEstimation) and settings.smoothing > 0.0:
            self._bind_smoothing(settings.smoothing, (settings.noise or OdometryNoise()).mean_age)

    def process(self, measurement: SwerveMeasurement) -> None:
        """Take in a message."""
        h = self.interval(self.measured or measurement, measurement)
        super().process(measurement)
        if self._smoothing is not None:
            self._read_arm[:] = measurement.arm
            self._smooth(self._smoothing.started, h)
            self._smoothing.started = True

    def _bind_smoothing(self, time: float, age: float) -> None:
        """Positions of the base and of the arm at the moment of a message."""
        inputs, arm = self.robot.input, self._arm_drives.arrays
        m = len(inputs.groups["arm"])
        self._smoothing = smoothing = Smoothing(time, age, 2 + m)
        self._read_arm, drives = np.zeros(m), {"drives": self._drives.rates, "mean": arm["mean"], "sag": arm["sag"]}
        own = {"pose": self.odometry.mean, "arm": self._read_arm}
        sizes = {"m": m, "base": inputs["base"].start}
        self._smooth = bind(smooth_pose, smoothing.arrays | drives | own, **sizes, age=age, time=time)

    @property
    def pose(self) -> Array:
        """(x, y, yaw) of the base that is controlled."""
        pose = super().pose
        if self._smoothing is not None and self._smoothing.started:
            pose[:2] = self._smoothing.arrays["value"][:2]
        return pose

    @property
    def arm(self) -> Array:
        """Angles (m) of the arm less their zeros, smoothed if they shall be."""
        smooth = None if self._smoothing is None else self._smoothing.value
        if smooth is None:
            return super().arm
        return smooth[2:] if self._arm_offset is None else smooth[2:] - self._arm_offset


class TrackController(SwerveController):
    """Settings of ``tracking`` and ``estimation`` may be :class:`TrackTracking` and :class:`TrackEstimation`."""

    Estimator, Tracking = SmoothedEstimator, FrictionTracking
    tracking: FrictionTracking

    def measure(self, measurement: SwerveMeasurement) -> None:
        """Take in the message of this tick."""
        previous = self.measured or measurement
        super().measure(measurement)
        self.tracking.learn_friction(previous, measurement)
