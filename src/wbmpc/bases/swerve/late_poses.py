"""Global poses that come late, taken in by a filter at the time they belong to."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.swerve import odometry_filter
from wbmpc.bases.swerve.odometry_filter import State
from wbmpc.bases.swerve.odometry_memory import Moment, OdometryMemory, state_of
from wbmpc.bases.swerve.odometry_step import Interval
from wbmpc.checks import covariance as checked_covariance
from wbmpc.checks import numbers
from wbmpc.errors import InputError
from wbmpc.types import POSE_AHEAD

#: A global pose whose normalized error squared is above this is rejected: 99.99 % of chi-square with 3 degrees of freedom.
GATE = 21.1
#: So many rejections in a row mean that the estimate is wrong and not the source: its next pose is taken as it is.
PATIENCE = 10


class LatePoses:
    """The ``past`` of a filter, whose present is in ``memory``. ``taken``, ``rejected``: how many global poses did and did not fit."""

    def __init__(self, memory: OdometryMemory) -> None:
        self._memory, self.past = memory, deque[Moment]()
        self._spare: Array | None = None  # a record that is not needed any more
        self.taken = self.rejected = self._rejections = 0
        self._misfits = self._deviance = 0.0

    @property
    def misfit(self) -> float:
        """Mean of the normalized squared errors of the global poses taken in: 3 is expected."""
        return self._misfits / max(self.taken, 1)

    @property
    def deviance(self) -> float:
        """Of all global poses that were judged, those that did not fit too: -2 times the logarithm of their likelihood, but for a constant
        for each. One that does not fit counts as one at the gate, as likely as any that far off."""
        return self._deviance

    def remember(self) -> None:
        """The state and the interval that the memory holds become past."""
        record, self._spare = self._spare, None
        if record is None:
            record = np.empty_like(self._memory.record)
        record[:] = self._memory.record
        self.past.append(Moment(record, self._memory.legs))

    def forget(self, before: float) -> None:
        """What was ``before`` a time [s] is not needed any more."""
        while self.past and self.past[0].record[0] < before:
            self._spare = self.past.popleft().record

    def clear(self) -> None:
        """Older global poses do not count any more."""
        self.past.clear()

    def correct(self, t: float, pose: ArrayLike, covariance: ArrayLike) -> bool:
        """Take in a global pose (x, y, yaw) that was true at time ``t`` [s], with its covariance (3, 3).

        The filter goes back to that time, corrects, and comes forward again. False when the pose is older than the
        past, of a future that no message has come from (:data:`~wbmpc.types.POSE_AHEAD`), or does not fit (:data:`GATE`, :data:`PATIENCE`).
        Raises :class:`InputError` for what is not finite, for a covariance that is none, and where pose and filter are both
        certain: which one is right cannot be decided. Nothing is lost then.
        """
        z, r = numbers("global pose", "pose", pose, 3), checked_covariance("global pose", covariance)
        if not np.isfinite(t):
            raise InputError(f"global pose: its time must be finite, got {t}")
        memory, back, last = self._memory, 0, float(self._memory.record[0])
        oldest = self.past[0].record[0] if self.past else last
        if t < oldest or -np.inf < last < t - POSE_AHEAD:
            return False
        state, rates = memory.state, np.zeros(3)
        while state.t > t:
            back += 1
            state = state_of(self.past[-back].record, state.mean.size)
        if back:
            step = self.past[-back].record[memory.state_end :]
            rates = step[Interval.SIZE : Interval.SIZE + 3] / step[Interval.H]
        corrected = self._corrected(state, rates, t, z, r)
        self.rejected += corrected is None
        self.taken += corrected is not None
        if corrected is not None:
            self._replay(corrected, back)
        return corrected is not None

    def _replay(self, state: State, back: int) -> None:
        """Go on from another ``state`` over the last ``back`` intervals."""
        memory = self._memory
        memory.set_state(state)
        end = memory.state_end
        for moment in [self.past[-k] for k in range(back, 0, -1)]:
            moment.record[:end] = memory.record[:end]
            memory.record[end:] = moment.record[end:]
            memory.legs = moment.legs
            memory.propagate()

    def _corrected(self, state: State, rates: Array, t: float, z: Array, r: Array) -> State | None:
        """The state with a pose taken in that belongs to a moment of the step after it, in which the base moves at ``rates``
        (3); None where it does not fit."""
        error = odometry_filter.apart(state, rates, t, z)
        misfit, log_determinant = odometry_filter.misfit(state, error, r)
        self._deviance += min(misfit, GATE) + log_determinant
        if misfit > GATE:
            self._rejections += 1
            if self._rejections <= PATIENCE:
                return None
            # the filter is lost: carried away, or by wheels that are worse than believed. Its pose is the source's
            self._rejections = 0
            return odometry_filter.replaced(state, error, r)
        self._rejections = 0
        self._misfits += misfit
        return odometry_filter.corrected(state, error, r)
