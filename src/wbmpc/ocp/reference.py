"""References over time: what a residual compares with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.checks import LATEST, real_numbers, unit_quaternions
from wbmpc.errors import InputError


@dataclass(frozen=True)
class Reference:
    """Samples of a reference: ``times`` (n,) [s, absolute], ``values`` (n, width).

    ``kind``: what holds between samples. "linear"; "pose": the quaternion part by normalized linear interpolation; "hold" and
    "pose_hold": the value of the last sample at or before t. Before the first and after the last sample the end values hold.
    """

    times: NDArray[np.float64]
    values: NDArray[np.float64]
    kind: str = "linear"

    KINDS = ("linear", "pose", "hold", "pose_hold")

    def __post_init__(self) -> None:
        times = np.ascontiguousarray(np.atleast_1d(real_numbers("reference, times", self.times)))
        values = np.ascontiguousarray(np.atleast_2d(real_numbers("reference, values", self.values)))
        if times.size == 0:
            raise InputError("reference: at least one sample is needed")
        if times.ndim != 1 or values.shape[0] != times.size:
            raise InputError(f"reference: {times.size} times need {times.size} rows of values, got {values.shape}")
        if not (np.isfinite(times).all() and np.isfinite(values).all()):
            raise InputError("reference: times and values must be finite")
        if np.abs(times).max() > LATEST:
            raise InputError(f"reference: times must be at most {LATEST:g} s, got {np.abs(times).max():g}")
        if np.any(np.diff(times) < 0):
            raise InputError("reference: times must not decrease")
        if self.kind not in self.KINDS:
            raise InputError(f"reference: unknown kind '{self.kind}'; valid: {', '.join(self.KINDS)}")
        if self.kind.startswith("pose"):
            values = _continuous_quaternions(values)
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)

    @classmethod
    def unchecked(cls, times: NDArray[np.float64], values: NDArray[np.float64]) -> Reference:
        """Linear between ``values`` (n, width) at ``times`` (n) [s] that a plan's own code has made: contiguous, finite and in order."""
        made = object.__new__(cls)  # (the checks take a tenth of a real-time iteration)
        vars(made).update(times=times, values=values, kind="linear")
        return made

    @classmethod
    def constant(cls, value: ArrayLike) -> Reference:
        """One ``value`` (width,) for all times."""
        return cls(np.zeros(1), np.atleast_2d(real_numbers("reference", value)))

    @classmethod
    def poses(cls, times: ArrayLike, positions: ArrayLike, quaternions: ArrayLike, hold: bool = False) -> Reference:
        """Poses: positions (n, 3) [m], unit quaternions (n, 4) or one (4,) for all times."""
        times = np.atleast_1d(real_numbers("reference, times", times))
        positions = np.atleast_2d(real_numbers("reference, positions", positions))
        rotations = real_numbers("reference, quaternions", quaternions)
        for name, given, width in (("positions", positions, 3), ("quaternions", rotations, 4)):
            if given.shape not in ((times.size, width), (width,)):
                raise InputError(
                    f"reference, {name}: {times.size} times need shape ({times.size}, {width}), got {given.shape}"
                )
        rotations = np.broadcast_to(rotations, (times.size, 4))
        return cls(times, np.hstack([positions, rotations]), "pose_hold" if hold else "pose")

    def at(self, t: float) -> NDArray[np.float64]:
        """The value (width,) at time t [s], as the solver samples it."""
        k = max(int(np.searchsorted(self.times, t + 1e-9, side="right")) - 1, 0)
        if self.kind.endswith("hold") or k == self.times.size - 1 or t <= self.times[0]:
            return self.values[k].copy()
        share = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        value: NDArray[np.float64] = (1.0 - share) * self.values[k] + share * self.values[k + 1]
        if self.kind == "pose":
            value[3:] /= np.linalg.norm(value[3:])
        return value


def _continuous_quaternions(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit length, and neighbors in the same half sphere (q and −q are the same rotation)."""
    if values.shape[1] != 7:
        raise InputError(f"reference: a pose has 7 numbers (position, quaternion), got {values.shape[1]}")
    values = values.copy()
    values[:, 3:] = unit_quaternions("reference", values[:, 3:])
    for i in range(1, len(values)):
        if values[i, 3:] @ values[i - 1, 3:] < 0.0:
            values[i, 3:] *= -1.0
    return values
