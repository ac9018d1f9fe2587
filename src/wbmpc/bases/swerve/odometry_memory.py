"""The arrays of the compiled fused odometry, and the past of which it keeps copies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.swerve.kalman_step import advance
from wbmpc.bases.swerve.odometry_filter import LegEvidence, OdometryNoise, State, with_open_legs
from wbmpc.bases.swerve.odometry_step import WHEELS, Interval, Noise, Otherwise, Way, farthest, measure
from wbmpc.bases.swerve.slip_step import WINDOWS, slip_memory
from wbmpc.bases.swerve.wheel_fit import WheelFit
from wbmpc.kernel.step import bind
from wbmpc.model.wheels import ModuleGeometry


class Moment(NamedTuple):
    """A state and the interval after it: a copy of ``OdometryMemory.record``, and what open legs showed."""

    record: Array
    legs: LegEvidence | None


class OdometryMemory:
    """``record``: time, ``mean`` (size), ``p`` (size, size) and ``lasted`` of the state, and the last interval: ``interval``
    (:class:`~wbmpc.bases.swerve.odometry_step.Interval`), ``twist`` (3), ``by_wheels`` (3 · 2n), ``correction`` (2n), ``covariance``
    (3, 3), all of them views of it. ``arrays``: everything by its name in the compiled functions.

    ``measure(h, turn, has_gyro)`` finds the interval from the positions ``before`` and ``now``, ``advance()`` moves the state
    over it; ``farthest()`` [rad]: how far the wheel turned that turned most; ``wheels``:
    the fit alone. ``legs``: what open legs showed in the interval.
    """

    def __init__(self, geometry: ModuleGeometry, radius: Array, noise: OdometryNoise) -> None:
        n, size = geometry.modules, WHEELS + 2 * geometry.modules
        self._made_of = geometry, radius, noise
        state = {"time": 1, "mean": size, "p": size * size, "lasted": 1}
        step = {"interval": int(Interval.SIZE), "twist": 3, "by_wheels": 6 * n, "correction": 2 * n, "covariance": 9}
        ends = np.cumsum([*state.values(), *step.values()])
        self.record = np.zeros(ends[-1])
        kept = dict(zip([*state, *step], np.split(self.record, ends[:-1]), strict=True))
        self.wheels = WheelFit(geometry, radius, twist=kept["twist"], correction=kept["correction"])
        self.state_end = int(ends[len(state) - 1])
        scratch = {"pose": 12, "by": 6 * n, "spread": 9, "cross": size}
        memory = {"off": 2 * n, "rolled_off": n, "way": int(Way.SIZE), "smoothed": 6 * n, "slip_mean": WINDOWS * 2 * n}
        memory |= {"apart": 2 * n + 2, "otherwise": int(Otherwise.SIZE)}
        self.arrays = {
            **self.wheels.memory,
            **kept,
            **{name: np.zeros(length) for name, length in (scratch | memory).items()},
            "inertial": np.zeros(3),
            "slip": slip_memory(),
            "noise": np.array([getattr(noise, entry.name.lower()) for entry in Noise], float),
        }
        a = self.arrays
        self.measure = bind(measure, a, n=n)
        self.advance = bind(advance, a, n=n)
        self.farthest = bind(farthest, a, n=n)
        self.legs: LegEvidence | None = None

    @property
    def state(self) -> State:
        """The state now: views, which move on with the memory."""
        return state_of(self.record, self.arrays["mean"].size)

    def propagate(self) -> None:
        """Move the state over the interval, and take in what open legs showed in it."""
        self.advance()
        self.record[0] += self.arrays["interval"][Interval.H]
        if self.legs is not None:
            self.set_state(with_open_legs(self.state, self.legs, self.arrays["correction"]))

    def set_state(self, state: State) -> None:
        """Go on from another state."""
        a = self.arrays
        a["time"][0], a["mean"][:], a["p"][:], a["lasted"][0] = state.t, state.mean, state.p.ravel(), state.lasted

    def forget_sliding(self) -> None:
        """Wheels that slide from now on begin to."""
        for name in ("apart", "otherwise", "lasted"):
            self.arrays[name][:] = 0.0

    def __deepcopy__(self, memo: dict[int, object]) -> OdometryMemory:
        """Views stay views of the copy's own record."""
        made = OdometryMemory(*self._made_of)
        for name, array in self.arrays.items():
            made.arrays[name][:] = array
            memo[id(array)] = made.arrays[name]  # steps of others that read it read the copy's
        made.legs = self.legs
        return made


def state_of(record: Array, size: int) -> State:
    """The state in a record, as views."""
    end = 1 + size + size * size
    return State(float(record[0]), record[1 : 1 + size], record[1 + size : end].reshape(size, size), float(record[end]))
