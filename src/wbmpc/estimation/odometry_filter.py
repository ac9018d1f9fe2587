"""Mathematics of :class:`wbmpc.estimation.fused_odometry.FusedOdometry`: its state, one interval on, and what legs and global poses say.

A Kalman filter on (x, y, yaw; gyro bias; lateness; steer zeros; wheel radii). Equations and sources: docs/explanation.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from wbmpc import lie
from wbmpc.checks import finite
from wbmpc.errors import InputError

Array = NDArray[np.float64]

#: Smallest eigenvalue of a matrix of correlations that has an inverse.
_CERTAIN = 1e-12
#: By so much the wheels' standard deviations grow when the filter was lost: a base that nobody carried away has wheels that
#: are worse than believed.
DOUBTED = 3.0
#: Places of gyro bias and lateness in the state; from WHEELS on the corrections of the wheels.
BIAS, LATE, WHEELS = 3, 4, 5


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
class LegsShow:
    """What legs show that give way: ``apart`` (k) [m], by which wheels and legs contradict each other at the correction ``fitted``
    of the step, its derivative (k, 2n) by (zeros, radii), its variance [m²], the same for each."""

    apart: Array
    by_wheels: Array
    variance: float


@dataclass(frozen=True)
class Step:
    """From one message to the next: length [s], twist and its derivative by (zeros, radii), both at the correction
    ``fitted``, covariance of the twist, variance of the wheels' turn by counts, turn that the gyro saw (NaN without)."""

    h: float
    twist: Array
    by_wheels: Array
    fitted: Array
    covariance: Array
    counts: float
    turn: float
    legs: LegsShow | None = None


@dataclass(frozen=True)
class State:
    """``mean``: x, y, yaw, gyro bias, lateness [rad], corrections of steer zeros and of radii; ``p``: covariance of its
    error."""

    t: float
    mean: Array
    p: Array


@cache
def _identity(size: int) -> Array:
    """Made once: NumPy lets go of the interpreter where it fills one, which a tick must not."""
    return np.eye(size)


def advanced(state: State, step: Step, noise: OdometryNoise) -> State:
    """One interval on: the wheels' twist moves the pose, the gyro's turn corrects it and everything behind it."""
    h, size = step.h, state.mean.size
    twist = step.twist + step.by_wheels @ (state.mean[WHEELS:] - step.fitted)
    mean = state.mean.copy()
    mean[:3] = lie.se2_step(state.mean[:3], twist)
    way, yaw = mean[:2] - state.mean[:2], state.mean[2] + 0.5 * twist[2]
    g = np.array([[np.cos(yaw), -np.sin(yaw), -0.5 * way[1]], [np.sin(yaw), np.cos(yaw), 0.5 * way[0]], [0, 0, 1.0]])
    a = _identity(size).copy()
    a[0, 2], a[1, 2], a[LATE, LATE] = -way[1], way[0], 0.0
    a[:3, WHEELS:] = g @ step.by_wheels
    moved_noise = g @ step.covariance
    rate = twist[2] / h if step.turn != step.turn else step.turn / h - state.mean[BIAS]
    late = (rate * noise.age) ** 2 + step.counts
    p = a @ state.p @ a.T
    p[:3, :3] += moved_noise @ g.T
    p[BIAS, BIAS] += noise.gyro_walk**2 * h
    behind = rate * noise.mean_age
    p[LATE, LATE], mean[LATE] = late, -behind
    if step.turn == step.turn:
        # what the gyro says less what it should: its bias and noise, the wheels' turn, lateness before and now
        row = np.zeros(size)
        row[BIAS], row[LATE], row[WHEELS:] = h, 1.0, step.by_wheels[2]
        reached = state.p @ row
        variance = row @ reached + step.covariance[2, 2] + late + noise.gyro**2 * h
        cross = a @ reached
        cross[:3] += moved_noise[:, 2]
        cross[LATE] = -late
        gain = cross / variance
        mean += gain * (step.turn - state.mean[BIAS] * h - state.mean[LATE] - behind - twist[2])
        p -= np.outer(gain, cross)
    if step.legs is not None:
        mean, p = _given_way(mean, p, step.legs, step.fitted)
    return State(state.t + h, mean, p)


def _given_way(mean: Array, p: Array, shown: LegsShow, fitted: Array) -> tuple[Array, Array]:
    """Mean and covariance with what open legs show: that they and the wheels do not contradict each other."""
    rows, apart = shown.by_wheels, shown.apart + shown.by_wheels @ (mean[WHEELS:] - fitted)
    cross = p[:, WHEELS:] @ rows.T
    s = rows @ cross[WHEELS:] + shown.variance * np.eye(len(rows))
    gain = np.linalg.solve(s, cross.T).T
    return mean - gain @ apart, p - gain @ cross.T


def apart(state: State, step: Step | None, t: float, pose: Array) -> Array:
    """By what (3) a pose of time ``t`` [s] is off from where a state has the base, ``step`` being the one after the state."""
    share = 0.0 if step is None else (t - state.t) / step.h
    there = state.mean[:3] if step is None else lie.se2_step(state.mean[:3], share * step.twist)
    error = pose - there
    error[2] = np.remainder(error[2] + np.pi, 2.0 * np.pi) - np.pi
    return np.asarray(error)


def misfit(state: State, error: Array, r: Array) -> float:
    """Normalised squared error of a pose that is off by ``error`` (3), with its covariance ``r`` (3, 3). Raises
    :class:`InputError` where pose and state are both certain."""
    s = state.p[:3, :3] + r
    _reject_certain(s)
    return float(error @ np.linalg.solve(s, error))


def corrected(state: State, error: Array, r: Array) -> State:
    """With a pose taken in that is off by ``error`` (3), with its covariance ``r`` (3, 3)."""
    gain = np.linalg.solve(state.p[:3, :3] + r, state.p[:3]).T
    keep = _identity(state.mean.size).copy()
    keep[:, :3] -= gain
    return State(state.t, state.mean + gain @ error, keep @ state.p @ keep.T + gain @ r @ gain.T)


def replaced(state: State, error: Array, r: Array) -> State:
    """Where a pose that is off by ``error`` (3) is, with its covariance ``r`` (3, 3); the wheels are doubted (``DOUBTED``)."""
    p = state.p.copy()
    p[:3, 3:], p[3:, :3], p[:3, :3] = 0.0, 0.0, r
    p[WHEELS:, :] *= DOUBTED
    p[:, WHEELS:] *= DOUBTED
    return State(state.t, np.concatenate([state.mean[:3] + error, state.mean[3:]]), p)


def _reject_certain(covariance: Array) -> None:
    """Raise :class:`InputError` for the covariance (3, 3) of a difference that is certain in some direction. Units do not count:
    a yaw that is not known at all (1e9 rad²) is none."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not spread.all() or np.linalg.eigvalsh(covariance / np.outer(spread, spread))[0] < _CERTAIN:
        raise InputError(
            "global pose: its covariance and the filter's own are both 0 in a direction, so that nothing can be weighed; valid: a "
            "covariance of full rank, or place() for where the base is exactly"
        )
