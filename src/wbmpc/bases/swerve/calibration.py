"""Self-calibration of a swerve base's wheels from a recorded run with global poses.

The poses come from a localization, or from a survey of a short reference drive (two poses, one before and one after a
stroke, are enough for the directions that the drive shows). The filter of :mod:`wbmpc.bases.swerve.fused_odometry` runs over the
record; what it then believes of the wheels is the calibration, with its covariance: directions that the drive does not
show keep the uncertainty that they had.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.bases.swerve.fused_odometry import FusedOdometry
from wbmpc.bases.swerve.odometry_filter import OdometryNoise
from wbmpc.bases.swerve.slipping_wheels import FEWEST, SHARE
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry, outlier_wheel
from wbmpc.bases.swerve.wheel_record import STILL, WheelRecord
from wbmpc.errors import InputError
from wbmpc.model.wheels import ModuleGeometry

_LOG = logging.getLogger("wbmpc")
#: Length [m] of pieces of the way, in which counts of encoders cancel; root mean square of what wheels contradict each other over their
#: way above which one is sought that hangs. What it counts then: hardly anything, as wheels that slip.
PIECE, CONTRADICTS, WEIGHT = 0.05, 0.005, 1e-3


def hanging_wheel(geometry: ModuleGeometry, record: WheelRecord, found: WheelCalibration) -> int | None:
    """The wheel that contradicts the others over a record, with the numbers that were ``found``: no zero and no radius explains
    it, and the others agree. None: there is none, or too few wheels to say which.

    A wheel in the air turns and rolls as it is commanded, and does not pull its leg along."""
    if geometry.modules < FEWEST:
        return None
    apart = _contradictions(geometry, record, found)
    if not len(apart) or np.mean(apart**2) < CONTRADICTS**2:
        return None
    legs = record.leg.mean(axis=0) if record.leg.size else np.zeros(geometry.modules)
    wheel, share = outlier_wheel(apart, geometry.steer_axes(legs))
    return wheel if share > SHARE else None


def weights_on_the_ground(geometry: ModuleGeometry, record: WheelRecord, found: WheelCalibration) -> Array | None:
    """Weights (n) that leave out the :func:`hanging_wheel`, with a warning; None: there is none."""
    wheel = hanging_wheel(geometry, record, found)
    if wheel is None:
        return None
    _LOG.warning(
        "log: wheel %d of %d contradicts the others as one does that hangs in the air: left out", wheel + 1, geometry.modules
    )  # fmt: skip
    return np.where(np.arange(geometry.modules) == wheel, WEIGHT, 1.0)


def _contradictions(geometry: ModuleGeometry, record: WheelRecord, found: WheelCalibration) -> Array:
    """(k, n, 2): by what wheels contradict each other over their way, in each piece of it."""
    wheels = WheelOdometry(
        geometry, wheel_radius=found.wheel_radius, leg_offset=found.leg_offset, steer_offset=found.steer_offset
    )
    rolled = np.abs(np.diff(record.wheel, axis=0)).mean(axis=1) * geometry.wheel_radius
    pieces, off, way = [], np.zeros((geometry.modules, 2)), 0.0
    for k, (steer, wheel) in enumerate(zip(record.steer, record.wheel, strict=True)):
        wheels.update(record.leg[k], steer, wheel)
        off, way = off + wheels.residual, way + (rolled[k - 1] if k else 0.0)
        if way >= PIECE:
            pieces.append(off / way)
            off, way = np.zeros((geometry.modules, 2)), 0.0
    return np.array(pieces)


def replay(
    geometry: ModuleGeometry, record: WheelRecord, *, prior: WheelCalibration | None = None, noise: OdometryNoise | None = None,
    weights: Array | None = None,
) -> FusedOdometry:  # fmt: skip
    """The filter once over a record: its ``calibration``, and how many poses were ``taken``. They come as soon as they are true.

    ``prior``: what was known before (:meth:`WheelCalibration.unknown` when left out); ``weights`` (n) of the wheels (left out: all
    alike). Raises :class:`InputError` for a record of another base: another number of modules, hinges that swing where the robot has
    none, or no leg angles where it has hinges.
    """
    if record.steer.ndim != 2 or record.steer.shape[1] != geometry.modules:
        raise InputError(
            f"log: the robot has {geometry.modules} modules, the channel 'steer' is of shape {record.steer.shape}"
        )
    _reject_other_legs(geometry, record)
    doubt = np.maximum(10.0 * record.place_std[0], 0.05)
    odometry = FusedOdometry(geometry, record.places[0], calibration=prior, noise=noise, pose_std=doubt)
    place = 0
    for k, t in enumerate(record.times):
        gyro = float(record.gyro[k]) if record.gyro.size else None
        brake = record.brake[k] if record.brake.size else None
        odometry.update(float(t), record.leg[k], record.steer[k], record.wheel[k], gyro, brake, weights)
        while place < len(record.place_times) and record.place_times[place] <= t:
            odometry.correct(
                float(record.place_times[place]), record.places[place], np.diag(record.place_std[place] ** 2)
            )
            place += 1
    return odometry


def _reject_other_legs(geometry: ModuleGeometry, record: WheelRecord) -> None:
    """Raise :class:`InputError` for legs that are not those of this base."""
    if geometry.legs_move:
        if record.leg.shape[1] == 0:
            raise InputError(
                "log: the robot's legs have hinges, and there is no channel 'leg' with their angles; valid: such a channel, or a "
                "robot with fixed legs"
            )
        return
    swung = float(np.ptp(record.leg, axis=0).max(initial=0.0))
    if swung > STILL or np.any(record.brake > 0.5):
        what = f"turn by {swung:.3g} rad" if swung > STILL else "have open brakes"
        raise InputError(
            f"log: the robot's legs are fixed, and those of the channel '{'leg' if swung > STILL else 'brake'}' {what}: this is a "
            "log of a robot with hinged legs"
        )


@dataclass(frozen=True)
class WheelFit:
    """What a record shows of the wheels: ``calibration``, of what was believed ``previous`` (its doubt wider than the one given where
    the record asked for it); which wheels (n) ``count``, the others were left out; global poses ``used`` and ``given``, and their
    ``deviance``, see :attr:`~wbmpc.bases.swerve.late_poses.LatePoses.deviance`."""

    calibration: WheelCalibration
    previous: WheelCalibration
    count: NDArray[np.bool_]
    used: int
    given: int
    deviance: float

    def mean_zero(self) -> tuple[float, float]:
        """Mean of the steer zeros of wheels that count, and its standard deviation [rad]."""
        found, n = self.calibration, self.calibration.modules
        return float(found.steer_offset[self.count].mean()), float(
            np.sqrt(found.covariance[:n, :n][np.ix_(self.count, self.count)].mean())
        )

    def hidden(self) -> dict[str, tuple[Array, Array]]:
        """Combinations of the numbers of wheels that count that the record did not show, of "steer zeros" and of "radii": weights (k, n) of norm
        1, and standard deviations (k) [rad, or relative] of the weighted sums, which are still what they were before."""
        out = {}
        for name, part in _PARTS(self.calibration.modules).items():
            root, shown, ways = _shown(self.previous, self.calibration, part)
            weights = ways.T[shown < SHOWN] @ np.linalg.pinv(root)
            weights = weights / np.linalg.norm(weights, axis=1, keepdims=True)
            weights = weights[np.sum(weights[:, self.count] ** 2, axis=1) > 0.5]
            covariance = weights @ self.calibration.covariance[part, part] @ weights.T
            out[name] = (weights, np.sqrt(np.diag(covariance)))
        return out


#: Steer zeros and radii in the covariance of n modules.
_PARTS: Callable[[int], dict[str, slice]] = lambda n: {"steer zeros": slice(0, n), "radii": slice(n, 2 * n)}


def _shown(previous: WheelCalibration, found: WheelCalibration, part: slice) -> tuple[Array, Array, Array]:
    """A root (n, k) of what was doubted before of a part, and there, in units of that doubt, the directions (columns) with the
    share of their variance that a record took away, ascending."""
    values, axes = np.linalg.eigh(previous.covariance[part, part])
    some = values > 1e-12 * max(values[-1], 1e-30)
    root = axes[:, some] * np.sqrt(values[some])
    back = np.linalg.pinv(root)
    left = back @ found.covariance[part, part] @ back.T
    shown, ways = np.linalg.eigh(np.eye(len(left)) - 0.5 * (left + left.T))
    return root, shown, ways


def _numbers(wheels: WheelCalibration, geometry: ModuleGeometry) -> Array:
    """Zeros [rad] and relative errors of radii (2n)."""
    return np.concatenate([wheels.steer_offset, wheels.wheel_radius / geometry.wheel_radius - 1.0])


def _surprise(previous: WheelCalibration, found: WheelCalibration, part: slice, apart: Array) -> float:
    """By how many of its standard deviations what was found is ``apart`` (2n) from before, in the direction of most."""
    root, shown, ways = _shown(previous, found, part)
    if shown.size == 0 or shown[-1] < SHOWN:
        return 0.0
    along = ways.T @ np.linalg.pinv(root) @ apart[part]
    return float(np.max(np.abs(along[shown >= SHOWN]) / np.sqrt(shown[shown >= SHOWN])))


#: A direction of which less than this share of its variance went away was not shown.
SHOWN = 0.1
#: Found so many standard deviations from what was believed: the belief was wrong. So much wider where only the poses say so.
SURPRISING, WIDER = 2.5, 5.0
#: Ratio of the wheels' contradiction to what their doubt explains; over many wheels and directions it is close to 1.
CROOKED = 1.5
#: Widest standard deviations [rad, relative] of what was believed before: beyond, no encoder is mounted and no tire made.
MAXIMUM = (0.2, 0.1)
#: Standard deviations [rad, relative] of wheels that are left out, at least.
LEFT_OUT = (0.04, 0.02)
#: Passes over a record; derivatives are good enough when the last pass moved by less than this share of the doubt.
PASSES, MOVED = 8, 0.1
#: Rejected share of the global poses, mean normalized squared error of the others (3 is expected), the wheels' contradiction over
#: their way: above this a record contradicts itself, and no numbers explain it.
REJECTED, MISFIT, ABSURD = 0.1, 9.0, 0.15


def fit_wheels(
    geometry: ModuleGeometry, record: WheelRecord, *, prior: WheelCalibration | None = None,
    noise: OdometryNoise | None = None,
) -> WheelFit:  # fmt: skip
    """Steer zeros and wheel radii that a record shows.

    The filter goes over the record again, from what it found, with more doubt of what was believed before, as long as what it
    found is more than ``SURPRISING`` standard deviations from that, or poses do not fit. Wheels that do not carry the base are left out,
    those off a :func:`carrying_diagonal` or one that hangs in the air, the latter with a warning (:data:`LEFT_OUT`).

    Raises :class:`InputError` for a record that still contradicts itself then (by its channel 'gyro', where it does not
    without it), or shows nothing; other arguments and errors as of :func:`replay`.
    """
    try:
        fit = _fitted(geometry, record, prior, noise)
        weights = weights_on_the_ground(geometry, record, fit.calibration)
        fit = fit if weights is None else _fitted(geometry, record, prior, noise, weights)
        return carrying_diagonal(geometry, record, fit, prior, noise) or fit
    except InputError:
        if _fits_without_gyro(geometry, record, prior, noise):
            raise InputError(
                "log: the channel 'gyro' contradicts wheels and global poses, which fit each other without it; the mean yaw rate "
                "since the row before is needed, in rad/s, positive to the left; or leave the channel out"
            ) from None
        raise


#: A deviance that is smaller by this says that a diagonal carries the base: the poses are e^35 times as likely.
MIN_DEVIANCE_DROP = 70.0


def carrying_diagonal(
    geometry: ModuleGeometry, record: WheelRecord, fit: WheelFit, prior: WheelCalibration | None,
    noise: OdometryNoise | None,
) -> WheelFit | None:  # fmt: skip
    """The fit to the two wheels of four that carry the base, where it explains the poses much better than the ``fit`` to all; else None.

    Radii that differ by fractions of a millimeter put most of the weight on one diagonal of a rigid base. Wheels that contradict each
    other slide, and friction is about as large as the load whatever the speed: the wheels with more load determine the motion, alone,
    and not the mean of all. A record in which each wheel is turned aside for a while shows which. Open hinges are no rigid base.
    """
    swung = np.ptp(record.leg, axis=0).max(initial=0.0) > STILL
    if geometry.modules != 4 or swung or np.any(record.brake > 0.5):
        return None
    legs = record.leg.mean(axis=0) if record.leg.size else np.zeros(4)
    # loads by which four wheels press each other against the floor: no force, no moments
    pressed = np.linalg.svd(np.column_stack([np.ones(4), geometry.steer_axes(legs)]).T)[2][-1]
    best, deviance = None, fit.deviance - MIN_DEVIANCE_DROP
    for side in (pressed, -pressed):
        if np.count_nonzero(side > 0.0) != 2:
            continue
        try:
            found = _fitted(geometry, record, prior, noise, np.where(side > 0.0, 1.0, WEIGHT))
        except InputError:
            continue
        if found.deviance < deviance:
            best, deviance = found, found.deviance
    return best


def _fits_without_gyro(
    geometry: ModuleGeometry, record: WheelRecord, prior: WheelCalibration | None, noise: OdometryNoise | None
) -> bool:
    if not record.gyro.any():
        return False
    try:
        _fitted(geometry, replace(record, gyro=np.zeros(0)), prior, noise)
    except InputError:
        return False
    return True


def _fitted(
    geometry: ModuleGeometry, record: WheelRecord, prior: WheelCalibration | None, noise: OdometryNoise | None,
    weights: Array | None = None,
) -> WheelFit:  # fmt: skip
    """As :func:`fit_wheels`, whatever it is that contradicts itself."""
    prior = prior or WheelCalibration.unknown(geometry)
    count = np.ones(geometry.modules, bool) if weights is None else weights >= 1.0
    if not count.all():
        prior = _doubted(prior, ~count)
    previous, start, widened = prior, prior, False
    for _ in range(PASSES):
        odometry = replay(geometry, record, prior=start, noise=noise, weights=weights)
        if odometry.contradiction > ABSURD:
            raise InputError(
                f"log: the wheels contradict each other by {100 * odometry.contradiction:.0f} % of their way; steering, leg "
                "and wheel angles are needed in radians, with the signs and in the order of the robot's file"
            )
        found = _as_believed(geometry, odometry.calibration, previous, start)
        moved = _numbers(found, geometry) - _numbers(start, geometry)
        wide = _doubts(geometry, previous, found, odometry, count)
        if max(wide) <= 1.0 and not (widened and np.abs(moved / _std(previous)).max() > MOVED):
            break
        scale = np.where(np.tile(count, 2), np.repeat(wide, geometry.modules), 1.0)
        widened, previous = True, replace(previous, covariance=previous.covariance * np.outer(scale, scale))
        start = replace(found, covariance=previous.covariance)
    _checked(odometry, record, previous, found, count)
    poses = odometry.global_poses
    return WheelFit(found, previous, count, poses.taken, len(record.places), poses.deviance)


def _doubted(prior: WheelCalibration, wheels: NDArray[np.bool_]) -> WheelCalibration:
    """What was known before, nothing of some ``wheels`` (n) bool: who reads the result sees that they were left out."""
    both, covariance = np.concatenate([wheels, wheels]), prior.covariance.copy()
    wide = np.maximum(_std(prior), np.repeat(LEFT_OUT, wheels.size))
    covariance[both, :], covariance[:, both] = 0.0, 0.0
    covariance[both, both] = wide[both] ** 2
    return replace(prior, covariance=covariance)


def _as_believed(
    geometry: ModuleGeometry, found: WheelCalibration, previous: WheelCalibration, start: WheelCalibration
) -> WheelCalibration:
    """What a pass ``found`` that began at ``start``, with the doubt of ``previous``, as if it had begun at its mean: where it begins
    is for the derivatives only, and no belief. What was not shown stays as it was: wheels that agreed would drag each other."""
    moved = _numbers(start, geometry) - _numbers(previous, geometry)
    moved = found.covariance @ np.linalg.pinv(previous.covariance, hermitian=True) @ moved
    apart = _numbers(found, geometry) - moved - _numbers(previous, geometry)
    n = geometry.modules
    for part in _PARTS(n).values():
        root, shown, ways = _shown(previous, found, part)
        ways = ways[:, shown >= SHOWN]
        apart[part] = root @ ways @ ways.T @ np.linalg.pinv(root) @ apart[part]
    radius = previous.wheel_radius + geometry.wheel_radius * apart[n:]
    return replace(found, steer_offset=previous.steer_offset + apart[:n], wheel_radius=radius)


def _contradicted(odometry: FusedOdometry) -> bool:
    """Whether too few global poses fit, or those that do fit badly."""
    lost = odometry.global_poses.rejected > REJECTED * (odometry.global_poses.taken + odometry.global_poses.rejected)
    return odometry.global_poses.taken < 2 or lost or odometry.global_poses.misfit > MISFIT


def _doubts(
    geometry: ModuleGeometry, previous: WheelCalibration, found: WheelCalibration, odometry: FusedOdometry,
    count: NDArray[np.bool_],
) -> list[float]:  # fmt: skip
    """Factors by which zeros and radii of the wheels that ``count`` are to be doubted more than before: 1 where they need not."""
    apart = _numbers(found, geometry) - _numbers(previous, geometry)
    parts = list(_PARTS(geometry.modules).values())
    wide = [_surprise(previous, found, part, apart) for part in parts]
    std = _std(previous).reshape(2, -1)[:, count]
    # wheels that point beside each other show zeros and radii that no pose shows, 2n - 3 parts of 2n of them
    n = int(count.sum())
    crooked = odometry.contradiction / np.sqrt(2.0 * np.mean(std**2) * (2 * n - 3) / (2 * n))
    if crooked > CROOKED:
        wide = [max(w, SURPRISING * crooked / CROOKED) for w in wide]
    if _contradicted(odometry) and max(wide) <= SURPRISING:
        wide = [max(w, WIDER) for w in wide]
    limits = np.array(MAXIMUM) / std.max(axis=1)
    return [max(1.0, min(w, maximum)) if w > SURPRISING else 1.0 for w, maximum in zip(wide, limits, strict=True)]


def _std(wheels: WheelCalibration) -> Array:
    """Standard deviations (2n) of zeros [rad] and radii (relative), never 0."""
    return np.maximum(np.concatenate(wheels.std), 1e-12)


def _checked(
    odometry: FusedOdometry, record: WheelRecord, previous: WheelCalibration, found: WheelCalibration, count: NDArray[np.bool_]
) -> None:  # fmt: skip
    """Raise :class:`InputError` for a record that contradicts itself or shows nothing."""
    n, available = found.modules, len(record.places)
    if _contradicted(odometry):
        times = f"{np.sqrt(odometry.global_poses.misfit / 3.0):.1f} times"
        why = "" if odometry.global_poses.taken < 2 else f", with {times} the errors that they state"
        zero, radius = (std[count].max() for std in previous.std)
        raise InputError(
            f"log: {odometry.global_poses.taken} of {available} global poses fit what wheels and gyro say{why}, though steer zeros may be "
            f"{1e3 * zero:.3g} mrad off and radii {100 * radius:.2g} %; check units, signs, times "
            "and standard deviations of the channel 'place', and whether the base was moved by hand or slipped"
        )
    if max(_shown(previous, found, part)[1].max(initial=0.0) for part in _PARTS(n).values()) < SHOWN:
        raise InputError(
            "log: the record shows nothing of the wheels that was not known before: the base must roll on between global poses, "
            "straight ahead and sideways for zeros and radii, farther than the poses are uncertain"
        )
