"""Messages of a swerve base with global poses, read from the channels of a log: what a calibration starts from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.run_files import TEXTS

#: Times of channels that differ by less [s] are the same (a microsecond's rounding, or single precision, is no other time).
SAME = 1e-4
#: A pose so little [s] before the first message or after the last counts there if the base stands: over so long [s] of messages
#: its wheels and legs turn by less than this [rad].
BESIDE, STANDS, STILL = 2.0, 0.2, 2e-3


@dataclass(frozen=True)
class WheelRecord:
    """Messages at ``times`` (k) [s]: ``leg`` (k, n or 0), ``steer``, ``wheel`` (k, n) [rad] as the encoders gave them, ``gyro`` (k)
    [rad/s] mean yaw rate since the message before (empty without a gyro), ``brake`` (k, n) of the hinges by then, 1 = open
    (empty: closed, or not known: motions of the legs count, but show nothing of the wheels). Global poses:
    ``place_times`` (m) [s] to which they belong, ``places`` (m, 3) x, y, yaw, ``place_std`` (m, 3) their standard deviations."""

    times: Array
    leg: Array
    steer: Array
    wheel: Array
    place_times: Array
    places: Array
    place_std: Array
    gyro: Array = field(default_factory=lambda: np.zeros(0))
    brake: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def of(cls, channels: Mapping[str, Array], where: str = "log") -> WheelRecord:
        """From the channels of a run's log.npz: ``steer``, ``wheel``, ``leg`` (hinged legs), ``gyro`` and ``brake`` (may be
        missing), all with the times ``steer.time``, and ``place`` with rows (x, y, yaw, standard deviations) and its own times, in
        any order. A pose up to 2 s before the first message or after the last, as of a survey, counts there if the base stands.
        Raises :class:`InputError`."""
        for name in ("steer", "wheel", "place"):
            if name not in channels or f"{name}.time" not in channels:
                known = sorted(c for c in channels if not c.endswith((".time", *TEXTS)))
                raise InputError(
                    f"{where}: there is no channel '{name}' with its '{name}.time'; a calibration needs steer, wheel and place "
                    f"(global poses: of a localization or a survey); this one has: {', '.join(known)}"
                )
        read = lambda name: _read(channels, name, where)
        times, steer, wheel = read("steer.time"), read("steer"), read("wheel")
        leg = read("leg") if "leg" in channels else np.zeros((len(times), 0))
        gyro = read("gyro") if "gyro" in channels else np.zeros(0)
        brake = read("brake") if "brake" in channels else np.zeros((times.size, 0))
        if times.ndim != 1 or times.size < 2 or (np.diff(times) < 0.0).any():
            raise InputError(
                f"{where}: channel 'steer.time': two or more times are needed, none before the one before it"
            )
        if steer.ndim != 2 or len(steer) != times.size:
            raise InputError(
                f"{where}: channel 'steer': one row for each of {times.size} times is needed, got {steer.shape}"
            )
        shapes = {"wheel": (steer.shape,), "leg": (steer.shape, (times.size, 0)), "gyro": (times.shape, (0,))}
        shapes["brake"] = shapes["leg"]
        for name, values in (("wheel", wheel), ("leg", leg), ("gyro", gyro), ("brake", brake)):
            if values.shape not in shapes[name]:
                raise InputError(
                    f"{where}: channel '{name}' must have the same times as 'steer', and its shape be {shapes[name][0]}, "
                    f"got {values.shape}"
                )
        for name in ("wheel", "leg", "gyro", "brake"):
            if f"{name}.time" in channels:
                _reject_other_times(read(f"{name}.time"), times, name, where)
        place, at = read("place"), read("place.time")
        if place.ndim != 2 or place.shape[1] != 6 or len(place) < 2 or at.shape != (len(place),):
            raise InputError(
                f"{where}: channel 'place': rows of x, y, yaw and their 3 standard deviations are needed, two or more, each "
                f"with its time, got {place.shape} and {at.shape}"
            )
        if (place[:, 3:] <= 0.0).any():
            raise InputError(
                f"{where}: channel 'place': standard deviations must be positive (a survey is not exact either)"
            )
        order = np.argsort(at, kind="stable")
        at = _beside(at[order], times, np.concatenate([wheel, leg], axis=1), where)
        return cls(times, leg, steer, wheel, at, place[order, :3], place[order, 3:], gyro, brake)


def _read(channels: Mapping[str, Array], name: str, where: str) -> Array:
    """A channel as finite numbers, or :class:`InputError`."""
    try:
        values = np.asarray(channels[name], float)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if not np.isfinite(values).all():
        raise InputError(f"{where}: channel '{name}': finite numbers are needed")
    return values


def _reject_other_times(own: Array, times: Array, name: str, where: str) -> None:
    """Raise :class:`InputError` for a channel whose ``own`` times [s] are not the ``times`` (k) of the steering."""
    if own.shape != times.shape:
        raise InputError(
            f"{where}: channel '{name}.time' must be the same as 'steer.time': {times.size} times, got {own.shape}"
        )
    apart = float(np.max(np.abs(own - times)))
    if apart > SAME:
        raise InputError(
            f"{where}: channel '{name}.time' must be the same as 'steer.time', and is up to {apart:.3g} s beside it; bring both to "
            "the same times first"
        )


def _beside(at: Array, times: Array, turned: Array, where: str) -> Array:
    """Times of poses (m) [s], moved into the record where they are a little beside it and wheels and legs ``turned`` (k, n) [rad]
    stand; :class:`InputError` for others beside it."""
    previous, after = at < times[0], at > times[-1]
    starts, ends = times <= times[0] + STANDS, times >= times[-1] - STANDS
    for beside, part, gap in ((previous, starts, times[0] - at), (after, ends, at - times[-1])):
        if not beside.any():
            continue
        moves = part.sum() < 2 or np.ptp(turned[part], axis=0).max() > STILL
        if moves or gap[beside].max() > BESIDE:
            why = "the base moves there" if moves else f"up to {gap[beside].max():.3g} s, more than {BESIDE:g} s"
            raise InputError(
                f"{where}: channel 'place': {beside.sum()} of {at.size} global poses are {'before' if part is starts else 'after'} "
                f"the record of the wheels ({times[0]:.6g} to {times[-1]:.6g} s; {why}): they cannot be used, leave them out"
            )
    return np.clip(at, times[0], times[-1])
