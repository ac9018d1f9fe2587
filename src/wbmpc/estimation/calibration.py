"""Self-calibration of a swerve base's wheels from a recorded run with global poses.

The poses come from a localisation, or from a survey of a short reference drive (two poses, one before and one after a
stroke, are enough for the directions that the drive shows). The filter of :mod:`wbmpc.estimation.fused` runs over the
record; what it then believes of the wheels is the calibration, with its covariance: directions that the drive does not
show keep the uncertainty that they had.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wbmpc.errors import InputError
from wbmpc.estimation.fused import FusedOdometry, OdometryNoise
from wbmpc.estimation.wheels import WheelCalibration
from wbmpc.model.swerve import SwerveGeometry

Array = NDArray[np.float64]
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
        missing), and ``place`` with rows (x, y, yaw, standard deviations), each with its ``.time``, in any order. A pose up to 2 s
        before the first message or after the last, as of a survey, counts there if the base stands. Raises :class:`InputError`."""
        for name in ("steer", "wheel", "place"):
            if name not in channels or f"{name}.time" not in channels:
                known = sorted(c for c in channels if not c.endswith(".time"))
                raise InputError(
                    f"{where}: there is no channel '{name}' with its '{name}.time'; a calibration needs steer, wheel and place "
                    f"(global poses: of a localisation or a survey); this one has: {', '.join(known)}"
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


def _beside(at: Array, times: Array, turned: Array, where: str) -> Array:
    """Times of poses (m) [s], moved into the record where they are a little beside it and wheels and legs ``turned`` (k, n) [rad]
    stand; :class:`InputError` for others beside it."""
    before, after = at < times[0], at > times[-1]
    starts, ends = times <= times[0] + STANDS, times >= times[-1] - STANDS
    for beside, part, gap in ((before, starts, times[0] - at), (after, ends, at - times[-1])):
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


def replay(
    geometry: SwerveGeometry,
    record: WheelRecord,
    *,
    prior: WheelCalibration | None = None,
    noise: OdometryNoise | None = None,
) -> FusedOdometry:
    """The filter after a record: its ``calibration``, and how many global poses were ``taken``. They come as soon as they are true.

    ``prior``: what was known before (:meth:`WheelCalibration.unknown` when left out). Raises :class:`InputError` for a record of
    another base, and where fewer than two poses fit.
    """
    if record.steer.ndim != 2 or record.steer.shape[1] != geometry.modules:
        raise InputError(
            f"log: the robot has {geometry.modules} modules, the channel 'steer' is of shape {record.steer.shape}"
        )
    doubt = np.maximum(10.0 * record.place_std[0], 0.05)
    odometry = FusedOdometry(geometry, record.places[0], calibration=prior, noise=noise, pose_std=doubt)
    place = 0
    for k, t in enumerate(record.times):
        gyro = float(record.gyro[k]) if record.gyro.size else None
        brake = record.brake[k] if record.brake.size else None
        odometry.update(float(t), record.leg[k], record.steer[k], record.wheel[k], gyro, brake)
        while place < len(record.place_times) and record.place_times[place] <= t:
            odometry.correct(
                float(record.place_times[place]), record.places[place], np.diag(record.place_std[place] ** 2)
            )
            place += 1
    if odometry.taken < 2:
        raise InputError(
            f"log: {odometry.taken} of {len(record.places)} global poses fit what wheels and gyro say; two or more are needed"
        )
    return odometry


def calibrate(
    geometry: SwerveGeometry,
    record: WheelRecord,
    *,
    prior: WheelCalibration | None = None,
    noise: OdometryNoise | None = None,
) -> WheelCalibration:
    """Steer zeros and wheel radii that a record shows, with their covariance; arguments and errors of :func:`replay`."""
    return replay(geometry, record, prior=prior, noise=noise).calibration
