"""What the runner checks: finite numbers, ages; and the horizon of the latency compensation."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from numbers import Integral, Real
from typing import Any

import numpy as np

from wbmpc.errors import InputError, RunAborted

#: Differences of times [s] below this are none.
ROUNDING = 1e-9
#: Greatest time [s] and rate [Hz] that make sense.
_MAXIMUM = 1e6


class SafeStop(RunAborted):
    """The robot has to stop, and why."""


@dataclasses.dataclass(frozen=True)
class RealTimeSettings:
    """Settings of the real-time runner.

    ``control_rate`` [Hz]; ``max_policy_age`` [s] after a policy became active (left out: its horizon), ``max_observation_age`` [s]
    of what the robot measured, ``patience`` [s]: for the first policy; beyond any of them the robot is stopped. ``watchdog`` [s]: a
    tick that hangs longer than this stops the robot from another thread. Latency: the ``percentile`` [%] of the last ``window`` delays
    from observation to finished policy, plus ``margin`` [s], in whole ticks, at most ``max_latency`` [s]. ``offset`` [s]: by how much
    the MPC's ticks follow the controller's (left out: a fifth of the controller's period). ``records``: samples kept of each figure.
    ``priority`` of the control thread in the kernel's real-time class (0: as the process).
    ``keep_last_policy``: an MPC that fails or is late does not stop the robot, for one that balances would fall: its controller goes on with
    the last policy.
    """

    control_rate: float = 400.0
    max_policy_age: float | None = None
    max_observation_age: float = 0.05
    patience: float = 10.0
    watchdog: float = 0.1
    percentile: float = 95.0
    window: int = 200
    margin: float = 2e-4
    max_latency: float = 0.1
    offset: float | None = None
    records: int = 100_000
    priority: int = 0
    keep_last_policy: bool = False

    def __post_init__(self) -> None:
        above = "a number above 0 and at most 1e6"
        positive = lambda v: 0.0 < v <= _MAXIMUM
        for name in ("control_rate", "max_observation_age", "patience", "watchdog", "max_latency"):
            self._check(name, Real, positive, above)
        if self.max_policy_age is not None:
            self._check("max_policy_age", Real, positive, f"{above}, or left out")
        self._check("percentile", Real, lambda v: 0.0 < v <= 100.0, "a number above 0 and at most 100")
        self._check("margin", Real, lambda v: 0.0 <= v <= _MAXIMUM, "a number from 0 to 1e6")
        for name in ("window", "records"):
            self._check(name, Integral, lambda v: 1 <= v <= 100 * _MAXIMUM, "a whole number from 1 to 1e8")
        self._check("priority", Integral, lambda v: 0 <= v <= 99, "a whole number from 0 (none) to 99")
        if self.offset is not None:  # an MPC that begins after that is of no use
            self._check(
                "offset", Real, lambda v: 0.0 <= v < self.patience, "a number from 0 to below patience, or left out"
            )
        if not isinstance(self.keep_last_policy, bool):
            raise InputError(f"real time: keep_last_policy must be True or False, got {self.keep_last_policy!r}")

    def _check(self, name: str, kind: type, allowed: Callable[[Any], bool], valid: str) -> None:
        """Raise :class:`InputError` unless the field is such a number; neither nan nor a truth value is one."""
        value = getattr(self, name)
        if isinstance(value, bool) or not isinstance(value, kind) or not allowed(value):
            raise InputError(f"real time: {name} must be {valid}, got {value!r}")

    @property
    def period(self) -> float:
        """Of the controller [s]."""
        return 1.0 / self.control_rate

    @property
    def mpc_offset(self) -> float:
        """``offset`` or its default [s]."""
        return 0.2 * self.period if self.offset is None else self.offset


class CommandCheck:
    """Raises :class:`SafeStop` for a command that is not there, is not made of finite numbers, or is not like the first one.

    Arrays of a dataclass that are empty unless they are given may come and go (none asked for).
    """

    def __init__(self) -> None:
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._kind: type | None = None

    def __call__(self, command: Any) -> None:
        if command is None:
            raise SafeStop("the controller gave no command")
        if self._kind is None:
            self._kind = type(command)
        if type(command) is not self._kind:
            raise SafeStop(f"command is of type {type(command).__name__}, the first one was a {self._kind.__name__}")
        self._check("command", command, False)

    def _check(self, name: str, value: Any, optional: bool) -> None:
        if dataclasses.is_dataclass(value):
            for field in dataclasses.fields(value):
                required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
                self._check(f"{name}.{field.name}", getattr(value, field.name), not required)
            return
        if value is None and optional:
            return
        try:
            numbers = np.asarray(value, float)
        except (TypeError, ValueError):
            raise SafeStop(f"{name} is not made of numbers, got {value!r:.50}") from None
        if not np.isfinite(numbers).all():
            raise SafeStop(f"{name} is not finite")
        if numbers.size == 0 and optional:
            return
        shape = self._shapes.setdefault(name, numbers.shape)
        if numbers.shape != shape:
            raise SafeStop(f"{name} has shape {numbers.shape}, the first one had {shape}")


class Latency:
    """How many control ticks ahead an observation has to be predicted so that its policy is ready in time."""

    def __init__(self, settings: RealTimeSettings) -> None:
        self.settings = settings
        self._ring = np.zeros(settings.window)
        self._count = 0
        self.ticks = 1

    def add(self, delay: float) -> None:
        """One measured delay [s] from observation to finished policy."""
        s = self.settings
        self._ring[self._count % s.window] = delay
        self._count += 1
        if self._count < 20 or self._count % 10 == 0:
            wait = sorted(self._ring[: min(self._count, s.window)].tolist())
            high = wait[math.ceil(s.percentile / 100.0 * len(wait)) - 1]
            ticks = math.ceil((min(high + s.margin, s.max_latency)) / s.period - 1e-9)
            self.ticks = max(ticks, 1)


def not_finite(name: str, value: Any) -> str | None:
    """Which part of a number, an array or a dataclass of them is not finite; None if all are. What is None is not there."""
    if value is None:
        return None
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            found = not_finite(f"{name}.{field.name}", getattr(value, field.name))
            if found is not None:
                return found
        return None
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        return None if np.isfinite(value).all() else name
    if isinstance(value, (float, int)):
        return None if math.isfinite(value) else name
    return None if np.isfinite(np.asarray(value, float)).all() else name


def check_measurement(measurement: Any, now: float, limit: float) -> None:
    """Raise :class:`SafeStop` if a measurement is not finite, or its time [s] is further than a limit [s] from ``now`` [s]."""
    bad = not_finite("measurement", measurement)
    if bad is not None:
        raise SafeStop(f"{bad} is not finite")
    age = now - float(measurement.time)
    if age > limit + ROUNDING:
        raise SafeStop(f"the measurement is {age:.3f} s old, the limit is {limit:g} s")
    if age < -limit:
        raise SafeStop(f"the measurement is from {-age:.3f} s ahead: its time is not the runner's")


def check_held_up(late: float, took: float, limit: float) -> None:
    """A process that was held up as a whole goes on with all threads at once: the watchdog may look too late to see it. Raises
    :class:`RunAborted` for a tick that begins later [s] or takes longer [s] than a limit [s]."""
    if max(late, took) > limit:
        what = f"began {late:.3f} s late" if late > limit else f"took {took:.3f} s"
        raise RunAborted(
            f"a tick of the controller {what}, the limit is {limit:g} s: the machine is too busy, or the process was held up"
        )
