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


@dataclass(frozen=True)
class WheelRecord:
    """Messages at ``times`` (k) [s]: ``leg`` (k, n or 0), ``steer``, ``wheel`` (k, n) [rad] as the encoders gave them, ``gyro`` (k)
    [rad/s] mean yaw rate since the message before (empty without a gyro). Global poses: ``place_times`` (m) [s] to which
    they belong, ``places`` (m, 3) x, y, yaw, ``place_std`` (m, 3) their standard deviations."""

    times: Array
    leg: Array
    steer: Array
    wheel: Array
    place_times: Array
    places: Array
    place_std: Array
    gyro: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, channels: Mapping[str, Array], where: str = "log") -> WheelRecord:
        """From the channels of a run's log.npz: ``steer``, ``wheel``, ``leg`` (hinged legs), ``gyro`` (may be missing), and
        ``place`` with rows (x, y, yaw, standard deviations), each with its ``.time``. Raises :class:`InputError`."""
        for name in ("steer", "wheel", "place"):
            if name not in channels or f"{name}.time" not in channels:
                known = sorted(c for c in channels if not c.endswith(".time"))
                raise InputError(
                    f"{where}: there is no channel '{name}' with its '{name}.time'; a calibration needs steer, wheel and place "
                    f"(global poses: of a localisation or a survey); this one has: {', '.join(known)}"
                )
        times, place = np.asarray(channels["steer.time"], float), np.asarray(channels["place"], float)
        if place.ndim != 2 or place.shape[1] != 6 or len(place) < 2:
            raise InputError(
                f"{where}: channel 'place': rows of x, y, yaw and their 3 standard deviations are needed, two or more"
            )
        leg = np.asarray(channels.get("leg", np.zeros((len(times), 0))), float)
        gyro = np.asarray(channels.get("gyro", np.zeros(0)), float)
        steer, wheel = np.asarray(channels["steer"], float), np.asarray(channels["wheel"], float)
        for name, values in (("wheel", wheel), ("leg", leg), *((("gyro", gyro),) if gyro.size else ())):
            if len(values) != len(times):
                raise InputError(f"{where}: channels 'steer' and '{name}' must have the same times")
        at = np.asarray(channels["place.time"], float)
        return cls(times, leg, steer, wheel, at, place[:, :3], place[:, 3:], gyro)


def replay(odometry: FusedOdometry, record: WheelRecord) -> Array:
    """Run the filter over a record; poses (k, 3) after each message. Global poses come as soon as they are true."""
    poses, place = np.empty((len(record.times), 3)), 0
    for k, t in enumerate(record.times):
        gyro = float(record.gyro[k]) if record.gyro.size else None
        odometry.update(float(t), record.leg[k], record.steer[k], record.wheel[k], gyro)
        while place < len(record.place_times) and record.place_times[place] <= t:
            odometry.correct(
                float(record.place_times[place]), record.places[place], np.diag(record.place_std[place] ** 2)
            )
            place += 1
        poses[k] = odometry.pose
    return poses


def calibrate(
    geometry: SwerveGeometry,
    record: WheelRecord,
    *,
    prior: WheelCalibration | None = None,
    noise: OdometryNoise | None = None,
) -> WheelCalibration:
    """Steer zeros and wheel radii that a record shows, with their covariance.

    ``prior``: what was known before (:meth:`WheelCalibration.unknown` when left out).
    """
    if record.steer.ndim != 2 or record.steer.shape[1] != geometry.modules:
        raise InputError(
            f"log: the robot has {geometry.modules} modules, the channel 'steer' is of shape {record.steer.shape}"
        )
    doubt = np.maximum(10.0 * record.place_std[0], 0.05)
    odometry = FusedOdometry(geometry, record.places[0], calibration=prior, noise=noise, pose_std=doubt)
    replay(odometry, record)
    return odometry.calibration
