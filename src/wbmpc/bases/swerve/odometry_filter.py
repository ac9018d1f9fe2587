"""Mathematics of :class:`wbmpc.bases.swerve.fused_odometry.FusedOdometry`: its state, and what legs and global poses say.

One interval on: :mod:`wbmpc.bases.swerve.odometry_step`.

A Kalman filter on (x, y, yaw; gyro bias; lateness; steer zeros; wheel radii). Equations and sources: docs/explanation.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cache

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.swerve.odometry_step import WHEELS
from wbmpc.checks import finite, is_certain
from wbmpc.errors import InputError

#: By so much the wheels' standard deviations grow when the filter was lost: a base that was not carried away has wheels that
#: are worse than believed.
DOUBTED = 3.0


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviations of what is random.

    ``along``, ``across`` [m/√m]: each wheel's displacement over the way it rolls; ``slip_window`` [s]: over which the
    wheels' contradiction is averaged, longer than slip lasts; ``reading`` [m]: of where a wheel is (counts); ``age`` [s] of
    a message's encoders, ``mean_age`` [s] before it; ``gyro`` [rad/s/√Hz], ``gyro_walk`` [rad/s/√s], ``gyro_bias`` [rad/s]
    at the start. Defaults: 2^14 counts on a radius of 0.1 m, messages up to 2 ms old, a gyro of the order of an ADIS16448.
    """

    along: float = 3e-4
    across: float = 3e-4
    slip_window: float = 0.2
    reading: float = 1.1e-5
    age: float = 6e-4
    mean_age: float = 1e-3
    gyro: float = 2e-4
    gyro_walk: float = 2e-5
    gyro_bias: float = 0.01

    def __post_init__(self) -> None:
        """Raise :class:`~wbmpc.errors.InputError` for what no deviation can be."""
        finite("odometry noise", **asdict(self))
        if min(asdict(self).values()) < 0.0 or self.slip_window == 0.0:
            raise InputError(f"odometry noise: no number may be negative, and slip_window not 0, got {self}")


@dataclass(frozen=True)
class LegEvidence:
    """What legs show that give way: ``apart`` (k) [m], by which wheels and legs contradict each other at the correction ``fitted``
    of the step, its derivative (k, 2n) by (zeros, radii), its variance [m²], the same for each."""

    apart: Array
    by_wheels: Array
    variance: float


@dataclass(frozen=True)
class State:
    """``mean``: x, y, yaw, gyro bias, lateness [rad], corrections of steer zeros and of radii; ``p``: covariance of its
    error; ``lasted`` [s]: for how long the error of wheels that slide has moved the pose."""

    t: float
    mean: Array
    p: Array
    lasted: float = 0.0


@cache
def _identity(size: int) -> Array:
    """Made once: NumPy lets go of the interpreter where it fills one, which a tick must not."""
    return np.eye(size)


def with_open_legs(state: State, shown: LegEvidence, fitted: Array) -> State:
    """With what open legs show: that they and the wheels do not contradict each other; ``fitted`` (2n): the correction of the wheels
    at which ``shown`` was found."""
    mean, p = state.mean, state.p
    rows, apart = shown.by_wheels, shown.apart + shown.by_wheels @ (mean[WHEELS:] - fitted)
    cross = p[:, WHEELS:] @ rows.T
    s = rows @ cross[WHEELS:] + shown.variance * np.eye(len(rows))
    gain = np.linalg.solve(s, cross.T).T
    return State(state.t, mean - gain @ apart, p - gain @ cross.T, state.lasted)


def apart(state: State, rates: Array, t: float, pose: Array) -> Array:
    """By what (3) a pose of time ``t`` [s] is off from where a state has the base, which goes on from there at ``rates`` (3)
    [m/s, rad/s] of its body twist."""
    after = t - state.t if np.isfinite(state.t) else 0.0  # no message yet: it stands
    there = lie.se2_step(state.mean[:3], after * rates)
    error = pose - there
    error[2] = lie.wrapped(error[2])
    return np.asarray(error)


def misfit(state: State, error: Array, r: Array) -> tuple[float, float]:
    """Normalized squared error of a pose that is off by ``error`` (3), with its covariance ``r`` (3, 3), and the logarithm of the
    determinant that normalizes it. Raises :class:`InputError` where pose and state are both certain."""
    s = state.p[:3, :3] + r
    _reject_certain(s)
    return float(error @ np.linalg.solve(s, error)), float(np.linalg.slogdet(s)[1])


def corrected(state: State, error: Array, r: Array) -> State:
    """With a pose taken in that is off by ``error`` (3), with its covariance ``r`` (3, 3).

    It ends what wheels that slide have made of the position as far as it ends its variance: a precise one all of it."""
    gain = np.linalg.solve(state.p[:3, :3] + r, state.p[:3]).T
    keep = _identity(state.mean.size).copy()
    keep[:, :3] -= gain
    p = keep @ state.p @ keep.T + gain @ r @ gain.T
    before, after = state.p[0, 0] + state.p[1, 1], p[0, 0] + p[1, 1]
    return State(state.t, state.mean + gain @ error, p, state.lasted * float(after / before) if before > 0.0 else 0.0)


def replaced(state: State, error: Array, r: Array) -> State:
    """Where a pose that is off by ``error`` (3) is, with its covariance ``r`` (3, 3); the wheels are doubted (``DOUBTED``)."""
    p = state.p.copy()
    p[:3, 3:], p[3:, :3], p[:3, :3] = 0.0, 0.0, r
    p[WHEELS:, :] *= DOUBTED
    p[:, WHEELS:] *= DOUBTED
    return State(state.t, np.concatenate([state.mean[:3] + error, state.mean[3:]]), p)


def _reject_certain(covariance: Array) -> None:
    """Raise :class:`InputError` for the covariance (3, 3) of a difference that is certain in some direction."""
    if is_certain(covariance):
        raise InputError(
            "global pose: its covariance and the filter's own are both 0 in a direction, so that nothing can be weighed; valid: a "
            "covariance of full rank, or place() for where the base is exactly"
        )
