"""The states of input filters in a controller: what a frequency-aware MPC needs between its solves."""

from __future__ import annotations

import numpy as np

from wbmpc.errors import InputError
from wbmpc.model.augment import FrequencyShaping
from wbmpc.types import Observation


class FilterMemory:
    """Filter states of a frequency-aware problem (:func:`wbmpc.ocp.frequency_aware`), kept consistent with the applied input.

    ``u`` (nu): the input that acts at the start, for which the filters are at rest: no transient. At every tick
    :meth:`input` turns the policy's ν into u; after it :meth:`advance` with the u that was applied. The filters follow the applied input,
    so that clamping causes no windup. ``dynamics``: the problem's; ``states`` (k): of the filters.
    """

    def __init__(self, dynamics: FrequencyShaping, u: np.ndarray) -> None:
        if not isinstance(dynamics, FrequencyShaping):
            raise InputError("filter memory: the problem has no filters; valid: one of wbmpc.ocp.frequency_aware")
        self.dynamics = dynamics
        rest = np.zeros(dynamics.dynamics.state.size)
        self.states = dynamics.equilibrium(rest, np.asarray(u, float))[0][rest.size :]

    def state(self, x: np.ndarray) -> np.ndarray:
        """The wrapped state of the inner x (nx)."""
        return np.concatenate([x, self.states])

    def observation(self, t: float, x: np.ndarray) -> Observation:
        """What the MPC observes at time ``t`` [s] in the inner state x (nx)."""
        return Observation(t, self.state(x))

    def input(self, wrapped: np.ndarray) -> np.ndarray:
        """The inner input u (nu) for the policy's, ``wrapped`` (nu)."""
        return self.dynamics.acting(self.states, wrapped)

    def advance(self, u: np.ndarray, h: float) -> None:
        """``u`` (nu) has acted for ``h`` [s]."""
        self.states = self.dynamics.advance(self.states, np.asarray(u, float), h)

    def copy(self) -> FilterMemory:
        """An independent copy, for predictions."""
        other = FilterMemory.__new__(FilterMemory)
        other.dynamics, other.states = self.dynamics, self.states.copy()
        return other
